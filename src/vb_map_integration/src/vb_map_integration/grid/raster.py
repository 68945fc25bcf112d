"""Polygons, chains and regions on the cells of a grid, and the parts into which borders split its free floor.

Coordinates are (column, row) as from `GridMap.world_to_grid`: whole numbers are the centres of cells.
Masks are uint8, 0 or 255, as OpenCV uses them. Most cover only a window of the map, as all of a large map is slow,
and none is made by numpy.zeros, whose small memory pages cost a page fault each.
"""

from __future__ import annotations

from typing import NamedTuple, Tuple

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
MIN_PART_AREA = 0.1


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
    corners = np.minimum(np.maximum(corners, 0.0), shape[::-1])
    (left, top), (right, bottom) = np.ceil(corners).astype(int).tolist()
    window = slice(top, bottom), slice(left, right)
    height, width = bottom - top, right - left
    mask = np.full((height, width), 0, np.uint8)
    starts = vertices - (left, top)
    x0, y0 = starts.T
    x1, y1 = np.roll(starts, -1, axis=0).T
    # each edge crosses the centres of the rows from `first` to the one before `beyond`
    extent = np.minimum(np.maximum(np.sort([y0, y1], axis=0), 0.0), height)
    first, beyond = np.ceil(extent).astype(np.int64)
    edge, number = _enumerate_runs(beyond - first)
    row = first[edge] + number
    slope = np.divide(x1 - x0, y1 - y0, out=np.zeros(len(starts)), where=beyond > first)
    x = x0[edge] + (row - y0[edge]) * slope[edge]
    order = np.lexsort((x, row))
    row = row[order].tolist()
    x_on_map = np.minimum(np.maximum(x[order], 0.0), width)
    column = np.ceil(x_on_map).astype(int).tolist()
    direction = np.where(y1 > y0, 1, -1)
    winding = np.cumsum(direction[edge[order]])
    # in each row the directions add up to zero, so no span reaches into the next one
    for k in np.flatnonzero(winding[:-1]).tolist():
        mask[row[k], column[k] : column[k + 1]] = 255
    return window, mask


def _enumerate_runs(lengths: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Numbers the elements of runs of lengths (N,): returns each one's run (K,) and its number there (K,)."""
    total = int(lengths.sum())
    if total > MAX_CROSSINGS:
        raise IntegrationError("too_complex")
    run = np.repeat(np.arange(len(lengths)), lengths)
    run_start = np.cumsum(lengths) - lengths
    return run, np.arange(total) - run_start[run]


class ChainCells(NamedTuple):
    """The cells that a chain runs through; neighbours share an edge, except where the chain was outside the map.

    Attributes:
        cells: (K, 2) int64 (row, column); they reach one cell beyond the map's rim.
        points: (K, 2) (column, row), a point of the chain in the cell.
        segment: (K,) int64, the chain's segment that the point is on.
        arc: (K,) [cells] arc length along the chain to the point.
    """

    cells: np.ndarray
    points: np.ndarray
    segment: np.ndarray
    arc: np.ndarray


def rasterize_chain(vertices: np.ndarray, shape: Tuple[int, int]) -> ChainCells:
    """Finds the cells along a chain (N, 2) (column, row), clipped to one cell beyond the map's rim."""
    start = vertices[:-1]
    step = vertices[1:] - start
    length = np.hypot(step[:, 0], step[:, 1])
    arc_start = np.cumsum(length) - length
    # the part of each segment within the map and its rim (Liang and Barsky's clipping)
    low = np.array([-1.0, -1.0])
    high = np.array([shape[1], shape[0]], dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        t_low = (low - start) / step
        t_high = (high - start) / step
    is_still = step == 0.0
    is_within = (start >= low) & (start <= high)
    t_enter = np.where(is_still, np.where(is_within, -np.inf, np.inf), np.minimum(t_low, t_high))
    t_leave = np.where(is_still, np.inf, np.maximum(t_low, t_high))
    t0 = np.maximum(t_enter.max(axis=1), 0.0)
    t1 = np.minimum(t_leave.min(axis=1), 1.0)
    # two samples per cell: the cells of neighbouring samples are the same or touch
    share = np.maximum(t1 - t0, 0.0)
    counts = np.where(t1 >= t0, np.ceil(2.0 * share * length).astype(np.int64) + 1, 0)
    segment, number = _enumerate_runs(counts)
    interval = share / np.maximum(counts - 1, 1)
    t = t0[segment] + interval[segment] * number
    points = start[segment] + t[:, None] * step[segment]
    arc = arc_start[segment] + t * length[segment]
    cells = np.floor(points + 0.5).astype(np.int64)[:, ::-1]
    moves = np.abs(np.diff(cells, axis=0))
    is_new = np.full(len(cells), True)
    is_new[1:] = moves.any(axis=1)
    # a diagonal step gets one of the two cells beside it, so that no fill slips through, unless the chain was off the map
    is_diagonal = np.full(len(cells), False)
    is_diagonal[1:] = (moves == 1).all(axis=1)
    samples = np.repeat(np.arange(len(cells)), is_new.astype(int) + is_diagonal)
    cells = cells[samples]
    added = np.flatnonzero(samples[1:] == samples[:-1])  # the first of each pair
    cells[added, 0] = cells[added - 1, 0]
    return ChainCells(cells, points[samples], segment[samples], arc[samples])


def count_free_parts(grid: GridMap, radius: float) -> int:
    """Counts the parts into which the free space falls for a robot of a given radius [m]; tiny ones are left out."""
    free = cv2.inRange(np.ascontiguousarray(grid.data), 0, OCCUPIED_THRESHOLD - 1)
    factor = int(np.ceil(np.sqrt(free.size / MAX_CELLS)))
    cell = grid.resolution * factor
    reach = radius / cell
    if factor > 1:
        # a coarse cell is free only if all its cells are: obstacles have grown by half a coarse cell already
        kernel = np.ones((factor, factor), np.uint8)
        eroded = cv2.erode(free, kernel, anchor=(0, 0), borderType=cv2.BORDER_CONSTANT, borderValue=0)
        free = np.ascontiguousarray(eroded[::factor, ::factor])
        reach = max(0.0, reach - 0.5)
    if reach > 1.0:
        framed = cv2.copyMakeBorder(free, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
        free = (cv2.distanceTransform(framed, cv2.DIST_L2, 3)[1:-1, 1:-1] > reach).astype(np.uint8)
    _, _, stats, _ = cv2.connectedComponentsWithStats(free, connectivity=4)
    return int((stats[1:, cv2.CC_STAT_AREA] * cell**2 >= MIN_PART_AREA).sum())
