"""The virtual border V = (P, s, delta) of the paper, Sect. 3, the error raised for an invalid one, and GeoJSON files.

All code that draws, stores, checks or shows borders passes them on as `VirtualBorder`. Files hold them as GeoJSON (RFC
7946), in metres of the map frame instead of degrees on the earth: a polygon as a Polygon, a separating curve or (if
`kind` is "virtual_wall") a wall as a LineString. The feature's properties are named as in `VirtualBorder`. Without a
seed, a polygon restricts its inside. Other programs' properties are ignored, as are null values and ids that are not
strings; errors in our properties, or in the geometry, are reported.

>>> border = VirtualBorder(points=[(1.0, 1.0), (2.0, 1.0), (2.0, 2.0), (1.0, 2.0)], seed=(1.5, 1.5), closed=True)
>>> border.zone.name, border.enabled, border.points.shape
('keep_out', True, (4, 2))
"""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import dataclass
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np
import shapely
import shapely.errors
import shapely.geometry

from vb_core import geometry
from vb_core.errors import CodedError
from vb_core.grid_map import Transform
from vb_core.notices import Notice, Severity
from vb_core.zones import KEEP_OUT, ZONES, Zone

# more than a person draws: over three minutes without a pause, at 25 spots a second
MAX_POINTS = 5000
# a chain counts as closed if the gap between its ends is at most this share of its length
CLOSING_SHARE = 0.15
# [m] no floor is farther from the origin: larger values come from a fault
MAX_COORDINATE = 1e6

MAX_NAME = 200  # characters
# [m/s] the highest value that a cell of the speed limit map can hold: 127 cm/s
MAX_SPEED = 1.27


def warning(code: str, **values: Any) -> Notice:
    """Makes a warning: a border with this issue can still be added."""
    return Notice.from_error(CodedError(code, **values), Severity.WARNING)


class IntegrationError(CodedError):
    """Raised when a border is refused. Nothing was changed.

    Attributes:
        warnings: the warnings found before the error.
    """

    warnings: Tuple[Notice, ...] = ()


