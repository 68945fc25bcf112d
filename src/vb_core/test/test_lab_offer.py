"""What is offered to people, by what is connected to the lab."""

import itertools
from dataclasses import replace
from typing import NamedTuple

import pytest

from vb_core import sentences
from vb_core.notices import Severity
from vb_core.lab_offer import NO_ROBOT, READY, UNREADY, ConnectedRobot, Connections
from vb_core.lab_offer import derive_offer, effective_commands, find_unkept
from vb_core.zones import ZONES

PLANS = dict(plans_round_borders=True)
STOP, STOP_AND_SPEED = dict(obeys_stop=True), dict(obeys_stop=True, obeys_speed=True)  # by robot_monitor
DRIVER = dict(driver=True)


class Case(NamedTuple):
    """A robot by what is connected to it: the zones that it keeps, and what it does."""

    connected: dict
    zones: list
    goes: bool
    stops: bool
    told: str  # what people are told about it: codes without their beginning, robot_

    def codes(self):
        return ["robot_" + code for code in self.told.split()]


CASES = [
    Case({}, zones=[], goes=False, stops=False, told="ignores_borders obeys_borders_only"),
    Case(STOP, zones=[], goes=False, stops=True, told="ignores_borders obeys_stop_only"),
    Case(STOP_AND_SPEED, zones=["slow"], goes=False, stops=True, told="ignores_borders obeys_by_navigation"),
    Case(DRIVER, zones=["keep_out", "slow"], goes=False, stops=True, told="plans_through_borders has_driver"),
    Case(PLANS, zones=["keep_out", "avoid"], goes=True, stops=False, told="plans_round_borders obeys_borders_only"),
    Case({**PLANS, **STOP}, ["keep_out", "avoid"], goes=True, stops=True, told="plans_round_borders obeys_stop_only"),
    Case({**PLANS, **STOP_AND_SPEED}, [*ZONES], goes=True, stops=True, told="plans_round_borders obeys_by_navigation"),
    Case({**PLANS, **DRIVER}, zones=[*ZONES], goes=True, stops=True, told="plans_round_borders has_driver"),
]
for_each_case = pytest.mark.parametrize("case", CASES, ids=[" ".join(case.connected) or "navigation" for case in CASES])


def robot(connected, name="ada", localized=True):
    return ConnectedRobot(name, navigation=True, localized=localized, **connected)


def offered_to(*robots, cameras=False):
    """Returns what a lab with these robots offers."""
    return derive_offer(Connections(robots, cameras, interaction=cameras))


@for_each_case
def test_a_robot_keeps_the_zones_that_planner_monitor_or_driver_enforce(case):
    offered = offered_to(robot(case.connected))
    assert list(offered.zones) == case.zones
    assert offered.ignored_by == {zone: () if zone in case.zones else ("ada",) for zone in ZONES}


@for_each_case
def test_a_lab_is_ready_if_its_robot_keeps_out_of_borders(case):
    assert offered_to(robot(case.connected)).state == (READY if "keep_out" in case.zones else UNREADY)


@for_each_case
def test_only_a_robot_that_plans_round_borders_is_sent_anywhere(case):
    offered = offered_to(robot(case.connected))
    assert offered.goes == (("ada",) if case.goes else ())
    assert ("go" in offered.commands) == case.goes


@for_each_case
def test_stop_is_offered_only_if_it_stops_a_robot(case):
    for localized in (True, False):
        commands = offered_to(robot(case.connected, localized=localized)).commands
        assert ("stop" in commands) == ("resume" in commands) == case.stops


@for_each_case
def test_people_are_told_what_a_robot_obeys(case):
    assert [line.code for line in offered_to(robot(case.connected)).lines] == case.codes()


@for_each_case
def test_a_lost_robot_keeps_no_zone_and_is_sent_nowhere(case):
    offered = offered_to(robot(case.connected, localized=False))
    assert (offered.zones, offered.goes, offered.state) == ((), (), UNREADY)
    plans, obeys = case.codes()
    assert [line.code for line in offered.lines] == [plans, "robot_not_localized", obeys]


