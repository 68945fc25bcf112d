"""The map as a round robot sees it: clearance, lines of sight, shortest paths.

Only the floor around the line and the robot matters. `crop` cuts that window out of the map, so that the cost of a
choice does not depend on the map's size; the path of a robot outside it enters at the window's edge.
"""

from __future__ import annotations

from typing import Optional

import cv2
import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from vb_core.grid_map import GridMap, Window, clearance_grid, sample

STOP_MARGIN = 0.10  # [m] beyond the radius where a robot stops
TRAVEL_MARGIN = 0.03  # [m] beyond the radius on the path; navigation keeps its own inflation
BLOCKED_THRESHOLD = 50  # [%] from this occupancy on a cell is blocked, even by a soft border
PATH_CELL = 0.05  # [m] cell size of the grid on which paths are searched, on maps of this size or finer ...
MAX_PATH_CELLS = 10000  # ... but coarser on maps that would have more cells: a search costs 1 ms per 1,000
START_TOLERANCE = 0.35  # [m] how far from free cells a path may start, for a robot at a wall
WINDOW_MARGIN = 3.0  # [m] of floor around what matters: robots look from up to 1.5 m, the line is extrapolated by 0.8 m
MAX_WINDOW_REACH = 8.0  # [m] robots and lines farther away do not make the window larger
WINDOW_STEP = 2.0  # [m] windows begin and end at multiples of this, so that one serves for a while as the spot moves
NEIGHBORS = ((0, 1), (1, 0), (1, 1), (1, -1))  # (rows, columns): each joins two cells in both directions


def bounding_window(spot, *others) -> Window:
    """Returns the window (x_min, y_min, x_max, y_max) [m] around a spot (2,) [m] and the points (N, 2) near it."""
    spot = np.asarray(spot, dtype=float)
    points = np.vstack([spot[None], *(np.asarray(some, dtype=float).reshape(-1, 2) for some in others)])
    points = points[np.abs(points - spot).max(axis=1) <= MAX_WINDOW_REACH]
    low = np.floor((points.min(axis=0) - WINDOW_MARGIN) / WINDOW_STEP) * WINDOW_STEP
    high = np.ceil((points.max(axis=0) + WINDOW_MARGIN) / WINDOW_STEP) * WINDOW_STEP
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