@dataclass(frozen=True, eq=False)
class VirtualBorder:
    """A virtual border.

    Attributes:
        points: (N, 2) float64 [m], map frame; P, the polygonal chain; if closed, the first point is not repeated.
        seed: (2,) float64 [m], map frame; s, a point on the side to be restricted.
        occupancy: delta, 0 .. 1; above .005 in a zone that is marked in the map, below 1 in a soft zone.
        closed: polygon (True) or separating curve (False); None decides by the gap between the chain's ends.
        id, name: what the store, and what people, call it by.
        enabled: the user's switch.
        created, modified: [s] ROS time.
        robots: names of the robots that it applies to; empty: all.
        is_wall: a virtual wall: the open chain itself may not be crossed, both sides stay usable, the seed is not used.
        zone: what the area means for robots (vb_core.zones); may be given by its name.
        max_speed: [m/s] in a zone that limits it; 0 elsewhere.
        map_id: fingerprint of the map on which a person accepted it; "" until then.

    Raises:
        IntegrationError: "bad_points", "too_few_points", "too_many_points", "bad_seed", "bad_occupancy",
            "bad_time", "bad_name", "bad_zone", "bad_speed".
    """

    points: np.ndarray
    seed: np.ndarray
    occupancy: float = 1.0
    closed: Optional[bool] = None
    id: str = ""
    name: str = ""
    enabled: bool = True
    created: float = 0.0
    modified: float = 0.0
    robots: Tuple[str, ...] = ()
    is_wall: bool = False
    zone: Zone = KEEP_OUT
    max_speed: float = 0.0
    map_id: str = ""

    def __post_init__(self) -> None:
        points = _coordinates(self.points, "bad_points")
        if len(points) > MAX_POINTS:
            raise IntegrationError("too_many_points", most=MAX_POINTS)
        if len(points) > 1:
            differs_from_previous = (np.diff(points, axis=0) != 0.0).any(axis=1)
            points = points[np.append(True, differs_from_previous)]
        closed = False if self.is_wall else self.closed
        if closed is None:
            gap = float(np.linalg.norm(points[-1] - points[0])) if len(points) > 2 else math.inf
            closed = gap <= CLOSING_SHARE * geometry.chain_length(points)
        if closed and len(points) > 1 and (points[0] == points[-1]).all():
            points = points[:-1]
        least = 3 if closed else 2
        if len(points) < least:
            raise IntegrationError("too_few_points", least=least, count=len(points))
        seed = _coordinates(points[0] if self.is_wall else self.seed, "bad_seed")
        if len(seed) != 1:
            raise IntegrationError("bad_seed")
        occupancy = _number(self.occupancy, "bad_occupancy")
        if not 0.0 <= occupancy <= 1.0:
            raise IntegrationError("bad_occupancy")
        zone = self.zone if isinstance(self.zone, Zone) else ZONES.get(str(self.zone))
        if zone is None:
            raise IntegrationError("bad_zone", zone=self.zone, known=", ".join(ZONES))
        is_not_soft = zone.soft and occupancy >= 1.0
        has_no_effect = zone.restricts and zone.value(occupancy) == 0
        if is_not_soft or has_no_effect:
            raise IntegrationError("bad_occupancy")
        speed = _number(self.max_speed, "bad_speed", speed=self.max_speed)
        has_limit = speed > 0.0
        fits_zone = has_limit == zone.limits_speed
        if not 0.0 <= speed <= MAX_SPEED or not fits_zone or (has_limit and self.is_wall):
            raise IntegrationError("bad_speed", speed=speed)
        for key in ("created", "modified"):
            value = _number(getattr(self, key), "bad_time", key=key)
            if value < 0.0:
                raise IntegrationError("bad_time", key=key)
            object.__setattr__(self, key, value)
        for key in ("id", "name"):
            text = getattr(self, key)
            if not isinstance(text, str) or len(text) > MAX_NAME or not text.isprintable():
                raise IntegrationError("bad_name", key=key)
        points.setflags(write=False)
        seed.setflags(write=False)
        given_robots = (self.robots,) if isinstance(self.robots, str) else self.robots
        robots = tuple(str(robot) for robot in given_robots if str(robot))
        checked = {"points": points, "seed": seed[0], "occupancy": occupancy, "zone": zone, "max_speed": speed}
        checked.update(closed=bool(closed), enabled=bool(self.enabled), robots=robots, is_wall=bool(self.is_wall))
        for key, value in checked.items():
            object.__setattr__(self, key, value)

    def replace(self, **changes: object) -> "VirtualBorder":
        """Returns a copy with some fields replaced, validated again."""
        return dataclasses.replace(self, **changes)

    @property
    def cell_value(self) -> int:
        """delta as an occupancy value of the map, 0 .. 100."""
        return self.zone.value(self.occupancy)

    def transform(self, transform: Transform) -> "VirtualBorder":
        """Moves the border into the frame of another map."""
        if not any(transform):
            return self
        return self.replace(points=transform.apply(self.points), seed=transform.apply(self.seed)[0])

    def has_same_area(self, other: "VirtualBorder") -> bool:
        """Returns whether both borders restrict the same cells on any map, whatever their occupancy."""
        return (
            self.closed == other.closed
            and self.is_wall == other.is_wall
            and np.array_equal(self.points, other.points)
            and np.array_equal(self.seed, other.seed)
        )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, VirtualBorder):
            return NotImplemented
        return self.has_same_area(other) and all(getattr(self, key) == getattr(other, key) for key in _PROPERTIES)

    __hash__ = None  # type: ignore[assignment]


def _coordinates(values: object, code: str) -> np.ndarray:
    """Copies coordinates to (N, 2) float64. Raises IntegrationError with this code if one is not finite or too far."""
    try:
        points = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise IntegrationError(code) from None
    if points.size == 0:
        points = points.reshape(0, 2)
    elif points.ndim == 1:
        points = points.reshape(1, -1)
    # nan compares as false
    if points.ndim != 2 or points.shape[1] != 2 or not (np.abs(points) <= MAX_COORDINATE).all():
        raise IntegrationError(code)
    return points


def _number(value: object, code: str, **values: object) -> float:
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise IntegrationError(code, **values)
    return number


# ------------------------------------------------------------------ GeoJSON
_WALL = "virtual_wall"
_FIELDS = [field.name for field in dataclasses.fields(VirtualBorder)]
_PROPERTIES = tuple(name for name in _FIELDS if name not in ("points", "seed", "closed", "is_wall"))


