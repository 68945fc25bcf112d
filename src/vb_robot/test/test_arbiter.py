"""Which source drives a robot, and whether it may; following and escaping. In a closed loop, on a unicycle."""

import math
from collections import namedtuple

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from driving_rig import DT, PROFILE, Rig
from plain_rooms import VIEW, empty, with_border
from vb_testing import assert_fields
from vb_core.geometry import map_to_base
from vb_core.interaction_tables import BORDER, DEFAULT, GUIDE, SEED, state_by_name
from vb_robot.driving.arbiter import Arbiter
from vb_robot.driving.escape import END_CLEARANCE, PINCHED_AFTER
from vb_robot.driving.command_gate import NAVIGATION, TELEOP
from vb_robot.driving.spot_follower import FAR_DISTANCE, NEAR_DISTANCE
from vb_robot.driving.velocity import MAX_TURN
from vb_robot.driving.localization import MIN_UNCERTAINTY
from vb_robot.spot_sightings import Sighting, SpotSightings


# ------------------------------------------------------------ who drives
def test_the_source_of_highest_priority_drives():
    rig = Rig()
    command = rig.step(4.0)
    assert_fields(command, source="none", publish=False)
    rig.navigation = (0.3, 0.1)
    command = rig.step()
    assert_fields(command, source="navigation", v=0.3, w=0.1)
    rig.follows()
    rig.teleop = (-0.1, 0.0)
    command = rig.step()
    assert_fields(command, source="teleop", v=-0.1)
    rig.latch.stop("a", "test")
    command = rig.step(0.6)
    assert_fields(command, source="stop", v=0.0, publish=True)


def test_navigation_goals_are_cancelled_while_the_robot_follows():
    rig = Rig().follows()
    rig.navigation = (0.5, 1.0)
    rig.goal = True
    earlier_cancellations = rig.cancelled
    rig.spot = None
    rig.step(3.0)
    assert all(command.source == "follow" for command in rig.commands[-60:])
    assert rig.commands[-1].v == rig.commands[-1].w == 0.0, "it waits for the spot where it is"
    assert rig.cancelled - earlier_cancellations == 3, "and cancels the goal again each second"


def test_another_publisher_stops_the_robot_and_is_named():
    rig = Rig().drives()
    rig.arbiter.gate.other_stamps["/move_base"] = rig.now
    assert rig.step().code == "other_cmd_vel_publisher"
    assert (rig.commands[-1].v, rig.commands[-1].w) == (0.0, 0.0)
    assert rig.arbiter.gate.other_publishers(rig.now) == "/move_base"
    assert rig.arbiter.gate.other_publishers(rig.now - 0.5) == "", "a simulation that begins again has none yet"
    assert rig.step(1.2).v == 0.3


@pytest.mark.parametrize("channel", ["state", "topic"])
def test_stop_is_latched_until_released_and_keeps_the_goal(channel):
    rig = Rig().drives()
    rig.teleop, rig.goal = (0.3, 0.0), True
    rig.step()
    if channel == "state":
        rig.latch.stop("a", "test")
    else:
        rig.arbiter.stops.add("a")
    assert rig.step(5.0).source == "stop"
    rig.latch.stop("a", "the robot, which tells")
    assert rig.step(5.0).code == "stopped"
    assert rig.cancelled == 0
    rig.teleop = None
    rig.latch.resume(rig.latch.number)
    assert rig.step(1.0).v == 0.3


LISTENERS = {  # (time [s], number of listeners, whether a zero is published)
    "a new one": [(9.0, 0, False), (10.0, 1, True), (12.9, 1, True), (13.1, 1, False)],
    "one that leaves": [(14.0, 2, True), (14.5, 1, True), (16.9, 1, True), (17.1, 1, False)],
}


@pytest.mark.parametrize("steps", LISTENERS.values(), ids=LISTENERS)
def test_a_new_listener_hears_zeros_for_three_seconds(steps):
    arbiter = Arbiter(PROFILE)
    for now, listeners, publishes in steps:
        assert arbiter.step(now, listeners).publish is publishes


def test_a_command_that_ends_is_followed_by_no_zeros():
    arbiter = Arbiter(PROFILE)
    assert arbiter.step(20.0).publish
    arbiter.request(TELEOP, 0.0, 0.0, 20.5)
    assert arbiter.step(20.5).publish
    assert arbiter.step(21.2).publish  # the command is too old: one zero
    assert not arbiter.step(21.3).publish


