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
from typing import List, Optional, Tuple

import cv2
import numpy as np

from vb_map_integration.border import IntegrationError
from vb_map_integration.grid import raster

# the seed's area touches a side of the curve if at least this share of the free samples on that side were filled
_MIN_FILLED_SHARE = 0.1
_SAMPLE_DISTANCE = 1.6  # [cells] how far from the curve the samples on both sides are
_STEPS_ROUND = np.argwhere(np.ones((3, 3))) - 1  # (row, column) from a cell to itself and its eight neighbours
# where the end of a chain is sampled to find its direction, as shares of the fitted length
_SAMPLES = np.linspace(0.0, 1.0, 16)
# values of cells in the working copy of the map: free, reached from the seed and blocked
_FREE, _FILLED, _BLOCKED = 0, 128, 255
# from where a blocked piece was met: from the curve's start, from its end or from both
_MET_BY_START, _MET_BY_END, _MET_BY_BOTH = 1, 2, 3


@dataclass(frozen=True)
class CurveCut:
    """A separating curve cut into the map: its cells, from one blocked cell to another, are blocked too.

    Attributes:
        cells: (H + 2, W + 2) uint8, the map in a frame of blocked cells.
        chain: (N, 2) (column, row) the drawn chain, and one more point beyond each end.
        normals: (N - 1, 2) the unit normal of each segment of the chain, to the left.
        drawn_arcs: (N - 2,) [cells] arc length along the chain to each drawn point.
        trace: the chain's cells from the blocked cell at its start to that at its end, maybe one beyond the map's rim.
        was_free: (K,) bool, which of them were free.
        line: (M, 2) (column, row) the curve with its extensions.
    """

    cells: np.ndarray
    chain: np.ndarray
    normals: np.ndarray
    drawn_arcs: np.ndarray
    trace: raster.ChainCells
    was_free: np.ndarray
    line: np.ndarray

    def direction_to(self, seed: np.ndarray) -> Optional[np.ndarray]:
        """Returns the unit vector (2,) from the curve to a seed (2,) in one of its cells; None elsewhere, and on the line."""
        seed_cell = np.floor(seed[::-1] + 0.5)
        hits = np.flatnonzero((self.trace.cells == seed_cell).all(axis=1))
        if not len(hits):
            return None
        segment = self.trace.segment[hits[0]]
        normal = self.normals[segment]
        height = float((seed - self.chain[segment]) @ normal)
        # within a hundredth of a cell of the line, a seed is on neither side
        return math.copysign(1.0, height) * normal if abs(height) > 0.01 else None

    def fill_side(self, start: Tuple[int, int]) -> Tuple[raster.CellWindow, np.ndarray]:
        """Fills the side of the curve that a free cell (row, column) is on.

        Returns:
            The window of the map that the side is in, and its (h, w) uint8 mask.

        Raises:
            IntegrationError: "seed_on_both_sides", "no_separation".
        """
        row, column = start
        filled_cells = self.cells.copy()  # costs little: 1 ms of 27 ms on a map of 4000 x 4000 cells
        _, _, _, box = cv2.floodFill(filled_cells, None, (column + 1, row + 1), _FILLED, flags=4)
        side = self._find_filled_side(filled_cells)
        self._fill_own_cells(filled_cells, side)
        left, top, width, depth = box
        map_cells = filled_cells[1:-1, 1:-1]
        # one cell wider all round, for the curve's own cells, and converted from the frame's coordinates to the map's
        rows = slice(max(top - 2, 0), min(top + depth, map_cells.shape[0]))
        columns = slice(max(left - 2, 0), min(left + width, map_cells.shape[1]))
        window = rows, columns
        return window, cv2.inRange(map_cells[window], _FILLED, _FILLED)

    def _find_filled_side(self, filled_cells: np.ndarray) -> float:
        """Finds on which side of the curve cells were filled: 1 on the left, -1 on the right."""
        near_drawn = (self.trace.arc >= self.drawn_arcs[0] - 1.0) & (self.trace.arc <= self.drawn_arcs[-1] + 1.0)
        is_sampled = near_drawn & self.was_free
        points = self.trace.points[is_sampled]
        to_left = _SAMPLE_DISTANCE * self.normals[self.trace.segment[is_sampled]]
        samples = np.array([points + to_left, points - to_left])
        # from the map's coordinates to the frame's; the frame's own cells are neither free nor filled
        last = filled_cells.shape[1] - 1, filled_cells.shape[0] - 1
        positions = np.minimum(np.maximum(samples + 1.5, 0.0), last).astype(np.int64)
        values = filled_cells[positions[..., 1], positions[..., 0]]
        filled_counts = (values == _FILLED).sum(axis=1)
        sample_counts = filled_counts + (values == _FREE).sum(axis=1)
        if not sample_counts.all():
            raise IntegrationError("no_separation")
        left, right = filled_counts / sample_counts
        if left >= _MIN_FILLED_SHARE and right >= _MIN_FILLED_SHARE:
            raise IntegrationError("seed_on_both_sides")
        if left == right == 0.0:
            raise IntegrationError("no_separation")
        return 1.0 if left > right else -1.0

    def _fill_own_cells(self, filled_cells: np.ndarray, side: float) -> None:
        """Fills the curve's own cells whose centre is on the filled side, and that touch filled ones."""
        # a centre c is at the height n . c - n . p over its segment, which begins at p and has the normal n
        segment = self.trace.segment
        segment_heights = (self.chain[:-1] * self.normals).sum(axis=1)
        cell_heights = (self.trace.cells[:, ::-1] * self.normals[segment]).sum(axis=1)
        heights = cell_heights - segment_heights[segment]
        is_on_side = (heights * side > 0.0) & self.was_free
        own_cells = self.trace.cells[is_on_side] + 1
        neighbour_rows, neighbour_columns = (own_cells[:, None] + _STEPS_ROUND).T
        touches_filled = (filled_cells[neighbour_rows, neighbour_columns] == _FILLED).any(axis=0)
        rows, columns = own_cells[touches_filled].T
        filled_cells[rows, columns] = _FILLED


