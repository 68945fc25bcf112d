"""What a scan, a map and a map of speeds let a robot do."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plain_rooms import empty, scan_of, with_border

from vb_core.robot_profile import Limits, RobotProfile
from vb_robot.driving.gate import BASE_DELAY, CLEARANCES, RATE, TELEOP, Gate
from vb_robot.driving.safety import (
    MIN_ARC_RADIUS,
    Clearance,
    Fix,
    arc,
    limit_around,
    pose_jump,
    safe_speed,
    stop_distance,
)
from vb_robot.driving.spot_follower import VelocityRequest

LIMITS, RADIUS, KEEP = Limits(), 0.18, Clearance(0.12, 0.04, 0.05)


def post_at(x, y):
    """A scan of one beam, which met something thin."""
    return scan_of([math.hypot(x, y)], math.atan2(y, x))


@given(st.floats(0.0, 2.0))
def test_safe_speed_stops_in_time(free):
    assert stop_distance(safe_speed(free, LIMITS), LIMITS) == pytest.approx(free, abs=1e-9)


@pytest.mark.parametrize("said, told", [(0.0, "zero"), (math.nan, "nan")])
def test_a_scanner_says_otherwise_that_nothing_came_back_if_its_profile_tells(said, told):
    ranges = np.full(360, said)
    assert scan_of(ranges, no_return=told).free_distance(0.2, 0.0, RADIUS, KEEP) == math.inf
    assert scan_of(ranges, no_return=told).sees_path(0.2, 0.0, RADIUS, 0.05)
    untold = scan_of(ranges)
    assert untold.free_distance(0.2, 0.0, RADIUS, KEEP) <= 0.0 or not untold.sees_path(0.2, 0.0, RADIUS, 0.05)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("v", [0.2, -0.2])
def test_what_stands_beside_its_way_is_passed_and_what_stands_in_it_is_not(v, side):
    width = RADIUS + KEEP.sides
    for across, passed in ((0.9 * width, False), (1.1 * width, True)):
        post = post_at(math.copysign(0.8, v), side * across)
        assert (post.free_distance(v, 0.0, RADIUS, KEEP) == math.inf) == passed
        # on an arc narrower than its limit it counts as driving straight on, on a wider one it turns away or towards it
        narrow = v / (0.8 * MIN_ARC_RADIUS)
        assert post.free_distance(v, narrow, RADIUS, KEEP) == post.free_distance(v, 0.0, RADIUS, KEEP)
        wide = -side * abs(v) / (1.2 * MIN_ARC_RADIUS) * math.copysign(1.0, v)
        assert post.free_distance(v, wide, RADIUS, KEEP) == math.inf


@pytest.mark.parametrize("w", [0.0, 0.2, -0.2])
@pytest.mark.parametrize("v", [0.2, -0.2])
def test_a_post_on_its_arc_is_as_far_as_the_arc_is_long(v, w):
    post = post_at(*arc((0.0, 0.0, 0.0), np.array([math.copysign(0.7, v)]), w / v)[0])
    assert post.free_distance(v, w, RADIUS, KEEP) == pytest.approx(0.7 - RADIUS - KEEP.ahead, abs=1e-6)


@pytest.mark.parametrize("room", [0.05, 0.1])
@pytest.mark.parametrize("age", [0.0, 0.1, 0.25])
def test_it_stops_before_what_it_saw_however_old_the_scan_is_and_uses_the_room_it_has(age, room):
    gate, ranges = Gate(RobotProfile()), np.full(360, math.inf)
    ranges[178:182] = RADIUS + CLEARANCES[TELEOP].ahead + room  # straight ahead
    gate.set_scan(scan_of(ranges), 10.0)
    v, _, code = gate.limit(10.0 + age, TELEOP, VelocityRequest(1.0, 0.0, "driving"))
    # it has moved since the scan, and moves on until the next command is at the wheels
    moving = max(age + 1.0 / RATE + BASE_DELAY, LIMITS.reaction_time)
    assert code == "obstacle" and v * moving + v * v / (2.0 * LIMITS.deceleration) == pytest.approx(room, abs=0.005)


def test_speed_limits_count_where_the_robot_is_and_as_far_as_it_needs_to_stop():
    zones = with_border(with_border(empty(), 3.0, 1.0, 4.0, 2.0, 20), 4.0, 1.0, 5.0, 2.0, 10)
    assert limit_around(zones, (1.0, 1.5), 0.5) == math.inf
    assert limit_around(zones, (2.6, 1.5), 0.5) == pytest.approx(0.2)
    assert limit_around(zones, (3.8, 1.5), 0.5) == pytest.approx(0.1)
    assert limit_around(zones, (3.2, 1.5), 0.0) == pytest.approx(0.2)
    assert limit_around(zones, (-5.0, 1.0), 0.5) == math.inf


def test_arc_closes_a_circle():
    assert np.allclose(arc((1.0, 2.0, 0.5), np.array([2 * math.pi * 0.7]), 1 / 0.7), [[1.0, 2.0]], atol=1e-9)
    assert np.allclose(arc((1.0, 2.0, math.pi / 2), np.array([0.5, -0.5]), 0.0), [[1.0, 2.5], [1.0, 1.5]])


def test_a_jump_of_the_pose_is_what_the_odometry_does_not_tell():
    before = Fix(10.0, (1.0, 2.0, math.pi / 2), (0.0, 0.0, 0.0))
    # the robot drove 1 m ahead and turned left by 1 rad, and both say so: ahead is +y in the map
    driven = Fix(11.0, (1.0, 3.0, math.pi / 2 + 1.0), (1.0, 0.0, 1.0))
    assert pose_jump(before, driven) == pytest.approx(0.0, abs=1e-9)
    # only localisation turned, or only odometry; the way round is the shorter one
    assert pose_jump(before, Fix(11.0, (1.0, 2.0, math.pi / 2 + 1.0), (0.0, 0.0, 0.0))) == pytest.approx(0.5)
    assert pose_jump(before, Fix(11.0, (1.0, 2.0, math.pi / 2), (0.0, 0.0, -1.0))) == pytest.approx(0.5)
    assert pose_jump(before, Fix(11.0, (1.0, 2.0, math.pi / 2 + 6.0), (0.0, 0.0, 0.0))) == pytest.approx(
        0.5 * (2 * math.pi - 6.0)
    )
    assert pose_jump(before, Fix(11.0, (1.3, 2.4, math.pi / 2), (0.0, 0.0, 0.0))) == pytest.approx(0.5)
    # without odometry, what a robot may have driven in the time is no jump: 1 m and 3 rad in a second
    blind = Fix(10.0, (1.0, 2.0, 0.0))
    assert pose_jump(blind, Fix(11.0, (2.0, 2.0, 3.0))) == pytest.approx(0.0)
    assert pose_jump(blind, Fix(10.5, (2.0, 2.0, 3.0))) == pytest.approx(0.5 + 0.5 * 1.5)
