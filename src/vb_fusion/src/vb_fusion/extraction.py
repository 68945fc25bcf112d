"""From the spots of all cameras to one border. The idea: one stroke is one track through time.

Use it for places on a floor, with the time at which they were seen, that somebody drew in one stroke: with gaps, strays
and rests, from one camera or several.

`ExtractionParams.robust()`, the default, in the order of the data, one module for each stage:

    stroke/observations    the spots, checked and put in the order of time
    stroke/track           which of them are the pointer's: the one feasible path through time that explains most floor
    stroke/camera_offsets  where the pointer really was: the cameras' offsets removed
    line/resampling        evenly along the stroke, however long the pointer stayed
    line/closure           polygon or separating curve
    line/fitting           the fewest straight sides that keep every detail larger than a tremble, and their corners

A drawing that grows is extracted again for the price of what is new (resumable_loop.py): `GrowingBorder`.

Bare points, without stamps, get an order in space first (stroke/ordering.py); all that follows is the same.
`ExtractionParams.paper()` runs Algorithms 1 to 3 of the paper as they are written (paper.py).

>>> import numpy as np
>>> angle = np.linspace(0.0, 2.0 * np.pi, 200)                      # a circle drawn in eight seconds, seen 25 times a second
>>> spots = 2.0 + np.column_stack([np.cos(angle), np.sin(angle)])
>>> chain = extract_border(spots, stamps=0.04 * np.arange(200))
>>> chain.closed, abs(chain.length - 2.0 * np.pi) < 0.2
(True, True)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Optional, Sequence, Tuple

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
from vb_fusion.resumable_loop import ResumableLoop
from vb_fusion.paper import bounding_diagonal, find_cluster, generate_polygon, thin_points
from vb_fusion.stroke.observations import TREMOR, Observations, make_observations, merge_observations, time_bins
from vb_fusion.stroke.ordering import order_points
from vb_fusion.stroke.camera_offsets import remove_offsets
from vb_fusion.stroke.seed import extract_seed
from vb_fusion.stroke.track import PointerTrack, find_places, find_tracks

__all__ = ["BorderChain", "ExtractionError", "ExtractionParams", "extract_border", "extract_seed"]

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

    @classmethod
    def robust(cls, **changes) -> "ExtractionParams":
        """Returns the default parameters, which select extraction by time."""
        return cls(mode="robust", **changes)


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
        params: `ExtractionParams.robust()` if None.
        stamps: (N,) [s] when each spot was seen. Robust mode is meant for them; without, the order is found in space.
        cameras: (N,) which camera saw it: names or numbers.
        confidences: (N,) 0 .. 1.
        mobile: (N,) true for a camera on a robot, whose pose is less certain.

    Raises:
        ExtractionError: "no_spots", "too_few_spots", "no_line", "bad_points", "line_self_intersects" or "too_many_spots".
    """
    params = params or ExtractionParams.robust()
    if params.mode == "robust" and stamps is not None:
        drawing = GrowingBorder(params)
        drawing.add(make_observations(points, stamps, cameras, confidences, mobile))
        return drawing.chain()
    seen = make_observations(points, None, cameras, confidences, mobile)
    _require(seen, params)
    if params.mode == "paper":
        return _paper(seen, params)
    drawn = seen.select(order_points(seen.points, params.eps))
    return _make_line(drawn, drawn, seen.select(slice(0)), params, ResumableLoop(), ResumableLoop())