def end_direction(points: np.ndarray, length: float) -> np.ndarray:
    """Fits the direction (2,), a unit vector, in which a chain (N, 2) leaves its last point, to its last `length`.

    The last two points alone would follow hand tremor.
    """
    back = points[::-1, 0] + 1j * points[::-1, 1]
    lengths = np.abs(np.diff(back))
    arc = np.concatenate([[0.0], np.cumsum(lengths)])
    tail = np.interp(min(length, arc[-1]) * _SAMPLES, arc, back)
    chord = complex(tail[0] - tail[-1])
    # the squares of complex numbers add up to a vector of twice the angle of the tail's main axis
    offsets = tail - tail.sum() / len(tail)
    axis = complex(np.sqrt(np.square(offsets).sum()))
    if abs(axis) < 1e-12:
        axis = chord or 1.0 + 0.0j
    if (axis * chord.conjugate()).real < 0.0:
        axis = -axis
    return np.array([axis.real, axis.imag]) / abs(axis)


@dataclass(frozen=True)
class _CurveEnd:
    """A blocked cell where an end of the curve may be.

    Attributes:
        extension: [cells] how far the drawn end must be extended to reach it; 0 if it is within the drawn chain.
        cell: (row, column) of the blocked cell, in the frame's coordinates.
        inset: how many cells of the trace lie farther out; None if it is beside the drawn end and not on the trace.
    """

    extension: float
    cell: Tuple[int, int]
    inset: Optional[int]


def cut_free_space(cells: np.ndarray, points: np.ndarray, fit_length: float, tolerance: float) -> CurveCut:
    """Extends a separating curve to the physical borders, and cuts it into the map.

    Args:
        cells: (H + 2, W + 2) uint8, changed in place: 255 on the frame and where the fill may not enter, else 0.
        points: (N, 2) (column, row), the drawn chain.
        fit_length: [cells] length of the chain's ends that gives the directions of the extensions.
        tolerance: [cells] how far a drawn end may lie from the wall that it belongs to; less than any robot's width.

    Raises:
        IntegrationError: "outside_map", "too_complex".
    """
    chain, trace = _extend(cells, points, fit_length, tolerance)
    rows, columns = trace.cells.T + 1
    was_free = cells[rows, columns] == _FREE
    cells[rows, columns] = _BLOCKED
    steps = np.diff(chain, axis=0)
    lengths = np.maximum(np.hypot(steps[:, 0], steps[:, 1]), 1e-12)
    to_left = steps[:, ::-1] * (-1.0, 1.0)
    normals = to_left / lengths[:, None]
    drawn_arcs = np.cumsum(lengths[:-1])
    is_between = (drawn_arcs > trace.arc[0]) & (drawn_arcs < trace.arc[-1])
    line = np.vstack([trace.points[0], points[is_between], trace.points[-1]])
    return CurveCut(cells, chain, normals, drawn_arcs, trace, was_free, line)


