"""Stage 4: polygon or separating curve, as people mean it.

The ends of a polygon come back to each other. Compared are the gap between them, as a share of the line, and how far
the line would have to turn to close: ends that face each other, or miss a corner, leave a gap in a polygon; ends that
lie side by side are the two legs of a U. Ends that cross or run past each other are cut there.
"""
from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Dict, Tuple

import numpy as np
from shapely.geometry import Polygon
from shapely.validation import make_valid

from vb_core import geometry

# gap in lengths of the line up to which it is closed, by the turn [deg] that closing takes
GAP_FACING = 0.28
GAP_SIDE_BY_SIDE = 0.075
TURN_FACING = 130.0
TURN_SIDE_BY_SIDE = 170.0
END_SECTION = 0.3  # share of the line at either end in which the ends may cross or overlap
OVERHANG_COST = 0.3  # a metre of overhang is given up for this many metres of a narrower gap
FLAT = 0.004  # area in squares of the length; a circle has 0.08, a line drawn there and back nothing


@dataclass(frozen=True)
class Closing:
    """The decision on one line.

    Attributes:
        closed: polygon or separating curve.
        code: why, with the values that its sentence names.
        gap: [m] between the ends.
        first, last: the outermost points that belong to the line; what hangs over a closing point does not.
    """

    closed: bool
    code: str
    gap: float
    first: int
    last: int
    values: Dict[str, str] = field(default_factory=dict)


def decide(points: np.ndarray, kind: str = "decide") -> Closing:
    """Closed or open?

    Args:
        points: (M, 2) [m], the line as drawn, M >= 2.
        kind: "decide" for the rule, "polygon" or "curve" to override it.
    """
    points = np.asarray(points, dtype=float)
    end = len(points) - 1
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    length = float(arc[-1])
    apart = float(np.linalg.norm(points[-1] - points[0]))
    whole = _values(apart, length)
    if kind == "curve":
        return Closing(False, "open_requested", apart, 0, end, whole)
    if len(points) < 3 or length == 0.0:
        return Closing(False, "open_two_points", apart, 0, end, whole)
    first, last = _without_overhang(points, arc)
    gap = float(np.linalg.norm(points[last] - points[first]))
    length = float(arc[last] - arc[first])
    if kind == "polygon":
        return Closing(True, "closed_requested", gap, first, last, _values(gap, length))
    inner = points[first : last + 1]
    turn = _closing_turn(inner, length, gap)
    allowed = float(np.interp(turn, [TURN_FACING, TURN_SIDE_BY_SIDE], [GAP_FACING, GAP_SIDE_BY_SIDE]))
    ratio = gap / length
    if ratio > allowed:
        code = "open_side_by_side" if ratio <= GAP_FACING else "open_apart"
        return Closing(False, code, apart, 0, end, whole)
    # what is enclosed, also where the line crosses itself
    if make_valid(Polygon(inner)).area < FLAT * length**2:
        return Closing(False, "open_flat", apart, 0, end, whole)
    code = "closed_cut" if last - first < end else "closed_gap"
    return Closing(True, code, gap, first, last, _values(gap, length))


def _values(gap: float, length: float) -> Dict[str, str]:
    percent = 100.0 * gap / length if length else 0.0
    return {"gap": f"{gap:.2f}", "percent": f"{percent:.0f}", "length": f"{length:.2f}"}


def _without_overhang(points: np.ndarray, arc: np.ndarray) -> Tuple[int, int]:
    """The two points of the end sections between which closing the line costs least."""
    length = arc[-1]
    head = np.flatnonzero(arc <= END_SECTION * length)
    tail = np.flatnonzero(arc >= (1.0 - END_SECTION) * length)
    distance = np.linalg.norm(points[head][:, None, :] - points[tail][None, :, :], axis=2)
    overhang = arc[head][:, None] + (length - arc[tail])[None, :]
    spacing = length / len(points)
    cost = np.maximum(distance - spacing, 0.0) + OVERHANG_COST * overhang
    i, j = np.unravel_index(int(np.argmin(cost)), cost.shape)
    return int(head[i]), int(tail[j])


def _closing_turn(points: np.ndarray, length: float, gap: float) -> float:
    """How far [deg] the line turns on the way from its end to its start."""
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
