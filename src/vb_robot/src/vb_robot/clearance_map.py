"""The map as a round robot sees it: clearance, lines of sight, shortest paths.

The idea: only the floor around the line and the robot matters. `crop` cuts that window out of the map, so that the
cost of a choice does not depend on the map's size; a robot from outside enters at the window's edge.
"""

from __future__ import annotations

from typing import Optional, Tuple

import cv2
import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from vb_core import geometry
from vb_core.grid_layers import Window, clearance_grid, sample
from vb_core.grid_map import GridMap

STOP_MARGIN = 0.10  # [m] beyond the radius where a robot stops
TRAVEL_MARGIN = 0.03  # [m] beyond the radius on the path; navigation keeps its own inflation
BLOCKED_THRESHOLD = 50  # [%] from this occupancy on a cell is blocked, so also by soft borders
PATH_CELL = 0.05  # [m] cell size of the grid on which paths are searched, on maps of this size or finer ...
MAX_PATH_CELLS = 10000  # ... and in windows coarser, where there would be more: a search costs 1 ms per 1,000
START_TOLERANCE = 0.35  # [m] how far from free cells a path may start: a robot at a wall
WINDOW_MARGIN = 3.0  # [m] of floor around what matters: a robot looks at it from 1.5 m, the line is extrapolated by 2 m
MAX_WINDOW_REACH = 8.0  # [m] robots and lines farther away do not make the window larger
WINDOW_STEP = 2.0  # [m] windows begin and end at multiples of this, so that one serves while the spot moves on
ROUTE_SPACING = 0.05  # [m] between places of a route


def bounding_window(spot, *others) -> Window:
    """Returns the window (x_min, y_min, x_max, y_max) [m] around a spot (2,) [m] and the points (N, 2) near it."""
    spot = np.asarray(spot, dtype=float)
    points = np.vstack([spot[None], *(np.asarray(some, dtype=float).reshape(-1, 2) for some in others)])
    points = points[np.abs(points - spot).max(axis=1) <= MAX_WINDOW_REACH]
    low = np.floor((points.min(axis=0) - WINDOW_MARGIN) / WINDOW_STEP) * WINDOW_STEP
    high = np.ceil((points.max(axis=0) + WINDOW_MARGIN) / WINDOW_STEP) * WINDOW_STEP
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


