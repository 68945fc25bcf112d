"""Paths out of a border, driven in a closed loop with a unicycle."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vb_core.grid_map import GridMap
from vb_core.robot_profile import Driving, RobotProfile
from vb_core.vocabulary import BORDER, DEFAULT
from vb_robot.driving import border_exit
from vb_robot.driving.arbiter import Arbiter
from vb_robot.driving.border_exit import MARGIN, ExitPlanner
from vb_robot.driving.gate import RATE
from vb_robot.driving.safety import Scan
from vb_robot.driving.workspace import Workspace

RADIUS, DT = 0.18, 1.0 / RATE
OPEN = np.full(360, math.inf)


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
    mask[int(y0 * 20) : int(y1 * 20), int(x0 * 20) : int(x1 * 20)] = True
    return mask


class Rig:
    """An arbiter on a unicycle that a border has enclosed; its scanner sees `ranges`."""

    def __init__(self, map_with_borders, physical, pose, ranges=OPEN, exit_borders=True):
        profile = RobotProfile(driving=Driving(exit_borders=exit_borders))
        self.arbiter, self.maps = Arbiter(profile), (map_with_borders, physical)
        self.pose, self.ranges, self.now, self.poses, self.state, self.said = (
            pose,
            ranges,
            100.0,
            [pose],
            DEFAULT,
            set(),
        )
        self.goal = False
        # the border is new: it came where the robot was
        self.arbiter.set_maps(Workspace(physical, physical, RADIUS))
        self.step()
        self.arbiter.set_maps(Workspace(map_with_borders, physical, RADIUS))

    def step(self):
        self.now += DT
        self.arbiter.set_goal(self.goal, self.now)
        self.arbiter.plan_exit(self.now)
        self.arbiter.set_state(self.state, "a" if self.state != DEFAULT else "", 0.0, self.now)
        self.arbiter.gate.set_pose(self.pose, self.now)
        self.arbiter.gate.set_scan(Scan(self.ranges, -math.pi, math.pi / 180, 0.1, 8.0, np.eye(4), RADIUS), self.now)
        command = self.arbiter.step(self.now)
        assert abs(command.v) <= 0.2 + 1e-9 and abs(command.w) <= 0.8 + 1e-9
        middle = self.pose[2] + 0.5 * command.w * DT
        self.pose = (
            self.pose[0] + command.v * DT * math.cos(middle),
            self.pose[1] + command.v * DT * math.sin(middle),
            self.pose[2] + command.w * DT,
        )
        self.poses.append(self.pose)
        self.said.add(command.code)
        return command


def drive(map_with_borders, physical, pose, ranges=OPEN, seconds=90.0):
    """(whether the robot became free, the poses, what held it or why it gave up)."""
    rig = Rig(map_with_borders, physical, pose, ranges)
    watch = Workspace(map_with_borders, physical, RADIUS)
    for _ in range(int(seconds / DT)):
        rig.step()
        if watch.distance_to_keep_out(rig.pose[:2]) >= RADIUS + MARGIN - 1e-6:
            return True, np.array(rig.poses), ""
        if rig.arbiter.exit.failed:
            return False, np.array(rig.poses), rig.arbiter.exit.failed
    return False, np.array(rig.poses), f"too late {rig.said}"


@settings(max_examples=8, deadline=None)
@given(st.floats(3.9, 5.1), st.floats(0.9, 2.1), st.floats(-3.14, 3.14))
def test_leaves_a_carpet_by_about_the_shortest_path(x, y, yaw):
    physical = room()
    free, poses, why = drive(restricted(physical, square(physical, 4.0, 1.0, 5.0, 2.0)), physical, (x, y, yaw))
    assert free, why
    driven = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1).sum()
    # the strip to the right of it is wide enough as well
    edge = min(x - 4.0, 5.0 - x, y - 1.0, 2.0 - y)
    assert driven <= max(edge, 0.0) + RADIUS + MARGIN + 0.2


def test_everything_but_a_corner_is_restricted():
    physical = room()
    map_with_borders = restricted(physical, ~square(physical, 4.0, 3.4, 6.0, 5.0))
    # from the left of the wall round its end
    free, poses, why = drive(map_with_borders, physical, (2.0, 1.0, 2.0))
    assert free, why
    assert poses[-1, 0] > 4.2 and poses[-1, 1] > 3.6
    gap = min(Workspace(physical, physical, RADIUS).distance_to_blocked(pose) for pose in poses)
    assert gap >= RADIUS, "it does not touch the wall"


def test_gap_between_border_and_wall_is_no_place_to_end():
    physical = room()
    # 0.6 m are left to the right wall: the robot fits in, but out of there nothing leads
    map_with_borders = restricted(physical, square(physical, 3.0, 0.0, 5.35, 5.0))
    route = ExitPlanner(Workspace(map_with_borders, physical, RADIUS), RADIUS, (5.1, 2.5)).plan_path((5.1, 2.5))
    assert route is not None and route[-1, 0] < 3.0


def test_no_allowed_floor_and_no_path():
    physical = room()
    full = Workspace(restricted(physical, np.ones(physical.shape, bool)), physical, RADIUS)
    assert ExitPlanner(full, RADIUS, (1, 1)).plan_path((1, 1)) is None
    shut = physical.with_data(np.where(np.arange(120) == 60, 100, physical.data).astype(np.int8))
    map_with_borders = restricted(shut, square(shut, 3.05, 0.0, 6.0, 5.0))
    assert ExitPlanner(Workspace(map_with_borders, shut, RADIUS), RADIUS, (4.0, 2.0)).plan_path((4.0, 2.0)) is None


def enclosed(ranges=OPEN, pose=(4.5, 1.5, 0.0), exit_borders=True):
    physical = room()
    return Rig(restricted(physical, square(physical, 4.0, 1.0, 5.0, 2.0)), physical, pose, ranges, exit_borders)


def test_gives_up_where_something_is_in_the_way_and_tries_again():
    rig = enclosed(np.full(360, 0.25))
    while not rig.arbiter.exit.failed:
        rig.step()
        assert rig.now < 130.0
    assert rig.arbiter.exit.failed == "obstacle"
    assert np.allclose(np.array(rig.poses)[:, :2], (4.5, 1.5)), "it only turns"
    rig.ranges = OPEN
    while math.dist(rig.pose[:2], (4.5, 1.5)) < 0.5:
        rig.step()
        assert rig.now < 170.0


def test_waits_while_somebody_draws_and_keeps_navigations_goal_for_afterwards():
    rig = enclosed()
    rig.state = BORDER
    assert all(rig.step().source == "none" for _ in range(40))
    rig.state = DEFAULT
    rig.goal = True
    driven = []
    while not driven or driven[-1].source == "exit_border":
        rig.arbiter.request("navigation", 0.0, 0.5, rig.now + DT)  # its recovery turns the robot, in vain
        driven.append(rig.step())
        assert rig.now < 130.0
    assert driven[-1].source == "navigation" and not any(command.cancel for command in driven)
    assert Workspace(*rig.maps, RADIUS).distance_to_keep_out(rig.pose[:2]) >= RADIUS + MARGIN - 1e-6


def test_a_robot_that_is_not_to_leave_borders_stays_in_one_also_with_a_goal():
    rig = enclosed(exit_borders=False)
    rig.goal = True
    assert all(rig.step().source == "none" for _ in range(60))


def test_without_a_new_map_nobody_is_driven_out_of_free_floor():
    rig = enclosed(pose=(2.0, 4.0, 0.0))
    assert all(rig.step().source == "none" for _ in range(40))


def test_a_robot_that_was_brought_near_a_border_is_left_to_the_one_that_brought_it():
    rig = enclosed(pose=(2.0, 4.0, 0.0))
    rig.step()
    rig.pose = (4.0 - RADIUS + 0.01, 1.5, 0.0)
    rig.goal = True
    for _ in range(40):
        rig.arbiter.request("navigation", -0.1, 0.0, rig.now + DT)
        assert rig.step().source == "navigation"


@pytest.mark.parametrize("gap", [0.06, -0.02])
def test_a_robot_too_near_for_navigation_to_plan_is_helped_away_and_keeps_its_goal(gap):
    rig = enclosed(pose=(2.0, 4.0, 0.0))
    rig.step()
    rig.pose = (4.0 - RADIUS - gap, 1.5, 0.3)
    rig.goal = True
    commands = [rig.step() for _ in range(160)]
    assert {command.source for command in commands} == {"none", "exit_border"} and not any(c.cancel for c in commands)
    assert rig.pose[0] < 4.0 - RADIUS - MARGIN + 0.05, "to a cell"
    rig.arbiter.request("navigation", 0.1, 0.0, rig.now + DT)
    assert rig.step().source == "navigation"


def test_navigation_that_wants_to_go_on_into_a_border_is_helped_away_too():
    rig = enclosed(pose=(2.0, 4.0, 0.0))
    rig.step()
    rig.pose = (4.0 - RADIUS - 0.01, 1.5, 0.0)
    rig.goal = True
    drivers = set()
    for _ in range(100):
        rig.arbiter.request("navigation", 0.2, 0.1, rig.now + DT)
        drivers.add(rig.step().source)
    assert "exit_border" in drivers and max(pose[0] for pose in rig.poses) < 4.0 - RADIUS + 0.03


def test_navigation_that_wants_to_go_on_past_a_wall_that_it_would_touch_is_helped_away_too():
    rig = enclosed(pose=(2.0, 4.0, 0.0))
    rig.step()
    rig.pose = (4.0 - RADIUS - 0.01, 1.5, math.pi / 2)
    rig.goal = True
    ahead = np.abs(np.linspace(-math.pi, math.pi, 360, endpoint=False)) < math.radians(20)
    drivers = set()
    for _ in range(100):
        facing = abs(math.remainder(rig.pose[2] - math.pi / 2, 2.0 * math.pi)) < math.radians(30)
        rig.ranges = np.where(ahead & facing, RADIUS + 0.02, OPEN)
        rig.arbiter.request("navigation", 0.2, 0.0, rig.now + DT)
        command = rig.step()
        drivers.add(command.source)
        assert command.source != "navigation" or command.v == 0.0 or not facing
    assert "exit_border" in drivers


@pytest.mark.parametrize("side, enough", [(0.9, 0.5), (1.1, 1.5)])
def test_a_pocket_is_allowed_floor_from_a_least_area_on(side, enough, monkeypatch):
    """Of the floor where the robot fits as a whole; what is smaller is no place to be helped to."""
    physical = room()
    mask = square(physical, 3.05, 0.0, 6.0, 5.0) & ~square(physical, 4.0, 2.0, 4.0 + side, 2.0 + side)
    map_with_borders = restricted(physical, mask)
    fits = side - 2 * (RADIUS + MARGIN + 0.03 + physical.resolution)
    for area, found in ((0.3 * fits**2, True), (1.5 * side**2, False)):
        monkeypatch.setattr(border_exit, "MIN_AREA", area)
        route = ExitPlanner(Workspace(map_with_borders, physical, RADIUS), RADIUS, (5.5, 4.0)).plan_path((5.5, 4.0))
        assert (route is not None and 4.0 < route[-1, 0] < 4.0 + side and 2.0 < route[-1, 1] < 2.0 + side) == found
