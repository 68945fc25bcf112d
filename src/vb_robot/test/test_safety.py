"""What a scan, a map and a map of speed limits let a robot do, and how uncertain its pose is."""

import cmath
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plain_rooms import empty, scan_of, with_border
from vb_core.robot_profile import Limits, RobotProfile
from vb_robot.driving.command_gate import CLEARANCES, TELEOP, CommandGate
from vb_robot.driving.scan_clearance import Clearance, Fix, arc_positions, lowest_speed_limit, pose_jump, safe_speed, stop_distance
from vb_robot.driving.velocity import VelocityRequest
from vb_robot.driving.workspace import MAX_UNCERTAINTY, MIN_UNCERTAINTY, UNCERTAINTY_UPDATES, PoseUncertainty, Workspace

LIMITS, RADIUS, KEEP = Limits(), 0.18, Clearance(0.12, 0.04, 0.05)


@given(st.floats(-0.5, 2.0), st.floats(0.1, 0.5))
def test_safe_speed_stops_in_time(free, delay):
    v = safe_speed(free, LIMITS, delay)
    assert stop_distance(v, LIMITS, delay) == stop_distance(-v, LIMITS, delay)
    assert stop_distance(v, LIMITS, delay) == pytest.approx(max(free, 0.0), abs=1e-9)
    assert stop_distance(v, LIMITS, delay) == pytest.approx(v * delay + v * v / 3.0)


@pytest.mark.parametrize("reading, no_return", [(0.0, "zero"), (math.nan, "nan")])
def test_a_profile_says_which_range_means_no_echo(reading, no_return):
    ranges = np.full(360, reading)
    assert scan_of(ranges, no_return=no_return).free_distance(0.2, 0.0, RADIUS, KEEP) == math.inf
    assert scan_of(ranges, no_return=no_return).sees_path(0.2, 0.0, RADIUS, 0.05)
    by_default = scan_of(ranges)
    assert by_default.free_distance(0.2, 0.0, RADIUS, KEEP) <= 0.0 or not by_default.sees_path(0.2, 0.0, RADIUS, 0.05)


@pytest.mark.parametrize("room", [0.05, 0.1])
@pytest.mark.parametrize("age", [0.0, 0.1, 0.25])
def test_a_robot_stops_before_what_it_saw_however_old_the_scan(age, room):
    gate, ranges = CommandGate(RobotProfile()), np.full(360, math.inf)
    ranges[178:182] = RADIUS + CLEARANCES[TELEOP].ahead + room  # straight ahead
    gate.set_scan(scan_of(ranges), 10.0)
    v, _, code = gate.limit(10.0 + age, TELEOP, VelocityRequest(1.0, 0.0, "driving"))
    # it has moved since the scan, and moves on until the next command reaches the wheels
    moving = max(age + 1.0 / 20.0 + 0.02, 0.15)
    assert code == "obstacle" and v * moving + v * v / (2.0 * LIMITS.deceleration) == pytest.approx(room, abs=0.005)


@given(st.floats(1.5, 3.5), st.floats(0.0, 1.0), st.integers(-45, 45), st.integers(-45, 45))
def test_speed_limits_count_within_the_stop_distance(x, reach, up, right):
    zones = empty(5.0, 5.0)
    row, column = zones.world_to_cell((x, 2.5))[0] + (up, right)
    zones.data[row, column] = 20
    gap = math.dist((x, 2.5), zones.cell_to_world(np.array([[row, column]]))[0])
    assert lowest_speed_limit(zones, (x, 2.5), reach) == (0.2 if gap <= reach + 2.0 * 0.025 else math.inf)


def test_the_lower_of_two_speed_limits_counts():
    zones = with_border(with_border(empty(), 3.0, 1.0, 4.0, 2.0, 20), 4.0, 1.0, 5.0, 2.0, 10)
    for place, limit in (((1.0, 1.5), math.inf), ((2.6, 1.5), 0.2), ((3.8, 1.5), 0.1), ((-5.0, 1.0), math.inf)):
        assert lowest_speed_limit(zones, place, 0.5) == pytest.approx(limit)


def test_arc_closes_a_circle():
    assert np.allclose(arc_positions((1.0, 2.0, 0.5), np.array([2 * math.pi * 0.7]), 1 / 0.7), [[1.0, 2.0]], atol=1e-9)
    assert np.allclose(arc_positions((1.0, 2.0, math.pi / 2), np.array([0.5, -0.5]), 0.0), [[1.0, 2.5], [1.0, 1.5]])


POSES = st.tuples(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.floats(-3.0, 3.0))


@given(POSES, POSES, st.one_of(st.none(), st.tuples(POSES, POSES)), st.floats(0.01, 2.0))
def test_a_jump_is_what_odometry_or_top_speed_cannot_explain(earlier, later, odometry, seconds):
    """A turn of 1 rad counts as 0.5 m; without odometry, motion of 1 m/s and 3 rad/s is allowed. In complex numbers."""
    (p, turned_p), (q, turned_q) = ((complex(x, y), cmath.rect(1.0, yaw)) for x, y, yaw in (earlier, later))
    moved, turned, spare = 0.0, 1.0, seconds
    if odometry is not None:
        (a, turned_a), (b, turned_b) = ((complex(x, y), cmath.rect(1.0, yaw)) for x, y, yaw in odometry)
        moved, turned, spare = (b - a) / turned_a * turned_p, turned_b / turned_a, 0.0
    distance, angle = abs(q - p - moved), abs(cmath.phase(turned_q / turned_p / turned))
    fixes = zip((10.0, 10.0 + seconds), (earlier, later), odometry or 2 * [None])
    jump = pose_jump(*(Fix(*fix) for fix in fixes))
    assert jump == pytest.approx(max(0.0, distance - spare) + 0.5 * max(0.0, angle - 3.0 * spare), abs=1e-9)


