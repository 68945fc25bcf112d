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


def make_stroke(sights: np.ndarray, trust: np.ndarray) -> Stroke:
    """The stations of sights (N, 2) [m] with weights (N,), N >= 3; what was drawn twice at the end is merged."""
    # what two cameras see in turn is not a movement: a mean over five sights
    window = np.clip(np.arange(len(sights))[:, None] + np.arange(-2, 3), 0, len(sights) - 1)
    calm = (sights[window] * trust[window][..., None]).sum(axis=1) / trust[window].sum(axis=1)[:, None]
    station = np.empty(len(sights), dtype=np.int64)
    number, seen, x, y = 0, 0, 0.0, 0.0
    for row, (px, py) in enumerate(calm.tolist()):
        if seen and (px - x / seen) ** 2 + (py - y / seen) ** 2 > TREMBLE**2:
            number, seen, x, y = number + 1, 0, 0.0, 0.0
        seen, x, y = seen + 1, x + px, y + py
        station[row] = number
    stroke = _means(sights, trust, station)
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


def fit_line(stroke: Stroke, joined: bool) -> np.ndarray:
    """The vertices (M, 2) [m] of the line; if it is joined, it goes on from its last vertex to the first."""
    starts = _divide(stroke)
    if joined and len(starts) > 2:
        # begin at a corner, so that the side in which the drawing began is one side
        shift = int(starts[len(starts) // 2])
        stroke = Stroke(np.roll(stroke.points, -shift, axis=0), np.roll(stroke.trust, -shift))
        starts = _divide(stroke)
    return _fitted(stroke, starts, joined and len(starts) > 2)


def _divide(stroke: Stroke) -> np.ndarray:
    """The first station of each side."""
    x, y = (stroke.points - stroke.points.mean(axis=0)).T
    terms = stroke.weights * np.array([np.ones_like(x), x, y, x * x, y * y, x * y])
    before = np.concatenate([np.zeros((6, 1)), np.cumsum(terms, axis=1)], axis=1)
    count = len(x)
    # people mark corners by stopping: where the spot was seen more than twice as long as usual, less detail will do
    rest = np.maximum(stroke.trust, np.roll(stroke.trust, 1)) / np.median(stroke.trust)
    corner = DETAIL * np.clip(2.0 / rest, 0.25, 1.0)
    best = np.zeros(count + 1)
    start = np.zeros(count + 1, dtype=int)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    for end in range(1, count + 1):
        cost = best[:end] + _misfit(before[:, end, None] - before[:, :end])
        # what goes back over itself is two sides
        chord = np.hypot(x[:end] - x[end - 1], y[:end] - y[end - 1])
        cost[arc[end - 1] - arc[:end] > 1.5 * chord + 4.0 * TREMBLE] = np.inf
        start[end] = np.argmin(cost)
        best[end] = cost[start[end]] + corner[end % count]
    starts = [int(start[count])]
    while starts[-1] > 0:
        starts.append(int(start[starts[-1]]))
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
    side = np.searchsorted(starts, np.arange(len(at)), side="right") - 1
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
