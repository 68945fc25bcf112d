"""A border on the cells of a map, and the cells that open chains restrict: walls, and the seed's side of a curve.

Coordinates are (column, row) as from `GridMap.world_to_grid`: whole numbers are the centres of cells. Masks are uint8, 0
or 255, as OpenCV uses them. Most masks cover only a window, because all of a large map takes long. None is made by
numpy.zeros, whose memory comes in small pages, each of which costs a page fault.

A separating curve's "first and last line segments are linearly extended to the physical borders of the environment to
allow the separation of the area" (paper, Sect. 3). A cell is *blocked* if it is an obstacle, unknown, or off the map.
Blocked cells form connected pieces, and a curve divides the free space round it if and only if both its ends meet the
same piece. A table leg is a separate piece, so an extension that meets one goes on.

A drawn end may be joined to any wall within the tolerance, as no robot passes through so small a gap:

- ahead, where the extension meets it;
- behind, where the end has passed it;
- beside, where a straight extension would miss it. So a line a few centimetres in front of a doorway closes it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import List, NamedTuple, Optional, Tuple

import cv2
import numpy as np

from vb_core.grid_map import OCCUPIED_THRESHOLD
from vb_core.notices import Notice
from vb_map_integration.border import IntegrationError, warning
from vb_map_integration.restricted_cells import CellWindow

# [m] how far a seed on an obstacle or on the line is moved to free floor
MAX_SEED_SHIFT = 0.2
# crossings of edges and rows that one border may have; a scribble with more would fill the memory
MAX_CROSSINGS = 4_000_000
# [m] width of a virtual wall's band; on coarse maps the band is just the cells that the chain runs through
WALL_WIDTH = 0.1
# [m] length of a curve's end that gives its extension's direction: longer than hand tremor, shorter than a doorway
EXTENSION_FIT_LENGTH = 0.3
# [m] a drawn end this near a wall is joined to it: less than any robot's width
WALL_SNAP_DISTANCE = 0.2
# [m] a longer extension causes a warning: people who draw from wall to wall stop nearer to the walls
LONG_EXTENSION = 1.0
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


@dataclass(frozen=True, eq=False)
class BorderOnGrid:
    """A border on the cells of a map, and the warnings found so far.

    Attributes:
        cells: (H, W) uint8, the map's: unknown is 255 as uint8, so one comparison finds obstacles and unknown cells.
        resolution: [m] edge length of a cell.
        points, seed: (N, 2), (2,) [cells] the border's, column first.
        issues: the warnings, in the order in which they were found.
    """

    cells: np.ndarray
    resolution: float
    points: np.ndarray
    seed: np.ndarray
    issues: List[Notice] = field(default_factory=list)

    def warn(self, code: str, **values: str) -> None:
        """Adds a warning."""
        self.issues.append(warning(code, **values))

    @property
    def seed_cell(self) -> Tuple[int, int]:
        """(row, column) of the cell that the seed is in."""
        return tuple(np.floor(self.seed[::-1] + 0.5).astype(int).tolist())  # type: ignore[return-value]

    def find_free_cell(self, barred: np.ndarray, away: Optional[np.ndarray] = None) -> Tuple[int, int]:
        """Returns the seed's cell (row, column) or, if it is barred, the nearest free one, towards `away` if given.

        Raises:
            IntegrationError: "seed_on_obstacle" if there is none within MAX_SEED_SHIFT.
        """
        row, column = self.seed_cell
        if not barred[row, column]:
            return row, column
        radius = MAX_SEED_SHIFT / self.resolution
        reach = int(radius) + 1
        top = max(0, row - reach)
        left = max(0, column - reach)
        allowed = barred[top : row + reach + 1, left : column + reach + 1] == 0
        cells = np.argwhere(allowed) + (top, left)
        offsets = cells[:, ::-1] - self.seed
        distances = np.hypot(offsets[:, 0], offsets[:, 1])
        if away is not None:
            distances[offsets @ away <= 0.0] = np.inf
        if len(distances) == 0 or distances.min() > radius:
            raise IntegrationError("seed_on_obstacle", radius=MAX_SEED_SHIFT)
        nearest = int(np.argmin(distances))
        self.warn("seed_moved", distance=f"{distances[nearest] * self.resolution:.2f}")
        return tuple(cells[nearest].tolist())  # type: ignore[return-value]


def enumerate_runs(lengths: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Numbers the elements of runs of lengths (N,). Returns each element's run (K,) and its number in that run (K,)."""
    total = int(lengths.sum())
    if total > MAX_CROSSINGS:
        raise IntegrationError("too_complex")
    run = np.repeat(np.arange(len(lengths)), lengths)
    run_start = np.cumsum(lengths) - lengths
    return run, np.arange(total) - run_start[run]


