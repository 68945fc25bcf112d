"""Polygon or separating curve: a rule without lengths in metres.

The ends of a polygon come back to each other. Measured is how far apart they are against the length of the chain,
and how sharply the chain would have to turn to close: ends that face each other, or miss a corner, leave a gap in a
polygon; ends that lie side by side are the two legs of a U. Ends that cross or run past each other are cut there.
"""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vb_core import geometry

# Gap in lengths of the chain up to which it is closed, by the turn [deg] that closing takes. A carpet of 6.5 m with a
# gap of 0.4 m has 0.06, a square of 1 m a side with 0.5 m has 0.14; a line has 1, three sides of a square 0.33.
GAP_FACING = 0.15
GAP_SIDE_BY_SIDE = 0.075
TURN_FACING = 120.0
TURN_SIDE_BY_SIDE = 170.0
# share of the chain at either end in which the ends may cross or overlap
END_SECTION = 0.3
# a metre of overhang is given up for this many metres of a narrower gap
OVERHANG_COST = 0.3
# area in squares of the length below which a polygon is a line drawn there and back; a circle has 0.08
FLAT = 0.004


@dataclass(frozen=True)
class Closing:
    """The decision on one chain; `points` lacks what hangs over beyond the closing point if it is closed."""

    closed: bool
    reason: str
    gap: float
    points: np.ndarray


def decide(points: np.ndarray, kind: str = "decide") -> Closing:
    """Closed or open?

    Args:
        points: (M, 2) [m], the chain as drawn, M >= 2.
        kind: "decide" for the rule, "polygon" or "curve" to override it.
    """
    points = np.asarray(points, dtype=float)
    end_gap = float(np.linalg.norm(points[-1] - points[0]))
    length = geometry.chain_length(points)
    if kind == "curve":
        return Closing(False, "open, as requested", end_gap, points)
    if len(points) < 3 or length == 0.0:
        return Closing(False, "open: two points make no area", end_gap, points)
    trimmed, gap = _cut_overhang(points, length)
    if len(trimmed) < 3:
        trimmed, gap = points, end_gap
    if kind == "polygon":
        return Closing(True, "closed, as requested", gap, trimmed)
    length = geometry.chain_length(trimmed)
    ratio = gap / length
    turn = _closing_turn(trimmed, length, gap)
    allowed = float(np.interp(turn, [TURN_FACING, TURN_SIDE_BY_SIDE], [GAP_FACING, GAP_SIDE_BY_SIDE]))
    measured = f"the ends are {gap:.2f} m apart, {100 * ratio:.0f} % of {length:.2f} m"
    if ratio > allowed:
        whole = geometry.chain_length(points)
        measured = f"the ends are {end_gap:.2f} m apart, {100 * end_gap / whole:.0f} % of {whole:.2f} m"
        side_by_side = ratio <= GAP_FACING
        why = " and lie side by side like the legs of a U" if side_by_side else ""
        return Closing(False, f"open: {measured}{why}", end_gap, points)
    if abs(_area(trimmed)) < FLAT * length**2:
        return Closing(False, f"open: {measured}, but they enclose next to nothing", end_gap, points)
    if len(trimmed) < len(points):
        return Closing(True, f"closed: the ends cross or overlap; cut there, {measured}", gap, trimmed)
    return Closing(True, f"closed: {measured}", gap, trimmed)


def _cut_overhang(points: np.ndarray, length: float):
    """The chain between the two points of its end sections at which closing it costs least, and the gap there."""
    spacing = length / 200.0
    dense = geometry.resample_chain(points, spacing)
    count = len(dense)
    section = max(1, int(END_SECTION * count))
    head, tail = dense[:section], dense[::-1][:section]
    distance = np.linalg.norm(head[:, None, :] - tail[None, :, :], axis=2)
    overhang = spacing * (np.arange(section)[:, None] + np.arange(section)[None, :])
    # distances below the sampling are a crossing
    cost = np.maximum(distance - spacing, 0.0) + OVERHANG_COST * overhang
    i, j = np.unravel_index(int(np.argmin(cost)), cost.shape)
    if i == 0 and j == 0:
        return points, float(distance[0, 0])
    return dense[i : count - j], float(distance[i, j])


def _closing_turn(points: np.ndarray, length: float, gap: float) -> float:
    """How far [deg] the chain turns on the way from its end to its start."""
    if gap <= length / 100.0:
        return 0.0
    dense = geometry.resample_chain(points, length / 100.0)
    window = 8  # percent of the length: longer than a tremor, shorter than a side
    leave = dense[-1] - dense[-1 - window]
    arrive = dense[window] - dense[0]
    across = points[0] - points[-1]
    return math.degrees(_angle(leave, across) + _angle(across, arrive))


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    return abs(math.atan2(a[0] * b[1] - a[1] * b[0], float(a @ b)))


def _area(points: np.ndarray) -> float:
    x, y = points[:, 0], points[:, 1]
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))
