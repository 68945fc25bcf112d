"""Polygons, chains and regions on the cells of a grid, and the parts into which borders split its free floor.

Coordinates are (column, row) as from `GridMap.world_to_grid`: whole numbers are the centres of cells.
Masks are uint8, 0 or 255, as OpenCV uses them. Most cover only a window of the map, as all of a large map is slow,
and none is made by numpy.zeros, whose small memory pages cost a page fault each.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

import cv2
import numpy as np

from vb_core.grid_map import OCCUPIED_THRESHOLD, GridMap
from vb_map_integration.border import IntegrationError

# rows and columns of a part of a map
CellWindow = Tuple[slice, slice]

# crossings of edges and rows that one polygon may have; a scribble with more would fill the memory
MAX_CROSSINGS = 4_000_000
# larger maps are checked in coarser cells: the check is about doors and rooms, and people wait for its result
MAX_CELLS = 2_000_000
# [m^2] smaller parts, by the area that the robot's centre can reach, are not counted
MIN_PART = 0.1


def polygon_mask(vertices: np.ndarray, shape: Tuple[int, int]) -> Tuple[CellWindow, np.ndarray]:
    """Finds the cells whose centre is in a polygon, clipped to the map.

    By the nonzero rule, all that the outline winds round is inside: an overshoot at the closing point leaves no hole.

    Args:
        vertices: (N, 2) (column, row), the first one not repeated.
        shape: (H, W) of the map.

    Returns:
        The window of the map that the polygon covers, which may be empty, and its (h, w) uint8 mask.

    Raises:
        IntegrationError: "too_complex" for an outline that crosses more than MAX_CROSSINGS rows.
    """
    corners = np.array([vertices.min(axis=0), vertices.max(axis=0) + 1.0])
    (left, top), (right, bottom) = np.ceil(np.minimum(np.maximum(corners, 0.0), shape[::-1])).astype(int).tolist()
    window = slice(top, bottom), slice(left, right)
    mask = np.full((bottom - top, right - left), 0, np.uint8)
    start = vertices - (left, top)
    end = np.concatenate([start[1:], start[:1]])
    y0, y1 = start[:, 1], end[:, 1]
    reach = np.array([np.minimum(y0, y1), np.maximum(y0, y1)])
    low, high = np.ceil(np.minimum(np.maximum(reach, 0.0), len(mask))).astype(np.int64)
    counts = high - low
    total = int(counts.sum())
    if total > MAX_CROSSINGS:
        raise IntegrationError("too_complex")
    edge = np.repeat(np.arange(len(start)), counts)
    row = np.arange(total) - (np.cumsum(counts) - counts - low)[edge]
    slope = np.divide(end[:, 0] - start[:, 0], y1 - y0, out=np.zeros(len(start)), where=counts > 0)
    x = start[edge, 0] + (row - y0[edge]) * slope[edge]
    order = np.lexsort((x, row))
    row = row[order]
    x = x[order]
    winding = np.cumsum(np.where(y1 > y0, 1, -1)[edge[order]])
    # in each row the windings add up to zero, so no span reaches into the next one
    spans = np.flatnonzero(winding[:-1] != 0)
    column = np.ceil(np.minimum(np.maximum(x, 0.0), mask.shape[1])).astype(np.int64)
    for r, a, b in zip(row[spans].tolist(), column[spans].tolist(), column[spans + 1].tolist()):
        mask[r, a:b] = 255
    return window, mask


@dataclass(frozen=True)
class ChainCells:
    """The cells that a chain runs through; neighbours share an edge, except where the chain was outside the map.

    Attributes:
        rows, columns: (K,) int64; they reach one cell beyond the map's rim.
        points: (K, 2) (column, row), a point of the chain in the cell.
        segment: (K,) int64, the chain's segment that the point is on.
        arc: (K,) [cells] arc length along the chain to the point.
    """

    rows: np.ndarray
    columns: np.ndarray
    points: np.ndarray
    segment: np.ndarray
    arc: np.ndarray

    def between(self, first: int, last: int) -> "ChainCells":
        """Returns the part from one cell to another, both included."""
        return ChainCells(**{name: values[first : last + 1] for name, values in vars(self).items()})


def rasterize_chain(vertices: np.ndarray, shape: Tuple[int, int]) -> ChainCells:
    """Finds the cells along a chain (N, 2) (column, row), clipped to one cell beyond the map's rim."""
    start = vertices[:-1]
    step = vertices[1:] - start
    length = np.hypot(step[:, 0], step[:, 1])
    arc_start = np.cumsum(length) - length
    # the part of each segment within the map and its rim (Liang and Barsky's clipping)
    low, high = np.array([-1.0, -1.0]), np.array([shape[1], shape[0]], dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        t_low, t_high = (low - start) / step, (high - start) / step
    still = step == 0.0
    within = (start >= low) & (start <= high)
    enter = np.where(still, np.where(within, -np.inf, np.inf), np.minimum(t_low, t_high))
    leave = np.where(still, np.inf, np.maximum(t_low, t_high))
    t0 = np.maximum(enter.max(axis=1), 0.0)
    t1 = np.minimum(leave.min(axis=1), 1.0)
    # two samples per cell: the cells of neighbouring samples are the same or touch
    part = np.maximum(t1 - t0, 0.0)
    counts = np.where(t1 >= t0, np.ceil(2.0 * part * length).astype(np.int64) + 1, 0)
    total = int(counts.sum())
    if total > MAX_CROSSINGS:
        raise IntegrationError("too_complex")
    segment = np.repeat(np.arange(len(step)), counts)
    index = np.arange(total) - (np.cumsum(counts) - counts)[segment]
    t = t0[segment] + (part / np.maximum(counts - 1, 1))[segment] * index
    columns, rows = (np.floor(s[segment] + t * d[segment] + 0.5).astype(np.int64) for s, d in zip(start.T, step.T))
    distance = np.full(total, 2)
    np.add(np.abs(rows[1:] - rows[:-1]), np.abs(columns[1:] - columns[:-1]), out=distance[1:])
    new = np.flatnonzero(distance)
    # a diagonal step gets one of the two cells beside it, so that no fill slips through, unless the chain was off the map
    distance = distance[new]
    corner = (distance == 2) & (rows[new] != rows[new - 1]) & (columns[new] != columns[new - 1])
    corner[:1] = False
    times = 1 + corner
    twice = np.repeat(new, times)
    extra = np.flatnonzero(times == 2)
    extra = extra + np.arange(len(extra))  # the first of each pair is the added cell
    rows, columns, segment, t = rows[twice], columns[twice], segment[twice], t[twice]
    rows[extra] = rows[extra - 1]
    points = start[segment] + t[:, None] * step[segment]
    return ChainCells(rows, columns, points, segment, arc_start[segment] + t * length[segment])


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
    below, right = rows * factor - free.shape[0], columns * factor - free.shape[1]
    padded = cv2.copyMakeBorder(free, 0, below, 0, right, cv2.BORDER_CONSTANT, value=0)
    return cv2.inRange(cv2.resize(padded, (columns, rows), interpolation=cv2.INTER_AREA), 255, 255)
