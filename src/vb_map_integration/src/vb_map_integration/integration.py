"""Integration of a virtual border into the occupancy grid map (paper, Sect. 3).

M_posterior is M_prior with the area on the seed's side of the border raised to delta. Physical obstacles keep
their value; the prior itself is never changed.
"""
from __future__ import annotations

from dataclasses import dataclass, field
from typing import List, Mapping, Optional, Sequence, Tuple

import cv2
import numpy as np
import shapely

from vb_core.grid_map import GridMap
from vb_core.parameters import Parameters, param
from vb_map_integration import curve, raster
from vb_map_integration.border import VirtualBorder
from vb_map_integration.findings import ERROR, WARNING, Finding, IntegrationError

__all__ = ["ERROR", "WARNING", "Finding", "Integration", "IntegrationError", "IntegrationParams", "integrate"]


@dataclass(frozen=True)
class IntegrationParams(Parameters):
    """What the integration goes by."""

    occupied_from: int = param(65, low=1, high=100, doc="occupancy from which on a cell is an obstacle (map_server's 0.65)")
    fit_length_m: float = param(0.3, "m", above=0.0, doc="length of a curve's end that gives its extension's direction")
    overshoot_m: float = param(0.2, "m", low=0.0, doc="how far a drawn end may reach beyond the wall it belongs to")
    seed_radius_m: float = param(0.2, "m", low=0.0, doc="how far a seed on an obstacle or on the line is moved")
    nearly_everything: float = param(0.98, low=0.0, high=1.0, doc="share of the free space that is worth a warning")


_DEFAULT = IntegrationParams()


@dataclass(frozen=True)
class Integration:
    """The result of an integration.

    Attributes:
        posterior: the map with the border.
        region: (H, W) bool, the cells that the border restricts; obstacles are not among them.
        findings: warnings.
        area_m2: [m^2] of the region.
        closed: polygon or separating curve.
        line: (M, 2) [m] map frame, the border as it acts: a curve with its extensions.
        value: what the region was raised to, 0 .. 100.
        over_unknown: whether unknown cells in the region were raised too.
        mask: the region as (H, W) uint8, 0 or 255.
    """

    posterior: GridMap
    region: np.ndarray
    findings: Tuple[Finding, ...]
    area_m2: float
    closed: bool
    line: np.ndarray
    value: int
    over_unknown: bool
    mask: np.ndarray = field(repr=False)


def integrate(
    prior: GridMap,
    border: VirtualBorder,
    params: Optional[IntegrationParams] = None,
    places: Optional[Mapping[str, Sequence[float]]] = None,
) -> Integration:
    """Integrates a border into a map.

    A polygon restricts its inside, unknown cells included, or all the free space outside that hangs together
    with the seed. A separating curve is extended to the physical borders and restricts what can be reached from
    the seed without crossing it. Unknown cells are raised only by a value that counts as an obstacle: a soft
    one would make them look freer than they were.

    Args:
        prior: the map; it stays as it is.
        border: the border.
        places: things whose being inside is worth a warning, for instance {"robot": (x, y)} [m] gives "robot_inside".

    Raises:
        IntegrationError: "separates_nothing", "seed_on_both_sides", "empty_region", "outside_map",
            "seed_outside_map", "seed_on_obstacle", "too_complex".
    """
    params = params or _DEFAULT
    findings: List[Finding] = []
    points = prior.world_to_grid(border.points)
    seed = prior.world_to_grid(border.seed)[0]
    cells = np.ascontiguousarray(prior.data)
    as_bytes = cells.view(np.uint8)  # unknown is 255
    try:
        _check_shape(prior, border, points, seed, findings)
        # obstacles and unknown in one comparison
        blocked = cv2.compare(as_bytes, params.occupied_from - 1, cv2.CMP_GT)
        if border.closed:
            mask, band = _polygon(prior, points, seed, as_bytes, blocked, params, findings)
            line = border.points
        else:
            band = slice(None)
            mask, line = _curve(prior, points, seed, as_bytes, blocked, params, findings)
        restricted = cv2.countNonZero(mask[band])
        if restricted == 0:
            raise IntegrationError("empty_region", "there is no free cell in the area: draw it larger or elsewhere")
        free = blocked.size - cv2.countNonZero(blocked)
        if restricted > params.nearly_everything * free:
            _warn(findings, "nearly_everything", "the area covers nearly all of the free space: is the seed on the right side?")
        if border.value == 0:
            _warn(findings, "no_effect", "an occupancy of 0 restricts nothing")
        for name, place in (places or {}).items():
            row, column = prior.world_to_cell(place)[0]
            if prior.contains_cells([[row, column]])[0] and mask[row, column]:
                _warn(findings, f"{name}_inside", f"the {name} stands in the area: it may find no way out")
    except IntegrationError as error:
        raise IntegrationError(error.code, error.message, findings) from None
    over_unknown = border.closed is True and border.value >= params.occupied_from
    posterior = raster.paint(cells[band], mask[band], border.value, over_unknown)
    region = cv2.min(mask[band], 1).view(bool)
    if len(region) < len(mask):
        posterior, part = cells.copy(), posterior
        posterior[band] = part
        region, part = np.zeros(prior.shape, dtype=bool), region
        region[band] = part
    return Integration(
        posterior=prior.with_data(posterior),
        region=region,
        findings=tuple(findings),
        area_m2=restricted * prior.resolution**2,
        closed=bool(border.closed),
        line=line,
        value=border.value,
        over_unknown=over_unknown,
        mask=mask,
    )


def _warn(findings: List[Finding], code: str, message: str) -> None:
    findings.append(Finding(WARNING, code, message))


