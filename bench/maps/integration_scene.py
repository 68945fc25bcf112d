"""The map and the borders of the benches of integration: a house of many rooms, polygons and curves in it."""

from __future__ import annotations

import numpy as np

from vb_core.grid_map import GridMap
from vb_map_integration.border import VirtualBorder


def house(width: int, height: int) -> GridMap:
    """Rooms of 160 x 100 cells, with doors and table legs."""
    data = np.zeros((height, width), np.int8)
    data[::100] = 100
    data[:, ::160] = 100
    data[[-1]] = 100
    data[:, [-1]] = 100
    for row in range(50, height - 1, 100):
        data[row : row + 30, 160 : width - 1 : 160] = 0
    for column in range(80, width - 1, 160):
        data[100 : height - 1 : 100, column : column + 30] = 0
    data[40::100, 40::160] = 100
    return GridMap(data, 0.025, (-10.0, -5.0, 0.0))


def polygon(grid: GridMap, random: np.random.Generator, share: float) -> VirtualBorder:
    """Makes a polygon with 100 points; its diameter is a share of the map's shorter side."""
    height, width = grid.shape
    radius = 0.5 * share * min(height, width)
    center = random.uniform((radius, radius), (width - radius, height - radius))
    angles = np.linspace(0.0, 2.0 * np.pi, 100, endpoint=False)
    radii = radius * (0.9 + 0.1 * np.cos(7 * angles))
    points = center + radii[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    seed = center
    while grid.data[int(round(seed[1])), int(round(seed[0]))] != 0:
        seed = center + random.uniform(-0.5, 0.5, 2) * radius
    return VirtualBorder(grid.grid_to_world(points), grid.grid_to_world(seed)[0], closed=True)


def curve(grid: GridMap, random: np.random.Generator) -> VirtualBorder:
    """Makes a drawn curve of 100 points across half of the map: its extensions go through rooms and doors."""
    height, width = grid.shape
    x = width * random.uniform(0.3, 0.7)
    rows = np.linspace(0.25, 0.75, 100) * height
    points = np.column_stack([x + 3.0 * np.sin(rows / 20.0), rows])
    seed = np.array([x - 0.2 * width, 0.5 * height])
    while grid.data[int(round(seed[1])), int(round(seed[0]))] != 0:
        seed += 3.0
    return VirtualBorder(grid.grid_to_world(points), grid.grid_to_world(seed)[0], closed=False)
