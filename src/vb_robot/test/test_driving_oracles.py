"""Driving, against oracles worked out by hand or written a second time, more simply."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from driving_rig import PROFILE, Rig
from examples import STEADY, off_thresholds
from plain_rooms import empty, scan_of, with_border

from vb_core import geometry
from vb_core.navigation_parameters import PATH_MARGIN
from vb_core.robot_profile import RobotProfile, Scanner
from vb_robot.driving.arbiter import Arbiter
from vb_robot.driving.escape import Escape
from vb_robot.driving.gate import ESCAPE, FOLLOW, NAVIGATION, NONE, TELEOP, Gate
from vb_robot.driving.safety import Clearance, arc
from vb_robot.driving.spot_follower import SpotFollower, VelocityRequest
from vb_robot.driving.workspace import Workspace

RADIUS = PROFILE.radius


# ------------------------------------------------------------ following
class Law:
    """The law of following, with hysteresis: nearer from 1.3 to 1 m, back from 0.75 to 0.9 m, turn from 14 to 4 deg."""

    def __init__(self):
        self.drives, self.turns = 0, False

    def request(self, distance, bearing):
        off = abs(math.degrees(bearing))
        self.turns = off > 14.0 or (self.turns and off >= 4.0)
        ended = (self.drives == 1 and distance <= 1.0) or (self.drives == -1 and distance >= 0.9)
        self.drives = 1 if distance > 1.3 else -1 if distance < 0.75 else 0 if ended else self.drives
        wanted = 0.8 * (distance - 0.95)
        v = {0: 0.0, -1: wanted, 1: wanted * max(0.0, 1.0 - abs(math.degrees(bearing)) / 25.0)}[self.drives]
        w = float(np.clip(1.8 * bearing, -0.8, 0.8)) if self.drives == 1 or self.turns else 0.0
        return VelocityRequest(float(np.clip(v, -0.2, 0.2)), w, "driving" if v != 0.0 or w != 0.0 else "spot_in_view")


SPOT = st.tuples(off_thresholds(0.4, 1.7), off_thresholds(-0.8, 0.8))


@settings(STEADY, max_examples=80)
@given(st.lists(st.one_of(SPOT, SPOT, SPOT, st.sampled_from(["no spot", "no pose"])), min_size=5, max_size=30))
def test_the_follower_obeys_its_law_and_restarts_after_a_loss(spots):
    follower, law = SpotFollower(), Law()
    for spot in spots:
        if isinstance(spot, str):
            follower.spot, law, wanted = (
                None if spot == "no spot" else (2.0, 0.0),
                Law(),
                VelocityRequest(0.0, 0.0, "spot_lost"),
            )
        else:
            distance, bearing = spot
            follower.spot, wanted = (distance * math.cos(bearing), distance * math.sin(bearing)), law.request(*spot)
        found = follower.compute_request(None if spot == "no pose" else (0.0, 0.0, 0.0))
        assert (found.v, found.w, found.code) == (pytest.approx(wanted.v), pytest.approx(wanted.w), wanted.code)


# ------------------------------------------------------------ escaping
class Pinched:
    """A workspace with its nearest obstacle `gap` [m] from the robot's rim, and its nearest free place at `place`."""

    def __init__(self, gap, place=(0.3, 0.0)):
        self.gap, self.place, self.asked = gap, place, []

    def distance_to_blocked(self, _pose):
        return RADIUS + self.gap

    def nearest_room(self, _pose, clearance, reach):
        self.asked.append((clearance, reach))
        return None if self.place is None else np.array(self.place)


def ask(escape, workspace, *times, goal=True, moves=False):
    """Returns for each of these times [s] whether the robot is helped."""
    return [escape.compute_request(now, (0.0, 0.0, 0.0), workspace, goal, moves) is not None for now in times]


@pytest.mark.parametrize(
    "gap, helped", [(0.019, 1), (0.021, 0), (-PATH_MARGIN - RADIUS + 0.001, 1), (-PATH_MARGIN - RADIUS - 0.001, 0)]
)
def test_escape_begins_near_an_obstacle_and_ends_farther_away(gap, helped):
    """A robot whose centre is inside an obstacle is not helped."""
    workspace, escape = Pinched(PATH_MARGIN + gap), Escape(RADIUS)
    assert ask(escape, workspace, 100.0, 101.4, 101.5, 102.0) == [False, False, helped, helped]
    workspace.gap = PATH_MARGIN + 0.039
    assert ask(escape, workspace, 102.1) == [helped]
    workspace.gap = PATH_MARGIN + 0.041
    assert ask(escape, workspace, 102.2) == [False]
    assert workspace.asked == [(pytest.approx(RADIUS + PATH_MARGIN + 0.09), 0.5)] * helped


