"""Draws the occupancy grid that SLAM would make of a world, and the ground truth of its scenarios."""

from __future__ import annotations

import math

import numpy as np
import shapely
from shapely.geometry import Polygon

from vb_core.grid_map import FREE, OCCUPIED, UNKNOWN, GridMap
from vb_sim.world import Scenario, Wall, World


def physical_map(world: World) -> GridMap:
    """Draws the physical map, in which walls and furniture are occupied and cells beyond the walls unknown."""
    room = world.room
    margin_cells = math.ceil(room.margin / room.resolution - 1e-9)
    columns = round(room.size[0] / room.resolution) + 2 * margin_cells
    rows = round(room.size[1] / room.resolution) + 2 * margin_cells
    offset = -margin_cells * room.resolution
    grid = GridMap(np.full((rows, columns), UNKNOWN, np.int8), room.resolution, (offset, offset, 0.0))
    width, height = room.size
    for t, value in ((min(room.wall_thickness, room.margin), OCCUPIED), (0.0, FREE)):
        right, top = width + t, height + t
        outline = np.array([(-t, -t), (right, -t), (right, top), (-t, top)])
        grid.data[outline_mask(grid, outline)] = value
    obstacles = [wall_outline(wall) for wall in world.walls]
    for thing in world.furniture:
        obstacles += thing.contact_outlines()
    for outline in obstacles:
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
    a = np.array(wall.start, dtype=float)
    b = np.array(wall.end, dtype=float)
    length = max(float(np.linalg.norm(b - a)), 1e-9)
    along_x, along_y = (b - a) / length
    across = np.array([-along_y, along_x]) * wall.thickness / 2.0
    return np.array([a - across, b - across, b + across, a + across])


def outline_mask(grid: GridMap, outline: np.ndarray) -> np.ndarray:
    """Returns (H, W) bool: the cells, at least one, whose centres are within an outline (N, 2) [m]."""
    mask = np.zeros(grid.shape, bool)
    corners = grid.world_to_grid(outline)
    low, high = np.floor(corners.min(axis=0)), np.ceil(corners.max(axis=0)) + 1
    left, bottom = np.maximum(low.astype(int), 0)
    right, top = np.minimum(high.astype(int), grid.shape[::-1])
    if right <= left or top <= bottom:
        return mask
    columns, rows = np.meshgrid(np.arange(left, right), np.arange(bottom, top))
    mask[bottom:top, left:right] = shapely.contains_xy(Polygon(corners), columns, rows)
    if not mask.any():
        # even a table leg thinner than a cell stops a robot
        center = grid.world_to_cell(np.mean(outline, axis=0))
        mask[tuple(center[grid.contains_cells(center)].T)] = True
    return mask