class ClearanceMap:
    """A map prepared for queries about positions and paths. Made once per map and window.

    Args:
        grid: the map with borders: physical obstacles and borders.
        radius: [m] of the robot.
        physical: the map without borders, which decides what blocks the view; a border does not. None: `grid`.
    """

    def __init__(self, grid: GridMap, radius: float, physical: Optional[GridMap] = None) -> None:
        self.grid, self.radius = grid, radius
        self.blocked = (grid.data >= BLOCKED_THRESHOLD) | (grid.data < 0)
        self.clearance = clearance_grid(self.blocked, grid.resolution)
        seen_through = physical if physical is not None and physical.same_geometry(grid) else grid
        self.opaque = seen_through.data >= BLOCKED_THRESHOLD

    # ------------------------------------------------------------- places
    def has_room_at(self, points: np.ndarray) -> np.ndarray:
        """Returns (N,) bool: whether there is room for the robot and its margin at points (N, 2) [m]."""
        return sample(self.grid, self.clearance, points) >= self.radius + STOP_MARGIN

    def line_of_sight(self, points: np.ndarray, target) -> np.ndarray:
        """Returns (N,) bool: whether nothing opaque lies between points (N, 2) and a target (2,) [m]."""
        points = np.asarray(points, dtype=float).reshape(-1, 2)
        offsets = points - np.asarray(target, dtype=float)
        lengths = np.linalg.norm(offsets, axis=1)
        # from the target outwards at fixed steps, so that one point's answer does not depend on the others; the
        # first piece is left out: a spot at the foot of a wall is visible although its cell may be the wall's
        along = np.arange(2.0 * self.grid.resolution, lengths.max(initial=0.0), 0.5 * self.grid.resolution)
        units = offsets / np.maximum(lengths, 1e-9)[:, None]
        samples = target + along[None, :, None] * units[:, None, :]
        hidden = sample(self.grid, self.opaque, samples.reshape(-1, 2), outside=1.0).reshape(samples.shape[:2])
        hidden = np.where(along[None, :] < lengths[:, None], hidden, 0.0)
        return ~(hidden > 0).any(axis=1)

    # ------------------------------------------------------------- paths
    def path_lengths(self, start, places: np.ndarray, others=(), barred: Optional[np.ndarray] = None) -> np.ndarray:
        """Returns the lengths (N,) [m] of the shortest paths from a start (2,) [m] to places (N, 2) [m]; inf: no path.

        Other robots (K, 2) [m], of the same size, and barred cells (H, W) bool are in the way. A start outside a
        window is joined to the free cells of its edge by straight lines.
        """
        start, others = np.asarray(start, dtype=float), np.asarray(others, dtype=float).reshape(-1, 2)
        coarse = self.grid.resolution * np.sqrt(self.grid.data.size / MAX_PATH_CELLS)
        step = max(1, int(np.ceil(max(PATH_CELL, coarse) / self.grid.resolution - 0.01)))
        rows, columns = (size // step for size in self.grid.shape)
        blocks = self.clearance[: rows * step, : columns * step].reshape(rows, step, columns, step)
        # the largest clearance of a block: the smallest would close doorways that are wide enough
        free = blocks.max(axis=(1, 3), initial=0.0) >= self.radius + TRAVEL_MARGIN
        if barred is not None:
            free &= ~barred[: rows * step, : columns * step].reshape(blocks.shape).any(axis=(1, 3))
        cells = np.argwhere(free)
        centers = self.grid.cell_to_world(cells * step + (step - 1) / 2.0)
        for other in others:
            free[tuple(cells[np.linalg.norm(centers - other, axis=1) < 2.0 * self.radius + TRAVEL_MARGIN].T)] = False
        gaps = np.where(free[tuple(cells.T)], np.linalg.norm(centers - start, axis=1), np.inf)
        if self.grid.contains_cells(self.grid.world_to_cell(start))[0]:
            gates = np.argsort(gaps, kind="stable")[:1]
            gates = gates[gaps[gates] <= START_TOLERANCE]
            gaps = np.zeros(len(gaps))
        else:
            at_edge = ((cells == 0) | (cells == np.array(free.shape) - 1)).any(axis=1)
            gates = np.flatnonzero(at_edge & np.isfinite(gaps))
        paths = ShortestPaths(np.where(free, step * self.grid.resolution, np.inf), cells[gates], gaps[gates])
        wanted = self.grid.world_to_cell(places) // step
        inside = ((wanted >= 0) & (wanted < np.array(free.shape))).all(axis=1)
        lengths = np.full(len(wanted), np.inf)
        lengths[inside] = paths.costs[tuple(wanted[inside].T)]
        return lengths

    # ------------------------------------------------------------- sides
    def side_of(self, seed, chain: np.ndarray, closed: bool) -> Optional[np.ndarray]:
        """Predicts what a border along the chain would restrict with this seed, less exactly than the integration.

        Args:
            seed: (2,) [m]; chain: (M, 2) [m]; open ends are extended straight to the next obstacle.

        Returns:
            (H, W) bool; None if the chain separates nothing.
        """
        chain = np.asarray(chain, dtype=float).reshape(-1, 2)
        if len(chain) < 2:
            return None
        if not closed:
            chain = np.vstack(
                [self.ray_end(chain[0], chain[0] - chain[1]), chain, self.ray_end(chain[-1], chain[-1] - chain[-2])]
            )
        canvas = (~self.blocked).astype(np.uint8)
        pixels = np.rint(self.grid.world_to_grid(chain)).astype(np.int32)
        cv2.polylines(canvas, [pixels.reshape(-1, 1, 2)], closed, 0, thickness=1, lineType=cv2.LINE_8)
        _, labels = cv2.connectedComponents(canvas, connectivity=4)
        label = sample(self.grid, labels, np.asarray(seed, dtype=float).reshape(1, 2))[0]
        side = labels == label
        return side if label > 0 and side.sum() <= 0.98 * int(canvas.sum()) else None

    def ray_end(self, start: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Returns where (2,) [m] a ray from a start along a direction meets a blocked cell or the map's edge."""
        norm = float(np.linalg.norm(direction))
        if norm < 1e-9:
            return start
        reach = float(np.hypot(*self.grid.shape)) * self.grid.resolution
        steps = np.arange(0.0, reach, self.grid.resolution / 2.0)
        points = start + steps[:, None] * (direction / norm)
        hits = np.flatnonzero(sample(self.grid, self.blocked, points, outside=1.0) > 0)
        return points[hits[0]] if len(hits) else points[-1]


class ShortestPaths:
    """Finds least-cost paths from one start over a grid (Dijkstra, 8-connected).

    Args:
        cost: (H, W) of a step of one cell's side in each cell; inf: it is never entered.
        gates: (K, 2) cells (row, column) where paths begin; entry: (K,) the cost of reaching them from the start.

    Attributes:
        costs: (H, W) of the path to each cell; inf where there is none.
    """

    def __init__(self, cost: np.ndarray, gates: np.ndarray, entry: np.ndarray) -> None:
        rows, columns = cost.shape
        index = np.arange(cost.size).reshape(cost.shape)
        # the start is one more node; a length of 0 would be no edge
        edges = [(np.full(len(gates), cost.size), index[tuple(gates.T)], np.maximum(entry, 1e-6))]
        for dr, dc in NEIGHBORS:
            here = (slice(0, rows - dr), slice(max(0, -dc), columns - max(0, dc)))
            there = (slice(dr, rows), slice(max(0, dc), columns + min(0, dc)))
            length = 0.5 * np.hypot(dr, dc) * (cost[here] + cost[there])
            both = np.isfinite(length)
            edges.append((index[here][both], index[there][both], length[both]))
        begin, end, length = (np.concatenate(column) for column in zip(*edges))
        graph = csr_matrix((length, (begin, end)), shape=(cost.size + 1, cost.size + 1))
        costs, self._before = dijkstra(graph, directed=False, indices=cost.size, return_predecessors=True)
        self.costs = costs[:-1].reshape(cost.shape)

    def path_to(self, cell) -> np.ndarray:
        """Returns the cells (N, 2) of the path to a cell (row, column), in order; (0, 2) if there is none."""
        node, path = int(np.ravel_multi_index(tuple(cell), self.costs.shape)), []
        while np.isfinite(self.costs[tuple(cell)]) and node != self.costs.size:
            path.append(node)
            node = int(self._before[node])
        return np.column_stack(np.unravel_index(np.array(path[::-1], dtype=int), self.costs.shape))
