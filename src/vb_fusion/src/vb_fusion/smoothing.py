"""Robust mode, last step: the path is fitted to the points it was found in.

Along the path a local line is fitted (Gaussian weights, far points left out); corners are put back where two lines
meet at an angle, since a local fit rounds them.
"""
from __future__ import annotations

import math
from typing import Optional

import numpy as np
from scipy.spatial import cKDTree

from vb_core import geometry

BIN = 0.01  # [m] along the path
KNOWN = 0.08  # of the usual support: a fit goes a little beyond the edge of a gap, not across it
BANDWIDTH = 0.08  # [m] of the local fit along the path: longer than the tremor, shorter than a side
FAR = 0.15  # [m] across the path: no point of the stroke
SPACING = 0.04  # [m] of the fitted chain
CORNER_ANGLE = math.radians(35.0)
STRAIGHT = 0.015  # [m] rms distance from a line that is one
CORNER_ARM = (0.06, 0.30)  # [m] from the corner: where its two lines are fitted
CORNER_SHIFT = 0.10  # [m] a corner lies at most this far off the rounded chain
HOLE = 0.08  # [m] a stretch of the chain farther from all points is a gap that was bridged
GAP_ARMS = (0.40, 0.22)  # [m] lengths of the lines at either side of a gap: the short ones must agree with the long
GAP_STRAIGHT = 0.02  # [m] rms distance from its line
GAP_AGREE = 0.1  # [m] on where the corner is; a tremor beside the gap bends the short ones
GAP_ANGLE = (math.radians(45.0), math.radians(135.0))
GAP_REACH = 1.1  # a corner in a gap is at most so many widths of the gap away from its ends


def fit(path: np.ndarray, points: np.ndarray, weights: np.ndarray, closed: bool, bandwidth: float) -> np.ndarray:
    """A chain (M, 2) [m] along a path (K, 2) [m], fitted to weighted points (S, 2) [m].

    The ends of an open chain reach as far as the points do.
    """
    chain = path
    for widen in (1.5, 1.0, 1.0):
        chain = _fit_once(chain, points, weights, closed, widen * bandwidth)
    return chain


def _fit_once(path: np.ndarray, points: np.ndarray, weights: np.ndarray, closed: bool, bandwidth: float) -> np.ndarray:
    dense = geometry.resample_chain(path, BIN, closed)
    if len(dense) < 4:
        return path
    ring = np.vstack([dense, dense[:1]]) if closed else dense
    length = geometry.chain_length(ring)
    step = length / (len(ring) - 1)
    nearest = cKDTree(dense).query(points)[1]
    t, across = _along(dense, points, nearest, step, closed)
    near = across <= FAR
    if not closed:
        near &= (t > -FAR) & (t < length + FAR)
    spread = 1.5 * float(np.median(across[near])) if near.any() else FAR
    near &= across <= max(3.0 * spread, CORNER_SHIFT)  # at corners the rounded path is that far off
    t, w, at = t[near], weights[near], points[near]
    if len(t) < 3:
        return path
    first, last = (0.0, length) if closed else _extent(t, w, step)
    return _local_lines(dense, step, t, at, w, closed, bandwidth, first, last)


def _along(dense: np.ndarray, points: np.ndarray, nearest: np.ndarray, step: float, closed: bool):
    """Arc length t (S,) and distance (S,) of points to the dense path; beyond an open end t goes on."""
    count = len(dense)
    if closed:
        tangent = np.roll(dense, -3, axis=0) - np.roll(dense, 3, axis=0)
    else:
        index = np.arange(count)
        tangent = dense[np.minimum(index + 6, count - 1)] - dense[np.maximum(index - 6, 0)]
    tangent = tangent / np.maximum(np.linalg.norm(tangent, axis=1), 1e-12)[:, None]
    offset = points - dense[nearest]
    ahead = (offset * tangent[nearest]).sum(axis=1)
    if closed:
        # inside a bend a point may be far from the chain and still "ahead"; keep to the nearest sample
        ahead = np.clip(ahead, -step, step)
    else:
        inner = (nearest > 0) & (nearest < count - 1)
        ahead = np.where(inner, np.clip(ahead, -step, step), ahead)
    across = np.linalg.norm(offset - ahead[:, None] * tangent[nearest], axis=1)
    return nearest * step + ahead, across


