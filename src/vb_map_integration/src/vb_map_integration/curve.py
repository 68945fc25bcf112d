"""Separating curves: extended to the physical borders, and the side that the seed is on.

Paper, Sect. 3: "its first and last line segments are linearly extended to the physical borders of the
environment to allow the separation of the area".

What makes a curve separate is topology: blocked cells (obstacles, unknown, everything off the map) form
connected pieces, and a curve parts the free space round it exactly if both its ends meet the same piece. A
table leg is a piece of its own, so an extension that meets one goes on.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, Optional, Tuple

import cv2
import numpy as np

from vb_map_integration import raster

# shares of the samples beside the curve from which on the restricted area counts as touching a side
TOUCHES = 0.1
# where on the end of a chain, as shares of the fitted length, its direction is sampled
_SAMPLES = np.linspace(0.0, 1.0, 16)
FindSeed = Callable[[np.ndarray, Optional[np.ndarray]], Tuple[int, int]]
_FILLED = 128
_NEIGHBOURS = np.array([-1, 0, 1])


@dataclass(frozen=True)
class Cut:
    """A separating curve cut into the map.

    Attributes:
        region: (H, W) uint8, the free cells on the seed's side.
        seed: (row, column) where the fill began.
        left, right: share of the free cells beside the drawn curve that the region holds; NaN if there are none.
        line: (M, 2) (column, row) the curve with its extensions.
        stops: for each end, the (row, column) of the blocked cell where it ends; may lie one beyond the map's rim.
    """

    region: np.ndarray
    seed: Tuple[int, int]
    left: float
    right: float
    line: np.ndarray
    stops: Tuple[Tuple[int, int], Tuple[int, int]]

    @property
    def separates(self) -> bool:
        """Whether the region lies on one side of the curve only, and there is something on the other."""
        sides = sorted((self.left, self.right))
        return not any(math.isnan(side) for side in sides) and sides[1] > 0.0 and sides[0] < TOUCHES


def end_direction(points: np.ndarray, length: float) -> np.ndarray:
    """Unit vector (2,) in which a chain (N, 2) leaves its last point, fitted to its last `length`.

    The last two points alone would follow the hand's tremor.
    """
    back = points[::-1]
    arc = np.concatenate([[0.0], np.cumsum(_lengths(back[1:] - back[:-1]))])
    at = min(length, arc[-1]) * _SAMPLES
    tail = np.column_stack([np.interp(at, arc, back[:, 0]), np.interp(at, arc, back[:, 1])])
    centred = tail - tail.sum(axis=0) / len(tail)
    (xx, xy), (_, yy) = centred.T @ centred
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy)
    direction = np.array([math.cos(angle), math.sin(angle)])
    chord = tail[0] - tail[-1]
    return direction if direction @ chord >= 0.0 else -direction


def separate(
    blocked: np.ndarray,
    points: np.ndarray,
    fit_length: float,
    overshoot: float,
    seed: np.ndarray,
    find_seed: FindSeed,
) -> Optional[Cut]:
    """Cuts a separating curve into the map and fills the seed's side.

    Args:
        blocked: (H, W) uint8 mask of cells that the fill may not enter.
        points: (N, 2) (column, row), the drawn chain.
        fit_length: [cells] how much of the chain's ends gives the extensions' direction.
        overshoot: [cells] how far a drawn end may reach beyond the wall that it belongs to.
        seed: (2,) (column, row).
        find_seed: gives the (row, column) where the fill begins, for a mask of blocked cells with the curve's cells
            added, and, for a seed in one of these, the direction (2,) that leads away from the curve.

    Returns:
        The cut, which separates or does not; None if the curve never touches the map.
    """
    rows, columns = blocked.shape
    reach = 2.0 * (rows + columns) + float(np.abs(points).max())
    chain = np.vstack(
        [
            points[0] + reach * end_direction(points[::-1], fit_length),
            points,
            points[-1] + reach * end_direction(points, fit_length),
        ]
    )
    trace = raster.trace_chain(chain, blocked.shape)
    inside = (trace.rows >= 0) & (trace.rows < rows) & (trace.columns >= 0) & (trace.columns < columns)
    arc = trace.arc - float(_lengths(points[:1] - chain[:1])[0])
    drawn_length = float(_lengths(points[1:] - points[:-1]).sum())
    drawn = (arc >= -1.0) & (arc <= drawn_length + 1.0)
    if not (inside & drawn).any():
        return None
    shut = np.ones(len(trace.rows), dtype=bool)
    shut[inside] = blocked[trace.rows[inside], trace.columns[inside]] != 0

    slack = min(overshoot, 0.25 * drawn_length)
    starts = _stops(shut, arc <= slack, outwards=-1)
    ends = _stops(shut, arc >= drawn_length - slack, outwards=1)

    cut = _cut(blocked, chain, trace, inside, drawn & ~shut, int(starts[0]), int(ends[0]), seed, find_seed)
    if cut.separates:
        return cut
    pair = _common_piece(blocked, trace, arc, starts, ends, drawn_length)
    if pair is None or pair == (starts[0], ends[0]):
        return cut
    return _cut(blocked, chain, trace, inside, drawn & ~shut, pair[0], pair[1], seed, find_seed)


def _stops(shut: np.ndarray, where: np.ndarray, outwards: int) -> np.ndarray:
    """Indices at which the trace, followed outwards, runs into something blocked; the nearest one first.

    The outermost cell lies beyond the map's rim, so there always is one.
    """
    indices = np.flatnonzero(where)[::outwards]
    if len(indices) == 0:  # the whole end lies off the map
        return np.array([0 if outwards < 0 else len(shut) - 1])
    hit = shut[indices]
    hit = hit & ~np.concatenate([[False], hit[:-1]])
    if not hit.any():
        return indices[-1:]
    return indices[hit]


def _common_piece(
    blocked: np.ndarray, trace: raster.Trace, arc: np.ndarray, starts: np.ndarray, ends: np.ndarray, drawn_length: float
) -> Optional[Tuple[int, int]]:
    """The stops on one and the same connected piece of blocked cells with the shortest extensions."""
    labels = cv2.copyMakeBorder(blocked, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=255)
    row = np.minimum(np.maximum(trace.rows + 1, 0), labels.shape[0] - 1)
    column = np.minimum(np.maximum(trace.columns + 1, 0), labels.shape[1] - 1)
    if len(starts) < 250:
        # filling the few pieces that one end meets is faster than labelling all there are
        label = 0
        for stop in starts:
            if labels[row[stop], column[stop]] == 255:
                label += 1
                cv2.floodFill(labels, None, (int(column[stop]), int(row[stop])), label, flags=8)
        ends = ends[labels[row[ends], column[ends]] != 255]
    else:
        _, labels = cv2.connectedComponents(labels, connectivity=8, ltype=cv2.CV_32S)

    def pieces(stops: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
        found, first = np.unique(labels[row[stops], column[stops]], return_index=True)
        return found, stops[first]

    start_pieces, start_stops = pieces(starts)
    end_pieces, end_stops = pieces(ends)
    _, i, j = np.intersect1d(start_pieces, end_pieces, assume_unique=True, return_indices=True)
    if len(i) == 0:
        return None
    extension = np.maximum(-arc[start_stops[i]], 0.0) + np.maximum(arc[end_stops[j]] - drawn_length, 0.0)
    best = int(np.argmin(extension))
    return int(start_stops[i[best]]), int(end_stops[j[best]])


def _cut(
    blocked: np.ndarray,
    chain: np.ndarray,
    trace: raster.Trace,
    inside: np.ndarray,
    beside: np.ndarray,
    start: int,
    end: int,
    seed: np.ndarray,
    find_seed: FindSeed,
) -> Cut:
    """Fills the seed's side of the curve between two of its stops."""
    part = np.zeros(len(inside), dtype=bool)
    part[min(start, end) : max(start, end) + 1] = True
    on_map = part & inside
    rows, columns = trace.rows[on_map], trace.columns[on_map]
    barrier = blocked.copy()
    barrier[rows, columns] = 255
    step = chain[1:] - chain[:-1]
    steps = np.maximum(_lengths(step), 1e-12)
    normal = np.column_stack([-step[:, 1] / steps, step[:, 0] / steps])

    away = None
    hit = np.flatnonzero((columns == math.floor(seed[0] + 0.5)) & (rows == math.floor(seed[1] + 0.5)))
    if len(hit):  # within a cell of the curve, yet on one side of it
        crossed = trace.segment[on_map][hit[0]]
        height = float((seed - chain[crossed]) @ normal[crossed])
        away = math.copysign(1.0, height) * normal[crossed] if abs(height) > 0.01 else None
    start_cell = find_seed(barrier, away)
    cv2.floodFill(barrier, None, start_cell[::-1], _FILLED, flags=4)
    region = cv2.compare(barrier, _FILLED, cv2.CMP_EQ)

    middle = beside & on_map
    points, aside = trace.points[middle] + 0.5, 1.6 * normal[trace.segment[middle]]
    left, right = (_share(barrier, np.floor(points + side * aside).astype(np.int64)) for side in (1.0, -1.0))

    # the cells that the curve runs through go to the side that their centre is on
    segment = trace.segment[on_map]
    offset = np.column_stack([columns, rows]) - chain[segment]
    height = (offset * normal[segment]).sum(axis=1)
    towards = 1.0 if not (left <= right) else -1.0
    own = np.flatnonzero((height * towards > 0.0) & (blocked[rows, columns] == 0))
    own = own[_touches(region, rows[own], columns[own])]
    region[rows[own], columns[own]] = 255

    first, last = trace.points[min(start, end)], trace.points[max(start, end)]
    between = chain[1:-1]
    vertex_arc = np.cumsum(steps)[:-1]
    between = between[(vertex_arc > trace.arc[min(start, end)]) & (vertex_arc < trace.arc[max(start, end)])]
    stops = tuple((int(trace.rows[k]), int(trace.columns[k])) for k in (start, end))
    return Cut(region, start_cell, left, right, np.vstack([first, between, last]), stops)  # type: ignore[arg-type]


def _share(barrier: np.ndarray, cells: np.ndarray) -> float:
    """Share of the cells (K, 2) (column, row) that were filled, of those that are free; NaN if none is."""
    columns, rows = cells[:, 0], cells[:, 1]
    ok = (columns >= 0) & (columns < barrier.shape[1]) & (rows >= 0) & (rows < barrier.shape[0])
    columns, rows = columns[ok], rows[ok]
    free = barrier[rows, columns] != 255
    count = np.count_nonzero(free)
    return np.count_nonzero(barrier[rows, columns] == _FILLED) / count if count else math.nan


def _touches(region: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """(K,) bool: which cells have a neighbour, corners included, in the region."""
    r = np.minimum(np.maximum(rows[:, None] + _NEIGHBOURS, 0), region.shape[0] - 1)
    c = np.minimum(np.maximum(columns[:, None] + _NEIGHBOURS, 0), region.shape[1] - 1)
    return (region[r[:, :, None], c[:, None, :]] != 0).any(axis=(1, 2))


def _lengths(vectors: np.ndarray) -> np.ndarray:
    return np.hypot(vectors[:, 0], vectors[:, 1])
