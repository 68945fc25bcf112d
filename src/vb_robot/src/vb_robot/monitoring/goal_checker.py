"""Finds the border that contains a robot, and the reason why a goal is unreachable, before navigation fails. No ROS.

Navigation gives up after its recoveries, half a minute later, and gives no reason. The maps show at once whether the
robot does not fit at the goal, or no free floor leads to it; the map without borders shows whether borders are why.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_core.grid_layers import clearance_grid, nearest_cell, sample
from vb_core.grid_map import GridMap
from vb_robot.clearance_map import START_TOLERANCE
from vb_robot.shortest_paths import ShortestPaths
from vb_robot.driving.workspace import LETHAL_THRESHOLD, forbidden

NEAR = 0.1  # [m] beyond twice the radius: two cells of most maps
SEARCH_CELLS = 200  # cells along the map's longer side: coarse, since the path is searched only for the border's name


@dataclass(frozen=True)
class KnownBorder:
    """A border's name, chain (N, 2) [m], seed (2,) [m], and kind."""

    name: str
    points: np.ndarray
    seed: np.ndarray
    polygon: bool

    def may_restrict(self, point) -> bool:
        """Returns whether a point is on the seed's side of a polygon; always true for a curve, which has no inside."""
        polygon = np.asarray(self.points, dtype=np.float32).reshape(-1, 1, 2)
        inside = [cv2.pointPolygonTest(polygon, (float(p[0]), float(p[1])), False) >= 0 for p in (point, self.seed)]
        return not self.polygon or inside[0] == inside[1]


def name_of(known: Sequence[KnownBorder], point) -> str:
    """Returns the name of the border that restricts a point (2,) [m]; "" if none is known.

    The maps do not say which border a cell is from, so polygons that may restrict the point come first, then curves; of
    each, the nearest.
    """

    def order(border: KnownBorder) -> tuple:
        distance = float(np.linalg.norm(border.points - point, axis=1).min())
        return not border.may_restrict(point), not border.polygon, distance

    return min(known, key=order).name if known else ""


def is_inside(borders: GridMap, physical: GridMap, point) -> bool:
    """Returns whether only a border forbids a point (2,) [m] to the robot."""
    bordered, plain = (sample(grid, grid.data, np.reshape(point, (1, 2)), -1.0)[0] for grid in (borders, physical))
    return bool(bordered >= LETHAL_THRESHOLD and bordered > plain)


def quoted(name: str) -> str:
    """Returns a border's name in quotes, for sentences."""
    return f"'{name}'" if name else "$border_without_name"


class GoalChecker:
    """Checks goals on one pair of maps.

    Args:
        borders: the map with borders, to plan on; physical: the map without, of the same geometry.
        radius: [m] of the robot's inscribed circle.
        known: the borders that are in force for this robot, for their names.
    """

    def __init__(self, borders: GridMap, physical: GridMap, radius: float, known: Sequence[KnownBorder]) -> None:
        self.borders, self.physical, self._known = borders, physical, known
        self._restricted = forbidden(borders, physical)
        # goals are refused only if that is certain: navigation may round differently by a cell
        self._radius = max(radius - borders.resolution, 0.5 * borders.resolution)
        self._areas = {which: self._label_areas(grid) for which, grid in (("borders", borders), ("physical", physical))}

    def name_at(self, point) -> str:
        """Returns the name of the border that contains a point (2,) [m], or leaves no room there."""
        return name_of(self._known, nearest_cell(self.borders, self._restricted, point, 2.0 * self._radius + NEAR)[1])

    def check(self, start, goal) -> Optional[Tuple[str, str]]:
        """Returns the reason why navigation will refuse a goal (2,) [m] from a start (2,) [m] or None.

        The reason is (code, border's name), with a code of "goal_off_map", "goal_in_border", "goal_in_obstacle",
        "goal_behind_border" or "goal_out_of_reach". Returns None without a reason.
        """
        grid = self.borders
        if not grid.contains_cells(grid.world_to_cell(goal))[0]:
            return "goal_off_map", ""
        goal_areas = {name: self._find_area(name, goal, 0.0) for name in self._areas}
        if not goal_areas["physical"]:
            return "goal_in_obstacle", ""
        if not goal_areas["borders"]:
            return "goal_in_border", self.name_at(goal)
        if start is None:
            return None
        start_areas = {name: self._find_area(name, start, START_TOLERANCE) for name in self._areas}
        if not start_areas["physical"] or goal_areas["physical"] != start_areas["physical"]:
            return ("goal_out_of_reach", "") if start_areas["physical"] else None
        if not start_areas["borders"] or goal_areas["borders"] != start_areas["borders"]:
            return "goal_behind_border", self._find_crossed_border(start, goal)
        return None

    def _label_areas(self, grid: GridMap) -> np.ndarray:
        """Labels the connected areas of floor (H, W) where the robot fits; 0 elsewhere. Unknown may be free."""
        room = clearance_grid(grid.data >= LETHAL_THRESHOLD, grid.resolution) >= self._radius
        return cv2.connectedComponents(room.astype(np.uint8), connectivity=4)[1]

    def _find_area(self, name: str, point, reach: float) -> int:
        areas, grid = self._areas[name], self.borders
        cell = tuple(grid.world_to_cell(point)[0])
        if grid.contains_cells(np.array([cell]))[0] and areas[cell]:
            return int(areas[cell])
        cell, _ = nearest_cell(grid, areas > 0, point, reach)
        return int(areas[cell]) if cell is not None else 0

    def _find_crossed_border(self, start, goal) -> str:
        """Returns the name of the first border on the path that crosses the fewest border cells."""
        if is_inside(self.borders, self.physical, start):
            return self.name_at(start)
        step = int(np.ceil(max(self.borders.shape) / SEARCH_CELLS))
        allowed, passable = (_downsample(self._areas[which] > 0, step) for which in ("borders", "physical"))
        passable |= allowed
        end_cells = self.borders.world_to_cell(np.array([start, goal])) // step
        passable[tuple(end_cells.T)] = True  # even if they lie beside the blocks where the robot fits
        cost = np.where(passable, np.where(allowed, 1.0, 1e3), np.inf)
        for row, column in ShortestPaths(cost, end_cells[:1], np.zeros(1)).path_to(end_cells[1]):
            if not allowed[row, column]:
                center = (np.array([row, column]) + 0.5) * step - 0.5
                return self.name_at(self.borders.cell_to_world(center[None])[0])
        return ""


def _downsample(cells: np.ndarray, step: int) -> np.ndarray:
    """Returns whether any cell of each block of step x step is marked."""
    rows = np.logical_or.reduceat(cells, np.arange(0, cells.shape[0], step), axis=0)
    return np.logical_or.reduceat(rows, np.arange(0, cells.shape[1], step), axis=1)
