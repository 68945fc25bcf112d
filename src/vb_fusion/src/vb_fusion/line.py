"""Stage 3: the line through the trace, as few straight sides as explain it.

A side is worth its two corners if it brings the line nearer to the stations than trembling does by chance. The best
division into sides is found exactly, by dynamic programming over all stretches of the trace; corners are where two
sides meet, so that they stay sharp, also where nobody saw them. At last the corners are moved until the line is as
near as it can be to all sights (iterated least squares, far sights count less).
"""
from __future__ import annotations

from typing import List, Tuple

import numpy as np

from vb_fusion.trace import STEP, Trace

SIDE_COST = 6.0  # a further side must explain so many times what trembling explains by chance on TREMBLING
TREMBLING = 0.15  # [m] of line on which a hand errs to the same side
HELD = 0.3  # of a station's weight
LONGEST_SIDE = 200  # stations, more than 10 m: bounds the time for very long borders
BLOCK = 64  # stations; bounds the memory


def fit_line(trace: Trace, closed: bool, tolerance: float, refine: bool = True) -> np.ndarray:
    """The vertices (M, 2) [m] of the line through a trace.

    Args:
        closed: the line goes on from the last station to the first.
        tolerance: [m] the line need not be nearer to the stations than this.
        refine: move the corners to where all sights together want them.
    """
    breaks = _divide(trace, tolerance)
    if closed:
        # begin at a corner, so that the side in which the drawing began is one side
        trace = trace.select(np.roll(np.arange(len(trace.points)), -_sharpest(trace, breaks)))
        breaks = _divide(trace, tolerance)
    sides = [_side(trace, first, last) for first, last in breaks]
    vertices, owner = _corners(trace, breaks, sides, closed)
    return _refined(trace, breaks, vertices, owner, closed) if refine else vertices


def _moments(trace: Trace) -> np.ndarray:
    """(K + 1, 6) sums of w, wx, wy, wxx, wyy, wxy over the stations before each."""
    at = trace.points - trace.points.mean(axis=0)
    w, x, y = trace.weights, at[:, 0], at[:, 1]
    terms = np.column_stack([w, w * x, w * y, w * x * x, w * y * y, w * x * y])
    return np.vstack([np.zeros(6), np.cumsum(terms, axis=0)])


def _misfit(sums: np.ndarray) -> np.ndarray:
    """[m^3] weighted squared distance from the best line, for sums (..., 6)."""
    w = np.maximum(sums[..., 0], 1e-12)
    xx = sums[..., 3] - sums[..., 1] ** 2 / w
    yy = sums[..., 4] - sums[..., 2] ** 2 / w
    xy = sums[..., 5] - sums[..., 1] * sums[..., 2] / w
    return np.maximum(0.5 * (xx + yy - np.sqrt((xx - yy) ** 2 + 4.0 * xy**2)), 0.0)


def _divide(trace: Trace, tolerance: float) -> List[Tuple[int, int]]:
    """(first, last) station of each side."""
    before = _moments(trace)
    count = len(trace.points)
    if count < 3:
        return [(0, count - 1)]
    # how much a hand trembles here: the usual misfit of short stretches, which corners hardly disturb
    steps = np.linalg.norm(np.diff(trace.points, axis=0), axis=1)
    span = int(np.clip(4.0 * TREMBLING / max(float(np.median(steps)), 1e-6), 1, min(count, 8)))
    short = before[span:] - before[:-span]
    noise = float(np.median(_misfit(short) / np.maximum(short[:, 0], 1e-12)))
    cost_of_side = SIDE_COST * TREMBLING * (noise + tolerance**2)
    best = np.zeros(count + 1)
    start = np.zeros(count + 1, dtype=int)
    for block in range(0, count, BLOCK):
        ends = np.arange(block + 1, min(block + BLOCK, count) + 1)
        low = max(0, block + 1 - LONGEST_SIDE)
        # of all sides that end in this block, at once; a side that would begin behind its end is never chosen
        misfit = _misfit(before[ends][:, None, :] - before[None, low : ends[-1], :])
        for row, end in enumerate(ends):
            cost = best[low:end] + misfit[row, : end - low]
            chosen = int(np.argmin(cost))
            best[end], start[end] = cost[chosen] + cost_of_side, low + chosen
    breaks, end = [], count
    while end > 0:
        breaks.append((int(start[end]), end - 1))
        end = int(start[end])
    return breaks[::-1]


