"""The parts into which borders split the free floor of a map."""

from __future__ import annotations

import cv2
import numpy as np

from vb_core.grid_map import OCCUPIED_THRESHOLD, GridMap

# larger maps are checked in coarser cells: the check is about doors and rooms, and people wait for its result
MAX_CELLS = 2_000_000
# [m^2] smaller parts, by the area that the robot's centre can reach, are not counted
MIN_PART = 0.1


def count_free_parts(grid: GridMap, radius: float) -> int:
    """Counts the parts into which the free space falls for a robot of a given radius [m]; tiny ones are left out."""
    free = cv2.inRange(np.ascontiguousarray(grid.data), 0, OCCUPIED_THRESHOLD - 1)
    factor = int(np.ceil(np.sqrt(free.size / MAX_CELLS)))
    cell = grid.resolution * factor
    reach = radius / cell
    if factor > 1:
        free = _coarser(free, factor)
        # a coarse cell is free only if all its cells are: obstacles have grown by half a coarse cell already
        reach = max(0.0, reach - 0.5)
    if reach > 1.0:
        framed = cv2.copyMakeBorder(free, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
        free = (cv2.distanceTransform(framed, cv2.DIST_L2, 3)[1:-1, 1:-1] > reach).astype(np.uint8)
    _, _, stats, _ = cv2.connectedComponentsWithStats(free, connectivity=4)
    return int((stats[1:, cv2.CC_STAT_AREA] * cell**2 >= MIN_PART).sum())


def _coarser(free: np.ndarray, factor: int) -> np.ndarray:
    """Makes a mask (H, W) uint8 with cells `factor` times as large; a coarse cell is set only if all its cells are."""
    rows, columns = (-(-size // factor) for size in free.shape)
    padded = cv2.copyMakeBorder(
        free, 0, rows * factor - free.shape[0], 0, columns * factor - free.shape[1], cv2.BORDER_CONSTANT, value=0
    )
    return cv2.inRange(cv2.resize(padded, (columns, rows), interpolation=cv2.INTER_AREA), 255, 255)
