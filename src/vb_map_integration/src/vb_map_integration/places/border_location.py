"""Locates a border on a new map by the walls round it. Maps are distorted, so their transform is a first guess."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Mapping, Optional, Tuple

import numpy as np

from vb_core.grid_map import GridMap, Transform
from vb_map_integration.border import VirtualBorder
from vb_map_integration.places.walls import WallMap, fit_locally
from vb_map_integration.storage.border_database import StoredMap

_MIN_SEEN_SHARE = 0.5  # share of a border's points that the map must know before a person is asked about the border


@dataclass(frozen=True)
class BorderLocation:
    """Where a border is on the current map.

    Attributes:
        border: the border at its position on this map.
        walls_agree: whether the walls round it confirm the position.
        floor_is_known: whether the map knows the floor there; until it does, no person is asked about the border.
        alternatives: the border at other possible positions, until a person says where it is.
        accepted: the border as a person accepted it, on `accepted_map`; None if that is the current map.
        accepted_map: the map on which it was accepted.
        transform: transform from that map's frame to the current one's.
    """

    border: VirtualBorder
    walls_agree: bool = True
    floor_is_known: bool = True
    alternatives: Tuple[VirtualBorder, ...] = ()
    accepted: Optional[VirtualBorder] = None
    accepted_map: Optional[GridMap] = None
    transform: Transform = Transform()


@dataclass(frozen=True)
class BorderLocator:
    """Locates the borders of a place on one of its maps.

    Attributes:
        grid, map_id: the map, and its fingerprint.
        stored_maps: the place's stored maps by fingerprint, the oldest first.
        transform: transform from the place's frame to the map's.
        other_transform: a second possible one; None if there is none.
    """

    grid: GridMap
    map_id: str
    stored_maps: Mapping[str, StoredMap]
    transform: Transform
    other_transform: Optional[Transform]

    @cached_property
    def _walls(self) -> WallMap:  # only needed for a border that was accepted on another map
        return WallMap(self.grid)

    def locate(self, border: VirtualBorder) -> BorderLocation:
        """Locates a stored border by the walls round it if they settle its position, else where it is expected."""
        # undo may restore a border whose map was dropped; a place's first map is never dropped
        stored = self.stored_maps.get(border.map_id) or next(iter(self.stored_maps.values()), None)
        if stored is None or stored.fingerprint == self.map_id:
            return BorderLocation(border.transform(self.transform))
        accepted = border.transform(stored.transform)
        expected = self.transform.after(stored.transform.inverse)
        fit = fit_locally(wall_map_of(stored), self._walls, expected, accepted.points)
        points = expected.apply(np.concatenate([accepted.points, [accepted.seed]]))
        floor_is_known = float(self._walls.is_known(points).mean()) >= _MIN_SEEN_SHARE
        walls_agree = fit is not None and fit.is_certain
        transform = fit.transform if fit is not None and walls_agree else expected
        alternatives = []
        if fit is not None and fit.is_possible and not walls_agree:
            alternatives.append(accepted.transform(fit.transform))
        if self.other_transform is not None:
            alternatives.append(border.transform(self.other_transform))
        return BorderLocation(
            border=accepted.transform(transform),
            walls_agree=walls_agree,
            floor_is_known=floor_is_known,
            alternatives=tuple(alternatives),
            accepted=accepted,
            accepted_map=stored.grid,
            transform=transform,
        )


@lru_cache(maxsize=64)
def wall_map_of(stored_map: StoredMap) -> WallMap:
    """Returns the walls of a stored map."""
    return WallMap(stored_map.grid)