@pytest.mark.parametrize("place", [(0.3, 0.0), None])
def test_escape_lasts_ten_seconds_and_then_rests_for_twenty(place):
    escape, workspace = Escape(RADIUS), Pinched(0.0, place)
    helped = place is not None
    assert ask(escape, workspace, 100.0, 101.5, 111.4, 111.6) == [False, helped, helped, False]
    assert ask(escape, workspace, 115.0, 131.4, 131.6, 141.5, 141.7) == [False, False, helped, helped, False]
    assert len(workspace.asked) == 2


def test_escape_also_rests_after_the_robot_was_free_for_a_moment():
    escape, workspace = Escape(RADIUS), Pinched(0.0)
    assert ask(escape, workspace, 100.0, 101.5) == [False, True]
    workspace.gap = 1.0
    assert ask(escape, workspace, 101.6) == [False]
    workspace.gap = 0.0
    assert ask(escape, workspace, 101.7, 131.4, 131.6) == [False, False, True]


def test_escape_waits_but_does_not_rest_after_time_was_set_back():
    escape, workspace = Escape(RADIUS), Pinched(0.0)
    assert ask(escape, workspace, 100.0, 101.5, 101.2) == [False, True, False]
    assert ask(escape, workspace, 99.7, 101.1, 101.3) == [False, False, True]


def test_a_robot_that_moves_or_has_no_goal_begins_to_wait_again():
    for given_ in ({"moves": True}, {"goal": False}):
        escape, workspace = Escape(RADIUS), Pinched(0.0)
        ask(escape, workspace, 100.0)
        ask(escape, workspace, 101.0, **given_)
        assert ask(escape, workspace, 102.4, 102.6) == [False, True]
    escape.interrupt(103.0)
    assert ask(escape, workspace, 104.4, 104.6) == [False, True], "and the rest is forgotten with the place"


@pytest.mark.parametrize("distance, v", [(0.01, 0.038), (0.1, 0.11), (0.5, 0.2)])
@pytest.mark.parametrize("bearing, share, w", [(0.0, 1.0, 0.0), (12.5, 0.5, 0.3927), (-30.0, 0.0, -0.8)])
def test_escape_drives_to_the_place_and_slows_down_before_it(distance, v, bearing, share, w):
    angle, yaw = math.radians(bearing), 3.0
    place = (1.0 + distance * math.cos(yaw + angle), 2.0 + distance * math.sin(yaw + angle))
    escape, workspace = Escape(RADIUS), Pinched(0.0, place)
    for now in (100.0, 101.5):
        request = escape.compute_request(now, (1.0, 2.0, yaw), workspace, True, False)
    assert (request.v, request.w) == (pytest.approx(share * v), pytest.approx(w, abs=1e-3))


# ------------------------------------------------------------ who drives
def test_a_new_listener_hears_zeros_for_three_seconds():
    arbiter = Arbiter(PROFILE)

    def published(*times, listeners=1):
        return [arbiter.step(now, listeners).publish for now in times]

    assert published(9.0, listeners=0) == [False]
    assert published(10.0, 12.9, 13.1) == [True, True, False]
    assert published(14.0, listeners=2) == [True] and published(14.5, 17.1) == [True, False], "one of them left"
    assert published(20.0, listeners=2) == [True]
    arbiter.request(TELEOP, 0.0, 0.0, 20.5)
    assert published(20.5, 21.2, 21.3, listeners=2) == [True, True, False], "its end, and no zeros after it"


@pytest.mark.parametrize("age, drives", [(-0.11, False), (-0.09, True), (0.49, True), (0.51, False)])
@pytest.mark.parametrize("source", [TELEOP, NAVIGATION])
def test_a_command_expires_after_half_a_second(source, age, drives):
    arbiter = Arbiter(PROFILE)
    arbiter.request(source, 0.1, 0.0, 50.0)
    assert (arbiter.step(50.0 + age).source == source) is drives


