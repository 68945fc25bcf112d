"""Extracts one border from the spots of all cameras, treating each stroke as one track through time.

Stages: `observations` (0, 2), `track` (1), `line` (3 to 5) and here (6); docs/explanation/extraction.md describes each.
`ExtractionParams(mode="paper")` runs the paper's algorithms (paper.py), which need no stamps.

>>> import numpy as np
>>> angle = np.linspace(0.0, 2.0 * np.pi, 200)                      # a circle drawn in eight seconds, seen 25 times a second
>>> spots = 2.0 + np.column_stack([np.cos(angle), np.sin(angle)])
>>> chain = extract_border(spots, stamps=0.04 * np.arange(200))
>>> chain.closed, abs(chain.length - 2.0 * np.pi) < 0.2
(True, True)
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np
from scipy.spatial.distance import cdist
from shapely.geometry import LineString, Polygon
from shapely.ops import unary_union
from shapely.validation import make_valid

from vb_core import geometry, sentences
from vb_core.parameters import Parameters, param
from vb_core.errors import CodedError
from vb_fusion.line import NEARLY_CLOSED, Closure, ResampledStroke, classify_closure, fit_line, resample_stroke
from vb_fusion.observations import (
    TREMOR,
    Observations,
    estimate_tremor,
    find_dropout,
    make_observations,
    merge_observations,
    remove_offsets,
)
from vb_fusion.paper import run_algorithms
from vb_fusion.seed import extract_seed
from vb_fusion.track import find_clusters, find_strokes

__all__ = ["BorderChain", "ExtractionParams", "extract_border", "extract_seed"]

MIN_DETAIL = 0.005  # [m] vertices whose loss moves the chain by less are dropped; a map cell is ten times as large
MIN_FIGURE_SIZE = 8.0  # tremors across; a smaller line that curls could be open or closed
MAX_SLIP_RATIO = 0.02  # of the area that a self-crossing line encloses; smaller loops are slips of the hand


@dataclass(frozen=True)
class ExtractionParams(Parameters):
    """Parameters of the extraction, with the names and values of the paper's Table 1 where it lists them."""

    mode: str = param("robust", choices=("robust", "paper"))
    eps: float = param(0.5, "m", above=0.0, high=5.0)
    min_pts: int = param(1, low=1, high=1000)
    min_exp: float = param(0.3, "m", low=0.0, high=100.0)
    min_size: int = param(10, low=2, high=100000)
    thinning_dist: float = param(0.1, "m", above=0.0, high=1.0)
    polygon_dist: float = param(0.5, "m", above=0.0, high=5.0)


