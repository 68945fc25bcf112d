"""Rooms that several tests of this package share."""

import numpy as np

from vb_core.grid_map import GridMap


def empty(width=8.0, height=5.0, resolution=0.025):
    """A floor without anything on it, its origin at (0, 0)."""
    return GridMap(np.zeros((round(height / resolution), round(width / resolution)), np.int8), resolution)


def room(width=8.0, height=5.0, resolution=0.05):
    """The same with walls of one cell."""
    grid = empty(width, height, resolution)
    grid.data[[0, -1]], grid.data[:, [0, -1]] = 100, 100
    return grid
