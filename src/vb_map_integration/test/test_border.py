"""GeoJSON, and whether a costmap takes soft values."""

import dataclasses
import json

import pytest

from integrators import square
from refusals import refused
from vb_core import sentences
from vb_core.errors import CodedError
from vb_core.navigation_parameters import is_trinary
from vb_map_integration.border import VirtualBorder, borders_from_geojson, borders_to_geojson

RING = [[0, 0], [4, 0], [4, 4], [0, 4], [0, 0]]
LINE = VirtualBorder([(0, 0), (0, 1), (0, 2)], (1, 1), closed=False)


# ----------------------------------------------------------------- GeoJSON
def test_geojson_round_trip():
    borders = [square(10, 10, id="b1", name="Küche: 'x' # y", robots=("ada",), occupancy=0.75), LINE]
    borders.append(VirtualBorder([(0, 0), (1, 2)], None, is_wall=True))
    borders.append(square(10, 10, zone="slow", max_speed=0.3))
    assert borders_from_geojson(borders_to_geojson(borders)) == borders


def test_properties_of_other_programs_are_left_out():
    border = borders_from_geojson(line([[0, 0], [1, 1]], seed=[1, 0], name="a", fid=7, style={"stroke": 1}))[0]
    assert (border.name, border.closed) == ("a", False)
    assert borders_from_geojson(line([[0, 0], [1, 1]], seed=[1, 0], robots="robot1"))[0].robots == ("robot1",)
    # a geographic information system exports every attribute of every border, even the empty ones
    empty = dict.fromkeys((field.name for field in dataclasses.fields(VirtualBorder)))
    exported = feature({"type": "Polygon", "coordinates": [RING]}, **{**empty, "id": 7})
    assert borders_from_geojson(json.dumps(exported))[0].has_same_area(VirtualBorder(RING, (2, 2), closed=True))


def feature(geometry, **properties):
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def line(coordinates, **properties):
    return json.dumps(feature({"type": "LineString", "coordinates": coordinates}, **properties))


def test_a_polygon_without_a_seed_restricts_its_inside():
    ring = [[0, 0], [4, 0], [4, 1], [1, 1], [1, 4], [0, 4], [0, 0]]
    border = borders_from_geojson(json.dumps(feature({"type": "Polygon", "coordinates": [ring]})))[0]
    x, y = border.seed
    assert 0 < x < 4 and 0 < y < 4 and (x < 1 or y < 1) and border.closed


@pytest.mark.parametrize(
    "code, document",
    [
        ("bad_border_file", line([[0, "a"], [1, 1]], seed=[1, 0])),
        ("bad_speed", line([[0, 0], [1, 1]], seed=[1, 0], zone="slow")),
        ("bad_border_file", line([[0, 0], [1, 1]])),
        ("bad_points", line([[0, 0], [1e400, 1]], seed=[1, 0])),
        ("too_many_points", line([[k, 0] for k in range(9999)], seed=[1, 0])),
        ("bad_border_file", "no JSON"),
        ("bad_border_file", "[]"),
        ("bad_border_file", json.dumps({"type": "FeatureCollection", "features": 3})),
        ("bad_border_file", json.dumps({"type": "FeatureCollection", "features": [3]})),
        ("bad_border_file", json.dumps(feature({"type": "Point", "coordinates": [0, 0]}))),
        ("bad_border_file", json.dumps(feature({"type": "Polygon", "coordinates": [RING, [[1, 1], [2, 1], [2, 2]]]}))),
        ("bad_border_file", json.dumps(feature({"type": "Polygon", "coordinates": [[[0, 0], [1, 1]]]}))),
    ],
)
def test_bad_geojson_is_refused(code, document):
    with refused(code):
        borders_from_geojson(document)


def test_the_reason_for_a_bad_file_is_in_the_readers_language():
    with pytest.raises(CodedError) as caught:
        borders_from_geojson(line([[0, 0], [1, 1]]))
    german = sentences.translate(caught.value.code, caught.value.values, "de")
    assert "braucht die Eigenschaft seed" in german and "restricted" not in german


# ----------------------------------------------------------------- costmaps
def test_a_trinary_costmap_is_blind_to_soft_values():
    layers = [{"name": "walls", "type": "costmap_2d::StaticLayer"}, {"name": "x", "type": "costmap_2d::InflationLayer"}]
    good = {"plugins": layers, "walls": {"trinary_costmap": False}}
    assert (is_trinary(good), is_trinary(None)) == (False, False)
    assert (is_trinary({}), is_trinary({"plugins": layers}), is_trinary({**good, "walls": 3})) == (True, True, True)
    for odd in ({"plugins": None}, {"plugins": ["x"], "static_layer": 3}):
        assert is_trinary(odd)