def _extend(
    cells: np.ndarray, points: np.ndarray, fit_length: float, tolerance: float
) -> Tuple[np.ndarray, raster.ChainCells]:
    """Extends a drawn chain to blocked cells, of one piece if possible; returns `CurveCut.chain` and `CurveCut.trace`."""
    shape = (cells.shape[0] - 2, cells.shape[1] - 2)
    reach = 2.0 * sum(shape) + float(np.abs(points).max())
    first = points[0] + reach * end_direction(points[::-1], fit_length)
    last = points[-1] + reach * end_direction(points, fit_length)
    chain = np.vstack([first, points, last])
    trace = raster.rasterize_chain(chain, shape)
    drawn_length = float(np.hypot(*np.diff(points, axis=0).T).sum())
    before_start = reach - trace.arc  # [cells] how far each cell lies before the drawn start
    beyond_end = trace.arc - reach - drawn_length  # [cells] and beyond the drawn end
    is_drawn = (before_start <= 1.0) & (beyond_end <= 1.0)
    is_on_map = ((trace.cells >= 0) & (trace.cells < shape)).all(axis=1)
    if not (is_drawn & is_on_map).any():
        raise IntegrationError("outside_map")
    tolerance = min(tolerance, 0.25 * drawn_length)
    starts = _find_ends(cells, trace.cells[::-1], before_start[::-1], points[0], tolerance)
    ends = _find_ends(cells, trace.cells, beyond_end, points[-1], tolerance)
    start, end = _ends_on_one_piece(cells, starts, ends) or (starts[0], ends[0])
    # to a cell beside the drawn end, the curve goes straight
    if start.inset is None:
        chain[0] = np.subtract(start.cell[::-1], 1)
    if end.inset is None:
        chain[-1] = np.subtract(end.cell[::-1], 1)
    if start.inset is None or end.inset is None:
        trace = raster.rasterize_chain(chain, shape)
    part = slice(start.inset or 0, len(trace.arc) - (end.inset or 0))
    return chain, raster.ChainCells(*(values[part] for values in trace))


def _find_ends(
    cells: np.ndarray, trace_cells: np.ndarray, beyond: np.ndarray, point: np.ndarray, tolerance: float
) -> List[_CurveEnd]:
    """Finds where an end of the curve may be, the nearest first; within the tolerance, cells on the curve come first.

    Args:
        trace_cells: (K, 2) the (row, column) of the curve's cells, outwards.
        beyond: (K,) [cells] how far each of them lies beyond the drawn end; negative within the chain.
        point: (2,) (column, row), the drawn end.
    """
    # the outermost cell is beyond the map's rim, so there is always one; if the end is off the map, maybe only one
    candidates = np.flatnonzero(beyond >= -tolerance)
    if not len(candidates):
        candidates = np.array([len(beyond) - 1])
    rows, columns = trace_cells[candidates].T + 1
    is_blocked = cells[rows, columns] != _FREE
    is_blocked[1:] &= ~is_blocked[:-1]  # only the first cell of each obstacle
    met = candidates[is_blocked] if is_blocked.any() else candidates[-1:]
    ends = []
    for k in met.tolist():
        row, column = (trace_cells[k] + 1).tolist()
        ends.append(_CurveEnd(max(float(beyond[k]), 0.0), (row, column), len(beyond) - 1 - k))
    reach = int(tolerance)
    left = max(int(point[0] + 0.5) - reach, 0)
    top = max(int(point[1] + 0.5) - reach, 0)
    around = cells[1:-1, 1:-1][top : top + 2 * reach + 1, left : left + 2 * reach + 1]
    beside = np.argwhere(around) + (top, left)
    distances = np.hypot(beside[:, 0] - point[1], beside[:, 1] - point[0])
    for k in np.argsort(distances, kind="stable"):
        if distances[k] <= tolerance:
            row, column = (beside[k] + 1).tolist()
            ends.append(_CurveEnd(tolerance, (row, column), None))
    return sorted(ends, key=lambda end: end.extension)


def _ends_on_one_piece(
    cells: np.ndarray, starts: List[_CurveEnd], ends: List[_CurveEnd]
) -> Optional[Tuple[_CurveEnd, _CurveEnd]]:
    """Returns the nearest start and end that are on the same connected piece of blocked cells.

    Both ends grow at the same pace, and mark each piece that they meet.
    """
    by_start = [(start, _MET_BY_START, _MET_BY_END) for start in starts]
    by_end = [(end, _MET_BY_END, _MET_BY_START) for end in ends]
    for candidate, mark, other_mark in sorted(by_start + by_end, key=lambda entry: entry[0].extension):
        met_mark = cells[candidate.cell]
        if met_mark == other_mark:
            cv2.floodFill(cells, None, candidate.cell[::-1], _MET_BY_BOTH, flags=8)
            start = next(each for each in starts if cells[each.cell] == _MET_BY_BOTH)
            end = next(each for each in ends if cells[each.cell] == _MET_BY_BOTH)
            return start, end
        if met_mark == _BLOCKED:
            cv2.floodFill(cells, None, candidate.cell[::-1], mark, flags=8)
    return None
