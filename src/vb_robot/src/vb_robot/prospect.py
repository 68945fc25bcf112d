"""Where a robot is to look: at the spot, or where the stationary cameras are about to lose it."""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Optional

import numpy as np

from vb_core.grid_map import GridMap, distance_to
from vb_core.parameters import Parameters, param
from vb_robot.terrain import Terrain, sample
from vb_robot.viewpoint import Drawing


@dataclass(frozen=True)
class ProspectParams(Parameters):
    """How far ahead is looked."""

    horizon: float = param(2.0, "m", low=0.0, high=10.0, doc="how far the line is thought straight on")
    beyond: float = param(0.3, "m", low=0.0, high=2.0, doc="the robot looks so far beyond the edge of what cameras see")
    beside: float = param(1.0, "m", low=0.0, high=5.0, doc="so near to the spot floor that nobody sees counts")
    least_gap: float = param(0.15, "m", low=0.0, high=2.0, doc="narrower shadows, as of a table's leg, do not count")
    lead: float = param(0.3, "m", low=0.0, high=1.0, doc="the robot looks so far ahead of a spot that it alone sees")


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
        self._places = coverage.cell_to_world(np.argwhere(self.mask))

    def at(self, points: np.ndarray) -> np.ndarray:
        """(N,) bool: which points (N, 2) [m] nobody sees."""
        return sample(self._grid, self.mask, points) > 0

    def nearest(self, point: np.ndarray, within: float) -> Optional[np.ndarray]:
        """(2,) [m] the nearest place that nobody sees, not farther than `within` [m]."""
        if not len(self._places):
            return None
        gaps = np.linalg.norm(self._places - point, axis=1)
        best = int(np.argmin(gaps))
        return self._places[best] if gaps[best] <= within else None


def with_focus(terrain: Terrain, unseen: Optional[UnseenFloor], drawing: Drawing, params: ProspectParams) -> Drawing:
    """The drawing with what the robot is to look at.

    While stationary cameras see the spot: where they will lose it if it goes straight on, or else the floor beside it
    that they do not see. When they do not: a little ahead of it.
    """
    if drawing.seeding:
        return drawing
    spot = np.asarray(drawing.spot, dtype=float)
    if drawing.watched and unseen is not None:
        place = _exit(terrain, unseen, spot, drawing.direction, params)
        if place is None:
            place = unseen.nearest(spot, params.beside)
        return drawing if place is None else replace(drawing, focus=place)
    if drawing.direction is None or drawing.watched:
        return drawing
    return replace(drawing, focus=spot + _room(terrain, spot, drawing.direction, params.lead) * drawing.direction)


def thought_on(terrain: Terrain, spot: np.ndarray, direction: np.ndarray, distance: float) -> np.ndarray:
    """(2,) [m] a spot (2,) moved on along a unit vector (2,), but not into a wall."""
    return spot + _room(terrain, spot, direction, distance) * direction


def _room(terrain: Terrain, spot: np.ndarray, direction: np.ndarray, distance: float) -> float:
    room = float(np.linalg.norm(terrain.ray_end(spot, direction) - spot)) - 0.05
    return min(distance, max(0.0, room))


def _exit(
    terrain: Terrain, unseen: UnseenFloor, spot: np.ndarray, direction: Optional[np.ndarray], params: ProspectParams
) -> Optional[np.ndarray]:
    """(2,) [m] a little beyond where the line ahead of the spot leaves what cameras see; None if it does not."""
    if direction is None:
        return None
    room = _room(terrain, spot, direction, params.horizon)
    along = np.arange(0.0, room + 1e-9, 0.05)
    lost = np.flatnonzero(unseen.at(spot + along[:, None] * direction))
    if not len(lost):
        return None
    reach = _room(terrain, spot, direction, params.horizon + params.beyond)
    return spot + min(float(along[lost[0]]) + params.beyond, reach) * direction
