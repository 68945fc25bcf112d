"""Separating curves: their extension to the physical borders, and the area on the seed's side.

Paper, Sect. 3: "its first and last line segments are linearly extended to the physical borders of the
environment to allow the separation of the area".

A cell is *blocked* if it is an obstacle, unknown, or off the map. Blocked cells form connected pieces, and a curve
divides the free space round it if and only if both its ends meet the same piece. A table leg is a separate piece, so an
extension that meets one goes on.

A drawn end may be joined to any wall within the tolerance, as no robot passes through so small a gap:

- ahead, where the extension meets it;
- behind, where the end has passed it;
- beside, where a straight extension would miss it: so a line a few centimetres in front of a doorway closes the doorway.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, List, Optional, Tuple

import cv2
import numpy as np

from vb_map_integration.border import IntegrationError
from vb_map_integration.grid import raster

# the seed's area touches a side of the curve if at least this share of the free samples on that side were filled
_TOUCHES = 0.1
_ASIDE = 1.6  # [cells] how far from the curve the samples on both sides are
# where the end of a chain is sampled to find its direction, as shares of the fitted length
_SAMPLES = np.linspace(0.0, 1.0, 16)
FindSeed = Callable[[np.ndarray, Optional[np.ndarray]], Tuple[int, int]]
# values of cells in the working copy of the map: free, reached from the seed and blocked
_FREE, _FILLED, _BLOCKED = 0, 128, 255
# from where a blocked piece was met: from the curve's start, from its end or from both
_MET_BY_START, _MET_BY_END, _MET_BY_BOTH = 1, 2, 3


@dataclass(frozen=True)
class Cut:
    """A separating curve cut into the map.

    Attributes:
        window: the part of the map that the region is in.
        region: (h, w) uint8 mask of that window, the free cells on the seed's side.
        line: (M, 2) (column, row) the curve with its extensions.
        stops: for each end, the (row, column) of the blocked cell where it ends; may be one beyond the map's rim.
    """

    window: raster.CellWindow
    region: np.ndarray
    line: np.ndarray
    stops: Tuple[Tuple[int, int], Tuple[int, int]]


def end_direction(points: np.ndarray, length: float) -> np.ndarray:
    """Fits the direction (2,), a unit vector, in which a chain (N, 2) leaves its last point, to its last `length`.

    The last two points alone would follow hand tremor.
    """
    back = points[::-1, 0] + 1j * points[::-1, 1]
    arc = np.concatenate([[0.0], np.cumsum(np.abs(back[1:] - back[:-1]))])
    tail = np.interp(min(length, arc[-1]) * _SAMPLES, arc, back)
    chord = complex(tail[0] - tail[-1])
    # the squares of complex numbers add up to a vector of twice the angle of the tail's main axis
    axis = complex(np.sqrt(np.square(tail - tail.sum() / len(tail)).sum()))
    if abs(axis) < 1e-12:
        axis = chord or 1.0 + 0.0j
    if (axis * chord.conjugate()).real < 0.0:
        axis = -axis
    return np.array([axis.real, axis.imag]) / abs(axis)


@dataclass(frozen=True)
class _Stop:
    """A blocked cell where an end of the curve may stop.

    Attributes:
        extension: [cells] how far the end must be extended to reach it; 0 if it is within the drawn chain.
        cell: (row, column) of the blocked cell.
        inset: how many cells of the trace lie farther out; None if it is beside the end and not on the trace.
    """

    extension: float
    cell: Tuple[int, int]
    inset: Optional[int]


def cut_free_space(
    cells: np.ndarray, points: np.ndarray, fit_length: float, tolerance: float, seed: np.ndarray, find_seed: FindSeed
) -> Cut:
    """Cuts a separating curve into the map and fills the seed's side.

    Args:
        cells: (H + 2, W + 2) uint8, changed in place: 255 on the frame and where the fill may not enter, else 0.
        points: (N, 2) (column, row), the drawn chain.
        fit_length: [cells] length of the chain's ends that gives the directions of the extensions.
        tolerance: [cells] how far a drawn end may lie from the wall that it belongs to; less than any robot's width.
        seed: (2,) (column, row).
        find_seed: returns the (row, column) where the fill begins, given a mask (H, W) of barred cells, including the
            curve's, and, for a seed in a cell of the curve, the direction (2,) that leads away from the curve.

    Raises:
        IntegrationError: "outside_map", "seed_on_both_sides", "no_separation", "too_complex", or as `find_seed`.
    """
    shape = (cells.shape[0] - 2, cells.shape[1] - 2)
    reach = 2.0 * sum(shape) + float(np.abs(points).max())
    directions = end_direction(points[::-1], fit_length), end_direction(points, fit_length)
    outer = [points[0] + reach * directions[0], points[-1] + reach * directions[1]]
    trace = raster.rasterize_chain(np.concatenate([outer[:1], points, outer[1:]]), shape)
    drawn_length = float(np.hypot(*(points[1:] - points[:-1]).T).sum())
    before = -(trace.arc - reach)  # [cells] how far each cell lies before the chain's start
    after = -before - drawn_length
    on_map = (trace.rows >= 0) & (trace.rows < shape[0]) & (trace.columns >= 0) & (trace.columns < shape[1])
    if not (on_map & (before <= 1.0) & (after <= 1.0)).any():
        raise IntegrationError("outside_map")
    tolerance = min(tolerance, 0.25 * drawn_length)
    starts = _stops(cells, trace, before, points[0], tolerance, outwards=-1)
    ends = _stops(cells, trace, after, points[-1], tolerance, outwards=1)
    start, end = _stops_on_one_piece(cells, starts, ends) or (starts[0], ends[0])
    for index, stop in enumerate((start, end)):
        if stop.inset is None:  # beside the end: go straight there
            outer[index] = np.array(stop.cell[::-1], dtype=float)
    chain = np.concatenate([outer[:1], points, outer[1:]])
    trace = raster.rasterize_chain(chain, shape)
    between_stops = trace.between(start.inset or 0, len(trace.arc) - 1 - (end.inset or 0))
    return _cut(cells, chain, between_stops, seed, find_seed)


def _stops(
    cells: np.ndarray, trace: raster.ChainCells, beyond: np.ndarray, point: np.ndarray, tolerance: float, outwards: int
) -> List[_Stop]:
    """Finds where an end of the curve may stop, the nearest first; within the tolerance, stops ahead come first.

    Args:
        beyond: (K,) [cells] how far each cell of the trace lies beyond the drawn end; negative within the chain.
        point: (2,) (column, row), the drawn end.
        outwards: -1 for the chain's start, 1 for its end.
    """
    # the outermost cell is beyond the map's rim, so there is always one; if the end is off the map, maybe only one
    indices = np.flatnonzero(beyond >= -tolerance)[::outwards]
    if not len(indices):
        indices = np.array([0 if outwards < 0 else len(beyond) - 1])
    hit = cells[trace.rows[indices] + 1, trace.columns[indices] + 1] != _FREE
    hit[1:] &= ~hit[:-1]
    ahead = []
    for k in (indices[hit] if hit.any() else indices[-1:]).tolist():
        cell = int(trace.rows[k]), int(trace.columns[k])
        inset = k if outwards < 0 else len(beyond) - 1 - k
        ahead.append(_Stop(max(float(beyond[k]), 0.0), cell, inset))
    within = int(tolerance)
    top, left = (max(int(value + 0.5) - within, 0) for value in point[::-1])
    rows, columns = np.nonzero(cells[1:-1, 1:-1][top : top + 2 * within + 1, left : left + 2 * within + 1])
    distances = np.hypot(rows + top - point[1], columns + left - point[0])
    nearest_first = [k for k in np.argsort(distances, kind="stable") if distances[k] <= tolerance]
    beside = [_Stop(tolerance, (int(rows[k]) + top, int(columns[k]) + left), None) for k in nearest_first]
    return sorted(ahead + beside, key=lambda stop: stop.extension)


def _stops_on_one_piece(cells: np.ndarray, starts: List[_Stop], ends: List[_Stop]) -> Optional[Tuple[_Stop, _Stop]]:
    """Returns the nearest stops of both ends on the same connected piece of blocked cells.

    Both ends grow at the same pace, and mark each piece that they meet.
    """

    def value(stop: _Stop) -> int:
        return int(cells[stop.cell[0] + 1, stop.cell[1] + 1])

    def fill(stop: _Stop, mark: int) -> None:
        cv2.floodFill(cells, None, (stop.cell[1] + 1, stop.cell[0] + 1), mark, flags=8)

    by_start = [(stop, _MET_BY_START, _MET_BY_END) for stop in starts]
    by_end = [(stop, _MET_BY_END, _MET_BY_START) for stop in ends]
    for stop, mark, other in sorted(by_start + by_end, key=lambda candidate: candidate[0].extension):
        met = value(stop)
        if met == other:
            fill(stop, _MET_BY_BOTH)
            start, end = (next(each for each in stops if value(each) == _MET_BY_BOTH) for stops in (starts, ends))
            return start, end
        if met == _BLOCKED:
            fill(stop, mark)
    return None


def _cut(cells: np.ndarray, chain: np.ndarray, trace: raster.ChainCells, seed: np.ndarray, find_seed: FindSeed) -> Cut:
    """Blocks the cells of a curve between its stops, and fills the seed's side of it.

    Args:
        chain: (N, 2) (column, row), the drawn chain, and one more point beyond each end.
        trace: the chain's cells from stop to stop.
    """
    steps = chain[1:] - chain[:-1]
    lengths = np.maximum(np.hypot(steps[:, 0], steps[:, 1]), 1e-12)
    normals = steps[:, ::-1] * (-1.0, 1.0) / lengths[:, None]  # each segment's, to the left
    arcs = np.cumsum(lengths[:-1])  # of the drawn points
    flat, stride = cells.reshape(-1), cells.shape[1]
    curve_cells = (trace.rows + 1) * stride + trace.columns + 1  # indices in `flat`
    was_free = flat[curve_cells] == _FREE
    flat[curve_cells] = _BLOCKED
    row, column = find_seed(cells[1:-1, 1:-1], _way_to(seed, chain, normals, trace))
    _, _, _, (x, y, width, depth) = cv2.floodFill(cells, None, (column + 1, row + 1), _FILLED, flags=4)

    samples = (trace.arc >= arcs[0] - 1.0) & (trace.arc <= arcs[-1] + 1.0) & was_free
    side = _filled_side(cells, trace.points[samples], _ASIDE * normals[trace.segment[samples]])
    # the curve's own cells go to the side that their centre is on, if that is the filled one
    normal, offsets = normals[trace.segment], (normals * chain[:-1]).sum(axis=1)
    heights = trace.columns * normal[:, 0] + trace.rows * normal[:, 1] - offsets[trace.segment]
    own_cells = curve_cells[(heights * side > 0.0) & was_free]
    neighbours = (np.array([-stride, 0, stride])[:, None] + [-1, 0, 1]).ravel()
    flat[own_cells[(flat[own_cells[:, None] + neighbours] == _FILLED).any(axis=1)]] = _FILLED

    # one cell wider all round, for the curve's own cells, and converted from the frame's coordinates to the map's
    rows = slice(max(y - 2, 0), min(y + depth, cells.shape[0] - 2))
    window = rows, slice(max(x - 2, 0), min(x + width, cells.shape[1] - 2))
    region = cv2.inRange(cells[1:-1, 1:-1][window], _FILLED, _FILLED)
    between = chain[1:-1][(arcs > trace.arc[0]) & (arcs < trace.arc[-1])]
    line = np.concatenate([trace.points[:1], between, trace.points[-1:]])
    stops = tuple((int(trace.rows[k]), int(trace.columns[k])) for k in (0, -1))
    return Cut(window, region, line, stops)  # type: ignore[arg-type]


def _way_to(seed: np.ndarray, chain: np.ndarray, normals: np.ndarray, trace: raster.ChainCells) -> Optional[np.ndarray]:
    """Returns the direction (2,) that leads from the curve to a seed in one of its cells; None for any other seed."""
    hits = np.flatnonzero((trace.columns == math.floor(seed[0] + 0.5)) & (trace.rows == math.floor(seed[1] + 0.5)))
    if not len(hits):
        return None
    segment = trace.segment[hits[0]]
    height = float((seed - chain[segment]) @ normals[segment])
    return math.copysign(1.0, height) * normals[segment] if abs(height) > 0.01 else None


def _filled_side(cells: np.ndarray, points: np.ndarray, offsets: np.ndarray) -> float:
    """Returns on which side of a curve the cells were filled: 1 on the left, -1 on the right.

    Args:
        points, offsets: (K, 2) (column, row), points on the curve, and from each to a sample on its left.

    Raises:
        IntegrationError: "seed_on_both_sides", "no_separation".
    """
    samples = np.array([points + offsets, points - offsets])
    # from the map's coordinates to the frame's; the frame's own cells are neither free nor filled
    positions = np.minimum(np.maximum(samples + 1.5, 0.0), (cells.shape[1] - 1, cells.shape[0] - 1)).astype(np.int64)
    values = cells[positions[..., 1], positions[..., 0]]
    filled, free = ((values == state).sum(axis=1).tolist() for state in (_FILLED, _FREE))
    left, right = (a / (a + b) if a + b else math.nan for a, b in zip(filled, free))
    if left >= _TOUCHES and right >= _TOUCHES:
        raise IntegrationError("seed_on_both_sides")
    if math.isnan(left + right) or left == right == 0.0:
        raise IntegrationError("no_separation")
    return 1.0 if left > right else -1.0
