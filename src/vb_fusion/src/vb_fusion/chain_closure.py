"""Stage 4: polygon or separating curve, as the person means it.

People who mean a closed figure return the pointer to where it began. So the gap between the ends is compared with
the figure's own size, its largest width: ends that come back by more than half of it are meant to meet. Ends that lie
side by side like the legs of a U leave an opening on purpose, unless it is small: in between, the angle decides by
which the line would turn to close. Ends that cross or run past each other are cut there.
"""
from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Dict, Tuple

import numpy as np
from scipy.spatial.distance import cdist
from shapely.geometry import Polygon
from shapely.validation import make_valid

from vb_core import geometry

CAME_BACK = 0.5  # gap in widths of the figure: the end is nearer to the start than to the figure's far side
LEGS = 0.2  # the same for parallel ends: the legs of a U are farther apart than an oversight
MISSED_CORNER = 120.0  # [deg] turn at the corner of an equilateral triangle; parallel legs would turn by 180
SLIVER = 0.03  # mean width in widths of the figure: a line that was drawn there and back encloses less
SAMPLES = 200  # along the line: one per half a per cent


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
    length = geometry.chain_length(points)
    apart = float(np.linalg.norm(points[-1] - points[0]))
    if kind == "curve":
        return Closing(False, "open_requested", apart, 0, end, _values(apart, length))
    if len(points) < 3 or length == 0.0:
        return Closing(False, "open_two_points", apart, 0, end, _values(apart, length))
    first, last = _without_overhang(points, length)
    cut = points[first : last + 1]
    gap = float(np.linalg.norm(cut[-1] - cut[0]))
    values = _values(gap, geometry.chain_length(cut))
    if kind == "polygon":
        return Closing(True, "closed_requested", gap, first, last, values)
    dense = geometry.resample_chain(points, length / SAMPLES)
    width = float(cdist(dense, dense).max())
    allowed = np.interp(_closing_turn(cut, gap), [MISSED_CORNER, 180.0], [CAME_BACK, LEGS])
    if apart > CAME_BACK * width or gap > allowed * width:
        code = "open_apart" if apart > CAME_BACK * width else "open_side_by_side"
        return Closing(False, code, apart, 0, end, _values(apart, length))
    # what is enclosed, also where the line crosses itself
    if make_valid(Polygon(cut)).area < SLIVER * width**2:
        return Closing(False, "open_flat", apart, 0, end, _values(apart, length))
    return Closing(True, "closed_cut" if last - first < end else "closed_gap", gap, first, last, values)


def _values(gap: float, length: float) -> Dict[str, str]:
    percent = 100.0 * gap / length if length else 0.0
    return {"gap": f"{gap:.2f}", "percent": f"{percent:.0f}", "length": f"{length:.2f}"}


def _without_overhang(points: np.ndarray, length: float) -> Tuple[int, int]:
    """The points of the first and the last third of the line between which it is closed.

    What is cut off must bring the ends nearer by half of its length: else the ends stay as they are.
    """
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    head = np.flatnonzero(arc <= length / 3.0)
    tail = np.flatnonzero(arc >= 2.0 * length / 3.0)
    over = arc[head][:, None] + (length - arc[tail])[None, :]
    # between two points the line may cross: a gap of less than their spacing is none
    cost = np.maximum(cdist(points[head], points[tail]) - length / len(points), 0.0) + 0.5 * over
    i, j = np.unravel_index(int(np.argmin(cost)), cost.shape)
    return int(head[i]), int(tail[j])


def _closing_turn(points: np.ndarray, gap: float) -> float:
    """How far [deg] the line turns from its end to its start."""
    dense = geometry.resample_chain(points, geometry.chain_length(points) / SAMPLES)
    tenth = len(dense) // 10
    if gap == 0.0 or tenth == 0:
        return 0.0
    across = points[0] - points[-1]
    return math.degrees(_angle(dense[-1] - dense[-1 - tenth], across) + _angle(across, dense[tenth] - dense[0]))


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    return abs(math.atan2(a[0] * b[1] - a[1] * b[0], float(a @ b)))
