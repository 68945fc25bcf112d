"""Answers queries about a map for a round robot: clearance, lines of sight, shortest paths.

Only the floor around the line and the robots matters. `bounding_window` gives the window of the map that contains it,
so that the time for a query does not depend on the map's size. The path of a robot outside enters at its edge.
"""

from __future__ import annotations

from typing import Optional

import cv2
import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from vb_core.geometry import Pose
from vb_core.grid_map import GridMap, Window, clearance_grid, sample

STOP_MARGIN = 0.10  # [m] clearance beyond the radius at a position where a robot stops
TRAVEL_MARGIN = 0.03  # [m] clearance beyond the radius on a path; navigation has its own inflation
BLOCKED_THRESHOLD = 50  # [%] occupancy from which a cell is blocked, even by a soft border
PATH_CELL = 0.05  # [m] minimum cell size of the grid for path searches
MAX_PATH_CELLS = 10000  # the path grid is coarser on larger maps; a search takes 1 ms per 1,000 cells
START_TOLERANCE = 0.35  # [m] maximum distance of a path's start from free cells, as a robot may stand at a wall
WINDOW_MARGIN = 3.0  # [m] around spot, robots and line; a robot looks from up to 1.5 m at 0.8 m of extrapolated line
MAX_WINDOW_REACH = 8.0  # [m] from the spot, beyond which robots and lines do not enlarge the window
WINDOW_STEP = 2.0  # [m] windows' edges are multiples of it, so that a window stays the same while a spot moves a little
NEIGHBORS = ((0, 1), (1, 0), (1, 1), (1, -1))  # (rows, columns); each edge is used in both directions


def bounding_window(spot: np.ndarray, line: np.ndarray, robot: Pose) -> Window:
    """Returns the window (x_min, y_min, x_max, y_max) [m] around a spot (2,), and a line (N, 2) and robot near it."""
    points = np.vstack([spot, line, robot[:2]])
    points = points[np.abs(points - spot).max(axis=1) <= MAX_WINDOW_REACH]
    low = points.min(axis=0) - WINDOW_MARGIN
    high = points.max(axis=0) + WINDOW_MARGIN
    x_min, y_min = (np.floor(low / WINDOW_STEP) * WINDOW_STEP).tolist()
    x_max, y_max = (np.ceil(high / WINDOW_STEP) * WINDOW_STEP).tolist()
    return x_min, y_min, x_max, y_max