def border_to_feature(border: VirtualBorder) -> Dict[str, Any]:
    """Writes a border as a Feature of plain values; inverse of `border_from_feature`."""
    points = border.points.tolist()
    geometry: Dict[str, Any] = {"type": "LineString", "coordinates": points}
    if border.closed:
        geometry = {"type": "Polygon", "coordinates": [points + points[:1]]}
    properties = {name: getattr(border, name) for name in _PROPERTIES}
    properties.update(zone=border.zone.name, seed=border.seed.tolist())
    if border.is_wall:
        properties["kind"] = _WALL
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def borders_to_geojson(borders: Sequence[VirtualBorder]) -> str:
    """Writes borders as a FeatureCollection; inverse of `borders_from_geojson`."""
    features = (json.dumps(border_to_feature(border), ensure_ascii=False) for border in borders)
    lines = ",\n".join(features)  # one line per border
    return f'{{"type": "FeatureCollection", "features": [\n{lines}\n]}}\n'


def borders_from_geojson(text: str) -> List[VirtualBorder]:
    """Reads the borders of a FeatureCollection or a single Feature; inverse of `borders_to_geojson`.

    Raises:
        CodedError: "bad_border_file", or as `VirtualBorder`; the message has the feature's number.
    """
    try:
        document = json.loads(text)
    except ValueError as error:
        raise CodedError("bad_border_file", reason_code="file_format", format="JSON", detail=str(error)) from None
    if not isinstance(document, dict):
        raise _file_error("type", "FeatureCollection", document)
    features = document.get("features") if document.get("type") == "FeatureCollection" else [document]
    if not isinstance(features, list):
        raise _file_error("features", "[...]", features)
    borders = []
    for number, feature in enumerate(features, 1):
        try:
            borders.append(border_from_feature(feature))
        except CodedError as error:
            raise CodedError(error.code, f"feature {number}: {error.message}", **error.values) from None
    return borders


def _file_error(key: str, expected: str, found: Any) -> CodedError:
    return CodedError("bad_border_file", reason_code="file_value", key=key, expected=expected, found=repr(found))


def border_from_feature(feature: Any) -> VirtualBorder:
    """Reads a border from a Feature; inverse of `border_to_feature`. Raises as `borders_from_geojson`."""
    if not isinstance(feature, dict) or feature.get("type") != "Feature":
        raise _file_error("type", "Feature", feature)
    try:
        shape = shapely.geometry.shape(feature.get("geometry"))
    except (shapely.errors.ShapelyError, ValueError, TypeError, LookupError, AttributeError) as error:
        detail = str(error).strip()
        raise CodedError("bad_border_file", reason_code="file_format", format="GeoJSON", detail=detail) from None
    if shape.geom_type not in ("Polygon", "LineString"):
        raise _file_error("geometry", "Polygon | LineString", shape.geom_type)
    closed = shape.geom_type == "Polygon"
    if closed and shape.interiors:
        raise CodedError("bad_border_file", reason_code="file_polygon_has_holes", found=1 + len(shape.interiors))
    points = shapely.get_coordinates(shape.exterior if closed else shape)  # heights are dropped
    properties = feature.get("properties")
    properties = properties if isinstance(properties, dict) else {}
    is_wall = not closed and properties.get("kind") == _WALL
    # other programs write null for absent values, and numbers as ids
    values = {key: properties[key] for key in (*_PROPERTIES, "seed") if properties.get(key) is not None}
    if not isinstance(values.get("id"), str):
        values.pop("id", None)
    if "seed" not in values:
        if not closed and not is_wall:
            raise CodedError("bad_border_file", reason_code="file_no_seed")
        values["seed"] = _point_inside(shape) if closed and np.isfinite(points).all() else (0.0, 0.0)
    try:
        return VirtualBorder(points, closed=closed, is_wall=is_wall, **values)
    except TypeError as error:
        raise CodedError("bad_border_file", reason_code="file_keys", detail=str(error)) from None


def _point_inside(polygon: Any) -> Tuple[float, float]:
    """Returns a point inside a polygon, or on its outline if it has no inside."""
    valid = polygon if polygon.is_valid else polygon.buffer(0)
    point = valid.representative_point()
    return polygon.exterior.coords[0][:2] if point.is_empty else (point.x, point.y)
