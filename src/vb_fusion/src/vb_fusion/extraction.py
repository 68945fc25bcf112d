"""From the spots of all cameras to one border. The idea: one stroke is one track through time.

The stages are modules, in the order of the data: stroke/observations, stroke/track, stroke/camera_offsets,
line/resampling, line/closure, line/fitting; docs/explanation/extraction.md says what each does.
`ExtractionParams.paper()` runs the paper's algorithms (paper.py), which need no stamps.

>>> import numpy as np
>>> angle = np.linspace(0.0, 2.0 * np.pi, 200)                      # a circle drawn in eight seconds, seen 25 times a second
>>> spots = 2.0 + np.column_stack([np.cos(angle), np.sin(angle)])
>>> chain = extract_border(spots, stamps=0.04 * np.arange(200))
>>> chain.closed, abs(chain.length - 2.0 * np.pi) < 0.2
(True, True)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np
from scipy.spatial.distance import cdist
from shapely.geometry import LineString, Polygon
from shapely.ops import unary_union
from shapely.validation import make_valid

from vb_core import geometry
from vb_core.parameters import Parameters, param
from vb_fusion.line.chain import BorderChain, ExtractionError
from vb_fusion.line import closure
from vb_fusion.line.fitting import fit_line
from vb_fusion.line.resampling import ResampledStroke, resample_stroke
from vb_fusion.paper import bounding_diagonal, find_cluster, generate_polygon, thin_points
from vb_fusion.stroke.observations import TREMOR, Observations, estimate_tremor, make_observations, merge_observations
from vb_fusion.stroke.camera_offsets import remove_offsets
from vb_fusion.stroke.seed import extract_seed
from vb_fusion.stroke.track import find_places, find_strokes

__all__ = ["BorderChain", "ExtractionError", "ExtractionParams", "extract_border", "extract_seed"]

SMALLEST_FIGURE = 8.0  # tremors across: the smallest curled line that can be told to be open
MAX_SLIP_RATIO = 0.02  # of the area that a crossing line encloses: smaller loops are slips of the hand


@dataclass(frozen=True)
class ExtractionParams(Parameters):
    """Parameters of the extraction; names and values of the paper's Table 1 where it has them."""

    mode: str = param("robust", choices=("robust", "paper"))
    eps: float = param(0.5, "m", above=0.0, high=5.0)
    min_pts: int = param(1, low=1, high=1000)
    min_exp: float = param(0.3, "m", low=0.0, high=100.0)
    max_exp: float = param(float("inf"), "m", above=0.0)
    min_size: int = param(10, low=2, high=100000)
    thinning_dist: float = param(0.1, "m", above=0.0, high=1.0)
    polygon_dist: float = param(0.5, "m", above=0.0, high=5.0)
    simplification_tolerance: float = param(0.005, "m", low=0.0, high=0.1)
    kind: str = param("auto", choices=("auto", "polygon", "curve"))

    @classmethod
    def paper(cls, **changes) -> "ExtractionParams":
        """Returns the parameters that select Algorithms 1 to 3 with Table 1's values."""
        return cls(mode="paper", **changes)


def extract_border(
    points: np.ndarray,
    params: Optional[ExtractionParams] = None,
    *,
    stamps: Optional[Sequence[float]] = None,
    cameras: Optional[Sequence] = None,
    confidences: Optional[Sequence[float]] = None,
    mobile: Optional[Sequence[bool]] = None,
) -> BorderChain:
    """Extracts the drawn polygonal chain.

    Args:
        points: (N, 2) float [m], map frame, any order. Non-finite ones are left out.
        params: `ExtractionParams()` if None.
        stamps: (N,) [s] when each spot was seen; the paper's mode does not use them.
        cameras: (N,) which camera saw it: names or numbers.
        confidences: (N,) 0 .. 1.
        mobile: (N,) true for a camera on a robot, whose pose is less certain.

    Raises:
        ExtractionError: "no_spots", "too_few_spots", "no_line", "bad_spots", "line_self_intersects" or "too_many_spots".
    """
    params = params or ExtractionParams()
    paper = params.mode == "paper"
    spots = make_observations(points, None if paper else stamps, cameras, confidences, mobile)
    count = int(spots.spots.sum())
    if count == 0:
        raise ExtractionError("no_spots")
    if count < params.min_size:
        raise ExtractionError("too_few_spots", spots=count, needed=params.min_size)
    if paper:
        return _paper(spots, params)
    if stamps is None:
        raise ExtractionError("bad_spots", what="stamps of the points")
    seen = merge_observations(spots)
    places = find_places(seen)
    drawn, left_out, joined = _join_strokes(seen, find_strokes(seen, places, params.eps), params)
    placed = remove_offsets(drawn)
    line = _make_line(drawn, placed, joined, estimate_tremor(placed), params)
    # what is between strokes was not seen; an opening is, unless the pointer was lifted from one end to the other
    began, ended = sorted(drawn.stamps[[0, -1]])
    lifted = not ((began < drawn.stamps) & (drawn.stamps < ended)).any()
    closing = line.gap if joined and (line.closed or lifted) else 0.0
    unseen = max(closing, _longest_unseen(placed, places.dropout))
    return replace(line, unseen=unseen, left_out=left_out.points, left_out_spots=int(left_out.spots.sum()))


def _longest_unseen(drawn: Observations, dropout: float) -> float:
    """Returns the longest way [m] between two observations in a row that are more than a dropout apart."""
    way = np.hypot(*np.diff(drawn.points, axis=0).T)
    return float(way[np.abs(np.diff(drawn.stamps)) > dropout].max(initial=0.0))


