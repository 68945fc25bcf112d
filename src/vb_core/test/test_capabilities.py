"""What a lab can do for people, by what is connected to it."""

import itertools
from collections import namedtuple
from dataclasses import replace

import pytest

from vb_testing import assert_fields
from vb_core import sentences
from vb_core.capabilities import NO_ROBOT, READY, UNREADY, ConnectedRobot, Connections
from vb_core.capabilities import derive_capabilities, effective_commands, describe_ignored_zone
from vb_core.notices import Severity
from vb_core.zones import ZONES

PLANS = dict(plans_round_borders=True)
STOP, STOP_AND_SPEED = dict(obeys_stop=True), dict(obeys_stop=True, obeys_speed=True)  # by robot_monitor
DRIVER = dict(has_driver=True)
# what is connected to a robot, what people are told of its plans and obedience, its zones, and whether it can be stopped
Case = namedtuple("Case", "connected plans obeys keeps stops", defaults=[(), False])
PLANNED, ALL = ("keep_out", "avoid"), tuple(ZONES)
CASES = [
    Case({}, "robot_ignores_borders", "robot_obeys_borders_only"),
    Case(STOP, "robot_ignores_borders", "robot_obeys_stop_only", stops=True),
    Case(STOP_AND_SPEED, "robot_ignores_borders", "robot_obeys_by_navigation", ("slow",), stops=True),
    Case(DRIVER, "robot_plans_through_borders", "robot_has_driver", ("keep_out", "slow"), stops=True),
    Case(PLANS, "robot_plans_round_borders", "robot_obeys_borders_only", PLANNED),
    Case({**PLANS, **STOP}, "robot_plans_round_borders", "robot_obeys_stop_only", PLANNED, stops=True),
    Case({**PLANS, **STOP_AND_SPEED}, "robot_plans_round_borders", "robot_obeys_by_navigation", ALL, stops=True),
    Case({**PLANS, **DRIVER}, "robot_plans_round_borders", "robot_has_driver", ALL, stops=True),
]
for_each_robot = pytest.mark.parametrize("case", CASES, ids=lambda case: " ".join(case.connected) or "navigation")


def robot(connected, name="ada", is_localized=True):
    return ConnectedRobot(name, has_navigation=True, is_localized=is_localized, **connected)


def offered_to(*robots, cameras=False):
    """Returns what a lab with these robots offers."""
    return derive_capabilities(Connections(robots, cameras, has_interaction=cameras))


@for_each_robot
def test_a_robot_keeps_the_enforced_zones(case):
    offered = offered_to(robot(case.connected))
    assert offered.zones == case.keeps
    assert offered.ignored_by == {**dict.fromkeys(ZONES, ("ada",)), **dict.fromkeys(case.keeps, ())}


@for_each_robot
def test_a_lab_is_ready_if_its_robot_keeps_out_of_borders(case):
    assert offered_to(robot(case.connected)).state == (READY if "keep_out" in case.keeps else UNREADY)


@for_each_robot
def test_only_robots_that_plan_round_borders_are_sent(case):
    offered = offered_to(robot(case.connected))
    is_sent = case.plans == "robot_plans_round_borders"
    assert offered.sendable_robots == (("ada",) if is_sent else ())
    assert ("go" in offered.commands) is is_sent


@pytest.mark.parametrize("localized", [True, False], ids=["localized", "lost"])
@for_each_robot
def test_stop_is_offered_only_if_it_stops_a_robot(case, localized):
    commands = offered_to(robot(case.connected, is_localized=localized)).commands
    assert ("stop" in commands) is ("resume" in commands) is case.stops


@for_each_robot
def test_people_hear_what_a_robot_obeys(case):
    assert [line.code for line in offered_to(robot(case.connected)).robot_notices] == [case.plans, case.obeys]


@for_each_robot
def test_a_lost_robot_keeps_no_zone_and_is_sent_nowhere(case):
    offered = offered_to(robot(case.connected, is_localized=False))
    assert_fields(offered, zones=(), sendable_robots=(), state=UNREADY)
    assert [line.code for line in offered.robot_notices] == [case.plans, "robot_not_localized", case.obeys]


