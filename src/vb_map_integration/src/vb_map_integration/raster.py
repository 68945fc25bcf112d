"""Polygons, chains and regions on the cells of a grid.

Coordinates are (column, row) as `GridMap.world_to_grid` gives them: whole numbers are the centres of cells.
Masks are (H, W) uint8, 0 or 255, as OpenCV wants them.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

import cv2
import numpy as np

from vb_map_integration.findings import IntegrationError

# [cells] crossings of edges and rows that one polygon may have; a scribble beyond it would fill the memory
MAX_CROSSINGS = 4_000_000


def polygon_mask(vertices: np.ndarray, shape: Tuple[int, int]) -> np.ndarray:
    """The cells whose centre lies in a polygon, clipped to the map.

    Where the outline crosses itself everything is inside that it winds round (nonzero rule), so that an
    overshoot at the closing point tears no hole.

    Args:
        vertices: (N, 2) (column, row), the first one not repeated.
        shape: (H, W) of the map.

    Returns:
        (H, W) uint8 mask.

    Raises:
        IntegrationError: "too_complex" for an outline that crosses millions of rows.
    """
    rows, columns = shape
    mask = np.zeros(shape, np.uint8)
    start, end = vertices, np.roll(vertices, -1, axis=0)
    low = np.ceil(np.clip(np.minimum(start[:, 1], end[:, 1]), 0, rows)).astype(np.int64)
    high = np.ceil(np.clip(np.maximum(start[:, 1], end[:, 1]), 0, rows)).astype(np.int64)
    counts = high - low
    total = int(counts.sum())
    if total == 0:
        return mask
    if total > MAX_CROSSINGS:
        raise IntegrationError("too_complex", "the border goes up and down too often: draw a simpler one")
    edge = np.repeat(np.arange(len(vertices)), counts)
    first = np.cumsum(counts) - counts
    row = np.arange(total) - first[edge] + low[edge]
    slope = np.divide(
        end[:, 0] - start[:, 0], end[:, 1] - start[:, 1], out=np.zeros(len(start)), where=counts > 0
    )
    x = start[edge, 0] + (row - start[edge, 1]) * slope[edge]
    order = np.lexsort((x, row))
    row, x = row[order], x[order]
    winding = np.cumsum(np.where(end[edge, 1] > start[edge, 1], 1, -1)[order])
    # in each row the windings add up to zero, so no span reaches into the next one
    spans = np.flatnonzero(winding[:-1] != 0)
    column = np.ceil(np.clip(x, 0, columns)).astype(np.int64)
    for r, a, b in zip(row[spans].tolist(), column[spans].tolist(), column[spans + 1].tolist()):
        mask[r, a:b] = 255
    return mask


@dataclass(frozen=True)
class Trace:
    """The cells that a chain runs through; neighbours share an edge, except where the chain was outside the map.

    Attributes:
        rows, columns: (K,) int64; cells up to one beyond the map's rim occur.
        points: (K, 2) (column, row), a point of the chain in the cell.
        segment: (K,) int64, which of the chain's segments it belongs to.
        arc: (K,) [cells] where on the chain the point lies.
    """

    rows: np.ndarray
    columns: np.ndarray
    points: np.ndarray
    segment: np.ndarray
    arc: np.ndarray


def trace_chain(vertices: np.ndarray, shape: Tuple[int, int]) -> Trace:
    """The cells along a chain (N, 2) (column, row), clipped to one cell beyond the map's rim."""
    start = vertices[:-1]
    step = vertices[1:] - start
    length = np.hypot(step[:, 0], step[:, 1])
    arc_start = np.cumsum(length) - length
    # the part of each segment within the map and its rim (Liang and Barsky's clipping)
    low, high = np.array([-1.0, -1.0]), np.array([shape[1], shape[0]], dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        t_low, t_high = (low - start) / step, (high - start) / step
    enter = np.where(step == 0.0, np.where((start >= low) & (start <= high), -np.inf, np.inf), np.minimum(t_low, t_high))
    leave = np.where(step == 0.0, np.inf, np.maximum(t_low, t_high))
    t0 = np.maximum(enter.max(axis=1), 0.0)
    t1 = np.minimum(leave.min(axis=1), 1.0)
    # two samples per cell: the cells of neighbouring samples are the same or touch
    part = np.maximum(t1 - t0, 0.0)
    counts = np.where(t1 >= t0, np.ceil(2.0 * part * length).astype(np.int64) + 1, 0)
    total = int(counts.sum())
    if total > MAX_CROSSINGS:
        raise IntegrationError("too_complex", "the border is too long for this map: draw a simpler one")
    segment = np.repeat(np.arange(len(step)), counts)
    index = np.arange(total) - (np.cumsum(counts) - counts)[segment]
    t = t0[segment] + part[segment] * index / np.maximum(counts[segment] - 1, 1)
    points = start[segment] + t[:, None] * step[segment]
    arc = arc_start[segment] + t * length[segment]
    cells = np.floor(points + 0.5).astype(np.int64)
    columns, rows = cells[:, 0], cells[:, 1]
    if total:
        new = np.concatenate([[0], np.flatnonzero((rows[1:] != rows[:-1]) | (columns[1:] != columns[:-1])) + 1])
        rows, columns, points, segment, arc = rows[new], columns[new], points[new], segment[new], arc[new]
        # over a corner: one of the two cells beside it is taken too, so that nothing slips through
        corner = (np.abs(rows[1:] - rows[:-1]) == 1) & (np.abs(columns[1:] - columns[:-1]) == 1)
        twice = np.repeat(np.arange(len(rows)), np.concatenate([[1], 1 + corner]))
        extra = np.flatnonzero(twice[1:] == twice[:-1])  # the first of each pair is the cell put in
        before = rows[twice[extra] - 1]
        rows, columns, points, segment, arc = (a[twice] for a in (rows, columns, points, segment, arc))
        rows[extra] = before
    return Trace(rows, columns, points, segment, arc)


def flood(blocked: np.ndarray, cell: Tuple[int, int]) -> np.ndarray:
    """The cells that can be reached from a cell (row, column) over edges, not corners, of cells that are not blocked.

    Args:
        blocked: (H, W) uint8 mask; stays as it is. The cell itself must be free.

    Returns:
        (H, W) uint8 mask.
    """
    filled = blocked.copy()
    cv2.floodFill(filled, None, (int(cell[1]), int(cell[0])), 128, flags=4)
    return cv2.compare(filled, 128, cv2.CMP_EQ)


def paint(cells: np.ndarray, mask: np.ndarray, value: int, over_unknown: bool) -> np.ndarray:
    """Raises the cells under a mask to a value; none is lowered.

    Args:
        cells: (H, W) int8 occupancies; stay as they are.
        mask: (H, W) uint8.
        value: 0 .. 100.
        over_unknown: whether unknown cells take the value too.

    Returns:
        (H, W) int8.
    """
    # as uint8 unknown is 255 and wins
    as_bytes = cells.view(np.uint8)
    raised = cv2.max(as_bytes, cv2.min(mask, value))
    if over_unknown:
        unknown = cv2.bitwise_and(cv2.compare(as_bytes, 255, cv2.CMP_EQ), mask)
        raised = cv2.subtract(raised, cv2.min(unknown, 255 - value))
    return raised.view(np.int8)


def runs_of(mask: np.ndarray) -> np.ndarray:
    """A mask as runs of cells: (N, 2) int64 [start, end) in the flat grid. Small however large the mask is."""
    flat = np.ascontiguousarray(mask).ravel()
    change = np.flatnonzero(flat[1:] != flat[:-1]) + 1
    if flat[0]:
        change = np.concatenate([[0], change])
    if flat[-1]:
        change = np.concatenate([change, [flat.size]])
    return change.reshape(-1, 2).astype(np.int64)


def paint_runs(cells: np.ndarray, runs: np.ndarray, value: int, over_unknown: bool, window: Tuple[int, int]) -> None:
    """`paint` in place, with runs instead of a mask, within the window [start, end) of the flat grid."""
    flat = cells.reshape(-1)
    flat = flat if over_unknown else flat.view(np.uint8)
    low = np.searchsorted(runs[:, 1], window[0], side="right")
    high = np.searchsorted(runs[:, 0], window[1], side="left")
    part = np.clip(runs[low:high], window[0], window[1])
    limit = flat.dtype.type(value)
    for a, b in part.tolist():
        np.maximum(flat[a:b], limit, out=flat[a:b])
