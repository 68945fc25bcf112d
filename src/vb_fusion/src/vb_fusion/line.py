"""Stage 3: the line through the stroke, as few straight sides as explain it.

The sights, in the order in which they were drawn, become stations a hand's tremble apart: a spot held still is one
station, however long. The stations are divided into sides, exactly, by dynamic programming: a corner is worth it if
leaving it out would lose a detail larger than a hand's tremble, and sooner where the pointer stopped.
Then the corners are moved to where the line is as near as it can be to all stations, which puts them where the sides
meet, even where no camera saw them.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import List, Tuple

import numpy as np
from scipy.spatial import cKDTree

from vb_fusion.observations import TREMBLE

LONGEST_SIDE = 200  # stations, 10 m: bounds the time for very long borders


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
    total = np.bincount(station, trust)
    points = np.column_stack([np.bincount(station, trust * sights[:, k]) / total for k in range(2)])
    return _merged(Stroke(points, total))


def _merged(stroke: Stroke) -> Stroke:
    """The stroke as far as it goes on to new floor: a line or ring that is drawn twice is one, seen twice as often."""
    at = stroke.points
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(at, axis=0), axis=1))])
    found = cKDTree(at).query_pairs(2.0 * TREMBLE, output_type="ndarray")
    earlier, later = found.min(axis=1), found.max(axis=1)
    # next to each other along the line is not drawn again
    again = arc[later] - arc[earlier] > 2.0 * np.linalg.norm(at[later] - at[earlier], axis=1) + 4.0 * TREMBLE
    new = np.ones(len(at), dtype=bool)
    new[later[again]] = False
    # two stations beside the line may be an overshoot; three are new floor
    run = np.flatnonzero(new[:-2] & new[1:-1] & new[2:])
    kept = int(run[-1]) + 3 if len(run) else len(at)
    if kept == len(at):
        return stroke
    nearest = cKDTree(at[:kept]).query(at[kept:])[1]
    trust = stroke.trust.copy()
    moved = at * trust[:, None]
    np.add.at(moved, nearest, moved[kept:].copy())
    np.add.at(trust, nearest, trust[kept:].copy())
    return Stroke(moved[:kept] / trust[:kept, None], trust[:kept])


def fit_line(stroke: Stroke, closed: bool, widest_gap: float) -> Tuple[np.ndarray, np.ndarray]:
    """The vertices (M, 2) [m] of the line, and where each station is on it (K, 2) [m].

    A closed line goes on from its last vertex to the first. A gap between its ends that is no wider than widest_gap
    [m] may hide a corner; across a wider one it is straight.
    """
    starts = _divide(stroke)
    joined = closed and len(starts) > 2 and float(np.linalg.norm(stroke.points[-1] - stroke.points[0])) <= widest_gap
    if joined:
        # begin at a corner, so that the side in which the drawing began is one side
        order = np.roll(np.arange(len(stroke.points)), -_sharpest(stroke, starts))
        stroke = Stroke(stroke.points[order], stroke.trust[order])
        starts = _divide(stroke)
    return _refined(stroke, starts, joined and len(starts) > 2)


def _divide(stroke: Stroke) -> List[int]:
    """The first station of each side."""
    at = stroke.points - stroke.points.mean(axis=0)
    w, x, y = stroke.weights, at[:, 0], at[:, 1]
    terms = np.column_stack([w, w * x, w * y, w * x * x, w * y * y, w * x * y])
    before = np.vstack([np.zeros(6), np.cumsum(terms, axis=0)])
    count = len(at)
    # people mark corners by stopping: where the spot was seen more than twice as long as usual, less detail will do
    rest = np.maximum(stroke.trust, np.roll(stroke.trust, 1)) / np.median(stroke.trust)
    corner = TREMBLE**3 * np.clip(2.0 / rest, 0.25, 1.0)
    best = np.zeros(count + 1)
    start = np.zeros(count + 1, dtype=int)
    for end in range(1, count + 1):
        low = max(0, end - LONGEST_SIDE)
        cost = best[low:end] + _misfit(before[end] - before[low:end])
        chosen = int(np.argmin(cost))
        best[end], start[end] = cost[chosen] + corner[end % count], low + chosen
    starts, end = [], count
    while end > 0:
        end = int(start[end])
        starts.append(end)
    return starts[::-1]


def _misfit(sums: np.ndarray) -> np.ndarray:
    """[m^3] squared distance from the best straight line, times the length, for sums (..., 6)."""
    w = np.maximum(sums[..., 0], 1e-12)
    xx = sums[..., 3] - sums[..., 1] ** 2 / w
    yy = sums[..., 4] - sums[..., 2] ** 2 / w
    xy = sums[..., 5] - sums[..., 1] * sums[..., 2] / w
    return np.maximum(0.5 * (xx + yy - np.sqrt((xx - yy) ** 2 + 4.0 * xy**2)), 0.0)


def _sharpest(stroke: Stroke, starts: List[int]) -> int:
    """The station at the sharpest corner between two sides."""
    corners = stroke.points[starts + [len(stroke.points) - 1]]
    sides = np.diff(corners, axis=0)
    sides = sides / np.maximum(np.linalg.norm(sides, axis=1), 1e-9)[:, None]
    return starts[1 + int(np.argmin((sides[:-1] * sides[1:]).sum(axis=1)))]


def _refined(stroke: Stroke, starts: List[int], joined: bool) -> Tuple[np.ndarray, np.ndarray]:
    """The vertices where the stations are least far from the line: least squares, far stations count less."""
    at, weights = stroke.points, stroke.weights
    sides = len(starts)
    vertices = [at[0]] + [0.5 * (at[k - 1] + at[k]) for k in starts[1:]] + [at[-1]]
    if joined:
        vertices = [0.5 * (at[0] + at[-1])] + vertices[1:-1]
    vertices = np.array(vertices)
    count = len(vertices)
    # a corner is unseen at most in the circle over the gap between the stations before and after it (Thales)
    before = [at[-1] if joined else at[0]] + [at[k - 1] for k in starts[1:]] + [at[-1]]
    after = [at[0]] + [at[k] for k in starts[1:]] + [at[-1]]
    room = 0.5 * np.linalg.norm(np.array(after)[:count] - np.array(before)[:count], axis=1) + TREMBLE
    middle = vertices
    start = np.repeat(np.arange(sides), np.diff(starts + [len(at)]))
    end = (start + 1) % count
    # a corner that the stations leave open, between sides that hardly turn, stays where it is
    held = 0.1 * TREMBLE * np.eye(2 * count)
    if not joined:
        # the ends of an open line are where the drawing ended, along their sides too
        for corner in (0, count - 1):
            held[2 * corner : 2 * corner + 2, 2 * corner : 2 * corner + 2] *= 10.0
    every = np.arange(len(start))
    for _ in range(3):
        a, b = vertices[start], vertices[end]
        along = b - a
        length = np.maximum((along**2).sum(axis=1), 1e-12)
        share = np.clip(((at - a) * along).sum(axis=1) / length, 0.0, 1.0)
        normal = np.column_stack([-along[:, 1], along[:, 0]]) / np.sqrt(length)[:, None]
        off = ((at - a) * normal).sum(axis=1)
        weight = weights / np.maximum(1.0, np.abs(off) / TREMBLE)
        rows = np.zeros((len(off), 2 * count))
        for axis in range(2):
            rows[every, 2 * start + axis] += (1.0 - share) * normal[:, axis]
            rows[every, 2 * end + axis] += share * normal[:, axis]
        scaled = rows * weight[:, None]
        move = vertices + np.linalg.solve(scaled.T @ rows + held, scaled.T @ off).reshape(-1, 2) - middle
        reach = np.maximum(np.linalg.norm(move, axis=1), 1e-12)
        vertices = middle + move * np.minimum(1.0, room / reach)[:, None]
    if not joined:
        # half a station of the line is beyond the middle of the last one
        for corner, inner in ((0, 1), (count - 1, count - 2)):
            outwards = vertices[corner] - vertices[inner]
            vertices[corner] += 0.5 * TREMBLE * outwards / max(float(np.linalg.norm(outwards)), 1e-9)
    a, b = vertices[start], vertices[end]
    return vertices, a + share[:, None] * (b - a)
