"""Borders as GeoJSON (RFC 7946), in metres of the map frame instead of degrees on the earth.

A Polygon is a polygon, a LineString a separating curve. The seed and other attributes are the feature's properties,
named as in `VirtualBorder`; a polygon without a seed restricts its inside, and a LineString of kind "virtual_wall"
needs none. Other programs' properties are ignored, as are null values and ids that are not strings; errors in ours, or
in the geometry, are reported.
"""

from __future__ import annotations

import dataclasses
import json
from typing import Any, Dict, List, Sequence, Tuple

import numpy as np
import shapely
import shapely.errors
import shapely.geometry

from vb_core.errors import CodedError
from vb_map_integration.border import VirtualBorder

_WALL = "virtual_wall"
_PROPERTIES = tuple(
    field.name for field in dataclasses.fields(VirtualBorder) if field.name not in ("points", "seed", "closed", "wall")
)


def border_to_feature(border: VirtualBorder) -> Dict[str, Any]:
    """Writes a border as a Feature of plain values; inverse of `border_from_feature`."""
    points = border.points.tolist()
    geometry: Dict[str, Any] = {"type": "LineString", "coordinates": points}
    if border.closed:
        geometry = {"type": "Polygon", "coordinates": [points + points[:1]]}
    properties = {name: getattr(border, name) for name in _PROPERTIES}
    properties.update(zone=border.zone.name, seed=border.seed.tolist())
    if border.wall:
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
        raise CodedError("bad_border_file", reason="$file_format", format="JSON", detail=str(error)) from None
    if not isinstance(document, dict):
        raise _wrong("type", "FeatureCollection", document)
    features = document.get("features") if document.get("type") == "FeatureCollection" else [document]
    if not isinstance(features, list):
        raise _wrong("features", "[...]", features)
    borders = []
    for number, feature in enumerate(features, 1):
        try:
            borders.append(border_from_feature(feature))
        except CodedError as error:
            raise CodedError(error.code, f"feature {number}: {error.message}", **error.values) from None
    return borders


def _wrong(key: str, expected: str, found: Any) -> CodedError:
    return CodedError("bad_border_file", reason="$file_value", key=key, expected=expected, found=repr(found))


def border_from_feature(feature: Any) -> VirtualBorder:
    """Reads a border from a Feature; inverse of `border_to_feature`.

    Raises:
        CodedError: "bad_border_file", or as `VirtualBorder`.
    """
    if not isinstance(feature, dict) or feature.get("type") != "Feature":
        raise _wrong("type", "Feature", feature)
    try:
        shape = shapely.geometry.shape(feature.get("geometry"))
    except (shapely.errors.ShapelyError, ValueError, TypeError, LookupError, AttributeError) as error:
        raise CodedError(
            "bad_border_file", reason="$file_format", format="GeoJSON", detail=str(error).strip()
        ) from None
    if shape.geom_type not in ("Polygon", "LineString"):
        raise _wrong("geometry", "Polygon | LineString", shape.geom_type)
    closed = shape.geom_type == "Polygon"
    if closed and shape.interiors:
        raise CodedError("bad_border_file", reason="$file_polygon_has_holes", found=1 + len(shape.interiors))
    points = shapely.get_coordinates(shape.exterior if closed else shape)  # heights are dropped
    properties = feature.get("properties")
    properties = properties if isinstance(properties, dict) else {}
    wall = not closed and properties.get("kind") == _WALL
    # other programs write null for absent values, and numbers as ids
    values = {key: properties[key] for key in (*_PROPERTIES, "seed") if properties.get(key) is not None}
    if not isinstance(values.get("id"), str):
        values.pop("id", None)
    if "seed" not in values:
        if not closed and not wall:
            raise CodedError("bad_border_file", reason="$file_no_seed")
        values["seed"] = _point_inside(shape) if closed and np.isfinite(points).all() else (0.0, 0.0)
    try:
        return VirtualBorder(points, closed=closed, wall=wall, **values)
    except TypeError as error:
        raise CodedError("bad_border_file", reason="$file_keys", detail=str(error)) from None


def _point_inside(polygon: Any) -> Tuple[float, float]:
    """Returns a point inside a polygon, or on its outline if it has no inside."""
    point = (polygon if polygon.is_valid else polygon.buffer(0)).representative_point()
    return (polygon.exterior.coords[0][:2]) if point.is_empty else (point.x, point.y)
