"""Distances in the physical map: how far a beam goes, how near the next obstacle is."""
from __future__ import annotations

from typing import Tuple

import cv2
import numpy as np

from vb_core.errors import CodedError
from vb_core.grid_map import OCCUPIED, GridMap


class DistanceField:
    """Distance from any place to the nearest obstacle of a map, and ray casting by it.

    Args:
        grid: the physical map; its origin must not be rotated. What is not free is an obstacle:
            nobody knows what is in unknown cells, and they lie behind the walls.

    Raises:
        CodedError: "bad_map" if the map's origin is rotated.
    """

    def __init__(self, grid: GridMap) -> None:
        if abs(grid.origin[2]) > 1e-9:
            raise CodedError("bad_map", "a simulated map's origin must not be rotated")
        self._resolution = grid.resolution
        self._origin = np.array(grid.origin[:2])
        self._free = np.pad((grid.data >= 0) & (grid.data < OCCUPIED), 1)  # a rim of obstacles ends every beam
        cells = cv2.distanceTransform(self._free.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        # from cell centre to the obstacle's edge, which is half a cell before its centre
        self._distance = np.maximum(cells.astype(float) - 0.5, 0.0) * grid.resolution
        self._rows, self._columns = self._free.shape

    def clearance(self, x: float, y: float) -> float:
        """[m] from a place to the nearest obstacle's edge, interpolated between cells; 0 off the map."""
        column = (x - self._origin[0]) / self._resolution + 0.5  # +1 for the rim, -0.5 to the cell's centre
        row = (y - self._origin[1]) / self._resolution + 0.5
        c, r = int(np.floor(column)), int(np.floor(row))
        if not (0 <= c < self._columns - 1 and 0 <= r < self._rows - 1):
            return 0.0
        fc, fr = column - c, row - r
        d = self._distance
        low = d[r, c] * (1 - fc) + d[r, c + 1] * fc
        high = d[r + 1, c] * (1 - fc) + d[r + 1, c + 1] * fc
        return float(low * (1 - fr) + high * fr)

    def cast(self, origin: Tuple[float, float], angles: np.ndarray, range_max: float) -> np.ndarray:
        """Ranges (N,) [m] of beams from `origin` [m] at `angles` (N,) [rad] in the map; inf where nothing is hit.

        Sphere tracing: each beam goes forward by the distance that is known to be free, so that a
        hundred cells of open floor cost one step.
        """
        directions = np.column_stack([np.cos(angles), np.sin(angles)]) / self._resolution
        start = (np.asarray(origin, dtype=float) - self._origin) / self._resolution + 1.0
        ranges = np.zeros(len(angles))
        result = np.full(len(angles), np.inf)
        active = np.arange(len(angles))
        smallest = self._resolution * 0.4
        # a beam along a wall creeps; no beam needs more than all cells of the map's diagonal
        for _ in range(4 * (self._rows + self._columns)):
            reached = ranges[active]
            cells = (start + reached[:, None] * directions[active]).astype(np.intp)
            np.clip(cells[:, 0], 0, self._columns - 1, out=cells[:, 0])
            np.clip(cells[:, 1], 0, self._rows - 1, out=cells[:, 1])
            rows, columns = cells[:, 1], cells[:, 0]
            hit = ~self._free[rows, columns]
            result[active[hit]] = reached[hit]
            # somewhere within the cell, not at its centre: up to half its diagonal less is free
            step = np.maximum(self._distance[rows, columns] - 0.75 * self._resolution, smallest)
            ranges[active] = reached + step
            active = active[~hit & (reached + step <= range_max)]
            if not len(active):
                break
        return result


def cast_disc(origin: Tuple[float, float], angles: np.ndarray, centre: Tuple[float, float], radius: float) -> np.ndarray:
    """Ranges (N,) [m] at which beams meet a disc, for instance a person's legs; inf where they miss."""
    to_centre = np.asarray(centre, dtype=float) - np.asarray(origin, dtype=float)
    along = np.cos(angles) * to_centre[0] + np.sin(angles) * to_centre[1]
    half_chord = radius**2 - (to_centre @ to_centre - along**2)
    with np.errstate(invalid="ignore"):
        ranges = along - np.sqrt(half_chord)
    return np.where((half_chord > 0) & (ranges > 0), ranges, np.inf)