def _check_shape(
    prior: GridMap, border: VirtualBorder, points: np.ndarray, seed: np.ndarray, findings: List[Finding]
) -> None:
    rows, columns = prior.shape
    limit = np.array([columns, rows]) - 0.5
    outside = int(((points < -0.5) | (points >= limit)).any(axis=1).sum())
    if outside:
        _warn(findings, "outside_map", f"{outside} of {len(points)} points lie outside the map: the border was clipped to it")
    if ((seed < -0.5) | (seed >= limit)).any():
        raise IntegrationError("seed_outside_map", "the seed point lies outside the map")
    chain = np.vstack([border.points, border.points[:1]]) if border.closed else border.points
    if not shapely.linestrings(chain).is_simple:
        _warn(findings, "self_crossing", "the border crosses itself: everything that it encloses counts as inside")


def _polygon(
    prior: GridMap,
    points: np.ndarray,
    seed: np.ndarray,
    as_bytes: np.ndarray,
    blocked: np.ndarray,
    params: IntegrationParams,
    findings: List[Finding],
) -> Tuple[np.ndarray, slice]:
    """(H, W) uint8: the area on the seed's side of a polygon, and the rows that it lies in."""
    inner = raster.polygon_mask(points, prior.shape)
    if cv2.countNonZero(inner) == 0:
        raise IntegrationError("empty_region", "the polygon holds no cell of the map: draw it larger or elsewhere")
    row, column = (int(value) for value in np.floor(seed[::-1] + 0.5))
    if inner[row, column]:
        if params.occupied_from <= as_bytes[row, column] <= 100:
            obstacle = cv2.inRange(as_bytes, params.occupied_from, 127)
            _free_cell(cv2.bitwise_or(obstacle, cv2.bitwise_not(inner)), seed, prior, params, findings)
        band = _band(points, prior)
        inner[band] = cv2.subtract(inner[band], cv2.inRange(as_bytes[band], params.occupied_from, 127))
        return inner, band
    # the outer area is all that hangs together with the seed, also behind the polygon
    barred = cv2.bitwise_or(blocked, inner) if blocked[row, column] else blocked
    start = _free_cell(barred, seed, prior, params, findings)
    return cv2.subtract(raster.flood(blocked, start), inner), slice(None)


def _band(points: np.ndarray, prior: GridMap) -> slice:
    """The map's rows that a polygon reaches: on a large map most of the work is left out."""
    low, high = np.clip((np.floor(points[:, 1].min()), np.ceil(points[:, 1].max()) + 1), 0, prior.shape[0])
    return slice(int(low), int(high))


def _curve(
    prior: GridMap,
    points: np.ndarray,
    seed: np.ndarray,
    as_bytes: np.ndarray,
    blocked: np.ndarray,
    params: IntegrationParams,
    findings: List[Finding],
) -> Tuple[np.ndarray, np.ndarray]:
    """(H, W) uint8: the area on the seed's side of a separating curve, and the curve with its extensions [m]."""
    moved: List[Finding] = []

    def find_seed(barrier: np.ndarray, away: Optional[np.ndarray]) -> Tuple[int, int]:
        moved.clear()
        return _free_cell(barrier, seed, prior, params, moved, away)

    fit, overshoot = params.fit_length_m / prior.resolution, params.overshoot_m / prior.resolution
    cut = curve.separate(blocked, points, fit, overshoot, seed, find_seed)
    if cut is None:
        raise IntegrationError("outside_map", "the curve lies outside the map")
    findings.extend(moved)
    if cut.left >= curve.TOUCHES and cut.right >= curve.TOUCHES:
        raise IntegrationError(
            "seed_on_both_sides", "the curve does not part the area: from the seed one gets to both of its sides"
        )
    if not cut.separates:
        raise IntegrationError(
            "separates_nothing", "the curve parts no area round the seed from the rest: draw it across free floor"
        )
    for stop in cut.stops:
        on_map = bool(prior.contains_cells([stop])[0])
        if not on_map or as_bytes[stop] > 127:
            where = "in unknown space" if on_map else "at the map's edge"
            _warn(findings, "no_wall_found", f"the curve's extension found no wall, it ended {where}")
    return cut.region, prior.grid_to_world(cut.line)


def _free_cell(
    barred: np.ndarray,
    seed: np.ndarray,
    prior: GridMap,
    params: IntegrationParams,
    findings: List[Finding],
    away: Optional[np.ndarray] = None,
) -> Tuple[int, int]:
    """The cell (row, column) of the seed, or the nearest one that is not barred, in a direction if one is given.

    Raises:
        IntegrationError: "seed_on_obstacle" if there is none within the radius.
    """
    column, row = (int(value) for value in np.floor(seed + 0.5))
    if not barred[row, column]:
        return row, column
    radius = params.seed_radius_m / prior.resolution
    reach = int(radius) + 1
    top, left = max(0, row - reach), max(0, column - reach)
    window = barred[top : row + reach + 1, left : column + reach + 1]
    rows, columns = np.nonzero(window == 0)
    offset = np.column_stack([columns + left, rows + top]) - seed
    distance = np.hypot(offset[:, 0], offset[:, 1])
    if away is not None:
        distance[offset @ away <= 0.0] = np.inf
    if len(distance) == 0 or distance.min() > radius:
        raise IntegrationError(
            "seed_on_obstacle", f"there is no free floor within {params.seed_radius_m} m of the seed point: show it elsewhere"
        )
    best = int(np.argmin(distance))
    _warn(findings, "seed_moved", f"the seed point was not on free floor and was moved by {distance[best] * prior.resolution:.2f} m")
    return int(rows[best] + top), int(columns[best] + left)


