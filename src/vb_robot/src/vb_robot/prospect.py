"""Where a robot is to look: at the spot, or where the stationary cameras are about to lose it."""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Optional

import numpy as np

from vb_core.grid_map import GridMap, distance_to
from vb_core.parameters import Parameters, param
from vb_robot.terrain import Terrain, sample
from vb_robot.viewpoint import NO_STRETCH, Drawing

STEP = 0.05  # [m] between places of a line that is thought on


@dataclass(frozen=True)
class ProspectParams(Parameters):
    """How far ahead is looked."""

    horizon: float = param(2.0, "m", low=0.0, high=10.0, doc="how far the line is thought straight on")
    ahead: float = param(0.3, "m", low=0.0, high=2.0, doc="the robot looks so far into what only it can see")
    beside: float = param(1.0, "m", low=0.0, high=5.0, doc="so near to the spot floor that nobody sees counts")
    least_gap: float = param(0.15, "m", low=0.0, high=2.0, doc="narrower shadows, as of a table's leg, do not count")


class UnseenFloor:
    """Floor that no stationary camera sees, without narrow shadows.

    Args:
        coverage: how many cameras see each cell; 0: none; -1: no floor. See camera_coverage_node.
    """

    def __init__(self, coverage: GridMap, least_gap: float) -> None:
        self._grid = coverage
        depth = distance_to(coverage.data != 0) * coverage.resolution
        core = depth >= 0.5 * least_gap
        # what was taken off the edges of the wide parts is given back
        near_core = distance_to(core) * coverage.resolution <= 0.5 * least_gap
        self.mask = (coverage.data == 0) & near_core

    def at(self, points: np.ndarray) -> np.ndarray:
        """(N,) bool: which points (N, 2) [m] nobody sees."""
        return sample(self._grid, self.mask, points) > 0

    def nearest(self, point: np.ndarray, within: float) -> Optional[np.ndarray]:
        """(2,) [m] the nearest place that nobody sees, not farther than `within` [m]."""
        row, column = self._grid.world_to_cell(np.asarray(point))[0]
        reach = int(np.ceil(within / self._grid.resolution))
        top, left = max(row - reach, 0), max(column - reach, 0)
        cells = np.argwhere(self.mask[top:max(row + reach + 1, 0), left:max(column + reach + 1, 0)])
        if not len(cells):
            return None
        places = self._grid.cell_to_world(cells + (top, left))
        gaps = np.linalg.norm(places - point, axis=1)
        best = int(np.argmin(gaps))
        return places[best] if gaps[best] <= within else None


def with_focus(terrain: Terrain, unseen: Optional[UnseenFloor], drawing: Drawing, params: ProspectParams) -> Drawing:
    """The drawing with what the robot is to look at.

    While stationary cameras see the spot: the stretch on which they will lose it if it goes straight on, or else the
    floor beside it that they do not see. When they do not: from where it was seen last on. People notice that they
    have lost the cameras a moment later, and hold still some decimetres beyond.
    """
    if drawing.seeding:
        return drawing
    spot = np.asarray(drawing.spot, dtype=float)
    if drawing.direction is None:
        stretch = spot[None] if not drawing.watched else NO_STRETCH
    elif not drawing.watched:
        stretch = _straight_on(terrain, spot, drawing.direction, params.horizon)
    elif unseen is not None:
        stretch = _first_unseen(unseen, _straight_on(terrain, spot, drawing.direction, params.horizon))
    else:
        stretch = NO_STRETCH
    if len(stretch):
        focus = stretch[min(int(round(params.ahead / STEP)), len(stretch) - 1)]
        return replace(drawing, focus=focus, stretch=stretch)
    place = unseen.nearest(spot, params.beside) if drawing.watched and unseen is not None else None
    return drawing if place is None else replace(drawing, focus=place)


def _straight_on(terrain: Terrain, spot: np.ndarray, direction: np.ndarray, length: float) -> np.ndarray:
    """(K, 2) [m] places a STEP apart from a spot on along a unit vector (2,), but not into a wall."""
    room = float(np.linalg.norm(terrain.ray_end(spot, direction) - spot)) - 0.05
    return spot + np.arange(0.0, min(length, max(0.0, room)) + 1e-9, STEP)[:, None] * direction


def _first_unseen(unseen: UnseenFloor, line: np.ndarray) -> np.ndarray:
    """(K, 2) [m] the first part of a line (N, 2) that no stationary camera sees; empty if they see all of it."""
    hidden = unseen.at(line)
    if not hidden.any():
        return NO_STRETCH
    begin = int(np.argmax(hidden))
    seen_again = np.flatnonzero(~hidden[begin:])
    return line[begin:begin + int(seen_again[0])] if len(seen_again) else line[begin:]
