"""A map of one room, borders in it, and integrators that keep them."""

import numpy as np

from vb_core.grid_map import GridMap
from vb_map_integration.border import VirtualBorder
from vb_map_integration.border_region import compute_region
from vb_map_integration.map_integrator import MapIntegrator


def room(height=120, width=160, origin=(-1.0, -1.0, 0.2)):
    data = np.zeros((height, width), np.int8)
    data[[0, -1]] = 100
    data[:, [0, -1]] = 100
    return GridMap(data, 0.05, origin)


GRID = room()


def at(*points, grid=GRID):
    return grid.grid_to_world(np.array(points, float))


def square(column, row, size=20, grid=GRID, **options):
    corners = at((column, row), (column + size, row), (column + size, row + size), (column, row + size), grid=grid)
    return VirtualBorder(corners, at((column + size / 2, row + size / 2), grid=grid)[0], closed=True, **options)


def integrator(root=None, grid=GRID, **params):
    result = MapIntegrator(root, **params)
    if grid is not None:
        result.set_map(grid)
    return result


def status_of_first(keeper):
    """Returns whether the first border is in force, and the reason if it is not, or is to be confirmed."""
    status = next(iter(keeper.in_force.statuses.values()))
    return status.is_in_force, status.reason


def expected(keeper):
    """Returns the cells of the map with borders, computed border by border."""
    cells = keeper.physical
    for border in keeper.borders:
        if border.enabled:
            cells = cells.with_data(np.maximum(cells.data, compute_region(keeper.physical, border).posterior.data))
    return cells.data
