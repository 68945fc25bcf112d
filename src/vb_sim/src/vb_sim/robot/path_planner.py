"""Computes an occupancy grid's costs as move_base's costmap_2d does, and finds shortest paths on them."""

from __future__ import annotations

from functools import cached_property
from typing import List, Optional, Tuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from vb_core import geometry
from vb_core.errors import CodedError
from vb_core.grid_map import OCCUPIED, GridMap, distance_to, nearest_cell, sample

Cell = Tuple[int, int]  # row, column
NEUTRAL_COST = 50.0  # cost of a free cell, and the weight of a cell's own cost: navfn's figures
COST_FACTOR = 0.8
# [m] depth in the inscribed zone from which a robot may still plan its way out; never from inside an obstacle
_ESCAPE = 0.10
_SPACING = 0.05  # [m] between a plan's poses
# a costmap's costs
LETHAL = 254
INSCRIBED = 253
NO_INFORMATION = 255
INFLATION = 0.17  # [m] for a robot: costmap_2d's inflation_radius minus the robot's own radius
_SCALING = 8.0  # [1/m] decay of the cost around obstacles: costmap_2d's cost_scaling_factor


class Costmap:
    """Costs (H, W) uint8: 254 obstacle, 253 robot's centre must not be there, 255 unknown, 0 free.

    Attributes:
        grid: the map from which it was made.
        costs: (H, W) uint8.
        distance: (H, W) float32 [m] from each cell's centre to the nearest obstacle cell's.
    """

    def __init__(
        self, grid: GridMap, radius: float, obstacles: Optional[np.ndarray] = None, inflation: float = INFLATION
    ) -> None:
        """Makes the costmap of a map.

        Args:
            radius: [m] of the robot, or person, that moves there.
            obstacles: (H, W) bool, further obstacle cells beside the map's.
            inflation: [m] beyond the radius, within which cells near obstacles cost more.
        """
        self.grid = grid
        static = static_costs(grid.data)
        if obstacles is not None:
            static[obstacles] = LETHAL
        self.distance = distance_to(static == LETHAL) * np.float32(grid.resolution)
        self.costs = inflate(static, self.distance, radius, inflation)

    def traversable(self) -> np.ndarray:
        """Returns (H, W) bool: in which cells the robot's centre may be; in unknown cells it may not."""
        return self.costs < INSCRIBED

    def occupancy(self) -> np.ndarray:
        """Returns (H, W) int8, as costmap_2d's publisher does: 100 lethal, 99 inscribed, 98 ... 0, -1 unknown."""
        table = np.zeros(256, np.int16)
        table[1:INSCRIBED] = 1 + (97 * (np.arange(1, INSCRIBED) - 1)) // 251
        table[INSCRIBED], table[LETHAL], table[NO_INFORMATION] = 99, 100, -1
        return table[self.costs].astype(np.int8)


def static_costs(data: np.ndarray) -> np.ndarray:
    """Converts occupancy (H, W) int8 to costs (H, W) uint8 as static_layer's interpretValue does.

    As without `trinary_costmap`: soft borders (occupancy under 100) are crossed where there is no other path.
    """
    table = np.full(256, NO_INFORMATION, np.uint8)  # -1, seen as unsigned, is among the rest
    table[: OCCUPIED + 1] = np.arange(OCCUPIED + 1) / OCCUPIED * LETHAL
    return table[data.view(np.uint8)]


def inflate(static: np.ndarray, distance: np.ndarray, radius: float, inflation: float) -> np.ndarray:
    """Inflates costs (H, W) uint8 with the decay of inflation_layer's computeCost; the higher cost wins."""
    decay = (INSCRIBED - 1) * np.exp(-_SCALING * (distance - radius))
    # a cell whose distance equals the radius is within it, despite rounding errors
    inflated = np.where(distance <= radius + 1e-6, INSCRIBED, decay)
    inflated[distance > radius + inflation + 1e-6] = 0
    costs = np.maximum(static, np.minimum(inflated, INSCRIBED).astype(np.uint8))
    costs[static == LETHAL] = LETHAL
    # as in the real layer: unknown stays unknown unless a robot would touch an obstacle there
    unknown = static == NO_INFORMATION
    costs[unknown] = np.where(inflated[unknown] >= INSCRIBED, INSCRIBED, NO_INFORMATION)
    return costs


