"""Borders as GeoJSON (RFC 7946), in metres of the map frame instead of degrees on the earth.

A Polygon is a polygon, a LineString a separating curve. The seed and the rest are the feature's properties, named as
in `VirtualBorder`; a polygon without a seed restricts its inside, and a LineString of kind "virtual_wall" needs none.
Properties of other programs are ignored; errors in ours, or in the geometry, are reported.
"""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any, Dict, List, Sequence

import numpy as np
import shapely

from vb_core.errors import CodedError
from vb_map_integration.border import VirtualBorder
from vb_map_integration.borders.border_values import border_from_mapping, border_to_mapping

_GEOMETRY = ("points", "seed", "kind")
_PROPERTIES = tuple(
    one.name for one in dataclasses.fields(VirtualBorder) if one.name not in (*_GEOMETRY, "closed", "wall")
)


def borders_to_geojson(borders: Sequence[VirtualBorder]) -> str:
    """Writes borders as a FeatureCollection; inverse of `borders_from_geojson`."""
    features = []
    for border in borders:
        values = border_to_mapping(border)
        points = values["points"]
        geometry: Dict[str, Any] = {"type": "LineString", "coordinates": points}
        if border.closed:
            geometry = {"type": "Polygon", "coordinates": [points + points[:1]]}
        properties = {key: value for key, value in values.items() if key not in _GEOMETRY}
        properties["seed"] = values["seed"]
        if border.wall:
            properties["kind"] = values["kind"]
        features.append({"type": "Feature", "geometry": geometry, "properties": properties})
    lines = ",\n".join(json.dumps(feature, ensure_ascii=False) for feature in features)  # a border is a line
    return f'{{"type": "FeatureCollection", "features": [\n{lines}\n]}}\n'


def borders_from_geojson(text: str) -> List[VirtualBorder]:
    """Reads the borders of a FeatureCollection or a single Feature; inverse of `borders_to_geojson`.

    Raises:
        CodedError: "bad_border_file" or what a border raises; the message names the feature's number.
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
            borders.append(_border(feature))
        except CodedError as error:
            raise CodedError(error.code, f"feature {number}: {error.message}", **error.values) from None
    return borders


def _wrong(key: str, expected: str, found: Any) -> CodedError:
    return CodedError("bad_border_file", reason="$file_value", key=key, expected=expected, found=repr(found))


def _border(feature: Any) -> VirtualBorder:
    if not isinstance(feature, dict) or feature.get("type") != "Feature":
        raise _wrong("type", "Feature", feature)
    geometry, properties = feature.get("geometry"), feature.get("properties")
    kind = geometry.get("type") if isinstance(geometry, dict) else None
    coordinates = geometry.get("coordinates") if isinstance(geometry, dict) else None
    if kind not in ("Polygon", "LineString") or not isinstance(coordinates, list):
        raise _wrong("geometry", "Polygon | LineString", kind)
    if kind == "Polygon" and len(coordinates) != 1:
        raise CodedError("bad_border_file", reason="$file_polygon_has_holes", found=len(coordinates))
    points = _positions(coordinates[0] if kind == "Polygon" else coordinates)
    given = dict(properties) if isinstance(properties, dict) else {}
    wall = kind == "LineString" and given.get("kind") == "virtual_wall"
    values = {key: value for key, value in given.items() if key in (*_PROPERTIES, "seed")}
    plain = "polygon" if kind == "Polygon" else "separating_curve"
    values.update(points=points, kind="virtual_wall" if wall else plain)
    if "seed" not in values and not wall:
        if kind == "LineString":
            raise CodedError("bad_border_file", reason="$file_no_seed")
        values["seed"] = _point_inside(points)
    return border_from_mapping(values)


def _positions(values: Any) -> List[List[float]]:
    """Returns the x and y of positions, whose height is left out; a ring's repeated first point goes with the rest."""
    if not isinstance(values, list):
        raise _wrong("coordinates", "[[x, y], ...]", values)
    for value in values:
        numbers = (
            isinstance(value, list)
            and len(value) in (2, 3)
            and all(isinstance(number, (int, float)) and not isinstance(number, bool) for number in value)
        )
        if not numbers:
            raise _wrong("coordinates", "[x, y]", value)
    return [value[:2] for value in values]


def _point_inside(points: List[List[float]]) -> List[float]:
    """Returns a point within a polygon, as far from its outline as a few centimetres tell."""
    if len(points) < 4 or not all(math.isfinite(value) for point in points for value in point):
        return points[0] if points else [0.0, 0.0]  # what is wrong is the points: the border says so
    inside = shapely.polygons(np.array(points)).buffer(0).representative_point()
    return points[0] if inside.is_empty else [inside.x, inside.y]