class GrowingBorder:
    """Extracts the border of a drawing in progress, incrementally.

    The chain is the one that `extract_border` finds in all spots at once.
    """

    def __init__(self, params: ExtractionParams) -> None:
        self._params = params
        self._observations = make_observations(np.zeros((0, 2)))
        self._places = find_places(self._observations)
        self._steps, self._samples, self._sides = ResumableLoop(), ResumableLoop(), ResumableLoop()

    def add(self, spots: Observations) -> None:
        """Adds spots.

        Args:
            spots: as `make_observations` returns them, with stamps since the same beginning and numbers for cameras.
        """
        if len(spots.points) == 0:
            return
        # moments that are over stay as they are; from the first that gets a spot on they are looked at again
        begin = time_bins(spots.stamps).min()
        kept = int(np.searchsorted(time_bins(self._observations.stamps), begin))
        recent = merge_observations(self._observations.select(slice(kept, None)).concatenate(spots))
        self._observations = self._observations.select(slice(kept)).concatenate(recent)
        self._places = self._places.before(begin).concatenate(find_places(recent))

    def chain(self) -> BorderChain:
        """Extracts the border of all spots so far.

        Raises:
            ExtractionError: as extract_border.
        """
        seen, params = self._observations, self._params
        _require(seen, params)
        # a quick stroke across a doorway is seen seldom, but unlike something bright that stays it is long
        tracks = find_tracks(seen, self._places, params.eps, 0.25 * params.min_exp, self._steps)
        drawn, left_out = _join_tracks(seen, tracks, params)
        return _make_line(drawn, remove_offsets(drawn), left_out, params, self._samples, self._sides)


def _require(seen: Observations, params: ExtractionParams) -> None:
    count = int(seen.spots.sum())
    if count == 0:
        raise ExtractionError("no_spots")
    if count < params.min_size:
        raise ExtractionError("too_few_spots", spots=count, needed=params.min_size)


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
    return _result(chain, decision, np.zeros((0, 2)), 0, {"cluster": seen.points[cluster], "thinned": thinned})


def _join_tracks(
    seen: Observations, tracks: List[PointerTrack], params: ExtractionParams
) -> Tuple[Observations, Observations]:
    """Joins tracks to one stroke.

    Returns:
        The observations of the stroke, in the order in which the line runs, and the observations left out.
    """
    # the widest is the line: moving back and forth explains much floor, but is no border
    tracks = sorted(tracks, key=lambda track: bounding_diagonal(track.points), reverse=True)
    if not tracks or bounding_diagonal(tracks[0].points) <= 0.8 * params.min_exp:
        raise _no_line(seen, params)
    line = tracks[0].observations
    others = [
        track.observations
        for track in tracks[1:]
        if track.gain > params.min_exp and seen.spots[track.observations].sum() >= params.min_size
    ]
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
    return seen.select(line), seen.select(left_out)


def _make_line(
    drawn: Observations,
    placed: Observations,
    left_out: Observations,
    params: ExtractionParams,
    samples: ResumableLoop,
    sides: ResumableLoop,
) -> BorderChain:
    """Runs stages 3 to 6: makes the line through the stroke as it was placed."""
    if len(placed.points) < 3 or not 0.8 * params.min_exp < bounding_diagonal(placed.points) < params.max_exp:
        raise _no_line(drawn, params)
    stroke = resample_stroke(placed.points, placed.weights, samples)
    if len(stroke.points) < 2:
        raise _no_line(drawn, params)
    decision = closure.classify_closure(stroke.points, params.kind)
    if decision.closed:
        kept = slice(decision.first, decision.last + 1)
        # a gap that may have been crossed unseen may hide a corner; across a wider one the line is straight
        line = fit_line(ResampledStroke(stroke.points[kept], stroke.trust[kept]), decision.gap <= params.eps, sides)
        if len(line) < 3:
            decision = closure.classify_closure(line)  # a straight line, though a polygon was asked for
    else:
        line = fit_line(stroke, False, sides)
    chain = _simplify(line, decision.closed, params.simplification_tolerance)
    stages = {"cluster": drawn.points, "placed": placed.points, "thinned": stroke.points}
    return _result(chain, decision, left_out.points, int(left_out.spots.sum()), stages)


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


def _result(chain: np.ndarray, decision: closure.Closure, left_out: np.ndarray, spots: int, stages) -> BorderChain:
    length = geometry.chain_length(chain, decision.closed)
    return BorderChain(
        chain, decision.closed, decision.code, length, decision.gap, decision.values, left_out, spots, stages
    )