class ClearanceMap:
    """A map prepared for queries about positions and paths, once per map and window.

    Args:
        grid: the map with borders.
        radius: [m] of the robot.
        physical: the map without borders, as borders do not block the view; by default `grid`.
    """

    def __init__(self, grid: GridMap, radius: float, physical: Optional[GridMap] = None) -> None:
        self.grid = grid
        self.radius = radius
        self.blocked = (grid.data >= BLOCKED_THRESHOLD) | (grid.data < 0)
        self.clearance = clearance_grid(self.blocked, grid.resolution)
        view_grid = physical if physical is not None and physical.same_geometry(grid) else grid
        self.opaque = view_grid.data >= BLOCKED_THRESHOLD

    # ------------------------------------------------------------- positions
    def has_room_at(self, points: np.ndarray) -> np.ndarray:
        """Returns (N,) bool: whether there is room at points (N, 2) [m] for the robot and its margin."""
        return sample(self.grid, self.clearance, points) >= self.radius + STOP_MARGIN

    def has_line_of_sight(self, points: np.ndarray, target) -> np.ndarray:
        """Returns (N,) bool: whether nothing opaque lies between points (N, 2) and a target (2,) [m]."""
        offsets = points - np.asarray(target, dtype=float)
        lengths = np.linalg.norm(offsets, axis=1)
        # the samples are at fixed steps from the target, so that a point's result does not depend on the others
        step = 0.5 * self.grid.resolution
        # the first steps are skipped: a spot at the foot of a wall is visible, although its cell may be the wall's
        first = 2.0 * self.grid.resolution
        distances = np.arange(first, lengths.max(initial=0.0), step)
        units = offsets / np.maximum(lengths, 1e-9)[:, None]
        samples = target + distances[None, :, None] * units[:, None, :]
        opacity = sample(self.grid, self.opaque, samples.reshape(-1, 2), outside=1.0)
        is_opaque = opacity.reshape(samples.shape[:2]) > 0
        is_between = distances < lengths[:, None]
        return ~(is_opaque & is_between).any(axis=1)

    # ------------------------------------------------------------- paths
    def path_lengths(self, start, positions: np.ndarray, others=(), barred: Optional[np.ndarray] = None) -> np.ndarray:
        """Returns the lengths (N,) [m] of the shortest paths from a start (2,) [m] to positions (N, 2) [m].

        A length is inf if there is no path. Paths avoid other robots (K, 2) [m], of the same size, and barred cells
        (H, W) bool. Straight lines connect a start outside the map's window to the free cells at its edge.
        """
        coarse = self.grid.resolution * np.sqrt(self.grid.data.size / MAX_PATH_CELLS)
        step = max(1, int(np.ceil(max(PATH_CELL, coarse) / self.grid.resolution - 0.01)))
        rows, columns = np.array(self.grid.shape) // step
        blocks = self.clearance[: rows * step, : columns * step].reshape(rows, step, columns, step)
        # a block's largest clearance counts, because the smallest would close doorways that are wide enough
        free = blocks.max(axis=(1, 3), initial=0.0) >= self.radius + TRAVEL_MARGIN
        if barred is not None:
            free &= ~barred[: rows * step, : columns * step].reshape(blocks.shape).any(axis=(1, 3))
        cells = np.argwhere(free)
        centers = self.grid.cell_to_world(cells * step + (step - 1) / 2.0)
        for other in others:
            too_near = np.linalg.norm(centers - other, axis=1) < 2.0 * self.radius + TRAVEL_MARGIN
            free[tuple(cells[too_near].T)] = False
        distances = np.linalg.norm(centers - start, axis=1)
        distances[~free[tuple(cells.T)]] = np.inf
        if self.grid.contains_cells(self.grid.world_to_cell(start))[0]:
            entries = np.argsort(distances, kind="stable")[:1]
            entries = entries[distances[entries] <= START_TOLERANCE]
            distances = np.zeros(len(distances))
        else:
            at_edge = ((cells == 0) | (cells == (rows - 1, columns - 1))).any(axis=1)
            entries = np.flatnonzero(at_edge & np.isfinite(distances))
        cost = np.where(free, step * self.grid.resolution, np.inf)
        paths = ShortestPaths(cost, cells[entries], distances[entries])
        targets = self.grid.world_to_cell(positions) // step
        inside = ((targets >= 0) & (targets < (rows, columns))).all(axis=1)
        lengths = np.full(len(targets), np.inf)
        lengths[inside] = paths.costs[tuple(targets[inside].T)]
        return lengths

    # ------------------------------------------------------------- sides
    def predict_restricted_side(self, seed, chain: np.ndarray, closed: bool) -> np.ndarray:
        """Predicts the area that a border along the chain would restrict with a seed, less exactly than integration.

        Args:
            seed: (2,) [m]; chain: (M, 2) [m]; open ends are extended straight to the next obstacle.

        Returns:
            (H, W) bool; no cell if the chain does not separate any area.
        """
        nowhere = np.zeros(self.grid.shape, dtype=bool)
        if len(chain) < 2:
            return nowhere
        if not closed:
            start = self.ray_end(chain[0], chain[0] - chain[1])
            end = self.ray_end(chain[-1], chain[-1] - chain[-2])
            chain = np.vstack([start, chain, end])
        canvas = (~self.blocked).astype(np.uint8)
        pixels = np.rint(self.grid.world_to_grid(chain)).astype(np.int32)
        cv2.polylines(canvas, [pixels.reshape(-1, 1, 2)], closed, 0, thickness=1, lineType=cv2.LINE_8)
        _, labels = cv2.connectedComponents(canvas, connectivity=4)
        label = sample(self.grid, labels, np.asarray(seed, dtype=float).reshape(1, 2))[0]
        side = labels == label
        separates = side.sum() <= 0.98 * int(canvas.sum())
        return side if label > 0 and separates else nowhere

    def ray_end(self, start: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Returns the point (2,) [m] at which a ray in a direction hits a blocked cell or the map's edge."""
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
        cost: (H, W) of a step of one cell's side in each cell; inf for a cell that must not be entered.
        entries: (K, 2) cells (row, column) in which paths enter the grid.
        entry_costs: (K,) costs of these cells from the start.

    Attributes:
        costs: (H, W) of the path to each cell; inf if there is none.
    """

    def __init__(self, cost: np.ndarray, entries: np.ndarray, entry_costs: np.ndarray) -> None:
        rows, columns = cost.shape
        nodes = np.arange(cost.size).reshape(cost.shape)
        start = cost.size  # an additional node
        # edges (from, to, length); a length of 0 would mean that there is no edge
        from_start = np.full(len(entries), start)
        edges = [(from_start, nodes[tuple(entries.T)], np.maximum(entry_costs, 1e-6))]
        for dr, dc in NEIGHBORS:
            left, right = max(0, -dc), max(0, dc)
            from_cells = (slice(0, rows - dr), slice(left, columns - right))
            to_cells = (slice(dr, rows), slice(right, columns - left))
            length = 0.5 * np.hypot(dr, dc) * (cost[from_cells] + cost[to_cells])
            passable = np.isfinite(length)
            edges.append((nodes[from_cells][passable], nodes[to_cells][passable], length[passable]))
        sources, targets, lengths = map(np.concatenate, zip(*edges))
        graph = csr_matrix((lengths, (sources, targets)), shape=(start + 1, start + 1))
        costs, self._before = dijkstra(graph, directed=False, indices=start, return_predecessors=True)
        self.costs = costs[:-1].reshape(cost.shape)

    def path_to(self, cell) -> np.ndarray:
        """Returns the cells (N, 2) of the path to a cell (row, column), in order; (0, 2) if there is none."""
        path = []
        node = int(np.ravel_multi_index(tuple(cell), self.costs.shape))
        while np.isfinite(self.costs[tuple(cell)]) and node != self.costs.size:
            path.append(node)
            node = int(self._before[node])
        return np.column_stack(np.unravel_index(np.array(path[::-1], dtype=int), self.costs.shape))
