"""A map for a round robot's questions: clearance, lines of sight, shortest paths.

Only the floor around the line and the robot matters. `crop` cuts that window out of the map, so that the computing time
does not depend on the map's size; the path of a robot outside the window enters at the window's edge.
"""

from __future__ import annotations

from typing import Optional

import cv2
import numpy as np

from vb_core.grid_layers import Window, clearance_grid, sample
from vb_core.grid_map import GridMap
from vb_robot.shortest_paths import ShortestPaths

STOP_MARGIN = 0.10  # [m] clearance beyond the radius where a robot stops
TRAVEL_MARGIN = 0.03  # [m] clearance beyond the radius on the path; navigation keeps its own inflation
BLOCKED_THRESHOLD = 50  # [%] a cell of this occupancy or more is blocked, even by a soft border
PATH_CELL = 0.05  # [m] least cell size of the grid on which paths are searched
MAX_PATH_CELLS = 10000  # a larger map is searched on coarser cells: a search takes 1 ms per 1,000 cells
START_TOLERANCE = 0.35  # [m] distance from free cells at which a path may start, for a robot at a wall
WINDOW_MARGIN = 3.0  # [m] around robot and line: robots look from up to 1.5 m, the line is extrapolated by 0.8 m
MAX_WINDOW_REACH = 8.0  # [m] robots and lines farther away do not enlarge the window
WINDOW_STEP = 2.0  # [m] windows start and end at multiples of this, so that one can be reused while the spot moves


def bounding_window(spot, *other_points) -> Window:
    """Returns the window (x_min, y_min, x_max, y_max) [m] around a spot (2,) [m] and those points (N, 2) near it."""
    spot = np.asarray(spot, dtype=float)
    points = np.vstack([spot[None], *(np.asarray(group, dtype=float).reshape(-1, 2) for group in other_points)])
    points = points[np.abs(points - spot).max(axis=1) <= MAX_WINDOW_REACH]
    low = np.floor((points.min(axis=0) - WINDOW_MARGIN) / WINDOW_STEP) * WINDOW_STEP
    high = np.ceil((points.max(axis=0) + WINDOW_MARGIN) / WINDOW_STEP) * WINDOW_STEP
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


