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
# cells of each kind that are looked for
SAMPLES = 200_000


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

    Obstacles and free cells of the old map must be found again at the same coordinates; a sample of them tells.
    """
    random = np.random.default_rng(0)
    cells = np.ascontiguousarray(old.data)
    obstacles = cv2.findNonZero(_mask(cells, OCCUPIED_FROM, 100))
    was_obstacle = np.zeros((0, 2), int) if obstacles is None else obstacles[:, 0, ::-1]
    if len(was_obstacle) > SAMPLES:
        was_obstacle = was_obstacle[random.integers(len(was_obstacle), size=SAMPLES)]
    if cells.size > SAMPLES:
        drawn = random.integers(cells.size, size=SAMPLES)
    else:
        drawn = np.arange(cells.size)
    values = cells.ravel()[drawn]
    was_free = np.column_stack(np.unravel_index(drawn[(values >= 0) & (values < OCCUPIED_FROM)], cells.shape))
    pairs = ((was_obstacle, (OCCUPIED_FROM, 100)), (was_free, (0, OCCUPIED_FROM - 1)))
    shares = [_found_again(old.cell_to_world(places), new, *limits) for places, limits in pairs if len(places)]
    return bool(shares) and min(shares) >= AGREEMENT


def _mask(cells: np.ndarray, low: int, high: int) -> np.ndarray:
    """(H, W) uint8: 255 where a cell's value lies between two others, both included."""
    return cv2.inRange(cells.view(np.uint8), low, high)


def _found_again(points: np.ndarray, grid: GridMap, low: int, high: int) -> float:
    """Share of points (N, 2) [m] beside which there is a cell between two values."""
    kernel = np.ones((2 * TOLERANCE + 1, 2 * TOLERANCE + 1), np.uint8)
    near = cv2.dilate(_mask(np.ascontiguousarray(grid.data), low, high), kernel)
    return float((grid.with_data(near.view(np.int8)).values_at(points, outside=0) != 0).mean())
