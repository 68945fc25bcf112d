"""check_navigation, with stand-ins for the nodes that it asks."""

from types import SimpleNamespace

import numpy as np
import pytest
import rospy

from refusals import refused
from vb_core import names
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_evaluation.navigation_check import check_navigation
from vb_evaluation.navigation_check.check_navigation import NavigationCheck
from vb_msgs.msg import RobotStatus, RobotStatusArray


def test_without_move_base_it_says_so_at_once(monkeypatch):
    waited = []

    def nobody(service, timeout):
        waited.append((service, timeout))
        raise rospy.ROSException("timeout exceeded")

    monkeypatch.setattr(rospy, "wait_for_service", nobody)
    with refused("no_planner") as caught:
        NavigationCheck((0.0, 0.0), move_base="robot1/move_base").run()
    assert "/robot1/move_base/make_plan" in str(caught.value)
    assert waited == [("/robot1/move_base/make_plan", 2.0)]


class Planner:
    """A map integrator and a move_base in one: it plans a straight line, or round a border if there is one."""

    def __init__(self, monkeypatch):
        self.borders = []
        self.posterior = GridMap(np.zeros((100, 100), np.int8), 0.05)
        monkeypatch.setattr(rospy, "wait_for_service", lambda *_, **__: None)
        monkeypatch.setattr(rospy, "get_param", lambda name, default: default)
        monkeypatch.setattr(check_navigation, "SystemObserver", lambda: self)
        transforms = SimpleNamespace(lookup=lambda *_, **__: np.eye(4))
        monkeypatch.setattr(check_navigation, "TransformLookup", lambda: transforms)
        monkeypatch.setattr(check_navigation, "call", self.call)
        monkeypatch.setattr(check_navigation, "WATCH_TIME", 0.01)

    def plan(self, start, goal, _service):
        around = [(2.0, 1.0)] if self.borders else []
        return np.array([start[:2], *around, goal[:2]], dtype=float)

    def call(self, name, _kind, request, _who):
        if name == names.ADD_BORDER:
            self.borders.append(request.border)
            return SimpleNamespace(success=True, id="one")
        if name == names.REMOVE_BORDER:
            self.borders.pop()
        return SimpleNamespace()


@pytest.mark.parametrize(
    "robots, name, expected",
    [
        ([], "", ("/move_base", "base_link")),
        ([], "ada", ("/ada/move_base", "ada/base_link")),
        (["ada"], "", ("/ada/nav", "ada_base")),
        (["ada", "bob"], "bob", ("/bob/nav", "bob_base")),
        (["ada", "bob"], "", "ada, bob"),
        (["ada", "bob"], "eve", "ada, bob"),
    ],
)
def test_the_robot_is_the_only_one_or_the_one_that_is_named(monkeypatch, robots, name, expected):
    def answer(*_):
        if not robots:
            raise rospy.ROSException("timeout exceeded")
        statuses = [RobotStatus(robot=key, move_base=f"/{key}/nav", frame=f"{key}_base") for key in robots]
        return RobotStatusArray(robots=statuses)

    monkeypatch.setattr(rospy, "wait_for_message", answer)
    if isinstance(expected, str):
        with pytest.raises(CodedError, match=expected):
            check_navigation.find_robot(name)
    else:
        robot = check_navigation.find_robot(name)
        assert (robot.move_base, robot.frame) == expected


@pytest.mark.parametrize("trinary, passed", [(True, None), (False, True)])
def test_check_names_what_a_move_base_lacks_for_soft_borders(monkeypatch, trinary, passed):
    Planner(monkeypatch)
    layer = {"static_layer": {"map_topic": names.MAP_WITH_BORDERS, "trinary_costmap": trinary}}
    monkeypatch.setattr(rospy, "get_param", lambda name, default: layer if name.endswith("costmap") else default)
    checks = {check.name: check for check in NavigationCheck((4.0, 0.0), at_once=60.0, timeout=60.0).run()}
    soft = checks["a soft border is gone round where that is possible"]
    assert soft.passed is passed
    assert ("trinary_costmap" in soft.result) is (passed is None)


def test_without_another_way_round_nothing_is_claimed_of_borders(monkeypatch):
    planner = Planner(monkeypatch)
    straight = np.array([(0.0, 0.0), (4.0, 0.0)])
    monkeypatch.setattr(planner, "plan", lambda *_: straight[:0] if planner.borders else straight)
    checks = NavigationCheck((4.0, 0.0), at_once=60.0, timeout=0.1).run()
    assert [check.passed for check in checks] == [None, None, True, None, True]
    assert "another way round" in checks[0].result


def test_a_goal_that_is_too_near_is_reported(monkeypatch):
    Planner(monkeypatch)
    with refused("path_too_short"):
        NavigationCheck((0.6, 0.0)).run()