@pytest.mark.parametrize("age, cancels", [(-0.1, False), (0.0, True), (0.9, True), (1.1, False)])
def test_following_cancels_a_goal_reported_within_a_second(age, cancels):
    rig = Rig().follows()
    rig.arbiter.set_goal(True, rig.now)
    assert rig.arbiter.step(rig.now + age).cancel is cancels
    rig.arbiter.set_goal(False, rig.now)
    assert not rig.arbiter.step(rig.now + age + 2.0).cancel


def test_halting_stops_the_robot_with_the_faults_code():
    halted = Rig().drives().arbiter.halt("fault")
    assert (halted.v, halted.w, halted.source, halted.code, halted.publish) == (0.0, 0.0, "navigation", "fault", True)


# ------------------------------------------------------------ the scan
@settings(STEADY, max_examples=300)
@given(
    st.lists(st.tuples(off_thresholds(-1.1, 1.1), off_thresholds(-0.35, 0.35)), min_size=1, max_size=6),
    st.sampled_from([1, -1]),
    st.sampled_from([0.0, 1.0, -1.0, 1.0 / 0.36, -1.0 / 0.36, 1.0 / 0.24]),
)
def test_the_free_distance_ends_where_a_round_robot_meets_a_point(places, direction, bend):
    """The distance is along its arc; a radius below 0.3 m counts as driving straight on.

    Args:
        places: (distance along the arc, distance to its left) [m] of each point.
        bend: curvature [1/m] of the arc.
    """
    (along, across), driven = np.transpose(places), bend if abs(bend) < 1.0 / 0.3 else 0.0
    scan, yaw = scan_of([0.0], 0.0, 0.01), direction * driven * along
    scan.points = arc((0.0, 0.0, 0.0), direction * along, driven)
    scan.points += across[:, None] * np.column_stack([-np.sin(yaw), np.cos(yaw)])
    width, driven_to, ahead = 0.18 + 0.04, np.linspace(0.0, 1.5, 3001), along > 0.0
    met = (np.hypot(along[ahead, None] - driven_to, across[ahead, None]) < width).any(axis=0)
    wanted = driven_to[np.argmax(met)] - 0.12 + 0.04 if met.any() else math.inf
    found = scan.free_distance(0.2 * direction, 0.2 * direction * bend, 0.18, Clearance(0.12, 0.04, 0.05))
    assert max(found, 0.04 - 0.12) == pytest.approx(wanted, abs=1e-3), "what is beside its nose is as good as touched"


@pytest.mark.parametrize("v", [0.2, -0.2])
@pytest.mark.parametrize(
    "w, needed, edge", [(0.0, 0.0, 6.4), (0.4, 0.0, 23.6), (-0.4, 0.0, 23.6), (0.4, 0.3, 33.9), (10.0, 0.0, 96.4)]
)
def test_beams_must_reach_along_the_arc_but_for_a_gap(v, w, needed, edge):
    """The robot's half width at 0.98 m is 10.4 deg, a hole may be 4 deg; an arc bends by half its turn within 0.3 m."""
    mount = geometry.transform(np.diag([math.copysign(1.0, v)] * 2 + [1.0]), (0.0, 0.0, 0.0))
    for half, seen in ((edge - 0.7, False), (edge + 0.7, True)):
        number = 2 * int(half * 10) + 1
        scan = scan_of(np.full(number, math.inf), -math.radians(half), math.radians(0.1), mount)
        assert scan.sees_path(v, w, 0.18, needed) is seen


@pytest.mark.parametrize("v", [0.2, -0.2])
@pytest.mark.parametrize("w, seen", [(0.4, True), (-0.4, False)])
def test_beams_to_its_left_show_the_arc_to_the_left(v, w, seen):
    """Relative to the direction of travel: 17 deg off straight on, backwards as forwards."""
    mount = geometry.transform(np.diag([math.copysign(1.0, v)] * 2 + [1.0]), (0.0, 0.0, 0.0))
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
    ranges, bearing, half = np.full(400, math.inf), 0.9 * bearing + 0.45, 0.9 * half + 0.2
    for begin, wide in holes:
        ranges[np.arange(begin, begin + wide) % 400] = math.nan
    ranges[alone] = math.inf
    off = [(0.9 * beam - bearing) % 360.0 - 180.0 for beam in np.flatnonzero(np.isinf(ranges))]
    off = sorted(one for one in off if abs(one) <= half + 4.0)
    covered = bool(off) and off[0] <= 4.0 - half and off[-1] >= half - 4.0 and all(np.diff(off) <= 4.0)
    assert scan_of(ranges, -math.pi, math.radians(0.9)).covers(math.radians(bearing), math.radians(half)) == covered