@dataclass(frozen=True)
class BorderChain:
    """A polygonal chain P (paper, Sect. 3).

    Attributes:
        points: (M, 2) float64 [m], M >= 2, in order; a closed chain's first point is not repeated.
        closed: polygon (True) or separating curve (False).
        code, values: of the sentence that says why it is closed or open.
        length: [m] of the chain, with its closing segment if it is closed.
        gap: [m] between the ends where the drawing left them.
        left_out: (L, 2) [m] positions of drawn spots that belong to no part of the chain.
        left_out_spots: number of spots at these positions.
        unseen: [m] length of the longest piece of the chain that no camera saw.
    """

    points: np.ndarray
    closed: bool
    code: str = ""
    length: float = 0.0
    gap: float = 0.0
    values: Dict[str, str] = field(default_factory=dict)
    left_out: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)), repr=False, compare=False)
    left_out_spots: int = 0
    unseen: float = 0.0

    @property
    def reason(self) -> str:
        """The English sentence that says why the chain is closed or open."""
        return sentences.translate(self.code, self.values) if self.code else ""


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
        points: (N, 2) float [m], map frame, any order. Non-finite points are left out.
        params: `ExtractionParams()` if None.
        stamps: (N,) [s] when each spot was seen; the paper's mode does not use them.
        cameras: (N,) the camera that saw each spot: names or numbers.
        confidences: (N,) 0 .. 1.
        mobile: (N,) true for a camera on a robot, whose pose is less certain.

    Raises:
        CodedError: "no_spots", "too_few_spots", "no_line", "figure_too_small", "line_self_intersects" or "too_many_spots".
    """
    params = params or ExtractionParams()
    paper = params.mode == "paper"
    spots = make_observations(points, None if paper else stamps, cameras, confidences, mobile)
    count = int(spots.spots.sum())
    if count == 0:
        raise CodedError("no_spots")
    if count < params.min_size:
        raise CodedError("too_few_spots", spots=count, needed=params.min_size)
    if paper:
        line = run_algorithms(spots.points, params)
        return _make_chain(line, classify_closure(line))
    if stamps is None:
        raise ValueError("only the paper's mode needs no stamps")
    seen = merge_observations(spots)
    clusters = find_clusters(seen)
    strokes, ends = find_strokes(seen, clusters, params.eps)
    line, others, joined = _join_strokes(seen, strokes, params)
    others = np.setdiff1d(np.concatenate([others, *ends]), line)
    placed = remove_offsets(seen.select(line))
    chain = _make_line(placed, joined, params)
    return replace(
        chain,
        unseen=_longest_unseen_gap(placed, chain, joined, find_dropout(clusters.stamps)),
        left_out=seen.points[others],
        left_out_spots=int(seen.spots[others].sum()),
    )


def _longest_unseen_gap(stroke: Observations, chain: BorderChain, joined: bool, dropout: float) -> float:
    """Returns the longest stretch [m] of the chain that no camera saw.

    The opening between start and end counts only if several strokes were joined and either the chain is closed or
    nothing was seen between the times of its two ends.
    """
    began, ended = sorted(stroke.stamps[[0, -1]])
    lifted = not ((began < stroke.stamps) & (stroke.stamps < ended)).any()
    opening = chain.gap if joined and (chain.closed or lifted) else 0.0
    steps = np.hypot(*np.diff(stroke.points, axis=0).T)
    return float(steps[np.abs(np.diff(stroke.stamps)) > dropout].max(initial=opening))


def _join_strokes(
    seen: Observations, strokes: List[np.ndarray], params: ExtractionParams
) -> Tuple[np.ndarray, np.ndarray, bool]:
    """Joins strokes, each given as the indices of its observations, into one line.

    Returns:
        The indices of the line's observations, in the order in which it runs; those of the strokes left out; whether
        several strokes were joined.
    """
    # strokes that could be a line alone, widest first: moving back and forth explains much floor, but is not a border
    wide = [(geometry.bounding_diagonal(seen.points[stroke]), stroke) for stroke in strokes]
    wide = [(size, stroke) for size, stroke in wide if size > params.min_exp - 2.0 * TREMOR]
    wide = [(size, stroke) for size, stroke in wide if seen.spots[stroke].sum() >= params.min_size]
    others = [stroke for _, stroke in sorted(wide, key=lambda one: -one[0])]
    if not others:
        raise CodedError("no_line", spots=int(seen.spots.sum()), shortest=f"{params.min_exp:g}")
    line, joined = others.pop(0), False
    while others:
        # the nearest pair of an end of the line and an end of another stroke
        near = np.array([cdist(seen.points[line[[0, -1]]], seen.points[other[[0, -1]]]) for other in others])
        which, at, end = np.unravel_index(int(np.argmin(near)), near.shape)
        if near[which, at, end] > params.eps + TREMOR:
            break
        # the stroke must run away from the line's end, or up to its start
        other, joined = others.pop(which)[:: -1 if at == end else 1], True
        line = np.concatenate([line, other] if at else [other, line])
    return line, np.concatenate([np.zeros(0, dtype=int), *others]), joined


def _make_line(placed: Observations, joined: bool, params: ExtractionParams) -> BorderChain:
    """Runs stages 3 to 6: makes the chain from observations whose camera offsets were removed."""
    tremor, size = estimate_tremor(placed), geometry.bounding_diagonal(placed.points)
    stroke = resample_stroke(placed.points, placed.weights, tremor)
    closure = classify_closure(stroke.points, tremor)
    if closure.code in NEARLY_CLOSED and size < MIN_FIGURE_SIZE * tremor:
        raise CodedError("figure_too_small", size=f"{size:.2f}", needed=f"{MIN_FIGURE_SIZE * tremor:.2f}")
    within = slice(closure.first, closure.last + 1)
    trimmed = ResampledStroke(stroke.points[within], stroke.trust[within], tremor)
    # a gap that was crossed unseen may hide a corner; a wider one, left by the hand, is closed by a straight side
    line = fit_line(trimmed, closure.closed and (joined or closure.gap <= params.eps))
    if len(line) < 3:
        closure = classify_closure(line)
    return _make_chain(_simplify(line, closure.closed), closure)


def _make_chain(chain: np.ndarray, closure: Closure) -> BorderChain:
    length = geometry.chain_length(chain, closure.closed)
    return BorderChain(chain, closure.closed, closure.code, length, closure.gap, closure.values)


def _simplify(chain: np.ndarray, closed: bool) -> np.ndarray:
    """Runs stage 6: drops vertices, and makes a closed chain a polygon that does not cross itself.

    Raises:
        CodedError: "line_self_intersects" if the enclosed area is not connected.
    """
    if not closed or len(chain) < 3:
        return np.asarray(LineString(chain).simplify(MIN_DETAIL).coords) if len(chain) > 2 else chain
    polygon = Polygon(chain)
    if not polygon.is_valid:
        # the whole enclosed area without slips of the hand; the lobes of an 8 meet in a point, so a neck joins them
        pieces = make_valid(polygon).buffer(0.0)
        lobes = [Polygon(piece.exterior) for piece in getattr(pieces, "geoms", [pieces])]
        whole = sum(lobe.area for lobe in lobes)
        neck = 0.2 * TREMOR
        large = unary_union([lobe.buffer(neck, join_style=2) for lobe in lobes if lobe.area >= MAX_SLIP_RATIO * whole])
        polygon = large.buffer(-0.5 * neck, join_style=2)
        if polygon.geom_type != "Polygon" or polygon.is_empty:
            raise CodedError("line_self_intersects")
    return np.asarray(Polygon(polygon.exterior).simplify(MIN_DETAIL).exterior.coords)[:-1]
