"""What a scan, a map and a map of speed limits let a robot do, and how uncertain its pose is."""

import cmath
import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from examples import STEADY, off_thresholds
from plain_rooms import empty, scan_of, with_border
from vb_core import geometry
from vb_core.robot_profile import Limits, RobotProfile
from vb_robot.driving import localization
from vb_robot.driving.command_gate import REQUIRED_GAPS, TELEOP, CommandGate
from vb_robot.driving.scan_clearance import RequiredGaps, safe_speed, stop_distance
from vb_robot.driving.velocity import VelocityRequest
from vb_robot.driving.workspace import Workspace, lowest_speed_limit

LIMITS, RADIUS, KEEP = Limits(), 0.18, RequiredGaps(0.12, 0.04, 0.05)


@settings(STEADY, max_examples=300)
@given(
    st.lists(st.tuples(off_thresholds(-1.1, 1.1), off_thresholds(-0.35, 0.35)), min_size=1, max_size=6),
    st.sampled_from([1, -1]),
    st.sampled_from([0.0, 1.0, -1.0, 1.0 / 0.36, -1.0 / 0.36, 1.0 / 0.24]),
)
def test_the_free_distance_ends_where_a_round_robot_meets_a_point(places, direction, bend):
    """Places are (distance along the arc, distance to its left) [m] of points. Arcs of less than 0.3 m count as straight."""
    along, across = np.transpose(places)
    driven = bend if abs(bend) < 1.0 / 0.3 else 0.0  # [1/m]
    yaw = direction * driven * along
    scan = scan_of([0.0], 0.0, 0.01)
    scan.points = geometry.arc_positions((0.0, 0.0, 0.0), direction * along, driven)
    scan.points += across[:, None] * np.column_stack([-np.sin(yaw), np.cos(yaw)])
    ahead = along > 0.0
    driven_to = np.linspace(0.0, 1.5, 3001)
    met = (np.hypot(along[ahead, None] - driven_to, across[ahead, None]) < 0.18 + 0.04).any(axis=0)
    expected = driven_to[np.argmax(met)] - 0.12 + 0.04 if met.any() else math.inf
    distance = scan.free_distance(0.2 * direction, 0.2 * direction * bend, 0.18, RequiredGaps(0.12, 0.04, 0.05))
    assert max(distance, 0.04 - 0.12) == pytest.approx(expected, abs=1e-3), "a point beside its nose counts as touched"


@pytest.mark.parametrize("v", [0.2, -0.2])
@pytest.mark.parametrize(
    "w, needed, edge", [(0.0, 0.0, 6.4), (0.4, 0.0, 23.6), (-0.4, 0.0, 23.6), (0.4, 0.3, 33.9), (10.0, 0.0, 96.4)]
)
def test_beams_must_reach_along_the_arc_but_for_a_gap(v, w, needed, edge):
    """The robot's half width at 0.98 m is 10.4 deg, a hole may be 4 deg; an arc bends by half its turn within 0.3 m."""
    mount = geometry.make_transform(np.diag([math.copysign(1.0, v)] * 2 + [1.0]), (0.0, 0.0, 0.0))
    for half, seen in ((edge - 0.7, False), (edge + 0.7, True)):
        number = 2 * int(half * 10) + 1
        scan = scan_of(np.full(number, math.inf), -math.radians(half), math.radians(0.1), mount)
        assert scan.sees_path(v, w, 0.18, needed) is seen


@pytest.mark.parametrize("v", [0.2, -0.2])
@pytest.mark.parametrize("w, seen", [(0.4, True), (-0.4, False)])
def test_beams_to_its_left_show_the_arc_to_the_left(v, w, seen):
    """Relative to the direction of travel: 17 deg off straight on, backwards as forwards."""
    mount = geometry.make_transform(np.diag([math.copysign(1.0, v)] * 2 + [1.0]), (0.0, 0.0, 0.0))
    scan = scan_of(np.full(36, math.inf), math.radians(5.0), math.radians(1.0), mount)
    assert scan.sees_path(v, w, 0.18, 0.0) is seen


@settings(STEADY)
@given(
    st.lists(st.tuples(st.integers(0, 399), st.integers(1, 40)), max_size=6),
    st.lists(st.integers(0, 399), max_size=3),
    st.integers(-200, 199),
    st.integers(3, 60),
)
def test_a_covered_sector_has_beams_to_its_edges_and_no_hole(holes, alone, bearing, half):
    """In degrees, with beams 0.9 apart; at an edge, as elsewhere, four degrees may be dark."""
    ranges = np.full(400, math.inf)
    bearing, half = 0.9 * bearing + 0.45, 0.9 * half + 0.2
    for begin, wide in holes:
        ranges[np.arange(begin, begin + wide) % 400] = math.nan
    ranges[alone] = math.inf
    offsets = [(0.9 * beam - bearing) % 360.0 - 180.0 for beam in np.flatnonzero(np.isinf(ranges))]
    inside = sorted(offset for offset in offsets if abs(offset) <= half + 4.0)
    gaps = np.diff([-half, *inside, half])
    scan = scan_of(ranges, -math.pi, math.radians(0.9))
    assert scan.covers(math.radians(bearing), math.radians(half)) == bool((gaps <= 4.0).all())


