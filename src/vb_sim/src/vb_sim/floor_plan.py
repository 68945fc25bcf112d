"""Draws the occupancy grid that SLAM would produce in a world, and the ground truth of its scenarios."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Tuple

import numpy as np
import shapely
from shapely.geometry import Polygon

from vb_core.grid_map import FREE, OCCUPIED, UNKNOWN, GridMap
from vb_sim.world import Furniture, Room, Scenario, Wall, World


def physical_map(world: World) -> GridMap:
    """Draws the physical map, in which walls and furniture are occupied and cells beyond the walls unknown."""
    grid = _physical_map(world.room, world.walls, world.furniture)
    return grid.with_data(grid.data.copy())


@lru_cache(maxsize=4)
def _physical_map(room: Room, walls: Tuple[Wall, ...], furniture: Tuple[Furniture, ...]) -> GridMap:
    margin_cells = int(math.ceil(room.margin / room.resolution - 1e-9))
    columns = int(round(room.size[0] / room.resolution)) + 2 * margin_cells
    rows = int(round(room.size[1] / room.resolution)) + 2 * margin_cells
    offset = -margin_cells * room.resolution
    grid = GridMap(np.full((rows, columns), UNKNOWN, np.int8), room.resolution, (offset, offset, 0.0))
    inside = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]) * room.size
    outwards = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    grid.data[outline_mask(grid, inside + outwards * min(room.wall_thickness, room.margin))] = OCCUPIED
    grid.data[outline_mask(grid, inside)] = FREE
    contacts = [contact for thing in furniture for contact in thing.contact_outlines()]
    for outline in [*map(wall_outline, walls), *contacts]:
        grid.data[outline_mask(grid, outline)] = OCCUPIED
    return grid


def ground_truth(world: World, scenario: Scenario) -> np.ndarray:
    """Returns (H, W) bool: the free cells that the scenario asks to restrict, in the geometry of `physical_map`.

    It corresponds to the ground truth map that the paper's authors drew by hand (Sect. 5.5). It does not use the code
    that integrates borders.
    """
    grid = physical_map(world)
    return outline_mask(grid, scenario.region) & (grid.data == FREE)


def wall_outline(wall: Wall) -> np.ndarray:
    """Returns a wall's outline (4, 2) [m] seen from above."""
    a, b = np.array(wall.start, dtype=float), np.array(wall.end, dtype=float)
    along = (b - a) / max(float(np.linalg.norm(b - a)), 1e-9)
    across = np.array([-along[1], along[0]]) * wall.thickness / 2.0
    return np.array([a - across, b - across, b + across, a + across])


def outline_mask(grid: GridMap, outline: np.ndarray) -> np.ndarray:
    """Returns (H, W) bool: the cells, at least one, whose centres are within an outline (N, 2) [m]."""
    mask = np.zeros(grid.shape, bool)
    corners = grid.world_to_grid(outline)
    low = np.maximum(np.floor(corners.min(axis=0)).astype(int), 0)
    high = np.minimum(np.ceil(corners.max(axis=0)).astype(int) + 1, np.array(grid.shape)[::-1])
    if (high <= low).any():
        return mask
    columns, rows = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    mask[low[1] : high[1], low[0] : high[0]] = shapely.contains_xy(Polygon(corners), columns, rows)
    if not mask.any():
        # even a table leg thinner than a cell stops a robot
        row, column = grid.world_to_cell(np.mean(outline, axis=0))[0]
        if 0 <= row < grid.shape[0] and 0 <= column < grid.shape[1]:
            mask[row, column] = True
    return mask
