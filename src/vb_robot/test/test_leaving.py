"""Ways out of a border and the driving, closed with a unicycle."""
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vb_core.errors import ParameterError
from vb_core.grid_map import GridMap
from vb_robot.drive import IN_THE_WAY
from vb_robot.leaving import LeaveParams, Leaving, Progress, WayOut
from vb_robot.safety import ForbiddenGround, SafetyParams
from vb_robot.workspace import Workspace

RADIUS, PARAMS, SAFETY, DT = 0.18, LeaveParams(), SafetyParams(), 1.0 / 12.0


def room():
    """6 m x 5 m with walls, and a wall from the lower edge to y = 3 m at x = 3 m."""
    data = np.zeros((100, 120), dtype=np.int8)
    data[[0, -1]] = 100
    data[:, [0, -1]] = 100
    data[:60, 60] = 100
    return GridMap(data, 0.05)


def restricted(grid, mask):
    data = grid.data.copy()
    data[mask & (data == 0)] = 100
    return grid.with_data(data)


def square(grid, x0, y0, x1, y1):
    mask = np.zeros(grid.shape, dtype=bool)
    mask[int(y0 * 20):int(y1 * 20), int(x0 * 20):int(x1 * 20)] = True
    return mask


def drive(posterior, physical, pose, obstacle=None, seconds=90.0):
    """(whether the robot became free, the poses, the last reason)."""
    way_out = WayOut(posterior, physical, RADIUS, PARAMS)
    watch = Workspace(posterior, physical, [], RADIUS)
    ground = ForbiddenGround(physical, SAFETY)
    leaving = Leaving(PARAMS, SAFETY)
    poses, now = [pose], 100.0
    for _ in range(int(seconds / DT)):
        if watch.hard_gap(pose[:2]) >= RADIUS + PARAMS.margin:
            return True, np.array(poses), ""
        progress, motion = leaving.step(now, pose, lambda v, w: obstacle if obstacle is not None
                                        else ground.free_way(pose, v, w))
        if progress is Progress.GIVEN_UP:
            return False, np.array(poses), motion.reason
        if progress is Progress.LOST_WAY:
            route = way_out.route(pose[:2])
            if route is None:
                return False, np.array(poses), "no way"
            leaving.set_route(route)
        assert abs(motion.v) <= 0.2 + 1e-9 and abs(motion.w) <= PARAMS.max_turn + 1e-9
        middle = pose[2] + 0.5 * motion.w * DT
        pose = (pose[0] + motion.v * DT * math.cos(middle), pose[1] + motion.v * DT * math.sin(middle),
                pose[2] + motion.w * DT)
        poses.append(pose)
        now += DT
    return False, np.array(poses), "too late"


@settings(max_examples=20, deadline=None)
@given(st.floats(3.9, 5.1), st.floats(0.9, 2.1), st.floats(-3.14, 3.14))
def test_leaves_a_carpet_by_about_the_shortest_way(x, y, yaw):
    physical = room()
    free, poses, why = drive(restricted(physical, square(physical, 4.0, 1.0, 5.0, 2.0)), physical, (x, y, yaw))
    assert free, why
    driven = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1).sum()
    # the strip to the right of it is wide enough as well
    edge = min(x - 4.0, 5.0 - x, y - 1.0, 2.0 - y)
    assert driven <= max(edge, 0.0) + RADIUS + PARAMS.margin + 0.2


def test_everything_but_a_corner_is_restricted():
    physical = room()
    posterior = restricted(physical, ~square(physical, 4.0, 3.4, 6.0, 5.0))
    # from the left of the wall round its end
    free, poses, why = drive(posterior, physical, (2.0, 1.0, 2.0))
    assert free, why
    assert poses[-1, 0] > 4.2 and poses[-1, 1] > 3.6
    gap = ForbiddenGround(physical, SAFETY).clearance_at(poses[:, :2]).min()
    assert gap >= RADIUS, "it does not touch the wall"


def test_gap_between_border_and_wall_is_no_place_to_end():
    physical = room()
    # 0.6 m are left to the right wall: the robot fits in, but out of there nothing leads
    posterior = restricted(physical, square(physical, 3.0, 0.0, 5.35, 5.0))
    route = WayOut(posterior, physical, RADIUS, PARAMS).route((5.1, 2.5))
    assert route is not None and route[-1, 0] < 3.0


def test_no_allowed_floor_and_no_way():
    physical = room()
    assert WayOut(restricted(physical, np.ones(physical.shape, bool)), physical, RADIUS, PARAMS).route((1, 1)) is None
    shut = physical.with_data(np.where(np.arange(120) == 60, 100, physical.data).astype(np.int8))
    posterior = restricted(shut, square(shut, 3.05, 0.0, 6.0, 5.0))
    assert WayOut(posterior, shut, RADIUS, PARAMS).route((4.0, 2.0)) is None


def test_gives_up_where_something_is_in_the_way():
    physical = room()
    free, poses, why = drive(restricted(physical, square(physical, 4.0, 1.0, 5.0, 2.0)), physical, (4.5, 1.5, 0.0), 0.0)
    assert not free and why == IN_THE_WAY
    assert np.allclose(poses[:, :2], (4.5, 1.5)), "it only turns"


def test_without_localisation_it_stands_and_gives_up():
    leaving = Leaving(PARAMS, SAFETY)
    leaving.set_route(np.array([[0.0, 0.0], [1.0, 0.0]]))
    outcomes = [leaving.step(0.1 * i, None, lambda v, w: math.inf) for i in range(200)]
    assert all(motion.v == 0.0 and motion.w == 0.0 for _, motion in outcomes)
    assert outcomes[-1][0] is Progress.GIVEN_UP and "localised" in outcomes[-1][1].reason


def test_pauses_do_not_count():
    leaving = Leaving(PARAMS, SAFETY)
    for i in range(30):
        leaving.pause()
        assert leaving.step(100.0 * i, None, lambda v, w: None)[0] is not Progress.GIVEN_UP


def test_localisation_that_jumps_asks_for_a_new_way():
    leaving = Leaving(PARAMS, SAFETY)
    leaving.set_route(np.array([[0.0, 0.0], [1.0, 0.0]]))
    assert leaving.step(0.0, (0.0, 0.0, 0.0), lambda v, w: math.inf)[0] is Progress.DRIVES
    assert leaving.step(0.1, (0.0, 0.5, 0.0), lambda v, w: math.inf)[0] is Progress.LOST_WAY


def test_faster_than_guided_is_refused():
    with pytest.raises(ParameterError, match="max_speed"):
        LeaveParams(max_speed=0.3)