@pytest.mark.parametrize("cameras", [True, False])
@for_each_robot
def test_laser_commands_need_cameras(case, cameras):
    commands = offered_to(robot(case.connected), cameras=cameras).commands
    assert all((name in commands) == cameras for name in ("define_border", "define_seed", "save", "cancel"))
    assert ("guide_robot" in commands) == (cameras and "has_driver" in case.connected)


def test_two_robots_are_offered_what_each_of_them_is_alone():
    """Whatever the two are: each zone and command of either is offered, and nothing more."""
    every = [(connected, localized) for connected, *_ in CASES for localized in (True, False)]
    for (of_ada, ada_known), (of_bob, bob_known) in itertools.product(every, every):
        pair = robot(of_ada, "ada", ada_known), robot(of_bob, "bob", bob_known)
        ada, bob, both = (offered_to(*robots, cameras=True) for robots in (pair[:1], pair[1:], pair))
        assert set(both.commands) == {*ada.commands, *bob.commands}
        assert set(both.zones) == {*ada.zones, *bob.zones}
        assert both.sendable_robots == ada.sendable_robots + bob.sendable_robots
        assert both.robot_notices == ada.robot_notices + bob.robot_notices
        assert both.ignored_by == {zone: ada.ignored_by[zone] + bob.ignored_by[zone] for zone in ZONES}
        assert (both.state == READY) == (ada.state == bob.state == READY)


def test_each_line_has_its_sentence():
    for connected, localized, name in itertools.product([case.connected for case in CASES], (True, False), ("", "ada")):
        for line in offered_to(robot(connected, name, localized)).robot_notices:
            values = {name.replace("_code", ""): value for name, value in line.values.items()}
            assert sentences.catalog()[line.code].format_map(values)


def test_a_lab_without_a_robot_has_no_warnings():
    offered = offered_to(ConnectedRobot(""), cameras=True)
    assert offered.state == NO_ROBOT
    assert offered.problems() == []
    assert [line.code for line in offered.robot_notices] == ["robot_not_connected"]


def test_commands_without_an_effect_are_not_offered():
    offered = derive_capabilities(Connections((robot(DRIVER),), has_interaction=True))
    assert effective_commands(offered, ("define_border", "guide_robot", "stop", "undo")) == ("stop", "undo")


@pytest.mark.parametrize(
    "zone, border_for, unkept",
    [
        ("keep_out", (), ("border_unkept_keep_out", {"who": "bob"})),
        ("keep_out", ("ada",), None),
        ("keep_out", ("bob",), ("border_unkept_keep_out", {"who": "bob"})),
        ("slow", (), ("border_unkept_slow", {"who": "ada, bob"})),
    ],
)
def test_a_border_names_its_robots_that_do_not_keep_it(zone, border_for, unkept):
    assert describe_ignored_zone(offered_to(robot(PLANS, "ada"), robot({}, "bob")), zone, border_for) == unkept


def test_a_border_in_a_lab_without_a_robot_says_so():
    assert describe_ignored_zone(offered_to(ConnectedRobot("")), "keep_out", ()) == ("border_without_robot", {})


@pytest.mark.parametrize(
    "changes, code, severity",
    [
        (dict(plans_round_borders=False, maps=("/map",)), "robot_ignores_borders", Severity.ERROR),
        (dict(plans_round_borders=False, has_driver=True), "robot_plans_through_borders", Severity.WARNING),
        (dict(missing_maps=("/robot_driver/keep_out",)), "robot_waits_for_map", Severity.ERROR),
        (dict(unheard_topics=("/cmd_vel/navigation",)), "robot_commands_unheard", Severity.ERROR),
        (dict(is_localized=False), "robot_not_localized", Severity.WARNING),
    ],
)
def test_each_fault_is_a_notice_that_names_its_robot(changes, code, severity):
    (notice,) = offered_to(replace(robot(PLANS), **changes)).problems()
    assert_fields(notice, code=code, severity=severity, robot="ada")
    assert "ada" in notice.sentence()


@pytest.mark.parametrize("name, topic, is_said", [("ada", "", True), ("ada", "/ada", False), ("", "", False)])
def test_a_named_robot_on_the_common_map_keeps_all_borders(name, topic, is_said):
    offered = offered_to(robot(dict(**PLANS, maps=(f"{topic}/virtual_borders/map",)), name))
    assert ("robot_keeps_all_borders" in [line.code for line in offered.robot_notices]) is is_said
