"""How a footprint touches borders, and the names of borders."""
import math

import numpy as np
import pytest

from vb_core.grid_map import GridMap
from vb_robot.driving.workspace import BorderContact, KnownBorder, Workspace


def workspace(borders, *squares, value=100):
    data = np.zeros((100, 120), dtype=np.int8)
    data[:, 60] = 100  # a wall, which is no border
    physical = GridMap(data, 0.05)
    data = data.copy()
    for y0, y1, x0, x1 in squares:
        data[int(y0 * 20):int(y1 * 20), int(x0 * 20):int(x1 * 20)] = value
    return Workspace(physical.with_data(data), physical, 0.18, borders)


def square(name, x0, y0, x1, y1, seed=None):
    points = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], dtype=float)
    return KnownBorder(name, points, np.array(seed or points.mean(axis=0)), True)


CARPET, CORNER = square("carpet", 0.5, 0.5, 1.5, 1.5), square("corner", 4.0, 4.0, 5.0, 5.0)


def test_standing():
    here = workspace([CARPET], (0.5, 1.5, 0.5, 1.5))
    assert here.standing((1.0, 1.0)) is BorderContact.INSIDE
    assert here.standing((1.62, 1.0)) is BorderContact.TOUCHES
    assert here.standing((1.8, 1.0)) is BorderContact.FREE
    assert here.standing((3.0, 3.0)) is BorderContact.FREE, "a wall is no border"
    assert here.standing((50.0, 3.0)) is BorderContact.FREE
    assert workspace([]).standing((1.0, 1.0)) is BorderContact.FREE


def test_names():
    here = workspace([CARPET, CORNER], (0.5, 1.5, 0.5, 1.5), (4.0, 5.0, 4.0, 5.0))
    assert here.name_at((1.0, 1.0)) == "carpet"
    assert here.name_at((1.6, 1.0)) == "carpet"
    assert here.name_at((4.5, 4.5)) == "corner"
    assert here.name_at((2.5, 2.5)) == ""
    assert workspace([], (0.5, 1.5, 0.5, 1.5)).name_at((1.0, 1.0)) == ""


def test_touching_areas_are_told_apart_by_their_polygons():
    other = square("mat", 1.5, 0.5, 2.5, 1.5)
    here = workspace([CARPET, other], (0.5, 1.5, 0.5, 2.5))
    assert here.name_at((1.0, 1.0)) == "carpet"
    assert here.name_at((2.0, 1.0)) == "mat"


def test_separating_curve_has_the_name_of_its_seed():
    curve = KnownBorder("left part", np.array([[1.0, 0.0], [1.0, 4.9]]), np.array([0.2, 2.0]), False)
    here = workspace([curve], (0.0, 5.0, 0.0, 1.0))
    assert here.name_at((0.5, 4.0)) == "left part"


def test_soft_borders_are_not_hard():
    here = workspace([CARPET], (0.5, 1.5, 0.5, 1.5), value=75)
    assert here.standing((1.0, 1.0)) is BorderContact.INSIDE and not here.is_hard((1.0, 1.0))
    assert workspace([CARPET], (0.5, 1.5, 0.5, 1.5)).is_hard((1.0, 1.0))


def test_a_map_lets_a_robot_out_but_not_further_in():
    data = np.zeros((200, 320), dtype=np.int8)
    data[:, 160:] = 100  # x = 4 m and more
    empty = GridMap(np.zeros_like(data), 0.025)
    ground = Workspace(empty.with_data(data), empty, 0.18)
    assert ground.free_distance((3.0, 2.5, 0.0), 0.2, 0.0, 0.05, False) == pytest.approx(1.0 - 0.18 - 0.05, abs=0.04)
    assert ground.free_distance((3.9, 2.5, 0.0), 0.2, 0.0, 0.05, False) <= 0.04
    assert ground.free_distance((3.9, 2.5, 0.0), -0.2, 0.0, 0.05, False) == math.inf
    assert ground.free_distance((3.0, 2.5, 0.0), 0.2, 0.1, 0.05, leaving=True) == math.inf