@pytest.mark.parametrize("cameras", [True, False])
@for_each_case
def test_commands_for_the_laser_need_cameras_and_guiding_a_driver(case, cameras):
    commands = offered_to(robot(case.connected), cameras=cameras).commands
    assert all((name in commands) == cameras for name in ("define_border", "define_seed", "save", "cancel"))
    assert ("guide_robot" in commands) == (cameras and "driver" in case.connected)


def test_two_robots_are_offered_what_each_of_them_is_alone():
    """Whatever the two are: each zone and command of either is offered, and nothing more."""
    every = [(case.connected, localized) for case in CASES for localized in (True, False)]
    for (of_ada, ada_known), (of_bob, bob_known) in itertools.product(every, every):
        pair = robot(of_ada, "ada", ada_known), robot(of_bob, "bob", bob_known)
        ada, bob, both = (offered_to(*robots, cameras=True) for robots in (pair[:1], pair[1:], pair))
        assert set(both.commands) == {*ada.commands, *bob.commands} and set(both.zones) == {*ada.zones, *bob.zones}
        assert (both.goes, both.lines) == (ada.goes + bob.goes, ada.lines + bob.lines)
        assert both.ignored_by == {zone: ada.ignored_by[zone] + bob.ignored_by[zone] for zone in ZONES}
        assert (both.state == READY) == (ada.state == bob.state == READY)


@pytest.mark.parametrize("language", sentences.languages())
def test_each_line_is_a_sentence_in_every_language(language):
    for case, localized, name in itertools.product(CASES, (True, False), ("", "ada")):
        for line in offered_to(robot(case.connected, name, localized)).lines:
            assert sentences.catalog(language)[line.code].format_map(line.values)


def test_a_lab_without_a_robot_has_no_warnings():
    offered = offered_to(ConnectedRobot(""), cameras=True)
    assert (offered.state, offered.notices()) == (NO_ROBOT, [])
    assert [line.code for line in offered.lines] == ["robot_not_connected"]


def test_commands_without_an_effect_are_not_offered():
    offered = derive_offer(Connections((robot(DRIVER),), interaction=True))
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
    assert find_unkept(offered_to(robot(PLANS, "ada"), robot({}, "bob")), zone, border_for) == unkept


def test_a_border_in_a_lab_without_a_robot_says_so():
    assert find_unkept(offered_to(ConnectedRobot("")), "keep_out", ()) == ("border_without_robot", {})


@pytest.mark.parametrize(
    "changes, code, severity",
    [
        (dict(plans_round_borders=False, maps=("/map",)), "robot_ignores_borders", Severity.ERROR),
        (dict(plans_round_borders=False, driver=True), "robot_plans_through_borders", Severity.WARNING),
        (dict(missing_maps=("/robot_driver/keep_out",)), "robot_waits_for_map", Severity.ERROR),
        (dict(unheard=("/cmd_vel/navigation",)), "robot_commands_unheard", Severity.ERROR),
        (dict(localized=False), "robot_not_localized", Severity.WARNING),
    ],
)
def test_each_fault_is_a_notice_that_names_its_robot(changes, code, severity):
    (notice,) = offered_to(replace(robot(PLANS), **changes)).notices()
    assert (notice.code, notice.severity, notice.robot) == (code, severity, "ada")
    assert "ada" in notice.sentence()


def test_a_sound_robot_has_no_notice():
    assert offered_to(robot(PLANS)).notices() == []


@pytest.mark.parametrize(
    "name, topic, is_said", [("ada", "", True), ("ada", "/ada", False), ("", "", False)], ids="common own alone".split()
)
def test_a_robot_on_the_common_map_is_said_to_keep_all_borders(name, topic, is_said):
    offered = offered_to(robot(dict(**PLANS, maps=(f"{topic}/virtual_borders/map",)), name))
    assert ("robot_keeps_all_borders" in [line.code for line in offered.lines]) is is_said