class ChainCells(NamedTuple):
    """The cells that a chain runs through; neighbours share an edge, except where the chain was outside the map."""

    cells: np.ndarray  # (K, 2) int64 (row, column); they reach one cell beyond the map's rim
    points: np.ndarray  # (K, 2) (column, row), a point of the chain in the cell
    segment: np.ndarray  # (K,) int64, the chain's segment that the point is on
    arc: np.ndarray  # (K,) [cells] arc length along the chain to the point


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
    t_enter_if_still = np.where(is_within, -np.inf, np.inf)
    t_enter = np.where(is_still, t_enter_if_still, np.minimum(t_low, t_high))
    t_leave = np.where(is_still, np.inf, np.maximum(t_low, t_high))
    t0 = np.maximum(t_enter.max(axis=1), 0.0)
    t1 = np.minimum(t_leave.min(axis=1), 1.0)
    # two samples per cell: the cells of neighbouring samples are the same or touch
    share = np.maximum(t1 - t0, 0.0)
    counts = np.where(t1 >= t0, np.ceil(2.0 * share * length).astype(np.int64) + 1, 0)
    segment, number = enumerate_runs(counts)
    interval = share / np.maximum(counts - 1, 1)
    t = t0[segment] + interval[segment] * number
    points = start[segment] + t[:, None] * step[segment]
    arc = arc_start[segment] + t * length[segment]
    cells = np.floor(points + 0.5).astype(np.int64)[:, ::-1]
    moves = np.abs(np.diff(cells, axis=0, prepend=cells[:1] - (1, 0)))  # a straight step leads to the first cell
    is_new = moves.any(axis=1)
    # a diagonal step gets one of the two cells beside it, so that no fill slips through, unless the chain was off the map
    is_diagonal = (moves == 1).all(axis=1)
    samples = np.repeat(np.arange(len(cells)), is_new.astype(int) + is_diagonal)
    cells = cells[samples]
    added = np.flatnonzero(samples[1:] == samples[:-1])  # the first of each pair
    cells[added, 0] = cells[added - 1, 0]
    return ChainCells(cells, points[samples], segment[samples], arc[samples])