@pytest.mark.parametrize("nans, step, covered", [(3, 1.0, True), (4, 1.0, False), (2, 3.0, True), (3, 3.0, False)])
def test_a_hole_of_four_degrees_or_three_beams_hides_nothing(nans, step, covered):
    beams = int(360 / step)
    ranges = np.full(beams, math.inf)
    ranges[beams // 2 : beams // 2 + nans] = math.nan
    assert scan_of(ranges, -math.pi, math.radians(step)).covers(0.0, 0.3) is covered
    assert scan_of(ranges, -math.pi, math.radians(step)).covers(math.pi, 0.3)


def along_y(y):
    """Returns the mount of a scanner that looks along +y from a point [m] on that axis."""
    return geometry.transform(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), (0.0, y, 0.2))


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


@pytest.mark.parametrize("at, point", [(0.0, 0.18), (0.3, 0.35)])
def test_an_echo_too_near_to_measure_touches_robot_or_scanner(at, point):
    mount = along_y(at)
    assert scan_of([0.05], 0.0, 0.01, mount).points[0] == pytest.approx([0.0, point])
    assert scan_of([-math.inf], 0.0, 0.01, mount).points[0] == pytest.approx([0.0, max(at, 0.18)])


# ------------------------------------------------------------ the gate
def knowing_gate(profile=PROFILE, ranges=math.inf, fov=360, inside=False, touched="", speed_limits=None):
    """Returns a gate with all its inputs at 10 s."""
    gate = Gate(profile)
    gate.workspace = Workspace(with_border(empty(), 0.0, 0.0, 8.0 * inside, 5.0), empty(), profile.radius)
    gate.speed_limits = speed_limits
    for number, blocks in enumerate(("forward", touched, "")):
        gate.set_contact(("bumper", number), blocks)
    gate.set_contact(("bumper", 0), "")
    gate.set_scan(scan_of(np.full(fov, ranges), -math.radians(fov // 2), math.radians(1.0)), 10.0)
    gate.record_input("state", 10.0)
    gate.set_pose((4.0, 2.5, 0.0), 10.0)
    return gate


@settings(STEADY)
@given(st.floats(0.0, 0.48), st.floats(0.05, 0.3), st.floats(-3.0, 3.0), st.sampled_from(["scan", "state", "pose"]))
def test_the_brakes_can_end_a_command_before_an_input_is_too_old(age, v, w, what):
    gate, limits = knowing_gate(), PROFILE.limits
    for other in {"scan", "state", "pose"} - {what}:
        gate.stamps[other] = 10.0 + age
    left = 0.5 - 1.0 / 20.0 - 0.02 - age
    turn = min(max(w, -limits.max_turn_rate), limits.max_turn_rate)
    share = min(1.0, left / max(v / limits.deceleration, abs(turn) / limits.turn_acceleration))
    found = gate.limit(10.0 + age, NAVIGATION, VelocityRequest(v, w, "driving"))
    if left <= 0.0:
        assert found == (0.0, 0.0, f"{what}_lost")
    elif share > 0.0 and v <= 0.25:
        assert found == (pytest.approx(share * v), pytest.approx(share * turn), "driving")


def test_a_missing_input_is_named_and_a_joystick_needs_only_the_scan():
    wish = VelocityRequest(0.1, 0.0, "driving")
    for lose, code in (
        (lambda gate: setattr(gate, "workspace", None), "no_map"),
        (lambda gate: setattr(gate, "pose_uncertain", True), "pose_uncertain"),
        (lambda gate: gate.set_pose(None, 10.0), "pose_lost"),
        (lambda gate: gate.set_pose((4.0, 3.5, 0.0), 10.0, 0.0, (0.0, 0.0, 0.0)), "pose_jumped"),
        (lambda gate: gate.stamps.pop("state"), "state_lost"),
        (lambda gate: gate.stamps.update(spot=8.0), "driving"),
    ):
        gate = knowing_gate()
        lose(gate)
        assert gate.limit(10.0, NAVIGATION, wish)[2] == code
        assert gate.limit(10.0, TELEOP, wish) == (0.1, 0.0, "driving")
    assert gate.limit(10.0, FOLLOW, wish) == (0.0, 0.0, "spot_lost")
    gate.stamps.pop("spot")
    assert gate.limit(10.0, FOLLOW, wish) == (0.0, 0.0, "spot_lost"), "also if there never was one"
    gate.clock_age = 0.6
    assert gate.limit(10.0, TELEOP, wish) == (0.0, 0.0, "clock_stopped")
    gate = Gate(PROFILE)
    assert gate.limit(10.0, TELEOP, wish) == (0.0, 0.0, "scan_lost")
    gate.set_scan(scan_of(np.full(360, math.inf)), 10.0)
    assert gate.limit(10.0, TELEOP, wish) == (0.1, 0.0, "driving")


@pytest.mark.parametrize(
    "source, ahead, sides, cells",
    [
        ("teleop", 0.05, 0.02, 0.0),
        ("follow", 0.12, 0.04, 0.06),
        ("escape", 0.12, 0.04, 0.05),
        ("navigation", 0.04, 0, -0.04),
    ],
)
def test_each_source_keeps_its_own_clearances(source, ahead, sides, cells):
    def drives(point, border=9.0):
        gate = knowing_gate()
        gate._scan.points = np.array([point])
        floor = empty(resolution=0.01)
        gate.workspace = Workspace(with_border(floor, border, 0.0, 8.0, 5.0), floor, RADIUS)
        gate.stamps["spot"] = 10.0
        return gate.limit(10.0, source, VelocityRequest(0.1, 0.0, "driving"))[0] > 0.0

    for more in (-0.015, 0.015):  # the lowest permitted speed stops within 1 cm, and a cell is 1 cm
        assert drives((RADIUS + ahead + more, 0.0)) is (more > 0.0)
        assert drives((0.02, -RADIUS - sides - more)) is (more > 0.0)
        assert drives((-1.0, 0.0), 4.0 + RADIUS + cells + 0.01 + more) is (more > 0.0)


SLOW = empty().with_data(np.full(empty().shape, 20, np.int8))  # 0.2 m/s everywhere
BLIND = RobotProfile(scanner=Scanner(present=False))
LAZY = PROFILE.replace(limits=PROFILE.limits.replace(max_speed=0.1))


@pytest.mark.parametrize(
    "source, gate, wish, found",
    [
        (NAVIGATION, knowing_gate(), (0.3, 0.2), (0.3, 0.2, "driving")),
        # a command that is too fast is slowed down on its arc
        (NAVIGATION, knowing_gate(), (9.0, 0.9), (0.5, 0.05, "speed_limit")),
        (FOLLOW, knowing_gate(), (0.4, 0.2), (0.2, 0.1, "speed_limit")),
        (ESCAPE, knowing_gate(), (-0.4, 0.2), (-0.2, 0.1, "speed_limit")),
        (FOLLOW, knowing_gate(LAZY), (0.4, 0.2), (0.1, 0.05, "speed_limit")),
        (NAVIGATION, knowing_gate(speed_limits=SLOW), (0.4, 0.4), (0.2, 0.2, "speed_zone")),
        (TELEOP, knowing_gate(speed_limits=SLOW), (0.1, 0.4), (0.1, 0.4, "driving")),
        (TELEOP, knowing_gate(), (0.0, -7.0), (0.0, -1.0, "driving")),
        # without a scanner it drives slowly, by its map alone
        (NAVIGATION, knowing_gate(BLIND), (0.2, 0.1), (0.1, 0.05, "floor_not_scanned")),
        (TELEOP, knowing_gate(BLIND), (0.2, 0.1), (0.1, 0.05, "floor_not_scanned")),
        # it backs off only where the scanner sees; a joystick may do so anywhere, slowly
        (FOLLOW, knowing_gate(fov=270), (-0.2, 0.1), (0.0, 0.1, "floor_not_scanned")),
        (FOLLOW, knowing_gate(), (-0.2, 0.1), (-0.2, 0.1, "driving")),
        (TELEOP, knowing_gate(fov=270), (-0.2, 0.1), (-0.1, 0.05, "floor_not_scanned")),
        # below 2 cm/s it only turns
        (NAVIGATION, knowing_gate(ranges=RADIUS + 0.041), (0.2, 0.3), (0.0, 0.3, "obstacle")),
        (NAVIGATION, knowing_gate(ranges=RADIUS + 0.0448), (0.2, 0.0), (0.03, 0.0, "obstacle")),
        # one contact allows only backing up and turning, another not even that, and none is cleared by another's value
        (TELEOP, knowing_gate(touched="forward"), (0.1, 0.2), (0.0, 0.2, "contact")),
        (TELEOP, knowing_gate(touched="forward"), (-0.1, 0.2), (-0.1, 0.2, "driving")),
        (TELEOP, knowing_gate(touched="all"), (-0.1, 0.0), (0.0, 0.0, "contact")),
        (TELEOP, knowing_gate(touched="all"), (0.0, 0.5), (0.0, 0.0, "contact")),
        # not finite
        (TELEOP, knowing_gate(), (math.nan, 0.0), (0.0, 0.0, "bad_command")),
        (TELEOP, knowing_gate(), (0.1, math.inf), (0.0, 0.0, "bad_command")),
        # inside a border, only navigation may not drive
        (NAVIGATION, knowing_gate(inside=True), (0.1, 0.2), (0.0, 0.2, "inside_border")),
        (TELEOP, knowing_gate(inside=True), (0.1, 0.2), (0.1, 0.2, "driving")),
        (FOLLOW, knowing_gate(inside=True), (0.1, 0.2), (0.1, 0.2, "driving")),
    ],
)
def test_the_gate_limits_a_command_and_names_the_reason(source, gate, wish, found):
    gate.stamps["spot"] = 10.0
    assert gate.limit(10.0, source, VelocityRequest(*wish)) == (*map(pytest.approx, found[:2]), found[2])


@settings(STEADY, max_examples=300)
@given(
    st.lists(
        st.tuples(st.sampled_from([0.0, 0.3, 0.3, 0.6, 1.2, -50.0]), st.sampled_from([None, -2, 0, 0, 1, 1, 2, 3])),
        min_size=3,
        max_size=12,
    ),
    st.sampled_from([0.0, 0.03]),
)
def test_a_jump_of_the_localisation_holds_the_robot_for_a_second(steps, ahead):
    """Shifts in units of 0.1 m, of which three are a jump; the odometry stays constant, the clock may be set back.

    Args:
        ahead: [s] by which the base's clock is ahead of the driver's.
    """
    gate, now, place, fixes, held_until = Gate(PROFILE), 100.0, 0, [], -math.inf
    for seconds, shift in steps:
        now += seconds
        held_until = -math.inf if held_until > now + 10.0 else held_until
        if shift is None:
            gate.set_pose(None, now)
            assert gate.pose(now) is None
            continue
        place += shift
        gate.set_pose((0.1 * place, 0.0, 0.0), now + ahead, odometry=(0.0, 0.0, 0.0))
        recent = [fix for fix in fixes if 0.0 <= now - fix[0] <= 1.0] or [fix for fix in fixes[-1:] if fix[0] <= now]
        jumps = any(abs(place - before) >= 3 for _, before in (*recent[:1], *recent[-1:]))
        fixes = [*([] if jumps else fixes), (now, place)]
        held_until = now + ahead + 1.0 if jumps else held_until
        assert gate.pose(now) == (None if now < held_until else (0.1 * place, 0.0, 0.0))
        request, wanted = VelocityRequest(0.0, 0.0), "pose_jumped" if now < held_until else "no_map"
        assert gate.limit(now, NAVIGATION, request) == (0.0, 0.0, wanted)


@settings(STEADY, max_examples=200)
@given(
    st.lists(
        st.tuples(st.sampled_from([-0.3, 0.0, 0.05, 0.12, 0.2, 0.3, 0.6, 1.5]), st.sampled_from([0.0, 0.0, 0.3, 0.6])),
        min_size=1,
        max_size=12,
    ),
    st.sampled_from([-0.6, -0.4, -0.1, 0.02, 0.1, 0.3, 0.7]),
)
def test_an_inputs_age_is_reduced_by_its_usual_period(messages, later):
    """A pause does not count as a period; a stamp slightly in the future counts as the present."""
    gate, now, stamps, periods = Gate(PROFILE), 10.0, [], []
    for seconds, ahead in messages:
        now += seconds
        gate.limit(now, NONE, VelocityRequest(0.0, 0.0))
        gate.record_input("scan", now + ahead)
        stamps.append(now if ahead < 0.5 else now + ahead)
        if len(stamps) > 1 and 0.0 < stamps[-1] - stamps[-2] < 1.0:
            periods.append(stamps[-1] - stamps[-2])
    slack = min(max(float(np.median(periods[-5:] or [0.0])) - 0.1, 0.0), 0.15)
    wanted = math.inf if later < -0.5 else later if later < 0.0 else max(later - slack, 0.0)
    assert gate._age(stamps[-1] + later, "scan") == pytest.approx(wanted)
