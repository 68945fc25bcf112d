"""Extracts one border from the spots of all cameras, treating each stroke as one track through time.

`extract_border` is the list of all stages, each described in its module and in docs/explanation/extraction.md:

    0       observations      the spots, checked, merged where they repeat each other, in order of time; their clusters
    1       strokes           which of them are the pointer's, as strokes, and which strokes make the line
    2       camera_offsets    the line without the errors of the cameras' poses
    3 to 6  polygonal_chain   samples along the line; polygon or separating curve; straight sides; vertices

`ExtractionParams(mode="paper")` runs the paper's algorithms instead (paper_algorithms.py), which need no stamps.
`LiveExtractor` keeps border and seed up to date while a person draws.

>>> import numpy as np
>>> angle = np.linspace(0.0, 2.0 * np.pi, 200)                      # a circle drawn in eight seconds, seen 25 times a second
>>> spots = 2.0 + np.column_stack([np.cos(angle), np.sin(angle)])
>>> chain = extract_border(spots, stamps=0.04 * np.arange(200))
>>> chain.closed, abs(chain.length - 2.0 * np.pi) < 0.2
(True, True)
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field, replace
from typing import Callable, Dict, List, Optional, Sequence

import numpy as np

from vb_core import geometry, sentences
from vb_core.errors import CodedError
from vb_core.parameters import Parameters, param
from vb_fusion.camera_offsets import remove_offsets
from vb_fusion.observations import is_on_floor, observe, require_spots
from vb_fusion.paper_algorithms import find_cluster, generate_polygon, thin_points
from vb_fusion.polygonal_chain import Closure, classify_closure, make_chain
from vb_fusion.seed_point import MIN_SPOTS, Dwell, choose_seed, find_dwells, find_competing_dwell
from vb_fusion.spot_collector import CollectedSpots
from vb_fusion.strokes import find_drawn_line

__all__ = ["BorderChain", "DrawnBorder", "ExtractionParams", "LiveExtractor", "extract_border", "extract_dwells"]


# ------------------------------------------------------------------ one border
@dataclass(frozen=True)
class ExtractionParams(Parameters):
    """Parameters of the extraction, with the names and values of the paper's Table 1 where it lists them."""

    mode: str = param("robust", choices=("robust", "paper"))
    eps: float = param(0.5, "m", above=0.0, high=5.0)
    min_pts: int = param(1, low=1, high=1000)  # paper mode only
    min_exp: float = param(0.3, "m", low=0.0, high=100.0)
    min_size: int = param(10, low=2, high=100000)
    thinning_dist: float = param(0.1, "m", above=0.0, high=1.0)  # paper mode only
    polygon_dist: float = param(0.5, "m", above=0.0, high=5.0)  # paper mode only


