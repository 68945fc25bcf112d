"""Whether a map is the one that borders were drawn on."""
from __future__ import annotations

import hashlib

import cv2
import numpy as np

from vb_core.grid_map import GridMap

OCCUPIED_FROM = 65
# [cells] tolerated between an obstacle's edge in the one map and in the other
TOLERANCE = 2
# share of the older map's obstacles and free cells that must still be there; a guess: moved furniture passes,
# another floor of the same house does not
AGREEMENT = 0.8


def fingerprint(grid: GridMap) -> str:
    """A map's identity: 64 hexadecimal digits that depend on every cell, on size, resolution and origin."""
    digest = hashlib.sha256()
    digest.update(np.array(grid.shape, np.int64).tobytes())
    # map_server and bags carry the resolution as float32
    digest.update(np.array([grid.resolution], np.float32).tobytes())
    digest.update(np.array(grid.origin, np.float32).tobytes())
    digest.update(np.ascontiguousarray(grid.data).data)
    return digest.hexdigest()


def compatible(old: GridMap, new: GridMap) -> bool:
    """Whether a new map shows the place of an old one: corrected, or grown, as a SLAM map does.

    Obstacles and free cells of the old map must be found again at the same coordinates.
    """
    rows, columns = np.nonzero(old.data >= 0)
    if len(rows) == 0:
        return False
    if len(rows) > 200_000:  # a regular sample tells as well
        step = len(rows) // 200_000 + 1
        rows, columns = rows[::step], columns[::step]
    was_obstacle = old.data[rows, columns] >= OCCUPIED_FROM
    points = old.cell_to_world(np.column_stack([rows, columns]))
    kernel = np.ones((2 * TOLERANCE + 1, 2 * TOLERANCE + 1), np.uint8)
    obstacles = cv2.dilate((new.data >= OCCUPIED_FROM).astype(np.uint8), kernel)
    free = cv2.dilate(((new.data >= 0) & (new.data < OCCUPIED_FROM)).astype(np.uint8), kernel)
    near_obstacle = new.with_data(obstacles.astype(np.int8)).values_at(points) > 0
    still_free = new.with_data(free.astype(np.int8)).values_at(points) > 0
    shares = []
    if was_obstacle.any():
        shares.append(float(near_obstacle[was_obstacle].mean()))
    if not was_obstacle.all():
        shares.append(float(still_free[~was_obstacle].mean()))
    return min(shares) >= AGREEMENT
