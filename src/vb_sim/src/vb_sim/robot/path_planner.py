"""Computes an occupancy grid's costs as move_base's costmap_2d does, and finds the cheapest paths on them."""

from __future__ import annotations

from functools import cached_property
from typing import List, Optional, Tuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from vb_core import geometry
from vb_core.errors import CodedError
from vb_core.grid_map import OCCUPIED, GridMap, distance_transform, nearest_cell, sample

Cell = Tuple[int, int]  # row, column
# as in navfn
NEUTRAL_COST = 50.0  # of a free cell
COST_FACTOR = 0.8  # of a cell's cost in the costmap
_ESCAPE = (
    0.10  # [m] how deep in the inscribed zone, but not in an obstacle, a robot may be and still plan a path out of it
)
_SPACING = 0.05  # [m] between a plan's poses
# a costmap's costs
LETHAL = 254
INSCRIBED = 253
NO_INFORMATION = 255
INFLATION = 0.17  # [m] for a robot: costmap_2d's inflation_radius minus the robot's own radius
_SCALING = 8.0  # [1/m] decay of the cost around obstacles: costmap_2d's cost_scaling_factor


class Costmap:
    """The costs of a map's cells: 254 for obstacles, 253 where the robot would touch one, 255 if unknown, 0 if free.

    Attributes:
        grid: the map.
        costs: (H, W) uint8.
        distance: (H, W) float32 [m] from each cell's centre to the nearest obstacle cell's.
    """

    def __init__(
        self, grid: GridMap, radius: float, obstacles: Optional[np.ndarray] = None, inflation: float = INFLATION
    ) -> None:
        """Computes the costs of a map.

        Args:
            radius: [m] radius of the robot or person.
            obstacles: (H, W) bool, obstacle cells that are not on the map.
            inflation: [m] beyond the radius, within which cells near obstacles cost more.
        """
        self.grid = grid
        static = static_costs(grid.data)
        if obstacles is not None:
            static[obstacles] = LETHAL
        self.distance = distance_transform(static == LETHAL) * np.float32(grid.resolution)
        self.costs = inflate(static, self.distance, radius, inflation)

    def occupancy(self) -> np.ndarray:
        """Returns (H, W) int8 as costmap_2d publishes it: 100 lethal, 99 inscribed, 98 to 0, -1 unknown."""
        table = np.zeros(256, np.int16)
        table[1:INSCRIBED] = 1 + (97 * (np.arange(1, INSCRIBED) - 1)) // 251
        table[INSCRIBED], table[LETHAL], table[NO_INFORMATION] = 99, 100, -1
        return table[self.costs].astype(np.int8)


def static_costs(data: np.ndarray) -> np.ndarray:
    """Converts occupancy (H, W) int8 to costs (H, W) uint8 as static_layer's interpretValue does.

    As in a static_layer without `trinary_costmap`, paths cross soft borders (occupancy below 100) only if they must.
    """
    table = np.full(256, NO_INFORMATION, np.uint8)  # includes -1, which is 255 as unsigned
    table[: OCCUPIED + 1] = np.arange(OCCUPIED + 1) / OCCUPIED * LETHAL
    return table[data.view(np.uint8)]


def inflate(static: np.ndarray, distance: np.ndarray, radius: float, inflation: float) -> np.ndarray:
    """Inflates costs (H, W) uint8 with the decay of inflation_layer's computeCost. The higher cost counts."""
    decay = (INSCRIBED - 1) * np.exp(-_SCALING * (distance - radius))
    # a cell at a distance of exactly the radius is inscribed; the tolerance covers rounding errors
    inflated = np.where(distance <= radius + 1e-6, INSCRIBED, decay)
    inflated[distance > radius + inflation + 1e-6] = 0
    costs = np.maximum(static, np.minimum(inflated, INSCRIBED).astype(np.uint8))
    costs[static == LETHAL] = LETHAL
    # as in costmap_2d, an unknown cell stays unknown unless a robot would touch an obstacle there
    unknown = static == NO_INFORMATION
    costs[unknown] = np.where(inflated[unknown] >= INSCRIBED, INSCRIBED, NO_INFORMATION)
    return costs