class ClearanceMap:
    """A map prepared for questions about places and paths. Made once per map and window.

    Args:
        grid: the map with borders: physical obstacles and borders.
        radius: [m] of the robot.
        physical: the map without borders, which decides what blocks the view; a border does not. None: `grid`.
        edge: whether the map's edge is blocked; a window's is not.
    """

    def __init__(self, grid: GridMap, radius: float, physical: Optional[GridMap] = None, edge: bool = True) -> None:
        self.grid, self.radius, self.edge = grid, radius, edge
        self.blocked = (grid.data >= BLOCKED_THRESHOLD) | (grid.data < 0)
        self.clearance = clearance_grid(self.blocked, grid.resolution, edge)
        seen_through = physical if physical is not None and physical.same_geometry(grid) else grid
        self.opaque = seen_through.data >= BLOCKED_THRESHOLD
        self._mark_passable()

    # ------------------------------------------------------------- places
    def clearance_at(self, points: np.ndarray) -> np.ndarray:
        """Returns (N,) [m] how far points (N, 2) [m] are from what is blocked or off the map."""
        return sample(self.grid, self.clearance, points)

    def has_room_at(self, points: np.ndarray) -> np.ndarray:
        """Returns (N,) bool: whether the robot with its margin finds room at points (N, 2) [m]."""
        return self.clearance_at(points) >= self.radius + STOP_MARGIN

    def line_of_sight(self, points: np.ndarray, target) -> np.ndarray:
        """Returns (N,) bool: whether nothing opaque lies between points (N, 2) and a target (2,) [m]."""
        points = np.asarray(points, dtype=float).reshape(-1, 2)
        target = np.asarray(target, dtype=float)
        if not len(points):
            return np.zeros(0, dtype=bool)
        offsets = points - target
        lengths = np.linalg.norm(offsets, axis=1)
        # from the target outwards at fixed steps, so that one point's answer does not depend on the others; the
        # first piece is left out: a spot at the foot of a wall is seen although its cell may be the wall's
        along = np.arange(2.0 * self.grid.resolution, max(float(lengths.max()), 1e-6), 0.5 * self.grid.resolution)
        units = offsets / np.maximum(lengths, 1e-9)[:, None]
        samples = target + along[None, :, None] * units[:, None, :]
        hidden = sample(self.grid, self.opaque, samples.reshape(-1, 2), outside=1.0).reshape(len(points), -1)
        hidden = np.where(along[None, :] < lengths[:, None], hidden, 0.0)
        return ~(hidden > 0).any(axis=1)

    # ------------------------------------------------------------- paths
    def _mark_passable(self) -> None:
        # in a window a choice is made four times a second; a whole map is searched once
        coarse = 0.0 if self.edge else self.grid.resolution * np.sqrt(self.grid.data.size / MAX_PATH_CELLS)
        self.step = step = max(1, int(np.ceil(max(PATH_CELL, coarse) / self.grid.resolution - 0.01)))
        rows, columns = (size // step for size in self.grid.shape)
        blocks = self.clearance[: rows * step, : columns * step].reshape(rows, step, columns, step)
        # the largest clearance of a block: the smallest would close doorways that are wide enough
        self.passable = blocks.max(axis=(1, 3), initial=0.0) >= self.radius + TRAVEL_MARGIN

    def shortest_paths(self, start, others=()) -> "ShortestPaths":
        """Searches the shortest paths from a start (2,) [m] to every place, around other robots (K, 2) [m] of the same size."""
        return ShortestPaths(self, np.asarray(start, dtype=float), np.asarray(others, dtype=float).reshape(-1, 2))

    # ------------------------------------------------------------- sides
    def side_of(self, seed, chain: np.ndarray, closed: bool) -> Optional[np.ndarray]:
        """Predicts what a border along the chain would restrict with the seed there: not as exactly as the integration.

        Args:
            seed: (2,) [m]; chain: (M, 2) [m], open ends are prolonged straight on to the next obstacle.

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
        """Returns the place (2,) [m] where a ray from a start (2,) [m] along a direction (2,) meets what is blocked or the map's edge."""
        norm = float(np.linalg.norm(direction))
        if norm < 1e-9:
            return start
        reach = float(np.hypot(*self.grid.shape)) * self.grid.resolution
        steps = np.arange(0.0, reach, self.grid.resolution / 2.0)
        points = start + steps[:, None] * (direction / norm)
        hits = np.flatnonzero(sample(self.grid, self.blocked, points, outside=1.0) > 0)
        return points[hits[0]] if len(hits) else points[-1]


class ShortestPaths:
    """The shortest paths from one start, searched once. Made by `ClearanceMap.shortest_paths`.

    The start is a separate node, joined to the free cell beside it; outside a window, to the free cells of the
    window's edge, with the straight line as the path up to there.
    """

    def __init__(self, clearance_map: ClearanceMap, start: np.ndarray, others: np.ndarray) -> None:
        self._clearance_map, self._start, self._others = clearance_map, start, others
        self._shape = clearance_map.passable.shape
        free = clearance_map.passable.copy()
        cells = np.argwhere(free)
        if len(others):
            gaps = np.linalg.norm(self._centers(cells)[:, None] - others[None], axis=2).min(axis=1)
            free[tuple(cells[gaps < 2.0 * clearance_map.radius + TRAVEL_MARGIN].T)] = False
        lengths, before = dijkstra(self._graph(free), directed=False, indices=free.size, return_predecessors=True)
        self._lengths = lengths[:-1].reshape(free.shape)
        self._before = np.where((before[:-1] < 0) | (before[:-1] == free.size), -1, before[:-1])

    def _graph(self, free: np.ndarray) -> csr_matrix:
        """Joins free cells (rows, columns) bool to their eight neighbours, by length [m]; the last node is the start."""
        clearance_map, (rows, columns) = self._clearance_map, free.shape
        index = np.arange(free.size).reshape(free.shape)
        gates, gaps = self._gates(np.argwhere(free))
        edges = [(np.full(len(gates), free.size), index[tuple(gates.T)], gaps)]  # (from, to, length [m])
        for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
            here = (slice(0, rows - dr), slice(max(0, -dc), columns - max(0, dc)))
            there = (slice(dr, rows), slice(max(0, dc), columns + min(0, dc)))
            both = free[here] & free[there]
            length = np.full(int(both.sum()), np.hypot(dr, dc) * clearance_map.step * clearance_map.grid.resolution)
            edges.append((index[here][both], index[there][both], length))
        begin, end, length = (np.concatenate(column) for column in zip(*edges))
        return csr_matrix((length, (begin, end)), shape=(free.size + 1, free.size + 1))

    def _gates(self, cells: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        """Returns free cells (K, 2) where paths begin, and (K,) [m] how far they are from the start."""
        clearance_map = self._clearance_map
        gaps = np.linalg.norm(self._centers(cells) - self._start, axis=1)
        if (
            not clearance_map.edge
            and not clearance_map.grid.contains_cells(clearance_map.grid.world_to_cell(self._start))[0]
        ):
            edge = ((cells == 0) | (cells == np.array(self._shape) - 1)).any(axis=1)
            return cells[edge], gaps[edge]
        nearest = np.argsort(gaps, kind="stable")[:1]
        nearest = nearest[gaps[nearest] <= START_TOLERANCE]
        return cells[nearest], np.full(len(nearest), 1e-6)

    def _centers(self, cells: np.ndarray) -> np.ndarray:
        step = self._clearance_map.step
        return self._clearance_map.grid.cell_to_world(cells * step + (step - 1) / 2.0)

    def _cells(self, points: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        cells = self._clearance_map.grid.world_to_cell(points) // self._clearance_map.step
        return cells, ((cells >= 0) & (cells < np.array(self._shape))).all(axis=1)

    def lengths_to(self, points: np.ndarray) -> np.ndarray:
        """Returns the lengths (N,) [m] of the paths to points (N, 2) [m]; inf where there is none."""
        cells, inside = self._cells(points)
        values = np.full(len(cells), np.inf)
        values[inside] = self._lengths[cells[inside, 0], cells[inside, 1]]
        return values

    def path_to(self, goal) -> Optional[np.ndarray]:
        """Returns the path (N, 2) [m] to a goal (2,) [m], pulled tight like a string, at most 5 cm apart; None if there is none.

        The search uses eight directions only; pulled tight, the path is close to what a planner with costs finds.
        """
        goal = np.asarray(goal, dtype=float)
        if not np.isfinite(self.lengths_to(goal[None])[0]):
            return None
        cell = self._cells(goal[None])[0][0]
        nodes = [int(cell[0] * self._shape[1] + cell[1])]
        while self._before[nodes[-1]] >= 0:
            nodes.append(int(self._before[nodes[-1]]))
        cells = np.column_stack(np.unravel_index(nodes[::-1], self._shape))
        corners = self._tightened(np.vstack([self._start, self._centers(cells)[1:-1], goal]))
        return geometry.resample_chain(corners, ROUTE_SPACING) if len(corners) > 1 else corners

    def _tightened(self, points: np.ndarray) -> np.ndarray:
        clearance_map = self._clearance_map
        # a cell of the path grid is as free as its freest part
        slack = 0.75 * clearance_map.step * clearance_map.grid.resolution
        needed = clearance_map.radius + TRAVEL_MARGIN - slack
        apart = needed + clearance_map.radius
        kept, last = [0], len(points) - 1
        while kept[-1] < last:
            here = points[kept[-1]]
            targets = points[kept[-1] + 1 :]
            reach = float(np.linalg.norm(targets - here, axis=1).max())
            share = np.linspace(0.0, 1.0, max(3, int(reach / ROUTE_SPACING)))
            samples = here + share[None, :, None] * (targets - here)[:, None, :]
            room = clearance_map.clearance_at(samples.reshape(-1, 2)).reshape(len(targets), -1)
            # a place that is too near to something may be left
            visible = (room >= min(needed, float(room[0, 0])) - 1e-6).all(axis=1)
            for other in self._others:
                gaps = np.linalg.norm(samples - other, axis=2)
                visible &= (gaps >= np.minimum(apart, gaps[:, :1]) - 1e-6).all(axis=1)
            kept.append(kept[-1] + 1 + (int(np.flatnonzero(visible)[-1]) if visible.any() else 0))
        return points[kept]
