"""Finds which border a robot is in, and why a goal cannot be reached, before navigation gives up.

Navigation gives up only after its recoveries, half a minute later, and does not say why. The maps show at once if there
is no room at the goal, or no free floor between the robot and the goal. The map without borders shows whether borders
are the reason.
"""

from __future__ import annotations

from typing import Dict, NamedTuple, Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_core.geometry import resample_chain
from vb_core.grid_map import GridMap, clearance_grid, nearest_cell, sample
from vb_robot.clearance_map import START_TOLERANCE, ShortestPaths
from vb_robot.driving.workspace import LETHAL_THRESHOLD, forbidden_cells

# [m] a border leaves no room at a point if it is nearer than twice the radius and this margin: two cells of most maps
_NAMING_MARGIN = 0.1
_NAMING_STEP = 0.05  # [m] between the points of a border whose distance is measured
SEARCH_CELLS = 200  # maximum along the map's longer side; coarse, as the path is searched only for a border's name


class KnownBorder(NamedTuple):
    """A border: its name, chain (N, 2) [m], seed (2,) [m], and whether it is a polygon."""

    name: str
    points: np.ndarray
    seed: np.ndarray
    is_polygon: bool

    def may_restrict(self, point) -> bool:
        """Returns whether a point (2,) [m] is on the seed's side of a polygon; always true for a curve, whose sides are not computed."""
        return not self.is_polygon or self._contains(point) == self._contains(self.seed)

    def _contains(self, point) -> bool:
        polygon = np.asarray(self.points, dtype=np.float32).reshape(-1, 1, 2)
        return cv2.pointPolygonTest(polygon, tuple(map(float, point)), False) >= 0


def find_border_name(borders: Sequence[KnownBorder], point) -> str:
    """Returns the name of the border that probably restricts a point (2,) [m], or "" if there are no borders.

    The maps do not say to which border a cell belongs. So polygons that may restrict the point come first, then curves,
    then other polygons; among equals, the nearest comes first.
    """

    def order(border: KnownBorder) -> tuple:
        line = resample_chain(border.points, _NAMING_STEP, border.is_polygon)
        distance = float(np.linalg.norm(line - point, axis=1).min())
        return not border.may_restrict(point), not border.is_polygon, distance

    return min(borders, key=order).name if borders else ""


def is_inside_border(map_with_borders: GridMap, physical: GridMap, point) -> bool:
    """Returns whether only a border forbids the robot to be at a point (2,) [m]."""
    position = np.reshape(point, (1, 2))
    with_borders = sample(map_with_borders, map_with_borders.data, position, -1.0)[0]
    without = sample(physical, physical.data, position, -1.0)[0]
    return bool(with_borders >= LETHAL_THRESHOLD and with_borders > without)


def border_values(name: str) -> Dict[str, str]:
    """Returns the values that name a border in a sentence, where it stands as {border}."""
    return {"border": f"'{name}'"} if name else {"border_code": "border_without_name"}


class GoalChecker:
    """Checks goals on one pair of maps.

    Args:
        map_with_borders: the map on which navigation plans.
        physical: the map without borders, of the same geometry.
        radius: [m] of the robot's inscribed circle.
        borders: those that are in force for this robot.
    """

    def __init__(
        self, map_with_borders: GridMap, physical: GridMap, radius: float, borders: Sequence[KnownBorder]
    ) -> None:
        self.map_with_borders, self.physical = map_with_borders, physical
        self.borders = borders
        self._barred = forbidden_cells(map_with_borders, physical)
        # one cell less, because navigation may round differently, and a goal must be refused only if that is certain
        self._radius = max(radius - map_with_borders.resolution, 0.5 * map_with_borders.resolution)
        self._components = {"with_borders": self._label(map_with_borders), "physical": self._label(physical)}

    def name_at(self, point) -> str:
        """Returns the name of the border that contains a point (2,) [m], or that leaves no room there."""
        reach = 2.0 * self._radius + _NAMING_MARGIN
        _, nearest = nearest_cell(self.map_with_borders, self._barred, point, reach)
        return find_border_name(self.borders, nearest)

    def check(self, start, goal) -> Optional[Tuple[str, str]]:
        """Returns why navigation will refuse a goal (2,) [m] from a start (2,) [m]: a code, and the border's name.

        The codes are "goal_off_map", "goal_in_border", "goal_in_obstacle", "goal_behind_border" and
        "goal_out_of_reach". Returns None if nothing is known against the goal. `start` is None if it is not known.
        """
        grid = self.map_with_borders
        if not grid.contains_cells(grid.world_to_cell(goal))[0]:
            return "goal_off_map", ""
        goal_components = {layer: self._component_at(layer, goal, 0.0) for layer in self._components}
        if not goal_components["physical"]:
            return "goal_in_obstacle", ""
        if not goal_components["with_borders"]:
            return "goal_in_border", self.name_at(goal)
        if start is None:
            return None
        start_components = {layer: self._component_at(layer, start, START_TOLERANCE) for layer in self._components}
        if not start_components["physical"]:
            return None
        if goal_components["physical"] != start_components["physical"]:
            return "goal_out_of_reach", ""
        if goal_components["with_borders"] != start_components["with_borders"]:
            return "goal_behind_border", self._crossed(start, goal)
        return None

    def _label(self, grid: GridMap) -> np.ndarray:
        """Labels the connected parts (H, W) of the floor with room for the robot; 0 is no room. Unknown is free."""
        room = clearance_grid(grid.data >= LETHAL_THRESHOLD, grid.resolution) >= self._radius
        return cv2.connectedComponents(room.astype(np.uint8), connectivity=4)[1]

    def _component_at(self, layer: str, point, reach: float) -> int:
        """Returns the label of the floor's part at a point (2,), else of the nearest within `reach` [m]; 0 for none."""
        components, grid = self._components[layer], self.map_with_borders
        cell = tuple(grid.world_to_cell(point)[0])
        if grid.contains_cells(np.array([cell]))[0] and components[cell]:
            return int(components[cell])
        cell, _ = nearest_cell(grid, components > 0, point, reach)
        return int(components[cell]) if cell is not None else 0

    def _crossed(self, start, goal) -> str:
        """Returns the name of the first border on the path that crosses the fewest border cells."""
        grid = self.map_with_borders
        if is_inside_border(grid, self.physical, start):
            return self.name_at(start)
        step = int(np.ceil(max(grid.shape) / SEARCH_CELLS))
        allowed = _any_of(self._components["with_borders"] > 0, step)
        passable = allowed | _any_of(self._components["physical"] > 0, step)
        # a start that is just off the map counts as on it
        last_cell = np.array(grid.shape) - 1
        ends = np.clip(grid.world_to_cell(np.array([start, goal])), 0, last_cell) // step
        passable[tuple(ends.T)] = True  # the ends may be outside the blocks that have room
        passable_cost = np.where(allowed, 1.0, 1e3)
        cost = np.where(passable, passable_cost, np.inf)
        for row, column in ShortestPaths(cost, ends[:1], np.zeros(1)).path_to(ends[1]):
            if not allowed[row, column]:
                middle = (np.array([row, column]) + 0.5) * step - 0.5
                return self.name_at(grid.cell_to_world(middle[None])[0])
        return ""


def _any_of(cells: np.ndarray, step: int) -> np.ndarray:
    """Returns, for each block of step x step cells, whether any cell is marked."""
    rows = np.logical_or.reduceat(cells, np.arange(0, cells.shape[0], step), axis=0)
    return np.logical_or.reduceat(rows, np.arange(0, cells.shape[1], step), axis=1)
