"""Stage 3: the line through the stroke, as few straight sides as explain it.

The sights, in the order in which they were drawn, become stations a hand's tremble apart: a spot held still is one
station, however long. The stations are divided into sides, exactly, by dynamic programming: a corner is worth it if
leaving it out would lose a detail larger than a hand's tremble, and sooner where the pointer stopped.
Then the corners are moved to where the sides fit all stations best (least squares), which puts them where the sides
meet, even where no camera saw them.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from vb_fusion.memory import Memory
from vb_fusion.stroke.observations import TREMBLE

DETAIL = 1.5 * TREMBLE**3  # [m^3] squared distance times length that a corner must explain


@dataclass(frozen=True)
class Stroke:
    """Stations along a stroke, in the order in which they were drawn.

    Attributes:
        points: (K, 2) [m].
        trust: (K,) how many spots each was made of, and how good they are.
    """

    points: np.ndarray
    trust: np.ndarray

    @property
    def weights(self) -> np.ndarray:
        """(K,) [m] of the line that each station represents."""
        steps = np.minimum(np.linalg.norm(np.diff(self.points, axis=0), axis=1), 2.0 * TREMBLE)
        return 0.5 * (np.append(steps, 0.0) + np.append(0.0, steps)) + 0.1 * TREMBLE


def make_stroke(sights: np.ndarray, trust: np.ndarray, known: Memory) -> Stroke:
    """The stations of sights (N, 2) [m] with weights (N,), N >= 3; what was drawn twice at the end is merged."""
    # what two cameras see in turn is not a movement: a mean over three sights
    wide = np.pad(np.column_stack([sights * trust[:, None], trust]), ((1, 1), (0, 0)), mode="edge")
    total = wide[:-2] + wide[1:-1] + wide[2:]
    calm = total[:, :2] / total[:, 2:]
    first, states = known.resume(calm, 1)
    station = states[:, 0]
    # from the beginning of the last station on
    first = int(np.searchsorted(station[:first], station[first - 1])) if first else 0
    number, seen, x, y = int(station[first - 1]) + 1 if first else 0, 0, 0.0, 0.0
    for row, (px, py) in enumerate(calm[first:].tolist(), start=first):
        if seen and (px - x / seen) ** 2 + (py - y / seen) ** 2 > TREMBLE**2:
            number, seen, x, y = number + 1, 0, 0.0, 0.0
        seen, x, y = seen + 1, x + px, y + py
        station[row] = number
    stroke = _means(sights, trust, station.astype(int))
    # the line ends where the spot was seen first and last
    stroke.points[[0, -1]] = calm[[0, -1]]
    return _merged(stroke)


def _means(points: np.ndarray, trust: np.ndarray, station: np.ndarray) -> Stroke:
    total = np.bincount(station, trust)
    return Stroke(np.column_stack([np.bincount(station, trust * axis) / total for axis in points.T]), total)


def _merged(stroke: Stroke) -> Stroke:
    """The stroke as far as it goes on to new floor: a line or ring that is drawn twice is one, seen twice as often."""
    at = stroke.points
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(at, axis=0), axis=1))])
    earlier, later = cKDTree(at).query_pairs(2.0 * TREMBLE, output_type="ndarray").T
    # the way between them is more than what a bend makes of it
    again = arc[later] - arc[earlier] > 2.0 * np.linalg.norm(at[later] - at[earlier], axis=1) + TREMBLE
    new = np.ones(len(at), dtype=bool)
    new[later[again]] = False
    # two stations beside the line may be an overshoot; three are new floor
    run = np.flatnonzero(new[:-2] & new[1:-1] & new[2:])
    kept = int(run[-1]) + 3 if len(run) else len(at)
    nearest = cKDTree(at[:kept]).query(at[kept:])[1]
    return _means(at, stroke.trust, np.concatenate([np.arange(kept), nearest]))


def fit_line(stroke: Stroke, joined: bool, known: Memory) -> np.ndarray:
    """The vertices (M, 2) [m] of the line; if it is joined, it goes on from its last vertex to the first."""
    x, y = (stroke.points - stroke.points[0]).T
    terms = stroke.weights * np.array([np.ones_like(x), x, y, x * x, y * y, x * y])
    sums = np.concatenate([np.zeros((6, 1)), np.cumsum(terms, axis=1)], axis=1)
    starts = _divide(stroke, sums, known)
    if joined and len(starts) > 3:
        # the side in which the drawing began and ended is one side
        last, first = sums[:, -1] - sums[:, starts[-1]], sums[:, starts[1]]
        away = np.linalg.norm(stroke.points[[-1, 0, starts[1] - 1]] - stroke.points[starts[-1]], axis=1)
        goes_on = (np.diff(away) > -2.0 * TREMBLE).all()
        if goes_on and _misfit(last + first) < _misfit(last) + _misfit(first) + DETAIL:
            starts = starts[1:]
    return _fitted(stroke, starts, joined and len(starts) > 2)


def _divide(stroke: Stroke, sums: np.ndarray, known: Memory) -> np.ndarray:
    """The first station of each side."""
    x, y = stroke.points.T
    count = len(x)
    # people mark corners by stopping: where the spot was seen more than twice as long as usual, less detail will do;
    # what is usual is rounded, so that it seldom changes while a line grows
    usual = 2.0 ** np.round(np.log2(np.median(stroke.trust)))
    rest = np.maximum(stroke.trust, np.append(stroke.trust[1:], 0.0)) / usual
    corner = DETAIL * np.clip(2.0 / rest, 0.25, 1.0)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    first, states = known.resume(np.column_stack([x, y, stroke.weights, corner]), 2)
    best = np.append(0.0, states[:, 0])
    for end in range(first + 1, count + 1):
        cost = best[:end] + _misfit(sums[:, end, None] - sums[:, :end])
        # what goes back over itself is two sides
        chord = np.hypot(x[:end] - x[end - 1], y[:end] - y[end - 1])
        cost[arc[end - 1] - arc[:end] > 1.5 * chord + 4.0 * TREMBLE] = np.inf
        start = int(cost.argmin())
        best[end] = cost[start] + corner[end - 1]
        states[end - 1] = best[end], start
    starts = [int(states[-1, 1])]
    while starts[-1] > 0:
        starts.append(int(states[starts[-1] - 1, 1]))
    return np.array(starts[::-1])


def _misfit(sums: np.ndarray) -> np.ndarray:
    """[m^3] squared distance from the best straight line, times the length, for sums (6, ...): 1, x, y, xx, yy, xy."""
    w, x, y, xx, yy, xy = sums
    xx, yy, xy = xx - x * x / w, yy - y * y / w, xy - x * y / w
    return np.maximum(0.5 * (xx + yy - np.hypot(xx - yy, 2.0 * xy)), 0.0)


def _fitted(stroke: Stroke, starts: np.ndarray, joined: bool) -> np.ndarray:
    """The vertices where the sides between them are least far from the stations, by weighted least squares."""
    at = stroke.points
    vertices = 0.5 * (at[starts - 1] + at[starts])
    if not joined:
        vertices = np.vstack([at[:1], vertices[1:], at[-1:]])
    count = len(vertices)
    # what comes before the first side belongs to the last
    side = (np.searchsorted(starts, np.arange(len(at)), side="right") - 1) % count
    ends = np.column_stack([side, (side + 1) % count])
    along = vertices[ends[:, 1]] - vertices[ends[:, 0]]
    length = np.maximum(np.linalg.norm(along, axis=1), 1e-9)[:, None]
    share = np.clip(((at - vertices[ends[:, 0]]) * along).sum(axis=1) / length[:, 0] ** 2, 0.0, 1.0)
    normal = np.column_stack([-along[:, 1], along[:, 0]]) / length
    rows = np.zeros((len(at), count, 2))
    every = np.arange(len(at))
    rows[every, ends[:, 0]] = (1.0 - share)[:, None] * normal
    rows[every, ends[:, 1]] += share[:, None] * normal
    rows = rows.reshape(len(at), -1)
    off = ((at - vertices[ends[:, 0]]) * normal).sum(axis=1)
    # a corner that the stations leave open, between sides that hardly turn, stays where it is
    scaled = rows * stroke.weights[:, None]
    move = np.linalg.solve(scaled.T @ rows + 0.3 * TREMBLE * np.eye(2 * count), scaled.T @ off)
    return vertices + move.reshape(-1, 2)
