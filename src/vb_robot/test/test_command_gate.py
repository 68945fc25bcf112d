"""The gate: which commands pass, how fast, and the reason that is named where one does not."""

import itertools
import math

import numpy as np
import pytest

from driving_rig import PROFILE
from plain_rooms import empty, scan_of, with_border
from vb_core.robot_profile import RobotProfile, Scanner
from vb_robot.driving.command_gate import ESCAPE, FOLLOW, NAVIGATION, NONE, TELEOP, CommandGate
from vb_robot.driving.scan_clearance import RequiredGaps
from vb_robot.driving.velocity import VelocityRequest
from vb_robot.driving.workspace import Workspace

RADIUS = PROFILE.radius
BLIND = RobotProfile(scanner=Scanner(present=False))


def knowing_gate(profile=PROFILE, ranges=math.inf, fov=360, inside=False, touched="", speed_limits=None, clock_age=0.0):
    """Returns a gate with all inputs at 10 s. Bumper 1's contact forbids the motion `touched`, if any."""
    gate = CommandGate(profile)
    borders = with_border(empty(), 0.0, 0.0, 8.0, 5.0) if inside else empty()
    gate.workspace = Workspace(borders, empty(), profile.radius)
    gate.speed_limits = speed_limits
    gate.clock_age = clock_age
    for number, motion in ((0, "forward"), (1, touched), (2, ""), (0, "")):  # bumper 0 is touched no more
        gate.set_contact(("bumper", number), motion)
    gate.set_scan(scan_of(np.full(fov, ranges), -math.radians(fov // 2), math.radians(1.0)), 10.0)
    gate.record_input("state", 10.0)
    gate.set_pose((4.0, 2.5, 0.0), 10.0)
    return gate


# ------------------------------------------------------------ the age of inputs
@pytest.mark.parametrize("old_input", ["scan", "state", "pose"])
@pytest.mark.parametrize(
    "age, v, w, share",
    [
        (0.0, 0.25, 1.0, 1.0),
        (0.25, 0.25, 0.0, 1.0),
        (0.33, 0.25, 0.0, 0.6),
        (0.33, 0.25, 1.0, 0.32),
        (0.33, 0.0, -0.64, 0.5),
        (0.42, 0.25, 0.0, 0.06),
        (0.431, 0.1, 0.0, 0.0),
        (0.48, 0.1, 0.0, 0.0),
        (9.0, 0.1, 0.0, 0.0),
    ],
)
def test_the_brakes_can_end_a_command_before_an_input_is_too_old(old_input, age, v, w, share):
    """Until 0.43 s after it, at 1.5 m/s^2 and 3.2 rad/s^2. After that, nothing passes."""
    gate = knowing_gate()
    for other in {"scan", "state", "pose"} - {old_input}:
        gate.stamps[other] = 10.0 + age
    limited = gate.limit(10.0 + age, NAVIGATION, VelocityRequest(v, w, "driving"))
    code = "driving" if share else f"{old_input}_lost"
    assert limited == (pytest.approx(share * v), pytest.approx(share * w), code)


WISH = VelocityRequest(0.1, 0.0, "driving")
LOSSES = {  # the code: how the input is lost
    "no_map": lambda gate: setattr(gate, "workspace", None),
    "pose_uncertain": lambda gate: setattr(gate, "pose_uncertain", True),
    "pose_lost": lambda gate: gate.set_pose(None, 10.0),
    "pose_jumped": lambda gate: gate.set_pose((4.0, 3.5, 0.0), 10.0, 0.0, (0.0, 0.0, 0.0)),
    "state_lost": lambda gate: gate.stamps.pop("state"),
}


@pytest.mark.parametrize("code, lose", LOSSES.items(), ids=LOSSES)
def test_a_missing_input_stops_navigation_with_its_name_and_a_joystick_not_at_all(code, lose):
    gate = knowing_gate()
    lose(gate)
    assert gate.limit(10.0, NAVIGATION, WISH) == (0.0, 0.0, code)
    assert gate.limit(10.0, TELEOP, WISH) == (0.1, 0.0, "driving")


def test_a_joystick_needs_only_the_scan():
    gate = CommandGate(PROFILE)
    assert gate.limit(10.0, TELEOP, WISH) == (0.0, 0.0, "scan_lost")
    gate.set_scan(scan_of(np.full(360, math.inf)), 10.0)
    assert gate.limit(10.0, TELEOP, WISH) == (0.1, 0.0, "driving")


@pytest.mark.parametrize("stamps", [{}, {"spot": 8.0}], ids=["never seen", "seen long ago"])
def test_only_following_needs_the_spot(stamps):
    gate = knowing_gate()
    gate.stamps.update(stamps)
    assert gate.limit(10.0, FOLLOW, WISH) == (0.0, 0.0, "spot_lost")
    assert gate.limit(10.0, NAVIGATION, WISH) == (0.1, 0.0, "driving")


@pytest.mark.parametrize(
    "periods, limit",
    [
        ([], 0.5),
        ([0.1] * 4, 0.5),
        ([0.12] * 4, 0.52),
        ([0.2] * 4, 0.6),
        ([0.3] * 4, 0.65),
        ([0.2, 1.5, 0.2, 1.5, 0.2, 1.5], 0.6),  # a pause is no period
        ([0.2, -0.3, 0.2, -0.3, 0.2], 0.6),  # nor is time that was set back
        ([0.3] * 5 + [0.05] * 3, 0.5),  # the median of the newest five
        ([0.3] * 5 + [0.05] * 2, 0.65),
    ],
)
def test_the_age_limit_grows_with_the_usual_period_of_an_input(periods, limit):
    gate = CommandGate(PROFILE)
    for stamp in itertools.accumulate([100.0, *periods]):
        gate.set_pose((4.0, 2.5, 0.0), stamp)
    assert [bool(gate.pose(stamp + limit + margin)) for margin in (-0.001, 0.001)] == [True, False]


@pytest.mark.parametrize("ahead, first, last", [(-0.3, 0, 199), (0.0, 0, 499), (0.49, 0, 499), (0.6, 101, 1099)])
def test_a_stamp_slightly_in_the_future_counts_as_now(ahead, first, last):
    gate = CommandGate(PROFILE)
    gate.limit(100.0, NONE, VelocityRequest())
    gate.set_pose((4.0, 2.5, 0.0), 100.0 + ahead)
    valid_ms = [ms for ms in (0, 99, 101, 199, 201, 499, 501, 1099, 1101) if gate.pose(100.0 + ms / 1000.0)]
    assert (valid_ms[0], valid_ms[-1]) == (first, last)


JUMPS = {  # the pose's x [m] by time [s], None while it is not known; when the robot is held
    "one step": ({0.0: 0.0, 0.3: 0.3, 0.9: 0.3, 1.29: 0.3, 1.31: 0.3}, [0.3, 0.9, 1.29]),
    "three steps within a second": ({0.0: 0.0, 0.3: 0.1, 0.6: 0.2, 0.9: 0.3}, [0.9]),
    "three steps in more than a second": ({0.0: 0.0, 0.6: 0.1, 1.2: 0.2, 1.8: 0.3}, []),
    "a step beyond an older one": ({0.0: 0.0, 0.5: 0.2, 0.9: -0.1}, [0.9]),
    "to and fro": ({0.0: 0.0, 0.3: 0.3, 0.6: 0.0, 1.59: 0.0, 1.61: 0.0}, [0.3, 0.6, 1.59]),
    "after a pause": ({0.0: 0.0, 50.0: 0.3}, [50.0]),
    "while it was lost": ({0.0: 0.0, 0.3: None, 0.6: 0.3}, [0.6]),
    "lost while it is held": ({0.0: 0.0, 0.3: 0.3, 0.6: None, 1.4: 0.3}, [0.3, 0.6]),
    "before time was set back": ({0.0: 0.0, 0.3: 0.3, -50.0: 0.3}, [0.3]),
    "while time was set back": ({0.0: 0.0, -50.0: 0.3, -49.7: 0.6}, [-49.7]),
}


@pytest.mark.parametrize("clock_ahead", [0.0, 0.005])
@pytest.mark.parametrize("x_at, held_at", JUMPS.values(), ids=JUMPS)
def test_a_jump_of_the_localisation_holds_the_robot_for_a_second(x_at, held_at, clock_ahead):
    gate = knowing_gate(BLIND)
    for seconds, x in x_at.items():
        now = 100.0 + seconds
        pose = None if x is None else (x, 0.0, 0.0)
        gate.set_pose(pose, now + clock_ahead, odometry=(0.0, 0.0, 0.0))
        gate.stamps["state"] = now
        is_held = seconds in held_at
        assert gate.pose(now) == (None if is_held else pose)
        unheld_code = "driving" if pose else "pose_lost"
        assert gate.limit(now, NAVIGATION, VelocityRequest()).code == ("pose_jumped" if is_held else unheld_code)


# ------------------------------------------------------------ what is ahead, and limits
@pytest.mark.parametrize(
    "source, gaps",
    [
        (TELEOP, RequiredGaps(ahead=0.05, sides=0.02, cells=0.0)),
        (FOLLOW, RequiredGaps(ahead=0.12, sides=0.04, cells=0.06)),
        (ESCAPE, RequiredGaps(ahead=0.12, sides=0.04, cells=0.05)),
        (NAVIGATION, RequiredGaps(ahead=0.04, sides=0.0, cells=-0.04)),
    ],
)
@pytest.mark.parametrize("excess", [-0.015, 0.015])  # the lowest permitted speed stops within 1 cm, and a cell is 1 cm
def test_each_source_keeps_its_own_gaps(source, gaps, excess):
    def drives(wall_ahead=2.0, wall_beside=2.0, border_ahead=2.0):
        """Returns whether it drives with these gaps [m] from the robot's rim."""
        gate = knowing_gate()
        gate.stamps["spot"] = 10.0
        scan = scan_of(np.full(360, math.inf))
        scan.points = np.array([(RADIUS + wall_ahead, 0.0), (0.02, -RADIUS - wall_beside)])
        gate.set_scan(scan, 10.0)
        floor = empty(resolution=0.01)
        border_x = 4.0 + RADIUS + border_ahead + floor.resolution
        gate.workspace = Workspace(with_border(floor, border_x, 0.0, 8.0, 5.0), floor, RADIUS)
        return gate.limit(10.0, source, VelocityRequest(0.1, 0.0)).v > 0.0

    assert drives(wall_ahead=gaps.ahead + excess) is (excess > 0.0)
    assert drives(wall_beside=gaps.sides + excess) is (excess > 0.0)
    assert drives(border_ahead=gaps.cells + excess) is (excess > 0.0)


SLOW = empty().with_data(np.full(empty().shape, 20, np.int8))  # 0.2 m/s everywhere
LAZY = PROFILE.replace(limits=PROFILE.limits.replace(max_speed=0.1))


@pytest.mark.parametrize(
    "source, gate, wish, limited",
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
        # not even a joystick drives by a clock that stands still
        (TELEOP, knowing_gate(clock_age=0.6), (0.1, 0.0), (0.0, 0.0, "clock_stopped")),
        # inside a border, only navigation may not drive
        (NAVIGATION, knowing_gate(inside=True), (0.1, 0.2), (0.0, 0.2, "inside_border")),
        (TELEOP, knowing_gate(inside=True), (0.1, 0.2), (0.1, 0.2, "driving")),
        (FOLLOW, knowing_gate(inside=True), (0.1, 0.2), (0.1, 0.2, "driving")),
    ],
)
def test_the_gate_limits_a_command_and_names_the_reason(source, gate, wish, limited):
    gate.stamps["spot"] = 10.0
    assert gate.limit(10.0, source, VelocityRequest(*wish)) == (*map(pytest.approx, limited[:2]), limited[2])


@pytest.mark.parametrize("source", [NAVIGATION, TELEOP])
def test_a_robot_that_stands_because_its_source_fell_silent_does_not_say_that_it_drives(source):
    gate = knowing_gate()
    for age, limited in ((0.25, WISH), (0.431, (0.0, 0.0, "idle")), (0.499, (0.0, 0.0, "idle"))):
        gate.stamps[source] = 10.0 - age
        assert gate.limit(10.0, source, WISH) == limited