class Planner:
    """Plans on one costmap. The search from the last start is kept, so that further goals from there cost nothing."""

    def __init__(self, costmap: Costmap) -> None:
        self.costmap, self._grid = costmap, costmap.grid
        self._free = costmap.traversable()
        self._weights = NEUTRAL_COST + COST_FACTOR * costmap.costs.astype(np.float64)
        # a start, and what `_search` found from there
        self._searched: Optional[Tuple[Cell, np.ndarray, np.ndarray]] = None

    def plan(self, start: np.ndarray, goal: np.ndarray, tolerance: float = 0.0) -> np.ndarray:
        """Plans the cheapest path.

        Args:
            start, goal: (2,) [m] in the map frame.
            tolerance: [m] how far from the goal the path may end if the goal itself cannot be reached.

        Returns:
            Points (N, 2) [m] from the start to the goal, at most 5 cm apart.

        Raises:
            CodedError: "off_map", "start_blocked", "goal_blocked" or "no_path".
        """
        start, goal = np.asarray(start, dtype=float), np.asarray(goal, dtype=float)
        costs, before = self._search(self._start_cell(start))
        last, end = self._goal_cell(goal, tolerance, costs)
        nodes = [int(np.ravel_multi_index(last, costs.shape))]
        while before[nodes[-1]] >= 0:
            nodes.append(int(before[nodes[-1]]))
        way = np.column_stack(np.unravel_index(nodes[::-1], costs.shape))
        middle = self._grid.cell_to_world(self._shortened(way, costs))
        # the exact ends, in those cells or beside them, replace the cells' centres
        path = np.vstack([start[None], middle[1:-1], end[None]])
        if not np.allclose(middle[0], path[0], atol=self._grid.resolution):
            path = np.vstack([path[:1], middle[:1], path[1:]])
        if np.allclose(path[0], path[-1]) and len(path) == 2:
            return path[:1]
        return geometry.resample_chain(path, _SPACING)

    def is_traversable(self, place: np.ndarray) -> bool:
        """Returns whether the robot's centre may be at a position (2,) [m]."""
        return bool(sample(self._grid, self._free, place)[0])

    # ------------------------------------------------------------ ends of the path
    def _cell(self, point: np.ndarray, what: str) -> Cell:
        finite = bool(np.isfinite(point).all())
        cell = self._grid.world_to_cell(point if finite else np.full(2, -1e9))[0]
        if not finite or not self._grid.contains_cells(cell)[0]:
            raise CodedError("off_map", f"the {what} ({point[0]:.2f}, {point[1]:.2f}) is not on the map")
        return int(cell[0]), int(cell[1])

    def _start_cell(self, start: np.ndarray) -> Cell:
        cell = self._cell(start, "start")
        if self._free[cell]:
            return cell
        # move_base frees the robot's own cell only. A robot that is in the inscribed zone by a localisation error gets
        # out of it here, but not across an obstacle or border, nor if its centre is in one.
        near, place = nearest_cell(self._grid, self._free, start, _ESCAPE)
        between = self._grid.world_to_cell(np.linspace(start, place, 16))
        if near is not None and (self.costmap.costs[tuple(between.T)] != LETHAL).all():
            return near
        raise CodedError(
            "start_blocked", f"the start ({start[0]:.2f}, {start[1]:.2f}) is inside an obstacle or a border"
        )

    def _goal_cell(self, goal: np.ndarray, tolerance: float, costs: np.ndarray) -> Tuple[Cell, np.ndarray]:
        cell = self._cell(goal, "goal")
        if np.isfinite(costs[cell]):
            return cell, goal
        near, place = nearest_cell(self._grid, np.isfinite(costs), goal, tolerance)
        if near is not None:
            return near, place
        if not self._free[cell]:
            raise CodedError(
                "goal_blocked", f"the goal ({goal[0]:.2f}, {goal[1]:.2f}) is in or too near an obstacle or a border"
            )
        raise CodedError("no_path", f"no way leads to ({goal[0]:.2f}, {goal[1]:.2f})")

    # ------------------------------------------------------------ search
    def _search(self, start: Cell) -> Tuple[np.ndarray, np.ndarray]:
        """Searches from a cell; returns the least cost of reaching each cell (H, W), and its predecessor (H * W,)."""
        if self._searched is None or self._searched[0] != start:
            first = np.ravel_multi_index(start, self._free.shape)
            costs, before = dijkstra(self._graph, indices=first, return_predecessors=True)
            self._searched = (start, costs.reshape(self._free.shape), before)
        return self._searched[1:]

    @cached_property
    def _graph(self) -> csr_matrix:
        """The cost of going from one cell to the next; cells are numbered row by row."""
        rows, columns = self._free.shape
        nodes = np.arange(self._free.size).reshape(self._free.shape)
        ends: List[np.ndarray] = []
        others: List[np.ndarray] = []
        weights: List[np.ndarray] = []
        for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
            a = (slice(0, rows - dy), slice(max(0, -dx), columns - max(0, dx)))
            b = (slice(dy, rows), slice(max(0, dx), columns + min(0, dx)))
            # no diagonal step past a blocked cell
            both = self._free[a] & self._free[b] & self._free[a[0], b[1]] & self._free[b[0], a[1]]
            i, j = nodes[a][both], nodes[b][both]
            w = (self._weights[a][both] + self._weights[b][both]) / 2.0 * np.hypot(dx, dy)
            ends += [i, j]
            others += [j, i]
            weights += [w, w]
        edges = (np.concatenate(weights), (np.concatenate(ends), np.concatenate(others)))
        return csr_matrix(edges, shape=(nodes.size, nodes.size))

    # ------------------------------------------------------------ shape of the path
    def _shortened(self, way: np.ndarray, costs: np.ndarray) -> np.ndarray:
        """Reduces a way (N, 2), which has only eight directions, to cells between which straight lines cost no more."""
        spent, last, kept = costs[tuple(way.T)], len(way) - 1, [0]

        def line_is_cheap(a: int, b: int) -> bool:
            start, end = way[[a, b]].astype(float)
            length = float(np.hypot(*(end - start)))
            count = max(2, int(2 * length) + 1)
            points = np.rint(start + (end - start) * np.linspace(0.0, 1.0, count)[:, None]).astype(int)
            if not self._free[tuple(points.T)].all():
                return False
            return float(self._weights[tuple(points.T)].mean()) * length <= (spent[b] - spent[a]) * (1.0 + 1e-9)

        while kept[-1] < last:
            at = kept[-1]
            best, probe = at + 1, at + 2
            while probe <= last and line_is_cheap(at, probe):
                best, probe = probe, probe + max(1, (probe - at) // 4)
            if probe > last > best and line_is_cheap(at, last):
                best = last
            kept.append(best)
        return way[kept]
