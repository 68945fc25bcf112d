"""Where one border is on a map, and what it restricted where it was accepted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Tuple

import cv2
import numpy as np

from vb_core.grid_map import OCCUPIED_THRESHOLD, GridMap
from vb_map_integration.border import VirtualBorder
from vb_map_integration.borders.issues import IntegrationError
from vb_map_integration.grid.region import Region
from vb_map_integration.integration import integrate
from vb_map_integration.places.registration import Transform


@dataclass(frozen=True)
class BorderPlace:
    """Where a border is on the current map.

    Attributes:
        border: there.
        is_shown: whether the walls round it say so.
        is_seen: whether the map knows the floor there; there is nothing to ask about before it does.
        others: at other places where it may be, until somebody says where it is.
        accepted: as it was accepted, on that map; None if that is the current one.
        accepted_on: that map.
        transform: from there to here.
    """

    border: VirtualBorder
    is_shown: bool = True
    is_seen: bool = True
    others: Tuple[VirtualBorder, ...] = ()
    accepted: Optional[VirtualBorder] = None
    accepted_on: Optional[GridMap] = None
    transform: Transform = Transform()

    def region_before(self, grid: GridMap) -> Optional[Region]:
        """Returns the free floor of this map that it restricted where it was accepted; None if there is none."""
        assert self.accepted is not None and self.accepted_on is not None
        try:
            effect = integrate(self.accepted_on, self.accepted)
        except IntegrationError:  # accepted by an earlier version, with other limits
            return None
        corners = self.accepted_on.grid_to_world([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        start, *ends = grid.world_to_grid(self.transform.apply(corners))
        matrix = np.column_stack([*(end - start for end in ends), start])
        there = effect.region.view(np.uint8)
        here = cv2.warpAffine(there, matrix, grid.shape[::-1], flags=cv2.INTER_NEAREST)
        left, top, width, height = cv2.boundingRect(here)
        window = slice(top, top + height), slice(left, left + width)
        free = (grid.data[window] >= 0) & (grid.data[window] < OCCUPIED_THRESHOLD)
        mask = here[window] * free * np.uint8(255)
        count = cv2.countNonZero(mask)
        return Region(window, mask, effect.value, False, count * grid.resolution**2) if count else None