@pytest.mark.parametrize("age, drives", [(-0.11, False), (-0.09, True), (0.49, True), (0.51, False)])
@pytest.mark.parametrize("source", [TELEOP, NAVIGATION])
def test_a_command_expires_after_half_a_second(source, age, drives):
    arbiter = Arbiter(PROFILE)
    arbiter.request(source, 0.1, 0.0, 50.0)
    assert (arbiter.step(50.0 + age).source == source) is drives


@pytest.mark.parametrize("age, cancels", [(-0.1, False), (0.0, True), (0.9, True), (1.1, False)])
def test_following_cancels_a_goal_reported_within_a_second(age, cancels):
    rig = Rig().follows()
    rig.arbiter.set_goal_active(True, rig.now)
    assert rig.arbiter.step(rig.now + age).cancel is cancels
    rig.arbiter.set_goal_active(False, rig.now)
    assert not rig.arbiter.step(rig.now + age + 2.0).cancel


def test_halting_stops_the_robot_with_the_faults_code():
    halted = Rig().drives().arbiter.halt("fault")
    assert_fields(halted, v=0.0, w=0.0, source="navigation", code="fault", publish=True)


# ------------------------------------------------------------ the gate
@pytest.mark.parametrize("gap", [0.05, 0.15, 0.3])  # [m] before the robot
@pytest.mark.parametrize("source", ["follow", "navigation", "teleop"])
@pytest.mark.parametrize("pose_error", [0.0, MIN_UNCERTAINTY])
def test_a_robot_does_not_cross_a_border_drawn_just_ahead_of_it(source, pose_error, gap):
    rig = Rig()
    rig.pose_error = pose_error
    rig.follows(2.0) if source == "follow" else setattr(rig, source, (0.5, 0.0))
    rig.step(0.5)
    edge = rig.pose[0] + PROFILE.radius + gap
    rig.set_grid(with_border(empty(), edge, 0.0, 8.0, 5.0))
    nose = []
    for _ in range(40):
        if source == "follow":
            rig.spot = (rig.pose[0] + 1.8, 2.5)
        rig.step()
        nose.append(rig.pose[0] + PROFILE.radius)
    assert max(nose) <= edge + 0.04
    assert rig.commands[-1].code == "border"


# ------------------------------------------------------------ one policy for spots
NEWER = state_by_name("of_a_newer_version")


@settings(max_examples=200)
@given(
    st.sampled_from([BORDER, SEED, GUIDE, NEWER]),
    st.lists(st.tuples(st.sampled_from(["red", "robot"]), st.floats(0.0, 1.0)), min_size=1, max_size=30),
)
def test_either_the_driver_or_the_dispatcher_acts_on_a_spot(state, spots):
    """Driver and dispatcher each keep their own record; both hear the same spots."""
    driver, dispatcher = SpotSightings(mobile_cameras=["robot"]), SpotSightings(mobile_cameras=["robot"])
    for record in (driver, dispatcher):
        record.set_state(state, "a", 0.0)
        for i, (camera, confidence) in enumerate(spots):
            record.add(Sighting(0.1 * i, (1.0, 1.0), camera, camera == "robot", confidence))
    now = 0.1 * len(spots) + 1.5
    certain = {camera for camera, confidence in spots if confidence >= 0.4}
    acting = driver.should_follow("robot", now), dispatcher.should_dispatch()
    # a guided robot acts only if it sees the spot itself; in an unknown state no robot moves
    assert sum(acting) == {GUIDE: "robot" in certain, NEWER: False}.get(state, bool(certain))
    assert acting[0] <= ("robot" in certain)
    assert acting[1] == (state in (BORDER, SEED) and "red" in certain)
    assert state != NEWER or driver.newest() is None


@given(*(st.lists(st.integers(0, 80), min_size=1, max_size=20, unique=True).map(sorted),) * 2)
def test_drivers_agree_on_who_follows_in_any_order_of_sightings(times_a, times_b):
    records = [[Sighting(0.1 * k, (1.0, 1.0), name, True) for k in ks] for name, ks in (("a", times_a), ("b", times_b))]
    drivers = [SpotSightings(), SpotSightings()]
    for driver, order in zip(drivers, (records, records[::-1])):
        driver.set_state(GUIDE, "x", 0.0)
        for sighting in [sighting for sightings in order for sighting in sightings]:
            driver.add(sighting)
    now = 0.1 * max(times_a[-1], times_b[-1])
    follows = [[driver.should_follow(name, now) for name in ("a", "b")] for driver in drivers]
    assert follows[0] == follows[1]
    assert sum(follows[0]) == 1