class Planner:
    """Plans paths on one costmap. It keeps the search from the last start, so that more goals from there are fast."""

    def __init__(self, costmap: Costmap) -> None:
        self.costmap = costmap
        self._grid = costmap.grid
        # where the robot's centre may be; not in unknown cells
        self._free = costmap.costs < INSCRIBED
        self._weights = NEUTRAL_COST + COST_FACTOR * costmap.costs.astype(np.float64)
        # a start, and the result of `_search` from there
        self._last_search: Optional[Tuple[Cell, np.ndarray, np.ndarray]] = None

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
        start, goal = np.asarray([start, goal], dtype=float)
        costs, predecessors = self._search(self._start_cell(start))
        goal_cell, end = self._goal_cell(goal, tolerance, costs)
        nodes = [int(np.ravel_multi_index(goal_cell, costs.shape))]
        while predecessors[nodes[-1]] >= 0:
            nodes.append(int(predecessors[nodes[-1]]))
        cells = np.column_stack(np.unravel_index(nodes[::-1], costs.shape))
        centers = self._grid.cell_to_world(self._simplify(cells, costs))
        # the exact start and end replace their cells' centres; a start in another cell than the first precedes that
        is_near_first = np.allclose(centers[0], start, atol=self._grid.resolution)
        between = centers[1:-1] if is_near_first else np.vstack([centers[:1], centers[1:-1]])
        path = np.vstack([start, between, end])
        if len(path) == 2 and np.allclose(start, end):
            return path[:1]
        return geometry.resample_chain(path, _SPACING)

    def is_traversable(self, position: np.ndarray) -> bool:
        """Returns whether the robot's centre may be at a position (2,) [m]."""
        return bool(sample(self._grid, self._free, position)[0])

    # ------------------------------------------------------------ ends of the path
    def _cell(self, point: np.ndarray, role: str) -> Cell:
        if np.isfinite(point).all():
            cells = self._grid.world_to_cell(point)
            if self._grid.contains_cells(cells)[0]:
                row, column = cells[0]
                return int(row), int(column)
        raise CodedError("off_map", f"the {role} ({point[0]:.2f}, {point[1]:.2f}) is not on the map")

    def _start_cell(self, start: np.ndarray) -> Cell:
        cell = self._cell(start, "start")
        if self._free[cell]:
            return cell
        # A robot may be in the inscribed zone because of a localisation error. It may plan a path out of that zone,
        # where move_base frees only the robot's own cell. The path must not start in or cross an obstacle or border.
        nearest, position = nearest_cell(self._grid, self._free, start, _ESCAPE)
        cells = self._grid.world_to_cell(np.linspace(start, position, 16))
        if nearest is not None and (self.costmap.costs[tuple(cells.T)] != LETHAL).all():
            return nearest
        position = f"({start[0]:.2f}, {start[1]:.2f})"
        raise CodedError("start_blocked", f"the start {position} is inside an obstacle or a border")

    def _goal_cell(self, goal: np.ndarray, tolerance: float, costs: np.ndarray) -> Tuple[Cell, np.ndarray]:
        cell = self._cell(goal, "goal")
        if np.isfinite(costs[cell]):
            return cell, goal
        nearest, position = nearest_cell(self._grid, np.isfinite(costs), goal, tolerance)
        if nearest is not None:
            return nearest, position
        position = f"({goal[0]:.2f}, {goal[1]:.2f})"
        if not self._free[cell]:
            raise CodedError("goal_blocked", f"the goal {position} is in or too near an obstacle or a border")
        raise CodedError("no_path", f"no way leads to {position}")

    # ------------------------------------------------------------ search
    def _search(self, start: Cell) -> Tuple[np.ndarray, np.ndarray]:
        """Searches from a cell, and returns each cell's lowest cost (H, W) and predecessor (H * W,)."""
        if self._last_search is None or self._last_search[0] != start:
            node = np.ravel_multi_index(start, self._free.shape)
            costs, predecessors = dijkstra(self._graph, indices=node, return_predecessors=True)
            self._last_search = (start, costs.reshape(self._free.shape), predecessors)
        return self._last_search[1:]

    @cached_property
    def _graph(self) -> csr_matrix:
        """The cost of moving from each cell to its neighbours. Cells are numbered row by row."""
        rows, columns = self._free.shape
        nodes = np.arange(self._free.size).reshape(self._free.shape)
        edges: List[Tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
            from_rows = slice(0, rows - dy)
            to_rows = slice(dy, rows)
            from_columns = slice(max(0, -dx), columns - max(0, dx))
            to_columns = slice(max(0, dx), columns + min(0, dx))
            a = (from_rows, from_columns)
            b = (to_rows, to_columns)
            # a diagonal step must not pass a blocked cell
            beside_is_free = self._free[from_rows, to_columns] & self._free[to_rows, from_columns]
            passable = self._free[a] & self._free[b] & beside_is_free
            costs = (self._weights[a] + self._weights[b]) / 2.0 * np.hypot(dx, dy)
            edges.append((costs[passable], nodes[a][passable], nodes[b][passable]))
        costs, sources, targets = (np.concatenate(column) for column in zip(*edges))
        one_way = csr_matrix((costs, (sources, targets)), shape=(nodes.size, nodes.size))
        return one_way + one_way.T

    # ------------------------------------------------------------ shape of the path
    def _simplify(self, cells: np.ndarray, costs: np.ndarray) -> np.ndarray:
        """Selects the cells of a path (N, 2) between which straight lines cost no more than steps from cell to cell."""
        spent = costs[tuple(cells.T)]
        last = len(cells) - 1
        corners = [0]

        def line_is_cheap(a: int, b: int) -> bool:
            start, end = cells[[a, b]].astype(float)
            length = float(np.hypot(*(end - start)))
            shares = np.linspace(0.0, 1.0, max(2, int(2 * length) + 1))
            line = np.rint(start + (end - start) * shares[:, None]).astype(int)
            crossed = tuple(line.T)
            if not self._free[crossed].all():
                return False
            line_cost = float(self._weights[crossed].mean()) * length
            return line_cost <= (spent[b] - spent[a]) * (1.0 + 1e-9)

        while corners[-1] < last:
            current = corners[-1]
            farthest, candidate = current + 1, current + 2
            while candidate <= last and line_is_cheap(current, candidate):
                farthest = candidate
                candidate += max(1, (candidate - current) // 4)
            if candidate > last > farthest and line_is_cheap(current, last):
                farthest = last
            corners.append(farthest)
        return cells[corners]
