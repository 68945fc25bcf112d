"""From many observations to one border: the point set of all cameras becomes a polygonal chain.

`ExtractionParams.paper()` runs Algorithms 1 to 3 of the paper as they are written, with the values of its Table 1.
`ExtractionParams.robust()`, the default, keeps Algorithm 1's purpose and parameters and replaces the greedy parts:
supported points only (ridge.py), one path through them (linking.py), fitted to the points again (smoothing.py).
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Sequence

import numpy as np
from shapely.geometry import LineString, Polygon

from vb_core import geometry
from vb_core.parameters import Parameters, param
from vb_fusion import closing, linking, ridge, smoothing
from vb_fusion.chain import BorderChain, ExtractionError
from vb_fusion.clustering import clustering, expansion
from vb_fusion.fixed_places import evened, without_fixed_places
from vb_fusion.observations import Observations, observations, without_bias, without_strays
from vb_fusion.polygon_generation import generate_poly
from vb_fusion.seed import extract_seed
from vb_fusion.thinning import thinning

__all__ = ["BorderChain", "ExtractionError", "ExtractionParams", "extract_border", "extract_seed"]


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
    bandwidth: float = param(smoothing.BANDWIDTH, "m", above=0.0, high=0.5, doc="local fit along the chain")
    tolerance: float = param(0.005, "m", low=0.0, high=0.1, doc="vertices that change less are left out; robust only")
    kind: str = param("decide", choices=("decide", "polygon", "curve"), doc="overrides the rule of closing.py")

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
) -> BorderChain:
    """The polygonal chain that was drawn.

    Args:
        points: (N, 2) float [m], map frame, any order. What is not finite is left out.
        params: `ExtractionParams.robust()` if None.
        stamps: (N,) [s] when each spot was seen; robust mode uses it, as the next two, if it is there.
        cameras: (N,) which camera saw it: names or numbers.
        confidences: (N,) 0 .. 1.

    Raises:
        ExtractionError: "no_spots", "too_few_spots", "no_line" or "bad_points", with a sentence.
    """
    params = params or ExtractionParams.robust()
    seen = observations(points, stamps, cameras, confidences)
    count = len(seen.points)
    if count == 0:
        raise ExtractionError("no_spots", "no spot was seen: point the laser at the floor and draw the border")
    if count < params.min_size:
        raise ExtractionError(
            "too_few_spots", f"{count} spot{'s were' if count > 1 else ' was'} seen, a border needs {params.min_size}"
        )
    if not expansion(seen.points) > params.min_exp:
        raise _no_line(count, params)
    return _paper(seen, params) if params.mode == "paper" else _robust(seen, params)


def _no_line(count: int, params: ExtractionParams) -> ExtractionError:
    limit = f"longer than {params.min_exp:g} m"
    if np.isfinite(params.max_exp):
        limit += f" and shorter than {params.max_exp:g} m"
    return ExtractionError("no_line", f"{count} spots seen, but none form a line {limit}")


def _paper(seen: Observations, params: ExtractionParams) -> BorderChain:
    """Sect. 4.3.2, the three stages one after the other."""
    cluster = clustering(seen.points, params.eps, params.min_pts, params.min_exp, params.max_exp, params.min_size)
    if cluster.size == 0:
        raise _no_line(len(seen.points), params)
    thinned = thinning(seen.points[cluster], params.thinning_dist)
    chain = thinned[generate_poly(thinned, params.polygon_dist)]
    if len(chain) < 2:
        raise _no_line(len(seen.points), params)
    decision = closing.decide(chain, params.kind)
    # the rule decides, but the chain stays as the paper makes it
    return _result(chain, decision, {"cluster": seen.points[cluster], "thinned": thinned})


def _robust(seen: Observations, params: ExtractionParams) -> BorderChain:
    count = len(seen.points)
    seen = without_bias(evened(without_fixed_places(without_strays(seen))))
    sites = ridge.merge(seen.points, seen.weights)
    everything, path = sites, None
    # a bright thing that is seen for long may be denser by far than a quick stroke: then ask for less
    for share in (0.1, 0.02):
        sites = everything.select(ridge.supported(everything, params.eps, share)[0])
        if len(sites.points):
            path = _best_path(sites, _site_ranks(seen, sites), params)
        if path is not None:
            break
    if path is None:
        raise _no_line(count, params)
    raw = path.nodes
    # what lies beside the path and was not found to belong to it must not draw it there
    of_path = np.zeros(len(sites.points), dtype=bool)
    of_path[path.sites] = True
    sites = sites.select(of_path)
    if path.ranks is not None and path.ranks[-(len(raw) // 3 or 1) :].mean() < path.ranks[: len(raw) // 3 or 1].mean():
        raw = raw[::-1]
    # a first fit takes the nodes' raggedness out: the ends' directions decide on closed or open
    calm = smoothing.fit(raw, sites.points, sites.weights, False, params.bandwidth)
    decision = closing.decide(calm, params.kind)
    fitted = smoothing.fit(decision.points, sites.points, sites.weights, decision.closed, params.bandwidth)
    fitted = smoothing.corners_in_gaps(fitted, sites.points, decision.closed)
    chain = _simplified(smoothing.sharpen_corners(fitted, decision.closed), decision.closed, params.tolerance)
    if not expansion(chain) > 0.8 * params.min_exp:
        raise _no_line(count, params)
    return _result(chain, decision, {"cluster": seen.points[sites.of_point >= 0], "thinned": raw})


def _site_ranks(seen: Observations, sites: ridge.Sites) -> Optional[np.ndarray]:
    ranks = seen.ranks
    if ranks is None:
        return None
    used = sites.of_point >= 0
    index, weights = sites.of_point[used], seen.weights[used]
    return np.bincount(index, weights * ranks[used], minlength=len(sites.points)) / sites.weights


def _best_path(sites: ridge.Sites, ranks: Optional[np.ndarray], params: ExtractionParams) -> Optional[linking.Path]:
    """The path with the largest expansion within the limits: clutter is dense, but a stroke is long."""
    found = linking.pieces(ridge.onto_ridge(sites, ranks), sites.points, sites.weights, params.eps, ranks)
    found = [path for path in found if path.weight >= 3.0 or len(path.nodes) > 2]
    # the ends of pieces lie inside of what was drawn: their points are means of several
    paths = linking.join(found, params.eps + linking.END_MARGIN)
    fitting = [
        path
        for path in paths
        if len(path.nodes) >= 2
        and 0.8 * params.min_exp < expansion(path.nodes) < params.max_exp
        and path.weight >= 0.7 * params.min_size
        and not linking.is_scrap(path)
    ]
    return max(fitting, key=lambda path: expansion(path.nodes), default=None)


def _simplified(chain: np.ndarray, closed: bool, tolerance: float) -> np.ndarray:
    """Fewer vertices, and a polygon that does not cross itself."""
    if closed and len(chain) >= 4:
        polygon = Polygon(chain)
        if not polygon.is_valid:
            # small loops that noise left; the largest part is the polygon that was meant
            parts = polygon.buffer(0)
            parts = max(parts.geoms, key=lambda part: part.area) if hasattr(parts, "geoms") else parts
            if parts.area > 0.7 * abs(polygon.area) and not parts.is_empty:
                polygon = Polygon(parts.exterior)
        simple = polygon.simplify(tolerance)
        vertices = np.asarray(simple.exterior.coords)[:-1]
        if len(vertices) >= 3:
            return vertices
    if len(chain) >= 3 and not closed:
        return np.asarray(LineString(chain).simplify(tolerance).coords)
    return chain


def _result(chain: np.ndarray, decision: closing.Closing, stages: dict) -> BorderChain:
    length = geometry.chain_length(chain, decision.closed)
    return BorderChain(chain, decision.closed, decision.reason, length, decision.gap, stages)
