"""Finds shortest paths on a costmap."""

from __future__ import annotations

from typing import List, Optional, Tuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from vb_core import geometry
from vb_core.errors import CodedError
from vb_core.grid_layers import nearest_cell
from vb_sim.robot.costmap import LETHAL, Costmap

NEUTRAL_COST = 50.0  # of a free cell, and how much a cell's cost adds to it: navfn's figures
COST_FACTOR = 0.8
# [m] up to this far inside the inscribed zone a robot may plan its way out; from inside an obstacle it may not
_ESCAPE = 0.10
_SPACING = 0.05  # [m] of a plan's poses


class Planner:
    """Plans on one costmap. The search from the last start is kept: more goals from there cost nothing."""

    def __init__(self, costmap: Costmap) -> None:
        self.costmap = costmap
        free = costmap.traversable()
        self._ids = np.full(free.shape, -1, np.int64)
        self._ids[free] = np.arange(int(free.sum()))
        self._cells = np.argwhere(free)  # (n, 2) row, column of each node
        self._weights = NEUTRAL_COST + COST_FACTOR * costmap.costs.astype(np.float64)
        self._graph: Optional[csr_matrix] = None
        self._searched: Optional[Tuple[int, np.ndarray, np.ndarray]] = None  # start node, costs, predecessors

    def plan(self, start: np.ndarray, goal: np.ndarray, tolerance: float = 0.0) -> np.ndarray:
        """Plans the cheapest path.

        Args:
            start, goal: (2,) [m] in the map frame.
            tolerance: [m] how far from the goal the path may end if the goal itself cannot be reached.

        Returns:
            (N, 2) [m], from the start to the goal, at most 5 cm apart.

        Raises:
            CodedError: "off_map", "start_blocked", "goal_blocked" or "no_path".
        """
        first, _ = self._start_node(np.asarray(start, dtype=float))
        costs, before = self._search(first)
        goal = np.asarray(goal, dtype=float)
        last, end = self._goal_node(goal, tolerance, costs)
        nodes = [last]
        while nodes[-1] != first:
            nodes.append(int(before[nodes[-1]]))
        nodes.reverse()
        kept = self._shortened(nodes, costs)
        middle = self.costmap.grid.cell_to_world(self._cells[kept])
        # the exact places, in those cells or beside them, replace the cells' centres
        path = np.vstack([np.asarray(start, dtype=float)[None], middle[1:-1], end[None]])
        if not np.allclose(middle[0], path[0], atol=self.costmap.grid.resolution):
            path = np.vstack([path[:1], middle[:1], path[1:]])
        if np.allclose(path[0], path[-1]) and len(path) == 2:
            return path[:1]
        return geometry.resample_chain(path, _SPACING)

    def is_traversable(self, place: np.ndarray) -> bool:
        """Returns whether the robot's centre may be at a place (2,) [m]."""
        cell = self.costmap.grid.world_to_cell(place)[0]
        return bool(self.costmap.grid.contains_cells(cell)[0] and self._ids[cell[0], cell[1]] >= 0)

    # ------------------------------------------------------------ ends of the path
    def _cell(self, point: np.ndarray, what: str) -> Tuple[int, int]:
        finite = bool(np.isfinite(point).all())
        cell = self.costmap.grid.world_to_cell(point if finite else np.full(2, -1e9))[0]
        if not finite or not self.costmap.grid.contains_cells(cell)[0]:
            raise CodedError("off_map", f"the {what} ({point[0]:.2f}, {point[1]:.2f}) is not on the map")
        return int(cell[0]), int(cell[1])

    def _start_node(self, start: np.ndarray) -> Tuple[int, np.ndarray]:
        cell = self._cell(start, "start")
        if self._ids[cell] >= 0:
            return int(self._ids[cell]), start
        # move_base frees the robot's own cell only. A robot that touches the inscribed zone by an error of its
        # localisation gets out of it here; one whose middle is in an obstacle or border does not.
        if self.costmap.costs[cell] != LETHAL and len(self._cells):
            near, place = nearest_cell(self.costmap.grid, self._ids >= 0, start, _ESCAPE)
            if near is not None and self._clear_of_obstacles(start, place):
                return int(self._ids[near]), place
        raise CodedError(
            "start_blocked", f"the start ({start[0]:.2f}, {start[1]:.2f}) is inside an obstacle or a border"
        )

    def _goal_node(self, goal: np.ndarray, tolerance: float, costs: np.ndarray) -> Tuple[int, np.ndarray]:
        cell = self._cell(goal, "goal")
        node = int(self._ids[cell])
        if node >= 0 and np.isfinite(costs[node]):
            return node, goal
        reachable = np.zeros(self._ids.shape, bool)
        reachable[tuple(self._cells[np.isfinite(costs)].T)] = True
        near, place = nearest_cell(self.costmap.grid, reachable, goal, tolerance)
        if near is not None:
            return int(self._ids[near]), place
        if node < 0:
            raise CodedError(
                "goal_blocked", f"the goal ({goal[0]:.2f}, {goal[1]:.2f}) is in or too near an obstacle or a border"
            )
        raise CodedError("no_path", f"no way leads to ({goal[0]:.2f}, {goal[1]:.2f})")

    def _clear_of_obstacles(self, a: np.ndarray, b: np.ndarray) -> bool:
        points = np.linspace(a, b, 16)
        cells = self.costmap.grid.world_to_cell(points)
        return bool((self.costmap.costs[cells[:, 0], cells[:, 1]] != LETHAL).all())

    # ------------------------------------------------------------ search
    def _search(self, start: int) -> Tuple[np.ndarray, np.ndarray]:
        if self._searched is None or self._searched[0] != start:
            if self._graph is None:
                self._graph = self._build_graph()
            costs, before = dijkstra(self._graph, indices=start, return_predecessors=True)
            self._searched = (start, costs, before)
        return self._searched[1], self._searched[2]

    def _build_graph(self) -> csr_matrix:
        rows, columns = self._ids.shape
        ends: List[np.ndarray] = []
        others: List[np.ndarray] = []
        weights: List[np.ndarray] = []
        for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
            a = (slice(0, rows - dy), slice(max(0, -dx), columns - max(0, dx)))
            b = (slice(dy, rows), slice(max(0, dx), columns + min(0, dx)))
            both = (self._ids[a] >= 0) & (self._ids[b] >= 0)
            if dx and dy:
                # no diagonal step between two blocked cells
                c = (a[0], b[1])
                d = (b[0], a[1])
                both &= (self._ids[c] >= 0) & (self._ids[d] >= 0)
            i, j = self._ids[a][both], self._ids[b][both]
            w = (self._weights[a][both] + self._weights[b][both]) / 2.0 * np.hypot(dx, dy)
            ends += [i, j]
            others += [j, i]
            weights += [w, w]
        count = len(self._cells)
        return csr_matrix(
            (np.concatenate(weights), (np.concatenate(ends), np.concatenate(others))), shape=(count, count)
        )

    # ------------------------------------------------------------ shape of the path
    def _shortened(self, nodes: List[int], costs: np.ndarray) -> List[int]:
        """Returns the nodes between which straight lines cost no more than the path over the cells (eight directions)."""
        kept = [nodes[0]]
        at = 0
        while at < len(nodes) - 1:
            best, probe = at + 1, at + 2
            while probe < len(nodes) and self._line_is_cheap(
                nodes[at], nodes[probe], costs[nodes[probe]] - costs[nodes[at]]
            ):
                best, probe = probe, probe + max(1, (probe - at) // 4)
            if probe >= len(nodes) and best < len(nodes) - 1:
                whole = costs[nodes[-1]] - costs[nodes[at]]
                best = len(nodes) - 1 if self._line_is_cheap(nodes[at], nodes[-1], whole) else best
            kept.append(nodes[best])
            at = best
        return kept

    def _line_is_cheap(self, a: int, b: int, limit: float) -> bool:
        start, end = self._cells[a].astype(float), self._cells[b].astype(float)
        length = float(np.hypot(*(end - start)))
        count = max(2, int(2 * length) + 1)
        points = np.rint(start + (end - start) * np.linspace(0.0, 1.0, count)[:, None]).astype(int)
        if (self._ids[points[:, 0], points[:, 1]] < 0).any():
            return False
        return float(self._weights[points[:, 0], points[:, 1]].mean()) * length <= limit * (1.0 + 1e-9)