@dataclass(frozen=True)
class BorderChain:
    """A polygonal chain P (paper, Sect. 3).

    Attributes:
        points: (M, 2) float64 [m], M >= 2, in order; a closed chain's first point is not repeated.
        closure: whether it is closed, and why.
        left_out: (L, 2) [m] positions of drawn spots that belong to no part of the chain.
        left_out_spots: number of spots at these positions.
        longest_unseen_gap: [m] length of the longest piece of the chain that no camera saw.
    """

    points: np.ndarray
    closure: Closure
    left_out: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)), repr=False, compare=False)
    left_out_spots: int = 0
    longest_unseen_gap: float = 0.0

    @property
    def closed(self) -> bool:
        """Polygon (True) or separating curve (False)."""
        return self.closure.closed

    @property
    def length(self) -> float:
        """Length of the chain [m], with its closing segment if it is closed."""
        return geometry.chain_length(self.points, self.closed)

    @property
    def reason(self) -> str:
        """The English sentence that says why the chain is closed or open."""
        return sentences.translate(self.closure.code, self.closure.values)


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
        stamps: (N,) [s] time at which each spot was seen. Only the paper's mode can do without them.
        cameras: (N,) the camera that saw each spot: names or numbers.
        confidences: (N,) 0 .. 1.
        mobile: (N,) true for a camera on a robot, whose pose is less certain.

    Raises:
        CodedError: "no_spots", "too_few_spots", "no_line", "figure_too_small", "line_self_intersects" or "too_many_spots".
        ValueError: without stamps, except in the paper's mode.
    """
    params = params or ExtractionParams()
    if params.mode == "paper":
        return _extract_as_in_paper(np.asarray(points, dtype=float).reshape(-1, 2), params)
    if stamps is None:
        raise ValueError("only the paper's mode needs no stamps")
    observations, clusters = observe(points, stamps, cameras, confidences, mobile, params.min_size)  # stage 0
    # stage 1
    line, left_out, was_joined = find_drawn_line(observations, clusters, params.eps, params.min_exp, params.min_size)
    line = remove_offsets(line)  # stage 2
    # stages 3 to 6
    vertices, closure, longest_unseen_gap = make_chain(line, was_joined, clusters.dropout_time, params.eps)
    return BorderChain(vertices, closure, left_out.points, int(left_out.spot_counts.sum()), longest_unseen_gap)


def _extract_as_in_paper(points: np.ndarray, params: ExtractionParams) -> BorderChain:
    """Runs Algorithms 1 to 3 of the paper on points (N, 2) [m]."""
    points = points[is_on_floor(points)]
    require_spots(len(points), params.min_size)
    chain = points[find_cluster(points, params.eps, params.min_pts, params.min_exp, params.min_size)]
    if len(chain):
        thinned = thin_points(chain, params.thinning_dist)
        chain = thinned[generate_polygon(thinned, params.polygon_dist)]
    if len(chain) < 2:
        raise CodedError("no_line", spots=len(points), shortest=f"{params.min_exp:g}")
    return BorderChain(chain, classify_closure(chain))


def extract_dwells(
    points: np.ndarray,
    *,
    stamps: Sequence[float],
    cameras: Optional[Sequence] = None,
    confidences: Optional[Sequence[float]] = None,
    mobile: Optional[Sequence[bool]] = None,
    border_points: Sequence[Sequence[float]] = (),
) -> List[Dwell]:
    """Extracts the places where the pointer dwelt, in the order in which it left them. There is at least one.

    Args:
        points, stamps, cameras, confidences, mobile: as for `extract_border`.
        border_points: (K, 2) [m] spots seen before the seed was requested, the border's.

    Raises:
        CodedError: "no_spots" or "no_seed".
    """
    observations, clusters = observe(points, stamps, cameras, confidences, mobile, MIN_SPOTS, "no_seed")
    return find_dwells(observations, clusters, border_points)


# ------------------------------------------------------------------ border and seed while a person draws
@dataclass(frozen=True)
class DrawnBorder:
    """The chain and the seed of one interaction, or for each the error that says why it is missing."""

    chain: Optional[BorderChain] = None
    dwells: Sequence[Dwell] = ()
    chain_error: Optional[CodedError] = None
    seed_error: Optional[CodedError] = None

    @property
    def seed(self) -> Optional[np.ndarray]:
        """The position (2,) [m] of the dwell that `choose_seed` takes for the seed point."""
        return choose_seed(self.dwells).point if self.dwells else None

    @property
    def competing_dwell(self) -> Optional[Dwell]:
        """Another place where the pointer dwelt, longer or later, which may have been meant as the seed."""
        return find_competing_dwell(self.dwells) if self.dwells else None


class LiveExtractor:
    """Repeats the extraction on all spots of an interaction when there are new ones, using at most a share of one core.

    The longer a drawing lasts, the longer one extraction takes, and the less often it is repeated.

    Args:
        params: parameters of the extraction.
        share: share of one core that live extraction may take.
    """

    def __init__(self, params: ExtractionParams, share: float) -> None:
        self._params = params
        self._share = share
        self._lock = threading.Lock()
        self._next_extraction_at = 0.0
        self._totals = (-1, -1)  # numbers of border and seed spots at the last extraction
        self.drawn = DrawnBorder()

    def update(self, snapshot: CollectedSpots, clock: Callable[[], float], force: bool = False) -> DrawnBorder:
        """Returns the border so far, extracted again if there are new spots and it is due. Thread safe.

        Args:
            clock: reads a monotonic clock [s].
            force: whether it is due regardless of what the last extraction cost.
        """
        with self._lock:
            totals = snapshot.counts[:2]
            if totals != self._totals and (force or clock() >= self._next_extraction_at):
                started = clock()
                try:
                    self._extract(snapshot)
                    self._totals = totals
                finally:  # a failed attempt costs as much as any
                    finished = clock()
                    self._next_extraction_at = finished + (finished - started) * (1.0 / self._share - 1.0)
            return self.drawn

    def _extract(self, snapshot: CollectedSpots) -> None:
        drawn = self.drawn
        border_total, seed_total, _ = snapshot.counts
        last_border_total, last_seed_total = self._totals
        if border_total != last_border_total:
            try:
                chain = extract_border(params=self._params, **_columns(snapshot.border))
                drawn = replace(drawn, chain=chain, chain_error=None)
            except CodedError as error:
                drawn = replace(drawn, chain=None, chain_error=error)
        if seed_total != last_seed_total:
            try:
                dwells = extract_dwells(border_points=snapshot.border["points"], **_columns(snapshot.seed))
                drawn = replace(drawn, dwells=dwells, seed_error=None)
            except CodedError as error:
                drawn = replace(drawn, dwells=(), seed_error=error)
        self.drawn = drawn


def _columns(spots: np.ndarray) -> Dict[str, np.ndarray]:
    """Returns the columns of spots (K,) of the type SPOT, which are named like the arguments of `extract_border`."""
    return {name: spots[name] for name in spots.dtype.names}
