"""Stages 3 to 6 of extraction.py: the polygonal chain along the drawn line.

Stage 3 makes samples: it replaces the observations, in the order in which they were drawn, by samples a tremor apart.
A spot held still is one sample, however long it is held. A piece drawn again at the stroke's end is merged into it.

Stage 4 decides whether the person meant a polygon or a separating curve. The line is closed if the opening between its
ends is small compared with the mean width of the floor that it would enclose, which is twice its area over its length.

- The opening of a U is always wider than this, however deep the U is. So the ends of a U stay open.
- The less the line would have to turn from its end to its start, the more likely it is that a side was left unfinished.
  The opening may then be wider, up to half of the figure's size.
- A wave encloses next to nothing, however near its ends are.

Ends that cross or run past each other are cut there, and half of the length cut off counts as opening.

Stage 5 fits sides. Dynamic programming divides the samples into the fewest straight sides that explain them. A corner
is kept if leaving it out would lose a detail larger than the hand's tremor, or a smaller one where the pointer stopped.
Least squares then moves the corners to where the sides fit all samples best, even where no camera saw a corner.

Stage 6 drops vertices that change nothing, and makes a closed chain a polygon that does not cross itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, Tuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist, pdist
from shapely.geometry import LineString, Polygon
from shapely.ops import unary_union
from shapely.validation import make_valid

from vb_core import geometry
from vb_core.errors import CodedError
from vb_fusion.observations import TIME_BIN, TREMOR, Observations

NEARLY_CLOSED = ("open_wide", "open_flat")  # codes of lines whose ends came near each other
MAX_OPENING_RATIO = 0.5  # [diameters of the figure] within it the end is nearer to the start than to the far side
CORNER_MISFIT = 1.5  # [tremors^3] squared distance times length that a corner must explain
MAX_BEND = 1.5  # [chords] longest arc that one side may stand for. A semicircle is 1.57 chords long
MIN_SPIKE = 2.0  # [tremors] a spike that is shorter may be noise
VERTEX_PRIOR = 0.3  # [tremors] length of line that holds a vertex in place if its sides hardly turn there
MIN_FIGURE_SIZE = 8.0  # [tremors] a smaller line that curls could be open or closed
MIN_DETAIL = 0.005  # [m] vertices whose loss moves the chain by less are dropped. A map cell is ten times as large
MAX_SLIP_RATIO = 0.02  # share of the area that a self-crossing line encloses. Smaller loops are slips of the hand


def make_chain(
    line: Observations, was_joined: bool, dropout: float, max_gap: float
) -> Tuple[np.ndarray, Closure, float]:
    """Makes the polygonal chain along the drawn line.

    Args:
        line: the observations in the order in which the line runs, without their cameras' offsets.
        was_joined: whether the line consists of several strokes.
        dropout: [s] time within which a moving pointer is seen again.
        max_gap: [m] widest gap between the line's ends that may hide a corner.

    Returns:
        The chain's vertices (M, 2) [m]; the decision whether it is closed; and the length [m] of the longest piece of it
        that no camera saw.

    Raises:
        CodedError: "figure_too_small", "line_self_intersects".
    """
    tremor = estimate_tremor(line)
    stroke = resample_stroke(line, tremor)  # stage 3
    closure = classify_closure(stroke.points, tremor)  # stage 4
    size = geometry.bounding_diagonal(line.points)
    if closure.code in NEARLY_CLOSED and size < MIN_FIGURE_SIZE * tremor:
        raise CodedError("figure_too_small", size=f"{size:.2f}", needed=f"{MIN_FIGURE_SIZE * tremor:.2f}")
    within = slice(closure.first, closure.last + 1)
    trimmed = ResampledStroke(stroke.points[within], stroke.observation_weights[within], tremor)
    starts = divide_into_sides(trimmed)  # stage 5
    # a gap that was crossed unseen may hide a corner. A wider one was left by the hand and gets a straight side
    hides_corner = closure.closed and (was_joined or closure.gap <= max_gap)
    vertices = fit_vertices(trimmed, starts, hides_corner and len(starts) > 2)
    if len(vertices) < 3:
        closure = classify_closure(vertices)
    vertices = simplify(vertices, closure.closed)  # stage 6
    return vertices, closure, _longest_unseen_gap(line, closure, was_joined, dropout)


def _longest_unseen_gap(line: Observations, closure: Closure, was_joined: bool, dropout: float) -> float:
    """Returns the longest stretch [m] of the line that no camera saw.

    The opening between start and end counts only if several strokes were joined. In addition, the chain must be closed,
    or nothing may have been seen between the times of its two ends.
    """
    began, ended = sorted(line.stamps[[0, -1]])
    is_between = (began < line.stamps) & (line.stamps < ended)
    is_unseen = was_joined and (closure.closed or not is_between.any())
    opening = closure.gap if is_unseen else 0.0
    dx, dy = np.diff(line.points, axis=0).T
    steps = np.hypot(dx, dy)
    pauses = np.abs(np.diff(line.stamps))
    return float(steps[pauses > dropout].max(initial=opening))


# ------------------------------------------------------------------ 3: samples
def estimate_tremor(stroke: Observations) -> float:
    """Estimates the distance [m] from a stroke within which its observations lie: hand tremor and camera errors.

    It is three standard deviations of the observations from the straight line between those 0.2 s before and after,
    rounded to half powers of two, so that it seldom changes while a line grows.
    """
    stamps, points = stroke.stamps, stroke.points
    next_rows = np.searchsorted(stamps, stamps + 2.0 * TIME_BIN)
    previous_rows = np.searchsorted(stamps, stamps - 2.0 * TIME_BIN) - 1
    inner = np.flatnonzero((previous_rows >= 0) & (next_rows < len(next_rows)))
    if len(inner) < 10:
        return TREMOR
    start = previous_rows[inner]
    end = next_rows[inner]
    shares = (stamps[inner] - stamps[start]) / (stamps[end] - stamps[start])
    share = shares[:, None]
    expected = (1.0 - share) * points[start] + share * points[end]
    squares = ((points[inner] - expected) ** 2).sum(axis=1)
    # half of the squares are below 2 ln 2 variances of an axis, and the errors of the line's ends add half a variance
    deviation = np.sqrt(np.median(squares) / (3.0 * np.log(2.0)))
    octaves = np.log2(max(3.0 * deviation, 1e-6) / TREMOR)
    rounded = np.clip(0.5 * np.round(2.0 * octaves), -1.0, 0.5)
    return float(TREMOR * 2.0**rounded)


@dataclass(frozen=True)
class ResampledStroke:
    """Samples along a stroke, in the order in which they were drawn."""

    points: np.ndarray  # (K, 2) [m]
    observation_weights: np.ndarray  # (K,) the total weight of the observations in each sample
    tremor: float  # [m] smaller details are noise

    @property
    def sample_lengths(self) -> np.ndarray:
        """(K,) [m] length of the line that each sample represents."""
        distances = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        steps = np.minimum(distances, 2.0 * self.tremor)
        return 0.5 * (np.append(steps, 0.0) + np.append(0.0, steps)) + 0.1 * self.tremor


def resample_stroke(line: Observations, tremor: float) -> ResampledStroke:
    """Resamples a line evenly, and merges a piece that was drawn again at its end.

    Args:
        line: at least three observations, in the order in which the line runs.
        tremor: [m] distance between samples.
    """
    # each observation is averaged with its neighbours: two cameras that see the spot in turn are not a movement
    weighted = np.column_stack([line.points * line.weights[:, None], line.weights])
    wide = np.pad(weighted, ((1, 1), (0, 0)), mode="edge")
    sums = wide[:-2] + wide[1:-1] + wide[2:]
    calm = sums[:, :2] / sums[:, 2:]
    sample = np.empty(len(calm), dtype=int)
    number, count = 0, 0
    total = 0j
    for row, position in enumerate((calm @ [1.0, 1.0j]).tolist()):
        if count and abs(position - total / count) > tremor:
            number += 1
            count = 0
            total = 0j
        count += 1
        total += position
        sample[row] = number
    stroke = _means(line.points, line.weights, sample, tremor)
    # the line ends where the spot was seen first and last
    stroke.points[[0, -1]] = calm[[0, -1]]
    return _merge_repeats(stroke)


def _means(points: np.ndarray, observation_weights: np.ndarray, sample: np.ndarray, tremor: float) -> ResampledStroke:
    total = np.bincount(sample, observation_weights)
    means = np.column_stack([np.bincount(sample, observation_weights * axis) / total for axis in points.T])
    return ResampledStroke(means, total, tremor)


def _merge_repeats(stroke: ResampledStroke) -> ResampledStroke:
    """Ends the stroke where it no longer reaches new floor. A line drawn twice is one line, seen twice as often."""
    points = stroke.points
    arc = geometry.arc_lengths(points)
    earlier, later = cKDTree(points).query_pairs(2.0 * stroke.tremor, output_type="ndarray").T
    chord = np.linalg.norm(points[later] - points[earlier], axis=1)
    # the stroke between such a pair is longer than a mere bend would make it
    is_repeated = arc[later] - arc[earlier] > 2.0 * chord + stroke.tremor
    is_new = np.ones(len(points), dtype=bool)
    is_new[later[is_repeated]] = False
    # two samples beside the line may be an overshoot, but three are new floor
    new_runs = np.flatnonzero(is_new[:-2] & is_new[1:-1] & is_new[2:])
    kept = int(new_runs[-1]) + 3 if len(new_runs) else len(points)
    if len(points) - kept < 4:
        return stroke  # an end that comes back to the start closes a ring
    nearest = cKDTree(points[:kept]).query(points[kept:])[1]
    return _means(points, stroke.observation_weights, np.concatenate([np.arange(kept), nearest]), stroke.tremor)


# ------------------------------------------------------------------ 4: closed or open
@dataclass(frozen=True)
class Closure:
    """The decision on one line.

    Attributes:
        closed: polygon (True) or separating curve (False).
        code: code of the sentence that says why.
        gap: [m] distance between the ends.
        length: [m] length of the line between its ends.
        first, last: indices of the line's first and last point, where an overhang past the closing point is left out.
    """

    closed: bool
    code: str
    gap: float
    length: float
    first: int
    last: int

    @property
    def values(self) -> Dict[str, str]:
        """The values in the sentence that `code` names."""
        percent = 100.0 * self.gap / self.length if self.length else 0.0
        return {"gap": f"{self.gap:.2f}", "percent": f"{percent:.0f}", "length": f"{self.length:.2f}"}


def classify_closure(points: np.ndarray, tremor: float = TREMOR) -> Closure:
    """Decides whether a line is a polygon or a separating curve.

    Args:
        points: (M, 2) [m], the line as drawn, M >= 2.
        tremor: [m] a narrower figure encloses nothing.
    """
    end = len(points) - 1
    arc = geometry.arc_lengths(points)
    length = float(arc[-1])
    apart = float(np.linalg.norm(points[-1] - points[0]))
    if len(points) < 3 or length == 0.0:
        return Closure(False, "open_two_points", apart, length, 0, end)
    first, last, opening = _find_closing_points(points, arc)
    within = slice(first, last + 1)
    cut = points[within]
    gap = float(np.linalg.norm(cut[-1] - cut[0]))
    length_within = float(arc[last] - arc[first])
    # a line that crosses itself encloses an area too
    area = make_valid(Polygon(cut)).area if len(cut) > 2 else 0.0
    width = 2.0 * area / (length_within + gap)
    if opening > MAX_OPENING_RATIO * pdist(cut).max():
        code = "open_apart"
    elif gap * _closing_turn(cut, arc[within]) > width * 180.0:
        code = "open_wide"
    elif width < tremor:
        code = "open_flat"
    else:
        code = "closed_trimmed" if last - first < end else "closed_gap"
        return Closure(True, code, gap, length_within, first, last)
    return Closure(False, code, apart, length, 0, end)


def _find_closing_points(points: np.ndarray, arc: np.ndarray) -> Tuple[int, int, float]:
    """Finds the points in the first and the last third of the line between which it closes, and the opening [m] there.

    An overhang is cut off only if this brings the ends nearer by at least half of its length.
    """
    length = arc[-1]
    head = np.flatnonzero(arc <= length / 3.0)
    tail = np.flatnonzero(arc >= 2.0 * length / 3.0)
    before_head = arc[head]
    behind_tail = length - arc[tail]
    overhang = before_head[:, None] + behind_tail[None, :]
    opening = cdist(points[head], points[tail]) + 0.5 * overhang
    i, j = np.unravel_index(int(np.argmin(opening)), opening.shape)
    return int(head[i]), int(tail[j]), float(opening[i, j])


def _closing_turn(points: np.ndarray, arc: np.ndarray) -> float:
    """Returns the angle [deg] by which the line would turn if closed from its end to its start.

    Its directions at both ends are taken over a tenth of its length.
    """
    line = points @ [1.0, 1.0j]
    lever = 0.1 * (arc[-1] - arc[0])
    start = line[0]
    end = line[-1]
    after_start = np.interp(arc[0] + lever, arc, line)
    before_end = np.interp(arc[-1] - lever, arc, line)
    directions = np.array([end - before_end, start - end, after_start - start])
    turns = np.angle(directions[1:] * np.conj(directions[:-1]))
    return float(np.degrees(np.abs(turns).sum()))


# ------------------------------------------------------------------ 5: sides
def divide_into_sides(stroke: ResampledStroke) -> np.ndarray:
    """Divides a stroke into straight sides, and returns the first sample of each."""
    x, y = (stroke.points - stroke.points[0]).T
    count = len(x)
    terms = stroke.sample_lengths * np.array([np.ones_like(x), x, y, x * x, y * y, x * y])
    sums = np.concatenate([np.zeros((6, 1)), np.cumsum(terms, axis=1)], axis=1)
    # people mark corners by stopping, so a smaller detail suffices where the spot was seen more than twice as long as
    # usual. The usual value is rounded, so that it seldom changes while a line grows
    weights = stroke.observation_weights
    usual = 2.0 ** np.round(np.log2(np.median(weights)))
    stop_ratio = np.maximum(weights, np.append(weights[1:], 0.0)) / usual
    corner_cost = CORNER_MISFIT * stroke.tremor**3 * np.clip(2.0 / stop_ratio, 0.25, 1.0)
    arc = geometry.arc_lengths(stroke.points)
    best = np.zeros(count + 1)
    predecessor = np.zeros(count + 1, dtype=int)
    starts = np.arange(0)
    for last in range(count):
        starts = np.append(starts, last)
        explained = best[starts] + _misfit(sums[:, last + 1, None] - sums[:, starts])
        # a line that goes back over itself is two sides
        chord = np.hypot(x[starts] - x[last], y[starts] - y[last])
        longest_bend = MAX_BEND * chord + 2.0 * MIN_SPIKE * stroke.tremor
        turns_back = arc[last] - arc[starts] > longest_bend
        cost = np.where(turns_back, np.inf, explained)
        chosen = int(cost.argmin())
        best[last + 1] = cost[chosen] + corner_cost[last]
        predecessor[last + 1] = starts[chosen]
        # a start that is worse than a corner here will never be the best one (PELT, Killick et al. 2012)
        starts = starts[explained <= best[last + 1] + 1e-9]
    firsts = [int(predecessor[count])]
    while firsts[-1] > 0:
        firsts.append(int(predecessor[firsts[-1]]))
    return np.array(firsts[::-1])


def _misfit(sums: np.ndarray) -> np.ndarray:
    """Returns the squared distance from the best straight line, times the length [m^3].

    Args:
        sums: (6, ...) weighted sums of 1, x, y, xx, yy and xy.
    """
    w, x, y, xx, yy, xy = sums
    # the moments about the mean. The smaller eigenvalue of their matrix is the misfit
    sxx = xx - x * x / w
    syy = yy - y * y / w
    sxy = xy - x * y / w
    difference = np.hypot(sxx - syy, 2.0 * sxy)
    return np.maximum(0.5 * (sxx + syy - difference), 0.0)


def fit_vertices(stroke: ResampledStroke, starts: np.ndarray, ends_meet: bool) -> np.ndarray:
    """Places the vertices (M, 2) [m] where the sides between them are nearest to the samples, by weighted least squares.

    `starts` are the first samples of the sides. If `ends_meet`, the last side ends where the first begins.
    """
    points = stroke.points
    vertices = 0.5 * (points[starts - 1] + points[starts])
    if not ends_meet:
        vertices = np.vstack([points[:1], vertices[1:], points[-1:]])
    count = len(vertices)
    # each sample is explained by the side from vertex `start` to `end`. Samples before the first side belong to the last
    samples = np.arange(len(points))
    start = (np.searchsorted(starts, samples, side="right") - 1) % count
    end = (start + 1) % count
    directions = vertices[end] - vertices[start]
    lengths = np.maximum(np.linalg.norm(directions, axis=1), 1e-9)[:, None]
    normals = np.column_stack([-directions[:, 1], directions[:, 0]]) / lengths
    offsets = points - vertices[start]
    along = (offsets * directions).sum(axis=1)[:, None]
    shares = np.clip(along / lengths**2, 0.0, 1.0)
    # a sample's distance from its side changes by as much as both vertices move along the normal, each by its share
    design = np.zeros((len(points), count, 2))
    design[samples, start] = (1.0 - shares) * normals
    design[samples, end] += shares * normals
    design = design.reshape(len(points), -1)
    weighted = design * stroke.sample_lengths[:, None]
    # a corner that the samples do not determine, between nearly collinear sides, stays in place
    prior = VERTEX_PRIOR * stroke.tremor * np.eye(2 * count)
    distances = (offsets * normals).sum(axis=1)
    move = np.linalg.solve(weighted.T @ design + prior, weighted.T @ distances)
    return vertices + move.reshape(-1, 2)


# ------------------------------------------------------------------ 6: vertices
def simplify(chain: np.ndarray, closed: bool) -> np.ndarray:
    """Drops vertices that change nothing, and makes a closed chain a polygon that does not cross itself.

    Raises:
        CodedError: "line_self_intersects" if the enclosed area is not connected.
    """
    if len(chain) < 3:
        return chain
    if not closed:
        return np.asarray(LineString(chain).simplify(MIN_DETAIL).coords)
    polygon = Polygon(chain)
    if not polygon.is_valid:
        # all of the enclosed area except slips of the hand. The lobes of an 8 meet in a point, so a neck joins them
        pieces = make_valid(polygon).buffer(0.0)
        lobes = [Polygon(piece.exterior) for piece in getattr(pieces, "geoms", [pieces])]
        area = sum(lobe.area for lobe in lobes)
        neck = 0.2 * TREMOR
        large_lobes = [lobe for lobe in lobes if lobe.area >= MAX_SLIP_RATIO * area]
        joined = unary_union([lobe.buffer(neck, join_style=2) for lobe in large_lobes])
        polygon = joined.buffer(-0.5 * neck, join_style=2)
        if polygon.geom_type != "Polygon" or polygon.is_empty:
            raise CodedError("line_self_intersects")
    return np.asarray(Polygon(polygon.exterior).simplify(MIN_DETAIL).exterior.coords)[:-1]