def _extent(t: np.ndarray, w: np.ndarray, step: float):
    """Where an open chain begins and ends: the outermost points but for the last two at either end."""
    order = np.argsort(t)
    cumulated = np.cumsum(w[order])
    drop = min(2.0, 0.01 * cumulated[-1])
    first = t[order][int(np.searchsorted(cumulated, drop))]
    last = t[order][min(int(np.searchsorted(cumulated, cumulated[-1] - drop)), len(t) - 1)]
    return float(first), float(max(last, first + step))


def _local_lines(dense, step, t, at, w, closed, bandwidth, first, last) -> np.ndarray:
    """Local linear regression of both coordinates over t, on bins of t."""
    length = len(dense) * step if closed else last - first
    bins = max(4, int(round(length / BIN)))
    size = length / bins
    if closed:
        index = np.floor((t % length) / size).astype(int) % bins
        centre = (np.arange(bins) + 0.5) * size
    else:
        inside = (t >= first - size) & (t <= last + size)
        t, at, w = t[inside], at[inside], w[inside]
        index = np.clip(np.floor((t - first) / size).astype(int), 0, bins)
        bins += 1
        centre = first + np.arange(bins) * size
    half = min(int(math.ceil(3.0 * bandwidth / size)), (bins - 1) // 2)
    lag = np.arange(-half, half + 1) * size
    kernel = np.exp(-0.5 * (lag / bandwidth) ** 2)
    sums = [np.bincount(index, values, minlength=bins) for values in (w, w * at[:, 0], w * at[:, 1])]

    def gather(values: np.ndarray, order: int) -> np.ndarray:
        padded = np.concatenate([values[-half:], values, values[:half]]) if closed else np.pad(values, half)
        return np.convolve(padded, (kernel * lag**order)[::-1], mode="valid")

    s0, s1, s2 = (gather(sums[0], order) for order in range(3))
    determinant = s0 * s2 - s1 * s1
    fitted = np.empty((bins, 2))
    known = s0 > KNOWN * np.median(s0[s0 > 0])
    sound = determinant > 0.02 * (bandwidth * s0) ** 2
    for axis in range(2):
        b0, b1 = gather(sums[1 + axis], 0), gather(sums[1 + axis], 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            fitted[:, axis] = np.where(sound, (s2 * b0 - s1 * b1) / determinant, np.nan)
    good = known & sound & np.isfinite(fitted).all(axis=1)
    if good.sum() < 3:
        return dense
    every = max(1, int(round(SPACING / size)))
    if closed:
        period = length
        keep = np.arange(0, bins, every)
        return np.column_stack(
            [np.interp(centre[keep], centre[good], fitted[good, axis], period=period) for axis in range(2)]
        )
    keep = np.unique(np.append(np.arange(0, bins, every), bins - 1))
    return np.column_stack([np.interp(centre[keep], centre[good], fitted[good, axis]) for axis in range(2)])


def corners_in_gaps(chain: np.ndarray, points: np.ndarray, closed: bool) -> np.ndarray:
    """Where a corner itself was not seen: both sides of the gap go on to where they meet, if that is near.

    Args:
        chain: (M, 2) [m], fitted; a gap is bridged by a straight line.
        points: (S, 2) [m] that it was fitted to.
    """
    step = 0.02
    dense = geometry.resample_chain(chain, step, closed)
    count = len(dense)
    tree = cKDTree(points)
    usual = float(np.median(tree.query(points, k=[min(3, len(points))])[0])) if len(points) > 1 else 0.0
    hole = max(HOLE, 3.0 * usual)
    empty = tree.query(dense)[0] > hole
    if not empty.any() or empty.all():
        return chain
    # a closed chain is turned so that it does not begin in a gap
    shift = int(np.argmin(empty)) if closed else 0
    dense, empty = np.roll(dense, -shift, axis=0), np.roll(empty, -shift)
    edges = np.flatnonzero(np.diff(empty.astype(int)))
    margin = int(round(hole / step))
    vertices, done = [], 0
    for first, last in zip(edges[:-1:2] + 1, edges[1::2] + 1):
        corner = _corner_between(dense, first - margin, last - 1 + margin, step, closed)
        if corner is not None and first - margin >= done:
            vertices += [dense[done : first - margin + 1], corner[None]]
            done = last - 1 + margin
    if not vertices:
        return chain
    return np.vstack(vertices + [dense[done:]]) if done < count else np.vstack(vertices)


def _corner_between(dense: np.ndarray, a: int, b: int, step: float, closed: bool) -> Optional[np.ndarray]:
    """(2,) where the lines that end at sample a and begin at sample b meet, if they do so ahead of both and near."""
    count = len(dense)
    start, end = dense[a], dense[b % count]
    near = GAP_REACH * float(np.linalg.norm(end - start))
    corners = []
    for arm in GAP_ARMS:
        size = int(round(arm / step))
        before, after = np.arange(a - size, a + 1), np.arange(b, b + size + 1)
        if closed:
            before, after = before % count, after % count
        elif before[0] < 0 or after[-1] >= count:
            return None
        mean, (u, v), off = _lines(np.stack([dense[before], dense[after]]))
        cross = float(u[0] * v[1] - u[1] * v[0])
        turn = abs(math.atan2(cross, float(u @ v)))
        if off.max() > GAP_STRAIGHT or not GAP_ANGLE[0] < turn < GAP_ANGLE[1]:
            return None
        between = mean[1] - mean[0]
        meet = mean[0] + (between[0] * v[1] - between[1] * v[0]) / cross * u
        ahead = np.array([(meet - start) @ u, (end - meet) @ v])
        if (ahead < -2.0 * step).any() or (ahead > near).any():
            return None
        corners.append(meet)
    return corners[0] if np.linalg.norm(corners[0] - corners[1]) < GAP_AGREE else None


def sharpen_corners(chain: np.ndarray, closed: bool) -> np.ndarray:
    """Puts a vertex where the chain's two sides would meet at an angle; the rounded stretch between goes.

    Args:
        chain: (M, 2) [m], sampled every SPACING or so.
    """
    dense = geometry.resample_chain(chain, 0.02, closed)
    count = len(dense)
    near, far = (max(1, int(round(arm / 0.02))) for arm in CORNER_ARM)
    if count < 2 * far + 1:
        return chain
    index = np.arange(count)
    before, after = _window(dense, -index_range(near, far), closed), _window(dense, index_range(near, far), closed)
    usable = np.ones(count, dtype=bool) if closed else (index >= far) & (index < count - far)
    p, u, err_p = _lines(before)
    q, v, err_q = _lines(after)
    cross = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    turn = np.abs(np.arctan2(cross, (u * v).sum(axis=1)))
    with np.errstate(divide="ignore", invalid="ignore"):
        s = ((q - p)[:, 0] * v[:, 1] - (q - p)[:, 1] * v[:, 0]) / cross
    meet = p + s[:, None] * u
    shift = np.linalg.norm(meet - dense, axis=1)
    straight = np.maximum(err_p, err_q) < STRAIGHT
    corner = usable & (turn > CORNER_ANGLE) & straight & (shift < CORNER_SHIFT)
    if not corner.any():
        return chain
    # of a run of candidates the one whose lines meet nearest to it
    score = np.where(corner, shift, np.inf)
    result, dropped = {}, np.zeros(count, dtype=bool)
    while np.isfinite(score).any():
        best = int(np.argmin(score))
        result[best] = meet[best]
        around = best + np.arange(-far, far + 1)
        cut = best + np.arange(-near, near + 1)
        if closed:
            around, cut = around % count, cut % count
        else:
            around, cut = around[(around >= 0) & (around < count)], cut[(cut >= 0) & (cut < count)]
        score[around] = np.inf
        dropped[cut] = True
    vertices = [result[k] if k in result else dense[k] for k in range(count) if k in result or not dropped[k]]
    return np.array(vertices)


def index_range(near: int, far: int) -> np.ndarray:
    """Offsets near..far."""
    return np.arange(near, far + 1)


def _window(dense: np.ndarray, offsets: np.ndarray, closed: bool) -> np.ndarray:
    """(M, K, 2): for each sample those at the given offsets, in the direction of travel."""
    index = np.arange(len(dense))[:, None] + np.sort(offsets)[None, :]
    index = index % len(dense) if closed else np.clip(index, 0, len(dense) - 1)
    return dense[index]


def _lines(windows: np.ndarray):
    """Mean (M, 2), unit direction of travel (M, 2) and rms distance (M,) of the lines through windows (M, K, 2)."""
    mean = windows.mean(axis=1)
    d = windows - mean[:, None, :]
    xx, yy, xy = (d[..., 0] ** 2).mean(1), (d[..., 1] ** 2).mean(1), (d[..., 0] * d[..., 1]).mean(1)
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    direction = np.column_stack([np.cos(angle), np.sin(angle)])
    forward = ((windows[:, -1] - windows[:, 0]) * direction).sum(axis=1)
    direction = direction * np.where(forward < 0.0, -1.0, 1.0)[:, None]
    least = 0.5 * (xx + yy - np.sqrt((xx - yy) ** 2 + 4.0 * xy**2))
    return mean, direction, np.sqrt(np.maximum(least, 0.0))