# ------------------------------------------------------------ maps and places
def workspace(value=100):
    """Returns a workspace with a square border and a wall, and its physical map."""
    physical = with_border(empty(6.0, resolution=0.05), 3.0, 0.0, 3.05, 5.0)
    return Workspace(with_border(physical, 0.5, 0.5, 1.5, 1.5, value), physical, 0.18), physical


def test_a_map_lets_a_robot_out_but_not_further_in():
    ground = Workspace(with_border(empty(), 4.0, 0.0, 8.0, 5.0), empty(), 0.18)
    assert ground.free_distance((3.0, 2.5, 0.0), 0.2, 0.0, 0.05) == pytest.approx(1.0 - 0.18 - 0.05, abs=0.04)
    assert ground.free_distance((3.9, 2.5, 0.0), 0.2, 0.0, 0.05) <= 0.04
    assert ground.free_distance((3.9, 2.5, 0.0), -0.2, 0.0, 0.05) == math.inf


def test_borders_but_not_walls_grow_by_the_pose_uncertainty():
    plain, physical = workspace()
    uncertain = Workspace(plain.borders, physical, 0.18, uncertainty=0.1)
    beside_border, beside_wall = (2.0, 1.0, math.pi), (2.4, 4.0, 0.0)
    for pose, loss in ((beside_border, 0.1), (beside_wall, 0.0)):
        plain_distance, distance = (ground.free_distance(pose, 0.2, 0.0, 0.0) for ground in (plain, uncertain))
        assert plain_distance - distance == pytest.approx(loss, abs=0.03)
    soft = Workspace(workspace(75)[0].borders, physical, 0.18, uncertainty=0.1)
    assert np.array_equal(soft.keep_out.data, soft.borders.data), "what may be entered is not made larger"


def test_navigations_map_has_what_the_driver_keeps_out_of():
    plain, physical = workspace()
    data = plain.borders.data.copy()
    data[31:, :] = -1
    physical = physical.with_data(np.minimum(data, physical.data))
    ground = Workspace(plain.borders.with_data(data), physical, 0.18, uncertainty=0.1)
    grown = ground.keep_out.data != ground.borders.data
    assert grown.any() and (ground.keep_out.data[grown] == 100).all() and (ground.borders.data[grown] == 0).all()
    assert (ground.keep_out.data[data < 0] == -1).all(), "unknown floor stays unknown: navigation does not plan there"


def spread(std, turned=np.eye(2)):
    """Returns the covariance (3, 3) of x, y and yaw, with std (2,) [m] along rotated axes."""
    covariance = np.diag([0.0, 0.0, 0.01])
    covariance[:2, :2] = turned @ np.diag(std) ** 2 @ turned.T
    return covariance


def test_the_uncertainty_rises_at_once_and_falls_slowly():
    uncertainty = PoseUncertainty()
    assert uncertainty.meters == MIN_UNCERTAINTY, "without a covariance"
    assert not uncertainty.add(spread([0.01, 0.005])) and uncertainty.meters == MIN_UNCERTAINTY
    turned = np.array([[0.5, 0.5], [-0.5, 0.5]]) * math.sqrt(2.0)
    assert uncertainty.add(spread([0.12, 0.005], turned)), "the worst direction, in steps"
    assert uncertainty.meters == pytest.approx(0.075)
    changed = [uncertainty.add(spread([0.01, 0.01])) for _ in range(UNCERTAINTY_UPDATES)]
    assert changed == [False] * (UNCERTAINTY_UPDATES - 1) + [True] and uncertainty.meters == MIN_UNCERTAINTY
    assert not uncertainty.lost
    uncertainty.add(np.full((3, 3), math.nan))
    assert uncertainty.meters == MAX_UNCERTAINTY, "what makes no sense is no reason to come nearer"


@pytest.mark.parametrize(
    "covariance, lost",
    [
        (np.diag([0.1, 0.1, 0.1]) ** 2, False),
        (np.diag([3.0, 0.1, 0.1]) ** 2, True),
        (np.diag([0.1, 0.1, 1.0]) ** 2, True),
        (np.full((3, 3), math.nan), True),
        (np.diag([0.01, 0.01, math.nan]), True),
        (np.diag([0.01, 0.01, -1.0]), True),
    ],
)
def test_a_localisation_that_may_be_anywhere_is_lost(covariance, lost):
    uncertainty = PoseUncertainty()
    uncertainty.add(covariance)
    assert uncertainty.lost == lost
    uncertainty.add(np.diag([0.05, 0.05, 0.05]) ** 2)
    assert not uncertainty.lost