def test_a_guided_robot_follows_also_while_a_quicker_camera_sees_the_spot():
    rig = Rig()
    rig.set_state(GUIDE)
    for _ in range(80):
        for camera, latency in (("red", 0.05), ("robot", 0.15)):
            rig.arbiter.add(Sighting(rig.now - latency, (3.8, 2.5), camera, camera == "robot"))
        rig.step()
    assert {command.code for command in rig.commands[20:40]} == {"driving"}
    assert rig.pose[0] > 2.3


def test_guide_leaves_alone_a_robot_that_does_not_see_the_spot():
    far = Rig(pose=(6.0, 2.5, 0.0), camera="robot2", cameras=("robot1", "robot2"))
    far.navigation = (0.3, 0.0)
    far.goal = True
    far.set_state(GUIDE)
    for _ in range(100):
        far.see((2.0, 2.5), "robot1")
        far.step()
    far.step(3.0)  # the laser is off
    assert far.cancelled == 0
    assert all(command.source == "navigation" for command in far.commands)


def test_a_robot_follows_until_another_one_sees_the_lost_spot():
    rig = Rig(cameras=("robot", "other"))
    rig.follows()
    rig.see((3.0, 2.5), "other")
    assert rig.step().source == "follow"
    rig.spot = None
    assert rig.step(5.0).source == "follow"
    rig.see((3.0, 2.5), "other")
    assert rig.step().source == "none", "another robot sees it now"


# ------------------------------------------------------------ following
Drag = namedtuple("Drag", "v w visible distance")


def drag_spot(path, speed, latency=0.12):
    """Drags a spot along a path from 1 m ahead of a robot, then rests 4 s. Returns an array of each quantity, by time."""
    path = np.asarray(path, dtype=float)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    rig, rng = Rig((path[0, 0] - 1.0, path[0, 1] + 0.1, 0.0)), np.random.default_rng(7)
    rig.set_state(GUIDE)
    waiting, moments = [], []
    for i in range(int((length[-1] / speed + 4.0) / DT)):
        spot = np.array([np.interp(i * DT * speed, length, path[:, k]) for k in range(2)])
        visible = bool(VIEW.sees(map_to_base(spot[None], rig.pose))[0])
        if visible:
            waiting.append((rig.now, spot + rng.normal(0.0, 0.003, 2)))
        while waiting and waiting[0][0] <= rig.now - latency:
            stamp, place = waiting.pop(0)
            rig.arbiter.add(Sighting(stamp, tuple(place), "robot", True, 0.9))
        command = rig.step()
        moments.append(Drag(command.v, command.w, visible, math.dist(rig.pose[:2], spot)))
    return Drag(*np.array(moments).T)


CIRCLE = np.column_stack([3 - np.cos(np.linspace(0, 2 * np.pi, 100)), 2.5 - np.sin(np.linspace(0, 2 * np.pi, 100))])
RECTANGLE = np.array([[2, 2.0], [4, 2.0], [4, 3.25], [2, 3.25], [2, 2.0]])
DRAGS = {
    "line away": ([[2, 2.5], [6, 2.5]], 0.2),
    "line sideways": ([[2, 2.5], [2, 4.5]], 0.2),
    "circle slowly": (CIRCLE, 0.1),
    "circle": (CIRCLE, 0.2),
    "rectangle": (RECTANGLE, 0.2),
    "rectangle clockwise": (RECTANGLE[::-1], 0.2),
    "line towards it": ([[4.0, 2.5], [1.5, 2.5]], 0.2),
}


@pytest.mark.parametrize("path, speed", DRAGS.values(), ids=DRAGS)
def test_the_spot_stays_in_view(path, speed):
    run = drag_spot(path, speed)
    assert np.abs(run.v).max() <= 0.2 + 1e-9
    assert np.abs(run.w).max() <= MAX_TURN + 1e-9
    assert run.visible.all()
    assert run.distance.min() > 0.4
    assert (run.v[-1], run.w[-1]) == pytest.approx((0.0, 0.0), abs=0.01), "it comes to rest with the spot"
    assert NEAR_DISTANCE <= run.distance[-1] <= FAR_DISTANCE


# ------------------------------------------------------------------ escaping
RADIUS = PROFILE.radius
EDGE = 4.0  # [m] where the border begins, along x