def _side(trace: Trace, first: int, last: int) -> Tuple[np.ndarray, np.ndarray]:
    """A point (2,) [m] on a side's line and its direction (2,)."""
    at, w = trace.points[first : last + 1], trace.weights[first : last + 1]
    middle = (w[:, None] * at).sum(axis=0) / w.sum()
    off = at - middle
    xx, yy, xy = (w * off[:, 0] ** 2).sum(), (w * off[:, 1] ** 2).sum(), (w * off[:, 0] * off[:, 1]).sum()
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    along = np.array([np.cos(angle), np.sin(angle)])
    return middle, along if (at[-1] - at[0]) @ along >= 0.0 else -along


def _sharpest(trace: Trace, breaks: List[Tuple[int, int]]) -> int:
    """The station after the sharpest corner between two sides."""
    if len(breaks) < 2:
        return len(trace.points) // 2
    along = [_side(trace, first, last)[1] for first, last in breaks]
    turn = [float(a @ b) for a, b in zip(along[:-1], along[1:])]
    return breaks[int(np.argmin(turn)) + 1][0]


def _corners(trace: Trace, breaks, sides, closed: bool) -> Tuple[np.ndarray, List[int]]:
    """The vertices, and for each side the index of the vertex where it begins."""
    vertices: List[np.ndarray] = []
    begins: List[int] = []
    count = len(sides)
    if not closed:
        vertices.append(_end(trace, breaks, sides[0], 0))
    for k in range(count if closed else count - 1):
        # the corner between side k and the next one
        begins.append(len(vertices) - 1)
        following = (k + 1) % count
        last, first = trace.points[breaks[k][1]], trace.points[breaks[following][0]]
        vertices += _corner(last, first, sides[k], sides[following])
    begins.append(len(vertices) - 1)
    if not closed:
        vertices.append(_end(trace, breaks, sides[-1], -1))
        return np.array(vertices), begins
    return np.array(vertices), begins[:count]


def _end(trace: Trace, breaks, side, which: int) -> np.ndarray:
    """Where the drawing began (0) or ended (-1) on its first or last side: the outermost sights but for a sixth."""
    first, last = breaks[which]
    middle, along = side
    outwards = -along if which == 0 else along
    of_side = (trace.of_sight >= first) & (trace.of_sight <= last)
    reach = np.sort((trace.sights[of_side] - middle) @ outwards)[::-1]
    there = int((reach >= reach[0] - 2.0 * STEP).sum())
    return middle + reach[there // 6] * outwards


def _foot(point: np.ndarray, side) -> np.ndarray:
    middle, along = side
    return middle + ((point - middle) @ along) * along


def _corner(last: np.ndarray, first: np.ndarray, side, following) -> List[np.ndarray]:
    """One vertex where two sides meet; two where they do not meet near the stretch between their stations."""
    a, b = _foot(last, side), _foot(first, following)
    (p, u), (q, v) = side, following
    cross = u[0] * v[1] - u[1] * v[0]
    gap = float(np.linalg.norm(first - last))
    if abs(cross) > 0.05:
        meet = p + ((q - p)[0] * v[1] - (q - p)[1] * v[0]) / cross * u
        if np.linalg.norm(meet - 0.5 * (a + b)) <= 0.75 * gap + STEP:
            return [meet]
    return [0.5 * (a + b)] if gap < 2.0 * STEP else [a, b]


def _refined(trace: Trace, breaks, vertices: np.ndarray, begins: List[int], closed: bool) -> np.ndarray:
    """The vertices moved to where the sights are least far from the line."""
    count = len(vertices)
    side_of_station = np.repeat(np.arange(len(breaks)), [last - first + 1 for first, last in breaks])
    start = np.array(begins)[side_of_station[trace.of_sight]] % count
    end = (start + 1) % count
    # a corner between sides that hardly turn is held where it was, as by one station
    identity = HELD * STEP * np.eye(2 * count)
    for _ in range(3):
        a, b = vertices[start], vertices[end]
        along = b - a
        length = np.maximum((along**2).sum(axis=1), 1e-12)
        share = np.clip(((trace.sights - a) * along).sum(axis=1) / length, 0.0, 1.0)
        normal = np.column_stack([-along[:, 1], along[:, 0]]) / np.sqrt(length)[:, None]
        off = ((trace.sights - a) * normal).sum(axis=1)
        usual = max(float(np.median(np.abs(off))), 1e-3)
        weight = trace.sight_weights / np.maximum(1.0, np.abs(off) / (3.0 * usual))
        rows = np.zeros((len(off), 2 * count))
        every = np.arange(len(off))
        for axis in range(2):
            rows[every, 2 * start + axis] += (1.0 - share) * normal[:, axis]
            rows[every, 2 * end + axis] += share * normal[:, axis]
        scaled = rows * weight[:, None]
        step = np.linalg.solve(scaled.T @ rows + identity, scaled.T @ off)
        vertices = vertices + step.reshape(-1, 2)
    return vertices
