"""Stage 5: the line through the stroke, with the fewest straight sides that explain it.

The samples are divided into sides, optimally, by dynamic programming: a corner is kept if leaving it out would lose a
detail larger than the hand's tremor, or a smaller one where the pointer stopped. Least squares then moves the corners
so that the sides fit all samples best, which puts them where the sides meet, even where no camera saw them.
"""

from __future__ import annotations

import numpy as np

from vb_fusion.line.resampling import ResampledStroke

CORNER_MISFIT = 1.5  # tremors^3: squared distance times length that a corner must explain
MAX_BEND = 1.5  # chords: no side's arc is longer; a semicircle's is 1.57
MIN_SPIKE = 2.0  # tremors there and back: a shorter spike may be noise
VERTEX_PRIOR = 0.3  # tremors of line that hold a vertex in place; where its sides turn, the samples outweigh it


def fit_line(stroke: ResampledStroke, joined: bool) -> np.ndarray:
    """Fits straight sides to a stroke.

    Args:
        stroke: the samples to fit.
        joined: whether the line continues from its last vertex to the first.

    Returns:
        The line's vertices (M, 2) [m].
    """
    x, y = (stroke.points - stroke.points[0]).T
    terms = stroke.weights * np.array([np.ones_like(x), x, y, x * x, y * y, x * y])
    sums = np.concatenate([np.zeros((6, 1)), np.cumsum(terms, axis=1)], axis=1)
    starts = _divide(stroke, sums)
    return _fit_vertices(stroke, starts, joined and len(starts) > 2)


def _divide(stroke: ResampledStroke, sums: np.ndarray) -> np.ndarray:
    """Divides a stroke into sides; returns the first sample of each."""
    x, y = stroke.points.T
    count = len(x)
    # people mark corners by stopping: where the spot was seen more than twice as long as usual, a smaller
    # detail suffices; the usual value is rounded, so that it seldom changes while a line grows
    usual = 2.0 ** np.round(np.log2(np.median(stroke.trust)))
    rest = np.maximum(stroke.trust, np.append(stroke.trust[1:], 0.0)) / usual
    corner = CORNER_MISFIT * stroke.tremor**3 * np.clip(2.0 / rest, 0.25, 1.0)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    best, before = np.zeros(count + 1), np.zeros(count + 1, dtype=int)
    starts = np.arange(0)
    for end in range(1, count + 1):
        starts = np.append(starts, end - 1)
        explained = best[starts] + _misfit(sums[:, end, None] - sums[:, starts])
        # a line that goes back over itself is two sides
        chord = np.hypot(x[starts] - x[end - 1], y[starts] - y[end - 1])
        back = arc[end - 1] - arc[starts] > MAX_BEND * chord + 2.0 * MIN_SPIKE * stroke.tremor
        cost = np.where(back, np.inf, explained)
        start = int(cost.argmin())
        best[end], before[end] = cost[start] + corner[end - 1], starts[start]
        # a start that is worse than a corner here will never be the best one (PELT, Killick et al. 2012)
        starts = starts[explained <= best[end] + 1e-9]
    firsts = [int(before[count])]
    while firsts[-1] > 0:
        firsts.append(int(before[firsts[-1]]))
    return np.array(firsts[::-1])


def _misfit(sums: np.ndarray) -> np.ndarray:
    """Returns the squared distance from the best straight line, times the length [m^3].

    Args:
        sums: (6, ...) weighted sums of 1, x, y, xx, yy and xy.
    """
    w, x, y, xx, yy, xy = sums
    xx, yy, xy = xx - x * x / w, yy - y * y / w, xy - x * y / w
    return np.maximum(0.5 * (xx + yy - np.hypot(xx - yy, 2.0 * xy)), 0.0)


def _fit_vertices(stroke: ResampledStroke, starts: np.ndarray, joined: bool) -> np.ndarray:
    """Moves the vertices to where the sides between them are nearest to the samples, by weighted least squares."""
    at = stroke.points
    vertices = 0.5 * (at[starts - 1] + at[starts])
    if not joined:
        vertices = np.vstack([at[:1], vertices[1:], at[-1:]])
    count = len(vertices)
    # samples before the first side belong to the last side
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
    # a corner that the samples do not determine, between nearly collinear sides, stays in place
    scaled = rows * stroke.weights[:, None]
    move = np.linalg.solve(scaled.T @ rows + VERTEX_PRIOR * stroke.tremor * np.eye(2 * count), scaled.T @ off)
    return vertices + move.reshape(-1, 2)
