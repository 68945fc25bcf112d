"""From the spots of all cameras to one border. The idea: one stroke is one track through time.

`ExtractionParams.robust()`, the default, in the order of the data, one module for each stage:

    stroke/observations   the spots, checked and put in the order of time
    stroke/track          which of them are the pointer's: the one feasible path through time that explains most floor
    stroke/placement      where the pointer really was: the cameras' offsets removed
    line/stations         evenly along the stroke, however long the pointer stayed
    line/closure          polygon or separating curve
    line/sides            the fewest straight sides that keep every detail larger than a tremble, and their corners

A drawing that grows is extracted again for the price of what is new (memory.py): `GrowingBorder`.

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
from vb_fusion.chain import BorderChain, ExtractionError
from vb_fusion.line import closure
from vb_fusion.line.sides import fit_line
from vb_fusion.line.stations import Stroke, make_stroke
from vb_fusion.memory import Memory
from vb_fusion.paper import clustering, expansion, generate_poly, thinning
from vb_fusion.stroke.observations import TREMBLE, Sights, check, condense, moments
from vb_fusion.stroke.ordering import in_order
from vb_fusion.stroke.placement import without_offsets
from vb_fusion.stroke.seed import extract_seed
from vb_fusion.stroke.track import Track, find_places, find_tracks

__all__ = ["BorderChain", "ExtractionError", "ExtractionParams", "extract_border", "extract_seed"]

SLIP = 0.02  # of the area that a crossing line encloses: smaller loops are slips of the hand


@dataclass(frozen=True)
class ExtractionParams(Parameters):
    """Parameters of the extraction; names and values of the paper's Table 1 where it has them."""

    mode: str = param("robust", choices=("robust", "paper"))
    eps: float = param(0.5, "m", above=0.0, high=5.0, doc="clustering: distance of neighbours; robust: widest gap")
    min_pts: int = param(1, low=1, high=1000, doc="clustering: neighbours of a core point; paper mode only")
    min_exp: float = param(0.3, "m", low=0.0, high=100.0, doc="shortest border, as diagonal of its bounding box")
    max_exp: float = param(float("inf"), "m", above=0.0, doc="longest border, likewise")
    min_size: int = param(10, low=2, high=100000, doc="fewest points of a border")
    thinning_dist: float = param(0.1, "m", above=0.0, high=1.0, doc="thinning: maxNeighborDist; paper mode only")
    polygon_dist: float = param(0.5, "m", above=0.0, high=5.0, doc="polygon generation: maxNeighborDist; paper only")
    tolerance: float = param(0.005, "m", low=0.0, high=0.1, doc="vertices that change less are left out; robust only")
    kind: str = param("decide", choices=("decide", "polygon", "curve"), doc="overrides the rule of line/closure.py")

    @classmethod
    def paper(cls, **changes) -> "ExtractionParams":
        """Algorithms 1 to 3 with Table 1's values."""
        return cls(mode="paper", **changes)

    @classmethod
    def robust(cls, **changes) -> "ExtractionParams":
        """The default."""
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
        ExtractionError: "no_spots", "too_few_spots", "no_line", "bad_points", "crosses_itself" or "too_many_spots".
    """
    params = params or ExtractionParams.robust()
    if params.mode == "robust" and stamps is not None:
        drawing = GrowingBorder(params)
        drawing.add(check(points, stamps, cameras, confidences, mobile))
        return drawing.chain()
    seen = check(points, None, cameras, confidences, mobile)
    _require(seen, params)
    if params.mode == "paper":
        return _paper(seen, params)
    drawn = seen.select(in_order(seen.points, params.eps))
    return _line(drawn, drawn, seen.select(slice(0)), params, Memory(), Memory())


class GrowingBorder:
    """The border of a drawing that goes on: what was extracted before is not extracted again.

    The chain is the one that `extract_border` finds in all spots at once.
    """

    def __init__(self, params: ExtractionParams) -> None:
        self._params = params
        self._sights = check(np.zeros((0, 2)))
        self._places = find_places(self._sights)
        self._steps, self._stations, self._sides = Memory(), Memory(), Memory()

    def add(self, spots: Sights) -> None:
        """Adds spots as `check` gives them, with stamps since the same beginning, and with numbers for cameras."""
        if len(spots.points) == 0:
            return
        # moments that are over stay as they are; from the first that gets a spot on they are looked at again
        begin = moments(spots.stamps).min()
        kept = int(np.searchsorted(moments(self._sights.stamps), begin))
        recent = condense(self._sights.select(slice(kept, None)).followed_by(spots))
        self._sights = self._sights.select(slice(kept)).followed_by(recent)
        self._places = self._places.until(begin).followed_by(find_places(recent))

    def chain(self) -> BorderChain:
        """The border of all spots so far.

        Raises:
            ExtractionError: as extract_border.
        """
        seen, params = self._sights, self._params
        _require(seen, params)
        # a quick stroke across a doorway is seen seldom, but unlike something bright that stays it is long
        tracks = find_tracks(seen, self._places, params.eps, 0.25 * params.min_exp, self._steps)
        drawn, left_out = _joined(seen, tracks, params)
        return _line(drawn, without_offsets(drawn), left_out, params, self._stations, self._sides)


def _require(seen: Sights, params: ExtractionParams) -> None:
    count = int(seen.spots.sum())
    if count == 0:
        raise ExtractionError("no_spots")
    if count < params.min_size:
        raise ExtractionError("too_few_spots", spots=count, needed=params.min_size)


def _no_line(seen: Sights, params: ExtractionParams) -> ExtractionError:
    return ExtractionError("no_line", spots=int(seen.spots.sum()), shortest=f"{params.min_exp:g}")


def _paper(seen: Sights, params: ExtractionParams) -> BorderChain:
    """Sect. 4.3.2, the three stages in turn; it also decides on closed or open, which the paper does not."""
    cluster = clustering(seen.points, params.eps, params.min_pts, params.min_exp, params.max_exp, params.min_size)
    if cluster.size == 0:
        raise _no_line(seen, params)
    thinned = thinning(seen.points[cluster], params.thinning_dist)
    chain = thinned[generate_poly(thinned, params.polygon_dist)]
    if len(chain) < 2:
        raise _no_line(seen, params)
    decision = closure.decide(chain, params.kind)
    return _result(chain, decision, np.zeros((0, 2)), 0, {"cluster": seen.points[cluster], "thinned": thinned})


def _joined(seen: Sights, tracks: List[Track], params: ExtractionParams) -> Tuple[Sights, Sights]:
    """The sights of the stroke, in the order in which the line runs, and those of strokes that do not go on from it."""
    # the widest is the line: going to and fro explains much, but makes no border
    tracks = sorted(tracks, key=lambda track: expansion(track.points), reverse=True)
    if not tracks or expansion(tracks[0].points) <= 0.8 * params.min_exp:
        raise _no_line(seen, params)
    line = tracks[0].sights
    others = [
        track.sights
        for track in tracks[1:]
        if track.gain > params.min_exp and seen.spots[track.sights].sum() >= params.min_size
    ]
    while others:
        # which end of another stroke is nearest to which end of the line
        near = [cdist(seen.points[line[[0, -1]]], seen.points[other[[0, -1]]]) for other in others]
        which = int(np.argmin([gaps.min() for gaps in near]))
        if near[which].min() > params.eps + TREMBLE:
            break
        at, end = np.unravel_index(int(np.argmin(near[which])), (2, 2))
        # it runs away from the line's end, or up to its beginning
        other = others.pop(which)[:: -1 if at == end else 1]
        line = np.concatenate([line, other] if at else [other, line])
    left_out = np.concatenate([np.zeros(0, dtype=int), *others])
    return seen.select(line), seen.select(left_out)


def _line(
    drawn: Sights, placed: Sights, left_out: Sights, params: ExtractionParams, stations: Memory, sides: Memory
) -> BorderChain:
    """Stages 3 to 6: the line through the stroke as it was placed."""
    if len(placed.points) < 3 or not 0.8 * params.min_exp < expansion(placed.points) < params.max_exp:
        raise _no_line(drawn, params)
    stroke = make_stroke(placed.points, placed.weights, stations)
    if len(stroke.points) < 2:
        raise _no_line(drawn, params)
    decision = closure.decide(stroke.points, params.kind)
    if decision.closed:
        kept = slice(decision.first, decision.last + 1)
        # a gap that may have been crossed unseen may hide a corner; across a wider one the line is straight
        line = fit_line(Stroke(stroke.points[kept], stroke.trust[kept]), decision.gap <= params.eps, sides)
        if len(line) < 3:
            decision = closure.decide(line)  # a straight line, though a polygon was asked for
    else:
        line = fit_line(stroke, False, sides)
    chain = _simplified(line, decision.closed, params.tolerance)
    stages = {"cluster": drawn.points, "placed": placed.points, "thinned": stroke.points}
    return _result(chain, decision, left_out.points, int(left_out.spots.sum()), stages)


def _simplified(chain: np.ndarray, closed: bool, tolerance: float) -> np.ndarray:
    """Stage 6: fewer vertices, and a polygon that does not cross itself.

    Raises:
        ExtractionError: "crosses_itself" if what it encloses is not connected.
    """
    if not closed or len(chain) < 3:
        return np.asarray(LineString(chain).simplify(tolerance).coords) if len(chain) > 2 else chain
    polygon = Polygon(chain)
    if not polygon.is_valid:
        # all that it encloses, without slips of the hand; the lobes of an 8 meet in a point and are joined by a neck
        pieces = make_valid(polygon).buffer(0.0)
        lobes = [Polygon(piece.exterior) for piece in getattr(pieces, "geoms", [pieces])]
        whole = sum(lobe.area for lobe in lobes)
        neck = 0.2 * TREMBLE
        large = unary_union([lobe.buffer(neck, join_style=2) for lobe in lobes if lobe.area >= SLIP * whole])
        polygon = large.buffer(-0.5 * neck, join_style=2)
        if polygon.geom_type != "Polygon" or polygon.is_empty:
            raise ExtractionError("crosses_itself")
    return np.asarray(Polygon(polygon.exterior).simplify(tolerance).exterior.coords)[:-1]


def _result(chain: np.ndarray, decision: closure.Closing, left_out: np.ndarray, spots: int, stages) -> BorderChain:
    length = geometry.chain_length(chain, decision.closed)
    return BorderChain(
        chain, decision.closed, decision.code, length, decision.gap, decision.values, left_out, spots, stages
    )