@pytest.mark.parametrize("nans, step, covered", [(3, 1.0, True), (4, 1.0, False), (2, 3.0, True), (3, 3.0, False)])
def test_a_hole_of_four_degrees_or_three_beams_hides_nothing(nans, step, covered):
    beams = int(360 / step)
    ranges = np.full(beams, math.inf)
    ranges[beams // 2 : beams // 2 + nans] = math.nan
    assert scan_of(ranges, -math.pi, math.radians(step)).covers(0.0, 0.3) is covered
    assert scan_of(ranges, -math.pi, math.radians(step)).covers(math.pi, 0.3)


def along_y(y):
    """Returns the mount of a scanner that looks along +y from a point [m] on that axis."""
    return geometry.make_transform(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), (0.0, y, 0.2))


@pytest.mark.parametrize(
    "radius, distances, counts",
    [
        (0.18, [0.16, 7.7], True),
        (0.18, [0.14, 7.9], False),
        (0.25, [0.225], True),
        (0.25, [0.215], False),
        (0.05, [0.022], True),
        (0.05, [0.015], False),
        (0.02, [0.001], True),  # a robot smaller than the margin takes no echo for its own part
    ],
)
def test_an_echo_counts_in_range_and_outside_the_robots_own_parts(radius, distances, counts):
    for distance in distances:
        points = scan_of([distance + 0.2], 0.0, 0.01, along_y(-0.2), radius).points
        assert points == pytest.approx(np.array([[0.0, distance]] if counts else np.zeros((0, 2))))


@pytest.mark.parametrize("scanner_y, point", [(0.0, 0.18), (0.3, 0.35)])
def test_an_echo_too_near_to_measure_touches_robot_or_scanner(scanner_y, point):
    mount = along_y(scanner_y)
    assert scan_of([0.05], 0.0, 0.01, mount).points[0] == pytest.approx([0.0, point])
    assert scan_of([-math.inf], 0.0, 0.01, mount).points[0] == pytest.approx([0.0, max(scanner_y, 0.18)])


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
    gate = CommandGate(RobotProfile())
    ranges = np.full(360, math.inf)
    ranges[178:182] = RADIUS + REQUIRED_GAPS[TELEOP].ahead + room  # straight ahead
    gate.set_scan(scan_of(ranges), 10.0)
    v, _, code = gate.limit(10.0 + age, TELEOP, VelocityRequest(1.0, 0.0, "driving"))
    # it has moved since the scan, and moves on until the next command reaches the wheels
    moving = max(age + 1.0 / 20.0 + 0.02, 0.15)
    assert code == "obstacle"
    assert v * moving + v * v / (2.0 * LIMITS.deceleration) == pytest.approx(room, abs=0.005)


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


POSES = st.tuples(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.floats(-3.0, 3.0))


@given(POSES, POSES, st.one_of(st.none(), st.tuples(POSES, POSES)), st.floats(0.01, 2.0))
def test_a_jump_is_what_odometry_or_top_speed_cannot_explain(earlier, later, odometry, seconds):
    """A turn of 1 rad counts as 0.5 m; without odometry, motion of 1 m/s and 3 rad/s is allowed. In complex numbers."""
    (p, turned_p), (q, turned_q) = ((complex(x, y), cmath.rect(1.0, yaw)) for x, y, yaw in (earlier, later))
    moved, turned, spare = 0.0, 1.0, seconds
    if odometry is not None:
        (a, turned_a), (b, turned_b) = ((complex(x, y), cmath.rect(1.0, yaw)) for x, y, yaw in odometry)
        moved, turned = (b - a) / turned_a * turned_p, turned_b / turned_a
        spare = 0.0
    distance, angle = abs(q - p - moved), abs(cmath.phase(turned_q / turned_p / turned))
    fixes = zip((10.0, 10.0 + seconds), (earlier, later), odometry or 2 * [None])
    jump = localization.pose_jump(*(localization.Fix(*fix) for fix in fixes))
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
    assert set(ground.borders.data[grown]) == {0}
    assert set(ground.keep_out.data[grown]) == {100}
    assert (ground.keep_out.data[data < 0] == -1).all(), "unknown floor stays unknown: navigation does not plan there"


def covariance_of(std, turned=np.eye(2)):
    """Returns the covariance (3, 3) of x, y and yaw, with std (2,) [m] along rotated axes."""
    covariance = np.diag([0.0, 0.0, 0.01])
    covariance[:2, :2] = turned @ np.diag(std) ** 2 @ turned.T
    return covariance


def test_the_uncertainty_rises_at_once_and_falls_slowly():
    uncertainty = localization.PoseUncertainty()
    assert uncertainty.meters == localization.MIN_UNCERTAINTY, "without a covariance"
    assert not uncertainty.add(covariance_of([0.01, 0.005]))
    assert uncertainty.meters == localization.MIN_UNCERTAINTY
    turned = np.array([[0.5, 0.5], [-0.5, 0.5]]) * math.sqrt(2.0)
    assert uncertainty.add(covariance_of([0.12, 0.005], turned)), "the worst direction, in steps"
    assert uncertainty.meters == pytest.approx(0.075)
    changed = [uncertainty.add(covariance_of([0.01, 0.01])) for _ in range(localization.UNCERTAINTY_UPDATES)]
    assert changed == [False] * (localization.UNCERTAINTY_UPDATES - 1) + [True]
    assert uncertainty.meters == localization.MIN_UNCERTAINTY
    assert not uncertainty.lost
    uncertainty.add(np.full((3, 3), math.nan))
    assert uncertainty.meters == localization.MAX_UNCERTAINTY, "what makes no sense is no reason to come nearer"


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
    uncertainty = localization.PoseUncertainty()
    uncertainty.add(covariance)
    assert uncertainty.lost == lost
    uncertainty.add(np.diag([0.05, 0.05, 0.05]) ** 2)
    assert not uncertainty.lost
