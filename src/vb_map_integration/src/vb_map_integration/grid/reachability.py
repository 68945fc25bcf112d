"""Finds what a robot can reach in a map, and what a border would cut off."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_core import masks
from vb_core.grid_map import OCCUPIED_THRESHOLD, GridMap

# larger maps are checked in coarser cells: the answer is about doors and rooms, and needed at once
MAX_CELLS = 2_000_000
# [m^2] smaller parts, measured for the robot's centre, are not counted
MIN_PART = 0.1


@dataclass(frozen=True)
class Reachability:
    """Computes where a robot can go in a map.

    Attributes:
        free_parts: number of parts of the free space, for a robot of this radius; tiny ones do not count.
        unreachable: indices of the goals that the robot cannot reach.
    """

    free_parts: int
    unreachable: Tuple[int, ...]


def check_reachability(
    grid: GridMap, goals: Sequence[Sequence[float]] = (), robot: Optional[Sequence[float]] = None, radius: float = 0.18
) -> Reachability:
    """Counts the parts of the free space, and finds the goals in a different part than the robot.

    Args:
        goals: (N, 2) [m].
        robot: (x, y) [m]; None: goals are measured against the largest part.
        radius: [m] the robot's.
    """
    free = masks.threshold_mask(np.ascontiguousarray(grid.data).view(np.uint8), OCCUPIED_THRESHOLD, cv2.CMP_LT)
    radius = radius / grid.resolution
    factor = int(np.ceil(np.sqrt(free.size / MAX_CELLS)))
    if factor > 1:
        free = _coarser(free, factor)
        grid = GridMap(np.where(free, np.int8(0), np.int8(100)), grid.resolution * factor, grid.origin)
        # a coarse cell is free only if all its cells are: obstacles have grown by half a coarse cell already
        radius = max(0.0, radius / factor - 0.5)
    if radius > 1.0:
        framed = cv2.copyMakeBorder(free, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
        free = masks.threshold_mask(cv2.distanceTransform(framed, cv2.DIST_L2, 3)[1:-1, 1:-1], radius, cv2.CMP_GT)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(free, connectivity=4)
    areas = stats[1:, cv2.CC_STAT_AREA]
    parts = int((areas * grid.resolution**2 >= MIN_PART).sum())
    if len(areas) == 0:
        return Reachability(0, tuple(range(len(goals))))
    home = int(np.argmax(areas)) + 1
    if robot is not None:
        found = _labels_near(grid, labels, robot, radius)
        if len(found) == 0:
            return Reachability(parts, tuple(range(len(goals))))
        home = int(found[0])
    return Reachability(
        parts, tuple(i for i, goal in enumerate(goals) if home not in _labels_near(grid, labels, goal, radius))
    )


def _coarser(free: np.ndarray, factor: int) -> np.ndarray:
    """Makes a mask (H, W) uint8 with cells `factor` times as large; one is set only where all are."""
    rows, columns = (-(-size // factor) for size in free.shape)
    padded = cv2.copyMakeBorder(
        free, 0, rows * factor - free.shape[0], 0, columns * factor - free.shape[1], cv2.BORDER_CONSTANT, value=0
    )
    return masks.threshold_mask(cv2.resize(padded, (columns, rows), interpolation=cv2.INTER_AREA), 254, cv2.CMP_GT)


def _labels_near(grid: GridMap, labels: np.ndarray, point: Sequence[float], radius: float) -> np.ndarray:
    """Labels of the parts within a robot's radius of a point that is itself on the map; the nearest first."""
    row, column = (int(value) for value in grid.world_to_cell(point)[0])
    if not grid.contains_cells([[row, column]])[0]:
        return np.array([], dtype=int)
    if labels[row, column]:
        return labels[row : row + 1, column]
    if grid.data[row, column] < 0 or grid.data[row, column] >= OCCUPIED_THRESHOLD:
        return np.array([], dtype=int)
    reach = int(radius) + 1
    top, left = max(0, row - reach), max(0, column - reach)
    window = labels[top : row + reach + 1, left : column + reach + 1]
    rows, columns = np.nonzero(window)
    distance = np.hypot(rows + top - row, columns + left - column)
    near = np.argsort(distance)[: int((distance <= reach).sum())]
    return np.array(list(dict.fromkeys(window[rows[near], columns[near]].tolist())), dtype=int)
