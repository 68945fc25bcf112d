"""A pinched robot gets away from what it stands too near to; a robot within a border stays. In a closed loop, on a unicycle."""

import math

import numpy as np
import pytest

from driving_rig import PROFILE, Rig
from plain_rooms import empty, with_border

from vb_core.vocabulary import BORDER, DEFAULT
from vb_robot.driving.escape import FREE, PINCHED_AFTER

RADIUS = PROFILE.radius
EDGE = 4.0  # [m] where the border begins, along x


def beside(gap, yaw=0.3):
    """A robot with a goal that navigation does not move, `gap` [m] from a border on its left or right, or ahead."""
    rig = Rig(grid=with_border(empty(), EDGE, 0.0, 8.0, 5.0), pose=(EDGE - RADIUS - gap, 2.5, yaw))
    rig.goal = True
    return rig


@pytest.mark.parametrize("yaw", [0.3, 1.6, 3.1])
@pytest.mark.parametrize("gap", [0.04, -0.02])
def test_a_pinched_robot_is_helped_away_and_keeps_its_goal(gap, yaw):
    rig = beside(gap, yaw)
    rig.step(10.0)
    assert {command.source for command in rig.commands} == {"none", "escape"} and rig.cancelled == 0
    assert rig.pose[0] < EDGE - RADIUS - FREE + 0.03, "to a cell"
    assert max(abs(command.v) for command in rig.commands) <= 0.2 and rig.commands[-1].source == "none"
    rig.navigation = (0.1, 0.0)
    assert rig.step().source == "navigation"


@pytest.mark.parametrize(
    "wish, yaw", [((0.2, 0.1), 0.0), ((0.2, 0.0), math.pi / 2)], ids=["into a border", "past a wall"]
)
def test_a_robot_that_the_gate_holds_is_helped_away_too(wish, yaw):
    rig = beside(0.01, yaw)
    ahead = np.abs(np.linspace(-math.pi, math.pi, 360, endpoint=False)) < math.radians(20)
    farthest = -math.inf
    for _ in range(200):
        facing = yaw and abs(math.remainder(rig.pose[2] - yaw, 2.0 * math.pi)) < math.radians(30)
        rig.ranges = np.where(ahead & bool(facing), RADIUS + 0.02, math.inf)
        rig.navigation = wish
        rig.step()
        farthest = max(farthest, rig.pose[0])
    assert "escape" in {command.source for command in rig.commands} and farthest < EDGE - RADIUS + 0.03


def test_escape_does_not_drive_into_the_unknown():
    rig = beside(0.02)
    grid = with_border(empty(), EDGE, 0.0, 8.0, 5.0)
    x = grid.cell_to_world(np.argwhere(np.ones(grid.shape)))[:, 0].reshape(grid.shape)
    rig.set_grid(grid.with_data(np.where(x < EDGE - RADIUS - 0.04, np.int8(-1), grid.data)))
    rig.step(10.0)
    assert {command.source for command in rig.commands} == {"none"}, "navigation plans nothing from there either"


@pytest.mark.parametrize("stops", [False, True])
def test_escape_forgets_its_place_once_a_person_intervenes(stops):
    rig = beside(0.02, math.pi)
    assert rig.step(PINCHED_AFTER + 0.5).source == "escape"
    if stops:
        rig.latch.stop("a", "test")
    else:
        rig.teleop = (0.0, 0.1)
    rig.step(0.5)
    rig.pose = (EDGE - RADIUS - 0.02, 1.0, math.pi)  # it was carried, or driven
    rig.latch.resume(rig.latch.number)
    rig.teleop = None
    rig.commands.clear()
    rig.step(1.0)
    assert "escape" not in {command.source for command in rig.commands}, "first it waits for navigation, as ever"
    rig.step(10.0)
    assert rig.pose[0] < EDGE - RADIUS - FREE + 0.03 and rig.pose[1] == pytest.approx(1.0, abs=0.1)


def test_escape_waits_while_somebody_draws():
    rig = beside(0.02)
    rig.set_state(BORDER)
    rig.step(5.0)
    assert {command.source for command in rig.commands} == {"none"}
    rig.set_state(DEFAULT)
    assert rig.step(2.0).source == "escape"


@pytest.mark.parametrize("left_alone", ["no goal", "navigation is dead", "within the border", "navigation drives it"])
def test_a_robot_that_is_not_pinched_is_left_alone(left_alone):
    rig = beside(-0.5 if left_alone == "within the border" else 0.02, math.pi)
    rig.goal = left_alone != "no goal"
    if left_alone == "navigation is dead":
        rig.navigation = (0.0, 0.3)
        rig.step(0.5)
        rig.navigation = None
        rig.silent.add("goal")  # it died; its goal is never ended
    elif left_alone == "navigation drives it":
        rig.navigation = (0.0, 0.5)
    rig.commands.clear()
    begin = rig.pose
    rig.step(10.0)
    assert "escape" not in {command.source for command in rig.commands}
    assert rig.pose[:2] == pytest.approx(begin[:2], abs=0.01)
