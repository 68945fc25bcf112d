"""Every code that a person or a program may get has a sentence, and each one comes where it should."""

import re
from pathlib import Path

import numpy as np
import pytest
from shapely.geometry import box

from vb_core import sentences
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_map_integration.border import VirtualBorder
from vb_map_integration.integration import integrate

from integrators import GRID, at, integrator, square
from oracle import ROOMS, world

PACKAGE = Path(__file__).resolve().parents[1]
RAISED = "|".join(
    [
        r'(?:IntegrationError|CodedError)\(\s*"(\w+)"',
        r'(?:_warn\(issues|WARNING), "(\w+)"',
        r'_coordinates\([^,]+, "(\w+)"',
    ]
)


def test_every_code_has_a_sentence():
    codes = set()
    for path in (PACKAGE / "src" / "vb_map_integration").rglob("*.py"):
        for groups in re.findall(RAISED, path.read_text()):
            codes.update(group for group in groups if group)
    assert {"no_separation", "splits_free_space", "bad_points", "soft_border_ignored"} <= codes
    assert codes <= set(sentences.catalog())


def codes_of(points, seed, boxes=(), room="rectangle", **options):
    prior, _ = world(ROOMS[room], (0.0, 0.0, 0.0), boxes)
    before = prior.data.copy()
    try:
        found = [one.code for one in integrate(prior, VirtualBorder(points, seed, **options)).issues]
    except CodedError as error:
        found = [error.code]
    assert np.array_equal(prior.data, before)
    return found


def test_a_curve_within_a_closed_box_separates_nothing_for_a_seed_outside():
    data = np.zeros((100, 160), np.int8)
    data[[0, -1]] = 100
    data[:, [0, -1]] = 100
    data[20:40, 70:90] = 100
    data[22:38, 72:88] = 0
    with pytest.raises(CodedError) as caught:
        integrate(GridMap(data, 0.05), VirtualBorder([(4.0, 1.2), (4.0, 1.8)], (6.0, 3.0), closed=False))
    assert caught.value.code == "no_separation"


def test_no_free_space_left_for_the_robot_is_reported():
    keeper = integrator()
    everything = VirtualBorder(at((-5, -5), (170, -5), (170, 130), (-5, 130)), at((80, 60))[0], closed=True)
    found = [one.code for one in keeper.add(everything, 1.0).issues]
    assert {"outside_map", "covers_nearly_all", "no_free_space_left"} == set(found)


@pytest.mark.parametrize("occupancy, code", [(0.0, "no_effect"), (0.01, None), (1.0, None)])
def test_a_border_without_effect_is_reported(occupancy, code):
    found = codes_of([(1, 1), (2, 1), (2, 2), (1, 2)], (1.5, 1.5), occupancy=occupancy, closed=True)
    assert found == ([code] if code else [])


def test_a_curve_that_starts_and_ends_at_one_table_restricts_what_it_cuts_off():
    # both ends on the same free-standing table: a pocket, its other side is the rest of the room
    table = box(3.0, 1.5, 5.0, 2.5)
    assert codes_of([(3.5, 2.6), (3.5, 3.2), (4.5, 3.2), (4.5, 2.6)], (4.0, 2.9), boxes=[table], closed=False) == []


def test_both_ends_in_unknown_space_are_reported():
    prior, _ = world(ROOMS["rectangle"], (0.0, 0.0, 0.0))
    data = prior.data.copy()
    data[data == 100] = -1  # a room whose walls nobody has seen
    result = integrate(prior.with_data(data), VirtualBorder([(4, 1), (4, 4)], (6, 2), closed=False))
    assert [found.code for found in result.issues] == ["no_wall_found", "no_wall_found"]


def test_no_answer_is_given_for_a_map_without_free_space():
    grid = GRID.with_data(np.full(GRID.shape, -1, np.int8))
    for border in (square(10, 10), VirtualBorder(at((30, 10), (30, 90)), at((80, 60))[0], closed=False)):
        try:
            integrate(grid, border)
        except CodedError as error:
            assert error.code in ("seed_on_obstacle", "no_separation")
