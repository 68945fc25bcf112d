"""What is offered to people, in every combination of connections."""

import itertools
from dataclasses import replace

import pytest

from vb_core import sentences
from vb_core.notices import Severity
from vb_core.zones import ZONES
from vb_core.lab_offer import NO_ROBOT, READY, UNREADY, ConnectedRobot, Connections, effective, offer, find_unkept

# who enforces stop and slow zones: nobody, robot_monitor without or with a known local planner, the driver
OBEDIENCE = [{}, dict(obeys_stop=True), dict(obeys_stop=True, obeys_speed=True), dict(driver=True)]


def robots(name):
    """Yields every possible robot."""
    for wired, obedience, localized in itertools.product((True, False), OBEDIENCE, (True, False)):
        yield ConnectedRobot(name, navigation=True, plans_round_borders=wired, localized=localized, **obedience)


def labs():
    """Yields every lab: with or without cameras, with one robot or with two in namespaces."""
    for cameras in (True, False):
        for robot in robots(""):
            yield Connections((robot,), cameras, cameras)
        for ada, bob in itertools.product(robots("ada"), robots("bob")):
            yield Connections((ada, bob), cameras, cameras)


def test_every_lab_is_offered_exactly_what_has_an_effect():
    count = 0
    for lab in labs():
        count += 1
        offered = offer(lab)
        # Stop is offered only if it stops a robot
        assert ("stop" in offered.commands) == any(robot.driver or robot.obeys_stop for robot in lab.robots)
        assert ("resume" in offered.commands) == ("stop" in offered.commands)
        laser = {"define_border", "define_seed", "save", "cancel"}
        assert laser & set(offered.commands) == (laser if lab.cameras else set())
        assert ("guide_robot" in offered.commands) == (lab.cameras and any(robot.driver for robot in lab.robots))
        told = {(line.robot, line.code): line.severity for line in offered.lines}
        for robot in lab.robots:
            kept = [zone for zone in ZONES if robot.name not in offered.ignored_by[zone]]
            # no zone counts as kept that neither planner nor driver enforces, or while the robot is lost
            assert ("keep_out" in kept) == (robot.localized and (robot.plans_round_borders or robot.driver))
            assert ("slow" in kept) == (robot.localized and (robot.driver or robot.obeys_speed))
            assert ("avoid" in kept) == (robot.localized and robot.plans_round_borders)
            # no robot that ignores borders is sent anywhere
            assert (robot.name in offered.goes) == (robot.localized and robot.plans_round_borders)
            lost = not robot.plans_round_borders and not robot.driver
            assert (told.get((robot.name, "robot_ignores_borders")) is Severity.ERROR) == lost
            assert ((robot.name, "robot_not_localized") in told) == (not robot.localized)
            says_stop = {"robot_has_driver", "robot_obeys_by_navigation", "robot_obeys_stop_only"}
            assert bool(says_stop & {code for name, code in told if name == robot.name}) == robot.stops
        assert set(offered.zones) == {zone for zone in ZONES if any(robot.keeps(zone) for robot in lab.robots)}
        assert ("go" in offered.commands) == bool(offered.goes)
        assert offered.state in (READY, UNREADY) and (offered.state == READY) == all(
            robot.keeps("keep_out") for robot in lab.robots
        )
        for line in offered.lines:
            for language in sentences.languages():
                assert sentences.catalog(language)[line.code].format_map(line.values)
    assert count == 2 * (16 + 16 * 16)


def test_a_lab_without_a_robot_has_no_warnings():
    offered = offer(Connections((ConnectedRobot(""),), cameras=True, interaction=True))
    assert offered.state == NO_ROBOT and offered.notices() == []
    assert [line.code for line in offered.lines] == ["robot_not_connected"]
    assert find_unkept(offered, "keep_out", ()) == ("border_without_robot", {})


def test_commands_without_an_effect_are_not_offered():
    offered = offer(Connections((ConnectedRobot("", driver=True, localized=True),), interaction=True))
    assert effective(offered, ("define_border", "guide_robot", "stop", "undo")) == ("stop", "undo")


def test_a_border_names_its_robots_that_do_not_keep_it():
    wired = ConnectedRobot("ada", navigation=True, plans_round_borders=True, localized=True)
    offered = offer(Connections((wired, replace(wired, name="bob", plans_round_borders=False))))
    assert find_unkept(offered, "keep_out", ()) == ("border_unkept_keep_out", {"who": "bob"})
    assert find_unkept(offered, "keep_out", ("ada",)) is None
    assert find_unkept(offered, "slow", ()) == ("border_unkept_slow", {"who": "ada, bob"})
    assert "bob" in sentences.translate(*find_unkept(offered, "keep_out", ("bob",)))


@pytest.mark.parametrize(
    "changes, code",
    [
        (dict(plans_round_borders=False, maps=("/map",)), "robot_ignores_borders"),
        (dict(plans_round_borders=False, driver=True), "robot_plans_through_borders"),
        (dict(missing_maps=("/robot_driver/keep_out",)), "robot_waits_for_map"),
        (dict(unheard=("/cmd_vel/navigation",)), "robot_commands_unheard"),
        (dict(localized=False), "robot_not_localized"),
    ],
)
def test_each_fault_is_a_notice_that_names_its_robot(changes, code):
    good = ConnectedRobot("ada", navigation=True, plans_round_borders=True, localized=True)
    assert offer(Connections((good,))).notices() == []
    notices = offer(Connections((replace(good, **changes),))).notices()
    assert [notice.code for notice in notices] == [code]
    assert notices[0].robot == "ada" and "ada" in notices[0].sentence()


def test_a_robot_on_the_common_map_keeps_all_borders():
    common = ConnectedRobot("ada", navigation=True, plans_round_borders=True, maps=("/virtual_borders/map",))
    own = replace(common, maps=("/ada/virtual_borders/map",))
    alone = replace(common, name="")
    told = [[line.code for line in offer(Connections((robot,))).lines] for robot in (common, own, alone)]
    assert ["robot_keeps_all_borders" in codes for codes in told] == [True, False, False]