def _no_line(seen: Observations, params: ExtractionParams) -> ExtractionError:
    return ExtractionError("no_line", spots=int(seen.spots.sum()), shortest=f"{params.min_exp:g}")


def _paper(seen: Observations, params: ExtractionParams) -> BorderChain:
    """Runs the three stages of Sect. 4.3.2; also decides on closed or open, which the paper does not."""
    cluster = find_cluster(seen.points, params.eps, params.min_pts, params.min_exp, params.max_exp, params.min_size)
    if cluster.size == 0:
        raise _no_line(seen, params)
    thinned = thin_points(seen.points[cluster], params.thinning_dist)
    chain = thinned[generate_polygon(thinned, params.polygon_dist)]
    if len(chain) < 2:
        raise _no_line(seen, params)
    decision = closure.classify_closure(chain, params.kind)
    return _result(chain, decision, {"cluster": seen.points[cluster], "thinned": thinned})


def _join_strokes(
    seen: Observations, strokes: List[np.ndarray], params: ExtractionParams
) -> Tuple[Observations, Observations, bool]:
    """Joins strokes, each the indices of its observations, to one line.

    Returns:
        The observations of the line, in the order in which it runs; those left out; whether the line is of several strokes.
    """
    size = [bounding_diagonal(seen.points[stroke]) for stroke in strokes]
    # what could be a line itself, the widest first: moving back and forth explains much floor, but is no border
    strokes = [
        strokes[k]
        for k in np.argsort(size)[::-1]
        if size[k] > params.min_exp - 2.0 * TREMOR and seen.spots[strokes[k]].sum() >= params.min_size
    ]
    if not strokes:
        raise _no_line(seen, params)
    line, others = strokes[0], strokes[1:]
    while others:
        # which end of another stroke is nearest to which end of the line
        near = [cdist(seen.points[line[[0, -1]]], seen.points[other[[0, -1]]]) for other in others]
        which = int(np.argmin([gaps.min() for gaps in near]))
        if near[which].min() > params.eps + TREMOR:
            break
        at, end = np.unravel_index(int(np.argmin(near[which])), (2, 2))
        # it runs away from the line's end, or up to its beginning
        other = others.pop(which)[:: -1 if at == end else 1]
        line = np.concatenate([line, other] if at else [other, line])
    left_out = np.concatenate([np.zeros(0, dtype=int), *others])
    return seen.select(line), seen.select(left_out), len(others) < len(strokes) - 1


def _make_line(
    drawn: Observations, placed: Observations, joined: bool, tremor: float, params: ExtractionParams
) -> BorderChain:
    """Runs stages 3 to 6: makes the line through the stroke as it was placed."""
    size = bounding_diagonal(placed.points) if len(placed.points) > 2 else 0.0
    if not params.min_exp - 2.0 * tremor < size < params.max_exp:
        raise _no_line(drawn, params)
    stroke = resample_stroke(placed.points, placed.weights, tremor)
    if len(stroke.points) < 2:
        raise _no_line(drawn, params)
    decision = closure.classify_closure(stroke.points, params.kind, tremor)
    if decision.code in closure.CURLED and size < SMALLEST_FIGURE * tremor:
        raise ExtractionError("figure_too_small", size=f"{size:.2f}", needed=f"{SMALLEST_FIGURE * tremor:.2f}")
    if decision.closed:
        kept = slice(decision.first, decision.last + 1)
        # a gap that was crossed unseen may hide a corner; across a wider one that the hand left the line is straight
        ring = ResampledStroke(stroke.points[kept], stroke.trust[kept], tremor)
        line = fit_line(ring, joined or decision.gap <= params.eps)
        if len(line) < 3:
            decision = closure.classify_closure(line)  # a straight line, though a polygon was asked for
    else:
        line = fit_line(stroke, False)
    chain = _simplify(line, decision.closed, params.simplification_tolerance)
    stages = {"cluster": drawn.points, "placed": placed.points, "thinned": stroke.points}
    return _result(chain, decision, stages)


def _simplify(chain: np.ndarray, closed: bool, tolerance: float) -> np.ndarray:
    """Runs stage 6: leaves vertices out, and makes a polygon that does not cross itself.

    Raises:
        ExtractionError: "line_self_intersects" if what it encloses is not connected.
    """
    if not closed or len(chain) < 3:
        return np.asarray(LineString(chain).simplify(tolerance).coords) if len(chain) > 2 else chain
    polygon = Polygon(chain)
    if not polygon.is_valid:
        # all that it encloses, without slips of the hand; the lobes of an 8 meet in a point and are joined by a neck
        pieces = make_valid(polygon).buffer(0.0)
        lobes = [Polygon(piece.exterior) for piece in getattr(pieces, "geoms", [pieces])]
        whole = sum(lobe.area for lobe in lobes)
        neck = 0.2 * TREMOR
        large = unary_union([lobe.buffer(neck, join_style=2) for lobe in lobes if lobe.area >= MAX_SLIP_RATIO * whole])
        polygon = large.buffer(-0.5 * neck, join_style=2)
        if polygon.geom_type != "Polygon" or polygon.is_empty:
            raise ExtractionError("line_self_intersects")
    return np.asarray(Polygon(polygon.exterior).simplify(tolerance).exterior.coords)[:-1]


def _result(chain: np.ndarray, decision: closure.Closure, stages: Dict[str, np.ndarray]) -> BorderChain:
    length = geometry.chain_length(chain, decision.closed)
    return BorderChain(chain, decision.closed, decision.code, length, decision.gap, decision.values, stages=stages)
