"""Stage 4: polygon or separating curve, as the person means it.

People close a line to enclose floor. So the opening between the ends is compared with the mean width of the floor
that would be enclosed, which is twice its area over the line's length. The opening of a U is always wider than that,
however deep the U is: parallel ends that far apart were drawn on purpose. The less the line would have to turn from its
end to its start, the more likely it is that a side was left unfinished, and the wider the opening may be, up to half of
the figure's size. A wave encloses next to nothing however near its ends are. Ends that cross or run past each other are
cut there; half of the length cut off counts as opening.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Dict, Tuple

import numpy as np
from scipy.spatial.distance import cdist, pdist
from shapely.geometry import Polygon
from shapely.validation import make_valid

from vb_core import geometry
from vb_fusion.stroke.observations import TREMOR

NEARLY_CLOSED = ("open_wide", "open_flat")  # codes of lines whose ends came near each other
MAX_OPENING_RATIO = 0.5  # opening in diameters of the figure: the end is nearer to the start than to the far side


@dataclass(frozen=True)
class Closure:
    """The decision on one line.

    Attributes:
        closed: polygon (True) or separating curve (False).
        code: why; `values` has the values that its sentence names.
        gap: [m] between the ends.
        first, last: indices of outermost points that belong to the line, without an overhang past the closing point.
    """

    closed: bool
    code: str
    gap: float
    first: int
    last: int
    values: Dict[str, str] = field(default_factory=dict)


def classify_closure(points: np.ndarray, tremor: float = TREMOR) -> Closure:
    """Decides whether a line is a polygon or a separating curve.

    Args:
        points: (M, 2) [m], the line as drawn, M >= 2.
        tremor: [m] a narrower figure encloses nothing.
    """
    points = np.asarray(points, dtype=float)
    end = len(points) - 1
    length = geometry.chain_length(points)
    apart = float(np.linalg.norm(points[-1] - points[0]))
    if len(points) < 3 or length == 0.0:
        return Closure(False, "open_two_points", apart, 0, end, _values(apart, length))
    first, last, opening = _without_overhang(points, length)
    cut = points[first : last + 1]
    gap = float(np.linalg.norm(cut[-1] - cut[0]))
    length_within = geometry.chain_length(cut)
    # mean width of the enclosed area, also where the line crosses itself
    width = 2.0 * make_valid(Polygon(cut)).area / (length_within + gap) if len(cut) > 2 else 0.0
    if opening > MAX_OPENING_RATIO * pdist(cut).max():
        code = "open_apart"
    elif gap * _closing_turn(cut, 0.1 * length_within) > width * 180.0:
        code = "open_wide"
    elif width < tremor:
        code = "open_flat"
    else:
        code = "closed_trimmed" if last - first < end else "closed_gap"
    if code.startswith("open"):
        return Closure(False, code, apart, 0, end, _values(apart, length))
    return Closure(True, code, gap, first, last, _values(gap, length_within))


def _values(gap: float, length: float) -> Dict[str, str]:
    percent = 100.0 * gap / length if length else 0.0
    return {"gap": f"{gap:.2f}", "percent": f"{percent:.0f}", "length": f"{length:.2f}"}


def _without_overhang(points: np.ndarray, length: float) -> Tuple[int, int, float]:
    """Finds the points in the first and the last third of the line between which it closes, and the opening [m] there.

    An overhang is cut off only if this brings the ends nearer by at least half of its length.
    """
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    head = np.flatnonzero(arc <= length / 3.0)
    tail = np.flatnonzero(arc >= 2.0 * length / 3.0)
    over = arc[head][:, None] + (length - arc[tail])[None, :]
    cost = cdist(points[head], points[tail]) + 0.5 * over
    i, j = np.unravel_index(int(np.argmin(cost)), cost.shape)
    return int(head[i]), int(tail[j]), float(cost[i, j])


def _closing_turn(points: np.ndarray, lever: float) -> float:
    """Returns the angle [deg] by which the line would turn if closed from its end to its start.

    Its directions at both ends are taken over `lever` [m].
    """
    line = points @ [1.0, 1.0j]
    arc = np.append(0.0, np.cumsum(np.abs(np.diff(line))))
    ahead, behind = np.interp([lever, arc[-1] - lever], arc, line)
    across = line[0] - line[-1]
    return float(np.degrees(np.abs(np.angle(np.conj([line[-1] - behind, across]) * [across, ahead - line[0]])).sum()))