def rig_beside_border(gap, yaw=0.3):
    """Returns a rig with a goal, but idle navigation, `gap` [m] from a border on its left or right, or ahead."""
    rig = Rig(grid=with_border(empty(), EDGE, 0.0, 8.0, 5.0), pose=(EDGE - RADIUS - gap, 2.5, yaw))
    rig.goal = True
    return rig


@pytest.mark.parametrize("yaw", [0.3, 1.6, 3.1])
@pytest.mark.parametrize("gap", [0.04, -0.02])
def test_a_pinched_robot_is_helped_away_and_keeps_its_goal(gap, yaw):
    rig = rig_beside_border(gap, yaw)
    rig.step(10.0)
    assert {command.source for command in rig.commands} == {"none", "escape"}
    assert rig.cancelled == 0
    assert rig.pose[0] < EDGE - RADIUS - END_CLEARANCE + 0.03, "to a cell"
    assert max(abs(command.v) for command in rig.commands) <= 0.2
    assert rig.commands[-1].source == "none"
    rig.navigation = (0.1, 0.0)
    assert rig.step().source == "navigation"


@pytest.mark.parametrize("wish, yaw", [((0.2, 0.1), 0.0), ((0.2, 0.0), math.pi / 2)], ids=["at_border", "past_wall"])
def test_a_robot_that_the_gate_holds_is_helped_away_too(wish, yaw):
    rig = rig_beside_border(0.01, yaw)
    ahead = np.abs(np.linspace(-math.pi, math.pi, 360, endpoint=False)) < math.radians(20)
    farthest = -math.inf
    for _ in range(200):
        facing = yaw and abs(math.remainder(rig.pose[2] - yaw, 2.0 * math.pi)) < math.radians(30)
        rig.ranges = np.where(ahead & bool(facing), RADIUS + 0.02, math.inf)
        rig.navigation = wish
        rig.step()
        farthest = max(farthest, rig.pose[0])
    assert "escape" in {command.source for command in rig.commands}
    assert farthest < EDGE - RADIUS + 0.03


def test_escape_does_not_drive_into_the_unknown():
    rig = rig_beside_border(0.02)
    grid = with_border(empty(), EDGE, 0.0, 8.0, 5.0)
    rig.set_grid(with_border(grid, 0.0, 0.0, EDGE - RADIUS - 0.04, 5.0, value=-1))
    rig.step(10.0)
    assert {command.source for command in rig.commands} == {"none"}, "navigation plans nothing from there either"


@pytest.mark.parametrize("stops", [False, True])
def test_escape_forgets_its_place_once_a_person_intervenes(stops):
    rig = rig_beside_border(0.02, math.pi)
    assert rig.step(PINCHED_AFTER + 0.5).source == "escape"
    if stops:
        rig.latch.stop("a", "test")
    else:
        rig.teleop = (0.0, 0.1)
    rig.step(0.5)
    rig.pose = (EDGE - RADIUS - 0.02, 1.0, math.pi)  # it was carried or driven away
    rig.latch.resume(rig.latch.number)
    rig.teleop = None
    rig.commands.clear()
    rig.step(1.0)
    assert "escape" not in {command.source for command in rig.commands}, "first it waits for navigation, as ever"
    rig.step(10.0)
    assert rig.pose[0] < EDGE - RADIUS - END_CLEARANCE + 0.03
    assert rig.pose[1] == pytest.approx(1.0, abs=0.1)


def test_escape_waits_while_somebody_draws():
    rig = rig_beside_border(0.02)
    rig.set_state(BORDER)
    rig.step(5.0)
    assert {command.source for command in rig.commands} == {"none"}
    rig.set_state(DEFAULT)
    assert rig.step(2.0).source == "escape"


@pytest.mark.parametrize("left_alone", ["no goal", "navigation is dead", "within the border", "navigation drives it"])
def test_a_robot_that_is_not_pinched_is_left_alone(left_alone):
    rig = rig_beside_border(-0.5 if left_alone == "within the border" else 0.02, math.pi)
    rig.goal = left_alone != "no goal"
    if left_alone == "navigation is dead":
        rig.navigation = (0.0, 0.3)
        rig.step(0.5)
        rig.navigation = None
        rig.silent.add("goal")  # navigation died; its goal never ends
    elif left_alone == "navigation drives it":
        rig.navigation = (0.0, 0.5)
    rig.commands.clear()
    begin = rig.pose
    rig.step(10.0)
    assert "escape" not in {command.source for command in rig.commands}
    assert rig.pose[:2] == pytest.approx(begin[:2], abs=0.01)
