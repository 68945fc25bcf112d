"""Why a goal cannot be reached, before navigation has found out. No ROS.

The idea: navigation gives up after its recoveries, half a minute later, and does not say why. The maps tell at once:
the goal has no room, or no free floor joins it to the robot; and the map without borders tells whether borders are why.
"""

from __future__ import annotations

from typing import Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_core.grid_layers import clearance_grid, nearest_cell
from vb_core.grid_map import GridMap
from vb_robot.clearance_map import START_TOLERANCE
from vb_robot.grid_ways import GridWays
from vb_robot.driving.workspace import LETHAL_THRESHOLD, BorderContact, KnownBorder, Workspace

SEARCH_CELLS = 200  # along the map's longer side: the way is only searched for the border's name


class GoalReview:
    """Reviews goals on one pair of maps.

    Args:
        borders: the map with borders; physical: the one without; radius: [m] of the robot's inscribed circle.
        known: the borders that are in force for this robot; they lend names.
    """

    def __init__(
        self, borders: GridMap, physical: Optional[GridMap], radius: float, known: Sequence[KnownBorder]
    ) -> None:
        self.workspace = Workspace(borders, physical, radius, known)
        # only what is certain is called out of reach: navigation may round differently by a cell
        self._radius = max(radius - borders.resolution, 0.5 * borders.resolution)
        self._rooms = {
            which: self._connected(grid)
            for which, grid in (("borders", borders), ("physical", self.workspace.physical))
        }

    def is_inside(self, place) -> bool:
        """Returns whether a place (2,) [m] is in an area that must not be entered."""
        return self.workspace.contact_at(place) is BorderContact.INSIDE and self.workspace.is_lethal(place)

    def review(self, start, goal) -> Optional[Tuple[str, str]]:
        """Returns why navigation will refuse a goal (2,) [m] from a start (2,) [m] or None: (code, border's name).

        Codes: "goal_off_map", "goal_in_border", "goal_in_obstacle", "goal_behind_border", "goal_out_of_reach". None if
        nothing speaks against the goal.
        """
        grid = self.workspace.borders
        if not grid.contains_cells(grid.world_to_cell(goal))[0]:
            return "goal_off_map", ""
        there = {which: self._room_at(which, goal, 0.0) for which in self._rooms}
        if not there["physical"]:
            return "goal_in_obstacle", ""
        if not there["borders"]:
            return "goal_in_border", self.workspace.name_at(goal)
        if start is None:
            return None
        here = {which: self._room_at(which, start, START_TOLERANCE) for which in self._rooms}
        if not here["physical"] or there["physical"] != here["physical"]:
            return ("goal_out_of_reach", "") if here["physical"] else None
        if not here["borders"] or there["borders"] != here["borders"]:
            return "goal_behind_border", self._crossed(start, goal)
        return None

    def _connected(self, grid: GridMap) -> np.ndarray:
        """Numbers the floor (H, W) that the robot can reach within itself; 0: no room. Unknown floor may be free."""
        room = clearance_grid(grid.data >= LETHAL_THRESHOLD, grid.resolution, edge=False) >= self._radius
        return cv2.connectedComponents(room.astype(np.uint8), connectivity=4)[1]

    def _room_at(self, which: str, place, reach: float) -> int:
        rooms, grid = self._rooms[which], self.workspace.borders
        cell = tuple(grid.world_to_cell(place)[0])
        if grid.contains_cells(np.array([cell]))[0] and rooms[cell]:
            return int(rooms[cell])
        cell, _ = nearest_cell(grid, rooms > 0, place, reach)
        return int(rooms[cell]) if cell is not None else 0

    def _crossed(self, start, goal) -> str:
        """Returns the name of the first border on the way that crosses the fewest border cells."""
        if self.is_inside(start):
            return self.workspace.name_at(start)
        step = int(np.ceil(max(self.workspace.borders.shape) / SEARCH_CELLS))
        allowed, passable = (_any_of(self._rooms[which] > 0, step) for which in ("borders", "physical"))
        passable |= allowed
        ends = self.workspace.borders.world_to_cell(np.array([start, goal])) // step
        passable[tuple(ends.T)] = True  # between two blocks that have room
        cost = np.where(passable, np.where(allowed, 1.0, 1e3), np.inf)
        for row, column in GridWays(cost, ends[:1], np.zeros(1)).way_to(ends[1]):
            if not allowed[row, column]:
                middle = (np.array([row, column]) + 0.5) * step - 0.5
                return self.workspace.name_at(self.workspace.borders.cell_to_world(middle[None])[0])
        return ""


def _any_of(cells: np.ndarray, step: int) -> np.ndarray:
    """Returns whether any cell of each block of step x step is marked."""
    rows = np.logical_or.reduceat(cells, np.arange(0, cells.shape[0], step), axis=0)
    return np.logical_or.reduceat(rows, np.arange(0, cells.shape[1], step), axis=1)
