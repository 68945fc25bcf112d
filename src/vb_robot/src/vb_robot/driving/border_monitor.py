"""Tells where a robot is with respect to the borders, and which border that is."""
from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import List, Sequence, Tuple

import cv2
import numpy as np

from vb_core.grid_map import GridMap
from vb_robot.driving.safety import HARD
from vb_robot.clearance_map import clearance_grid, nearest_cell, sample


@dataclass(frozen=True)
class KnownBorder:
    """A border as far as the monitor needs it: its name, chain (N, 2) [m], seed (2,) [m], and kind."""

    name: str
    points: np.ndarray
    seed: np.ndarray
    polygon: bool


class BorderContact(enum.Enum):
    """Where a footprint is with respect to the borders, from best to worst."""

    FREE = 0
    TOUCHES = 1
    INSIDE = 2


class BorderMonitor:
    """Compares the posterior with the physical map: what is more occupied is restricted by borders.

    The maps decide what is restricted, so that this always agrees with navigation. The borders only lend names.

    Args:
        posterior, physical: maps of the same geometry.
        borders: those that are enabled and meant for this robot.
        robot_radius: [m]
    """

    def __init__(
        self, posterior: GridMap, physical: GridMap, borders: Sequence[KnownBorder], robot_radius: float
    ) -> None:
        self._grid = posterior
        self._radius = robot_radius
        self._borders = list(borders)
        # unknown (-1) that becomes occupied is restricted too
        self.restricted = posterior.data > np.maximum(physical.data, 0)
        self._hard = self.restricted & (posterior.data >= HARD)
        _, self._parts = cv2.connectedComponents(self.restricted.astype(np.uint8), connectivity=8)
        # what is off the map is not a border
        self._gap = clearance_grid(self.restricted, posterior.resolution, edge=False)
        self._hard_gap = clearance_grid(self._hard, posterior.resolution, edge=False)

    def name_borders(self, borders: Sequence[KnownBorder]) -> None:
        """Takes the borders that lend their names."""
        self._borders = list(borders)

    def standing(self, place) -> BorderContact:
        """Where the round footprint at a place (2,) [m] is with respect to the restricted area."""
        point = np.asarray(place, dtype=float).reshape(1, 2)
        if sample(self._grid, self.restricted, point)[0] > 0:
            return BorderContact.INSIDE
        gap = sample(self._grid, self._gap, point, outside=np.inf)[0]
        return BorderContact.TOUCHES if gap < self._radius else BorderContact.FREE

    def distance_to_keepout(self, place) -> float:
        """[m] from a place (2,) [m] to the area that may not be entered at all; 0 within it."""
        return float(sample(self._grid, self._hard_gap, np.asarray(place, dtype=float).reshape(1, 2), np.inf)[0])

    def is_hard(self, place) -> bool:
        """Whether the restricted cell nearest to a place (2,) [m] may not be entered at all."""
        cell, _ = self._nearest(place)
        return cell is not None and bool(self._hard[cell])

    def names_at(self, place) -> List[str]:
        """The names of the borders that restrict a place (2,) [m], or the restricted area next to it.

        Usually one; several where restricted areas overlap and their chains cannot tell them apart.
        """
        cell, centre = self._nearest(place)
        if cell is None or not self._borders:
            return []
        part = self._parts[cell]
        seeds = np.array([border.seed for border in self._borders])
        here = [
            border for border, value in zip(self._borders, sample(self._grid, self._parts, seeds)) if value == part
        ]
        certain = [border for border in here if border.polygon and _same_side(border, centre)]
        if not certain:
            certain = [border for border in here if not border.polygon]
        if not certain:
            # a part that a border cut off contains no seed: the nearest chain made it
            nearest = min(self._borders, key=lambda b: float(np.linalg.norm(b.points - centre, axis=1).min()))
            certain = here or [nearest]
        return [border.name for border in certain]

    def _nearest(self, place) -> Tuple:
        """((row, column), centre (2,)) of the restricted cell nearest to a place within twice the radius."""
        return nearest_cell(self._grid, self.restricted, place, 2.0 * self._radius + self._grid.resolution)


def _same_side(border: KnownBorder, place: np.ndarray) -> bool:
    """Whether a place lies on the same side of a polygon as the border's seed."""
    polygon = np.asarray(border.points, dtype=np.float32).reshape(-1, 1, 2)
    inside = [cv2.pointPolygonTest(polygon, (float(p[0]), float(p[1])), False) >= 0 for p in (place, border.seed)]
    return inside[0] == inside[1]