class ClearanceMap:
    """A map prepared for queries about positions and paths. Constructed once per map and window.

    Args:
        grid: the map with borders: physical obstacles and borders.
        radius: [m] of the robot.
        physical: the map without borders, since borders do not block the view; None to use `grid`.
    """

    def __init__(self, grid: GridMap, radius: float, physical: Optional[GridMap] = None) -> None:
        self.grid, self.radius = grid, radius
        self.blocked = (grid.data >= BLOCKED_THRESHOLD) | (grid.data < 0)
        self.clearance = clearance_grid(self.blocked, grid.resolution)
        visible_map = physical if physical is not None and physical.same_geometry(grid) else grid
        self.opaque = visible_map.data >= BLOCKED_THRESHOLD

    # ------------------------------------------------------------- places
    def has_room_at(self, points: np.ndarray) -> np.ndarray:
        """Returns (N,) bool: whether the robot and its margin fit at points (N, 2) [m]."""
        return sample(self.grid, self.clearance, points) >= self.radius + STOP_MARGIN

    def line_of_sight(self, points: np.ndarray, target) -> np.ndarray:
        """Returns (N,) bool: whether nothing opaque lies between points (N, 2) and a target (2,) [m]."""
        points = np.asarray(points, dtype=float).reshape(-1, 2)
        offsets = points - np.asarray(target, dtype=float)
        lengths = np.linalg.norm(offsets, axis=1)
        # samples have fixed distances from the target, so that one point's result does not depend on the others; the
        # first piece is left out, because a spot at the foot of a wall is visible though its cell may be the wall's
        distances = np.arange(2.0 * self.grid.resolution, lengths.max(initial=0.0), 0.5 * self.grid.resolution)
        units = offsets / np.maximum(lengths, 1e-9)[:, None]
        samples = target + distances[None, :, None] * units[:, None, :]
        hidden = sample(self.grid, self.opaque, samples.reshape(-1, 2), outside=1.0).reshape(samples.shape[:2])
        hidden = np.where(distances[None, :] < lengths[:, None], hidden, 0.0)
        return ~(hidden > 0).any(axis=1)

    # ------------------------------------------------------------- paths
    def path_lengths(self, start, positions: np.ndarray, others=(), closed: Optional[np.ndarray] = None) -> np.ndarray:
        """Returns the lengths (N,) [m] of the shortest paths from a start (2,) [m] to positions (N, 2) [m].

        A length is inf if there is no path. Other robots (K, 2) [m], of the same size, and closed cells (H, W) bool are
        in the way. A start outside a window is joined to the free cells of its edge by straight lines.
        """
        start, others = np.asarray(start, dtype=float), np.asarray(others, dtype=float).reshape(-1, 2)
        min_cell_size = self.grid.resolution * np.sqrt(self.grid.data.size / MAX_PATH_CELLS)
        step = max(1, int(np.ceil(max(PATH_CELL, min_cell_size) / self.grid.resolution - 0.01)))
        rows, columns = (size // step for size in self.grid.shape)
        block_clearances = self.clearance[: rows * step, : columns * step].reshape(rows, step, columns, step)
        # a block has its largest clearance, because the smallest would close doorways that are wide enough
        free = block_clearances.max(axis=(1, 3), initial=0.0) >= self.radius + TRAVEL_MARGIN
        if closed is not None:
            free &= ~closed[: rows * step, : columns * step].reshape(block_clearances.shape).any(axis=(1, 3))
        cells = np.argwhere(free)
        centers = self.grid.cell_to_world(cells * step + (step - 1) / 2.0)
        for other in others:
            free[tuple(cells[np.linalg.norm(centers - other, axis=1) < 2.0 * self.radius + TRAVEL_MARGIN].T)] = False
        entry_costs = np.where(free[tuple(cells.T)], np.linalg.norm(centers - start, axis=1), np.inf)
        if self.grid.contains_cells(self.grid.world_to_cell(start))[0]:
            entries = np.argsort(entry_costs, kind="stable")[:1]
            entries = entries[entry_costs[entries] <= START_TOLERANCE]
            entry_costs = np.zeros(len(entry_costs))
        else:
            at_edge = ((cells == 0) | (cells == np.array(free.shape) - 1)).any(axis=1)
            entries = np.flatnonzero(at_edge & np.isfinite(entry_costs))
        paths = ShortestPaths(np.where(free, step * self.grid.resolution, np.inf), cells[entries], entry_costs[entries])
        goal_cells = self.grid.world_to_cell(positions) // step
        inside = ((goal_cells >= 0) & (goal_cells < np.array(free.shape))).all(axis=1)
        lengths = np.full(len(goal_cells), np.inf)
        lengths[inside] = paths.costs[tuple(goal_cells[inside].T)]
        return lengths

    # ------------------------------------------------------------- sides
    def side_of(self, seed, chain: np.ndarray, closed: bool) -> Optional[np.ndarray]:
        """Predicts the area that a border along the chain would restrict with this seed; an approximation.

        Args:
            seed: (2,) [m]; chain: (M, 2) [m]; open ends are extended straight to the next obstacle.

        Returns:
            (H, W) bool; None if the chain separates no area.
        """
        chain = np.asarray(chain, dtype=float).reshape(-1, 2)
        if len(chain) < 2:
            return None
        if not closed:
            chain = np.vstack(
                [self.ray_end(chain[0], chain[0] - chain[1]), chain, self.ray_end(chain[-1], chain[-1] - chain[-2])]
            )
        free = (~self.blocked).astype(np.uint8)
        pixels = np.rint(self.grid.world_to_grid(chain)).astype(np.int32)
        cv2.polylines(free, [pixels.reshape(-1, 1, 2)], closed, 0, thickness=1, lineType=cv2.LINE_8)
        _, labels = cv2.connectedComponents(free, connectivity=4)
        label = sample(self.grid, labels, np.asarray(seed, dtype=float).reshape(1, 2))[0]
        area = labels == label
        return area if label > 0 and area.sum() <= 0.98 * int(free.sum()) else None

    def ray_end(self, start: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Returns the point (2,) [m] where a ray meets a blocked cell or the map's edge."""
        norm = float(np.linalg.norm(direction))
        if norm < 1e-9:
            return start
        max_length = float(np.hypot(*self.grid.shape)) * self.grid.resolution
        distances = np.arange(0.0, max_length, self.grid.resolution / 2.0)
        points = start + distances[:, None] * (direction / norm)
        blocked = np.flatnonzero(sample(self.grid, self.blocked, points, outside=1.0) > 0)
        return points[blocked[0]] if len(blocked) else points[-1]