def fill_wall(wall: BorderOnGrid) -> Tuple[CellWindow, np.ndarray]:
    """Returns the free cells of a band along a virtual wall: a window, and its (h, w) uint8 mask.

    Raises:
        IntegrationError: "outside_map", "too_complex".
    """
    chain_cells = rasterize_chain(wall.points, wall.cells.shape).cells
    chain_cells = chain_cells[((chain_cells >= 0) & (chain_cells < wall.cells.shape)).all(axis=1)]
    if len(chain_cells) == 0:
        raise IntegrationError("outside_map")
    reach = int(WALL_WIDTH / 2.0 / wall.resolution + 1e-6)
    top, left = np.maximum(chain_cells.min(axis=0) - reach, 0).tolist()
    bottom, right = np.minimum(chain_cells.max(axis=0) + reach + 1, wall.cells.shape).tolist()
    window = slice(top, bottom), slice(left, right)
    mask = np.full(wall.cells[window].shape, 0, np.uint8)
    rows, columns = (chain_cells - (top, left)).T
    mask[rows, columns] = 255
    mask = cv2.dilate(mask, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
    free = cv2.inRange(wall.cells[window], 0, OCCUPIED_THRESHOLD - 1)
    return window, cv2.bitwise_and(mask, free)


def fill_side_of_curve(curve: BorderOnGrid) -> Tuple[CellWindow, np.ndarray, np.ndarray]:
    """Returns the area on the seed's side of a separating curve: a window, its (h, w) uint8 mask, and the line.

    The line (M, 2) (column, row) is the curve with its extensions. Warns of those that are long or meet no wall.

    Raises:
        IntegrationError: "outside_map", "too_complex", "seed_on_obstacle", "seed_on_both_sides", "no_separation".
    """
    cut = cut_free_space(curve)
    start = curve.find_free_cell(cut.cells[1:-1, 1:-1], cut.direction_to(curve.seed))
    window, mask = cut.fill_side(start)
    added = cut.line[[0, -1]] - curve.points[[0, -1]]
    extensions = curve.resolution * np.linalg.norm(added, axis=1)
    end_cells = cut.trace.cells[[0, -1]]
    is_on_map = ((end_cells >= 0) & (end_cells < curve.cells.shape)).all(axis=1)
    for cell, on_map, length, side in zip(end_cells.tolist(), is_on_map, extensions, ("line_start", "line_end")):
        if not on_map or curve.cells[tuple(cell)] > 127:
            curve.warn("no_wall_found")
        elif length > LONG_EXTENSION:
            curve.warn("extended_far", length=f"{length:.1f}", side_code=side)
    return window, mask, cut.line


@dataclass(frozen=True)
class CurveCut:
    """A separating curve cut into the map: its cells, from one blocked cell to another, are blocked too.

    Attributes:
        cells: (H + 2, W + 2) uint8, the map in a frame of blocked cells.
        trace: the curve's cells from the blocked cell at its start to that at its end; these two may be beyond the rim.
        was_free, is_drawn: (K,) bool, which of them were free, and which are on the drawn chain or next to its ends.
        starts, normals: (K, 2) the start of the segment that crosses each of them, and its unit normal, to the left.
        line: (M, 2) (column, row) the curve with its extensions.
    """

    cells: np.ndarray
    trace: ChainCells
    was_free: np.ndarray
    is_drawn: np.ndarray
    starts: np.ndarray
    normals: np.ndarray
    line: np.ndarray

    def direction_to(self, seed: np.ndarray) -> Optional[np.ndarray]:
        """Returns the unit vector (2,) from the curve to a seed (2,) in one of its cells; None elsewhere, and on the line."""
        hits = np.flatnonzero((self.trace.cells == np.floor(seed[::-1] + 0.5)).all(axis=1))
        if not len(hits):
            return None
        normal = self.normals[hits[0]]
        height = float((seed - self.starts[hits[0]]) @ normal)
        # within a hundredth of a cell of the line, a seed is on neither side
        return math.copysign(1.0, height) * normal if abs(height) > 0.01 else None

    def fill_side(self, start: Tuple[int, int]) -> Tuple[CellWindow, np.ndarray]:
        """Fills the side of the curve that a free cell (row, column) is on.

        Returns:
            The window of the map that the side is in, and its (h, w) uint8 mask.

        Raises:
            IntegrationError: "seed_on_both_sides", "no_separation".
        """
        filled_cells = self.cells.copy()  # costs little: 1 ms of 27 ms on a map of 4000 x 4000 cells
        _, _, _, box = cv2.floodFill(filled_cells, None, (start[1] + 1, start[0] + 1), _FILLED, flags=4)
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
        is_sampled = self.is_drawn & self.was_free
        points = self.trace.points[is_sampled]
        to_left = _SAMPLE_DISTANCE * self.normals[is_sampled]
        samples = np.array([points + to_left, points - to_left])
        # from the map's coordinates to the frame's; the frame's own cells are neither free nor filled
        last = filled_cells.shape[1] - 1, filled_cells.shape[0] - 1
        positions = np.minimum(np.maximum(samples + 1.5, 0.0), last).astype(np.int64)
        values = filled_cells[positions[..., 1], positions[..., 0]]
        filled_counts = (values == _FILLED).sum(axis=1)
        sample_counts = filled_counts + (values == _FREE).sum(axis=1)
        if not (sample_counts.all() and filled_counts.any()):
            raise IntegrationError("no_separation")
        left, right = filled_counts / sample_counts
        if left >= _MIN_FILLED_SHARE and right >= _MIN_FILLED_SHARE:
            raise IntegrationError("seed_on_both_sides")
        return 1.0 if left > right else -1.0

    def _fill_own_cells(self, filled_cells: np.ndarray, side: float) -> None:
        """Fills the curve's own cells whose centre is on the filled side, and that touch filled ones."""
        # a centre c is at the height n . c - n . p over its segment, which begins at p and has the normal n
        centers = self.trace.cells[:, ::-1]
        heights = (centers * self.normals).sum(axis=1) - (self.starts * self.normals).sum(axis=1)
        is_on_side = (heights * side > 0.0) & self.was_free
        own_cells = self.trace.cells[is_on_side] + 1
        neighbour_rows, neighbour_columns = (own_cells[:, None] + _STEPS_ROUND).T
        touches_filled = (filled_cells[neighbour_rows, neighbour_columns] == _FILLED).any(axis=0)
        rows, columns = own_cells[touches_filled].T
        filled_cells[rows, columns] = _FILLED


def end_direction(points: np.ndarray, length: float) -> np.ndarray:
    """Fits the direction (2,), a unit vector, in which a chain (N, 2) leaves its last point, to its last `length`.

    The direction between the last two points alone would follow hand tremor.
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


def cut_free_space(curve: BorderOnGrid) -> CurveCut:
    """Extends a separating curve to the physical borders, and cuts it into a copy of the map.

    Raises:
        IntegrationError: "outside_map", "too_complex".
    """
    points = curve.points
    # no fill may enter obstacles, unknown cells, or the frame round the map
    cells = np.full(np.add(curve.cells.shape, 2), _BLOCKED, np.uint8)
    cv2.inRange(curve.cells, OCCUPIED_THRESHOLD, 255, dst=cells[1:-1, 1:-1])
    fit_length = EXTENSION_FIT_LENGTH / curve.resolution
    chain, trace = _extend(cells, points, fit_length, WALL_SNAP_DISTANCE / curve.resolution)
    rows, columns = trace.cells.T + 1
    was_free = cells[rows, columns] == _FREE
    cells[rows, columns] = _BLOCKED
    steps = np.diff(chain, axis=0)
    lengths = np.maximum(np.hypot(steps[:, 0], steps[:, 1]), 1e-12)
    to_left = steps[:, ::-1] * (-1.0, 1.0)
    normals = to_left / lengths[:, None]
    drawn_arcs = np.cumsum(lengths[:-1])  # [cells] along the chain to each drawn point
    is_drawn = (trace.arc >= drawn_arcs[0] - 1.0) & (trace.arc <= drawn_arcs[-1] + 1.0)
    is_between = (drawn_arcs > trace.arc[0]) & (drawn_arcs < trace.arc[-1])
    line = np.vstack([trace.points[0], points[is_between], trace.points[-1]])
    return CurveCut(cells, trace, was_free, is_drawn, chain[trace.segment], normals[trace.segment], line)


def _extend(
    cells: np.ndarray, points: np.ndarray, fit_length: float, tolerance: float
) -> Tuple[np.ndarray, ChainCells]:
    """Extends a drawn chain to blocked cells, if possible of the same piece. Returns the longer chain and its cells."""
    shape = (cells.shape[0] - 2, cells.shape[1] - 2)
    reach = 2.0 * sum(shape) + float(np.abs(points).max())
    first = points[0] + reach * end_direction(points[::-1], fit_length)
    last = points[-1] + reach * end_direction(points, fit_length)
    chain = np.vstack([first, points, last])
    trace = rasterize_chain(chain, shape)
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
        trace = rasterize_chain(chain, shape)
    part = slice(start.inset or 0, len(trace.arc) - (end.inset or 0))
    return chain, ChainCells(*(values[part] for values in trace))


def _find_ends(
    cells: np.ndarray, trace_cells: np.ndarray, beyond: np.ndarray, point: np.ndarray, tolerance: float
) -> List[_CurveEnd]:
    """Finds where an end of the curve may be, the nearest first. Within the tolerance, cells on the curve come first.

    Args:
        trace_cells: (K, 2) the (row, column) of the curve's cells, outwards.
        beyond: (K,) [cells] how far each of them lies beyond the drawn end; negative within the chain.
        point: (2,) (column, row), the drawn end.
    """
    # the outermost cell lies beyond the map's rim, so there is always a candidate, even if the drawn end is off the map
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
        extension = max(float(beyond[k]), 0.0)
        ends.append(_CurveEnd(extension, (row, column), inset=len(beyond) - 1 - k))
    reach = int(tolerance)
    left = max(int(point[0] + 0.5) - reach, 0)
    top = max(int(point[1] + 0.5) - reach, 0)
    map_cells = cells[1:-1, 1:-1]
    nearby_cells = map_cells[top : top + 2 * reach + 1, left : left + 2 * reach + 1]
    beside = np.argwhere(nearby_cells) + (top, left)
    distances = np.hypot(beside[:, 0] - point[1], beside[:, 1] - point[0])
    within = np.count_nonzero(distances <= tolerance)
    nearest = np.argsort(distances, kind="stable")[:within]
    ends += [_CurveEnd(tolerance, (row, column), inset=None) for row, column in (beside[nearest] + 1).tolist()]
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
