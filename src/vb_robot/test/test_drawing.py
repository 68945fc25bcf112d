"""Where a robot is to look: the edge of what the cameras see, or a little ahead of a spot that it alone sees."""

import numpy as np
import pytest

from vb_core.grid_map import GridMap
from vb_robot.clearance_map import ClearanceMap
from vb_robot.dispatching.drawing import HALF_VIEW, MIN_LOOKAHEAD, REACTION, DrawingState, UnseenFloor

NO_CHAIN = np.zeros((0, 2))
RIGHT = np.array([0.3, 0.0])  # [m/s]


def room():
    """8 m x 5 m with walls; the cameras see x < 6 m, apart from a shadow 0.1 m wide at x = 3 m."""
    data = np.zeros((100, 160), dtype=np.int8)
    data[[0, -1]] = 100
    data[:, [0, -1]] = 100
    coverage = np.where(data > 0, np.int8(-1), np.int8(1))
    coverage[1:-1, 120:-1] = 0
    coverage[1:-1, 60:62] = 0
    return ClearanceMap(GridMap(data, 0.05), 0.18), UnseenFloor(GridMap(coverage, 0.05))


CLEARANCE_MAP, UNSEEN = room()


def look(spot, direction=None, seen_by_stationary=True, unseen=UNSEEN, seeding=False):
    drawing = DrawingState(np.array(spot), NO_CHAIN, direction, seen_by_stationary=seen_by_stationary, seeding=seeding)
    return drawing.with_target(CLEARANCE_MAP, unseen)


def focus(*args, **kwargs):
    return look(*args, **kwargs).look_at


def test_blind_spots_are_known_to_a_cell_and_narrow_shadows_do_not_count():
    assert UNSEEN.at(np.array([[6.03, 2.5], [7.9, 4.9], [5.97, 2.5], [3.05, 2.5], [20.0, 0.0]])).tolist() == [
        True,
        True,
        False,
        False,
        False,
    ]
    assert not UnseenFloor(GridMap(np.ones((5, 5), np.int8), 0.1)).mask.any()
    assert UnseenFloor(GridMap(np.zeros((5, 5), np.int8), 0.1)).mask.all()


def test_looks_where_the_line_ahead_leaves_what_cameras_see():
    assert focus((4.5, 2.5), RIGHT) == pytest.approx((6.0 + MIN_LOOKAHEAD, 2.5), abs=0.06)
    assert focus((4.9, 2.5), 3.0 * RIGHT) == pytest.approx((6.0 + 0.45 * REACTION, 2.5), abs=0.06), "a quick hand"
    assert focus((4.9, 2.5), 9.0 * RIGHT) == pytest.approx(
        (6.0 + HALF_VIEW, 2.5), abs=0.06
    ), "where it left stays in view"
    assert focus((7.6, 2.5), RIGHT)[0] < 7.95, "not into the wall"


def test_looks_at_the_spot_while_nothing_unseen_is_near():
    assert focus((2.0, 2.5), RIGHT) == pytest.approx((2.0, 2.5))
    assert focus((5.5, 2.5), None) == pytest.approx((6.025, 2.5), abs=0.04), "floor beside it that nobody sees"
    assert focus((5.5, 2.5), None, unseen=None) == pytest.approx((5.5, 2.5))
    assert focus((5.5, 2.5), RIGHT, seeding=True) == pytest.approx((5.5, 2.5))


def test_all_of_the_stretch_that_nobody_sees_is_known_up_to_the_wall():
    stretch = look((4.5, 2.5), RIGHT).stretch
    assert stretch[0] == pytest.approx((6.0, 2.5), abs=0.06) and stretch[-1][0] == pytest.approx(6.5, abs=0.06)
    assert look((5.5, 2.5), RIGHT).stretch[-1][0] == pytest.approx(7.5, abs=0.06), "no farther than the horizon"
    assert look((6.5, 2.5), RIGHT).stretch[-1][0] <= 7.95
    assert look((7.5, 2.5), -RIGHT).stretch[-1] == pytest.approx((6.0, 2.5), abs=0.06), "they see it again there"


def test_spot_that_only_the_robot_sees_or_nobody_stays_in_view_with_what_is_ahead():
    alone = look((7.0, 2.5), RIGHT, seen_by_stationary=False)
    assert alone.look_at == pytest.approx((7.0 + MIN_LOOKAHEAD, 2.5))
    assert (np.abs(alone.required_points - (7.0, 2.5)).max(axis=1) < 1e-6).any(), "people hold still where it was lost"
    assert look((7.0, 2.5), None, seen_by_stationary=False).look_at == pytest.approx((7.0, 2.5))
    assert look((7.9, 2.5), RIGHT, seen_by_stationary=False).look_at[0] <= 7.95, "not into the wall"
