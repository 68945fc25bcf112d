"""Derives from what is connected to a lab which commands have an effect there, and which zones its robots keep.

Which buttons may the page show? That depends on whether the lab has cameras, and on whether a robot plans on the map
with borders, is driven by this stack's driver, and is localised. One pure function, `derive_capabilities`, decides, and
gives the sentences that explain the decision. Page, display, check_lab and notices all use it, so that none of them
offers a Stop that stops nothing, or claims a zone that no robot keeps. No ROS.

>>> mine = ConnectedRobot("", has_navigation=True, plans_round_borders=True, is_localized=True)
>>> derive_capabilities(Connections((mine,))).commands
('go',)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

from vb_core import sentences
from vb_core.interaction_tables import CAMERA, COMMANDS, DRIVER, STOPPABLE
from vb_core.notices import Notice, Severity
from vb_core.zones import KEEP_OUT, ZONES

READY, NO_ROBOT, UNREADY = "ready", "no_robot", "robot_unready"


@dataclass(frozen=True)
class ConnectedRobot:
    """What is connected to a robot. The fields are those of vb_msgs/RobotStatus, where they are explained.

    `has_navigation`: a move_base is running for it.
    """

    name: str
    has_navigation: bool = False
    plans_round_borders: bool = False
    has_driver: bool = False
    is_localized: bool = False
    obeys_stop: bool = False
    obeys_speed: bool = False
    maps: Tuple[str, ...] = ()
    missing_maps: Tuple[str, ...] = ()
    unheard_topics: Tuple[str, ...] = ()

    @property
    def is_connected(self) -> bool:
        """Whether navigation or a driver is connected that could drive it."""
        return self.has_navigation or self.has_driver

    @property
    def accepts_goals(self) -> bool:
        """Whether its navigation accepts goals and plans round borders."""
        return self.has_navigation and self.plans_round_borders and not self.missing_maps

    @property
    def can_be_stopped(self) -> bool:
        """Whether it obeys Stop."""
        return self.has_driver or (self.has_navigation and self.obeys_stop)

    def respects(self, zone: str) -> bool:
        """Returns whether the robot keeps the rule of a zone, given by name. It keeps none while not localised."""
        return self.is_localized and ZONES[zone].is_respected_by(self)


@dataclass(frozen=True)
class Connections:
    """What is connected to a lab: its robots, whether cameras report, whether an interaction manager belongs to it."""

    robots: Tuple[ConnectedRobot, ...] = ()
    has_cameras: bool = False
    has_interaction: bool = False


@dataclass(frozen=True)
class Capabilities:
    """What a lab can do for people, and what holds for each of its robots.

    Attributes:
        state: READY, NO_ROBOT, or UNREADY if a connected robot does not keep out of borders.
        commands: those of vb_core.interaction_tables with needs that are met; "go" if a robot can be sent to a place.
        zones: the zones that at least one robot keeps.
        ignored_by: names of the connected robots that do not keep a zone, by the name of the zone.
        sendable_robots: the names of the robots that can be sent to a place.
        robot_notices: what to tell people about each robot while the connections do not change.
    """

    state: str
    commands: Tuple[str, ...]
    zones: Tuple[str, ...]
    ignored_by: Mapping[str, Tuple[str, ...]]
    sendable_robots: Tuple[str, ...]
    robot_notices: Tuple[Notice, ...]

    def problems(self) -> List[Notice]:
        """Returns the notices that report a problem."""
        return [notice for notice in self.robot_notices if notice.severity >= Severity.WARNING]


def derive_capabilities(connections: Connections) -> Capabilities:
    """Derives what a lab can do from what is connected to it."""
    connected = [robot for robot in connections.robots if robot.is_connected]
    ignored = {zone: tuple(robot.name for robot in connected if not robot.respects(zone)) for zone in ZONES}
    sendable_robots = tuple(robot.name for robot in connected if robot.accepts_goals and robot.respects(KEEP_OUT.name))
    pointing = connections.has_interaction and connections.has_cameras
    has = {
        CAMERA: pointing,
        DRIVER: pointing and any(robot.has_driver for robot in connected),
        STOPPABLE: any(robot.can_be_stopped for robot in connected),
    }
    commands = [name for name, command in COMMANDS.items() if has.get(command.needs)]
    if sendable_robots:
        commands.append("go")
    ready_state = UNREADY if ignored[KEEP_OUT.name] else READY
    return Capabilities(
        state=ready_state if connected else NO_ROBOT,
        commands=tuple(commands),
        zones=tuple(zone for zone in ZONES if len(ignored[zone]) < len(connected)),
        ignored_by=ignored,
        sendable_robots=sendable_robots,
        robot_notices=tuple(notice for robot in connections.robots for notice in _notices_about(robot)),
    )


def effective_commands(capabilities: Capabilities, commands: Sequence[str]) -> Tuple[str, ...]:
    """Returns those of an interaction's available commands that have an effect in this lab."""
    unmet = {name for name, command in COMMANDS.items() if command.needs} - set(capabilities.commands)
    return tuple(name for name in commands if name not in unmet)


def describe_ignored_zone(
    capabilities: Capabilities, zone: str, robots: Sequence[str]
) -> Optional[Tuple[str, Dict[str, str]]]:
    """Returns code and values of the sentence that says who does not keep a border, or None if all keep it.

    Args:
        zone: name of the border's zone.
        robots: names of the robots that the border is for; empty: all.
    """
    ignoring = [name for name in capabilities.ignored_by[zone] if not robots or name in robots]
    if capabilities.state == NO_ROBOT:
        return "border_without_robot", {}
    if not ignoring:
        return None
    return f"border_unkept_{zone}", sentences.robot_values(*ignoring)


def _notices_about(robot: ConnectedRobot) -> List[Notice]:
    """Returns what to tell people about a robot: what is missing, how it plans, and what it obeys."""
    values = {**sentences.robot_values(robot.name), "maps": ", ".join(robot.maps) or "-"}
    values["map"] = f"/{robot.name}/virtual_borders/map" if robot.name else "/virtual_borders/map"

    def notice(severity: Severity, code: str, **more_values: str) -> Notice:
        return Notice(code, severity, robot.name, values={**values, **more_values})

    if not robot.is_connected:
        return [notice(Severity.INFO, "robot_not_connected")]
    notices = []
    if robot.missing_maps:
        notices.append(notice(Severity.ERROR, "robot_waits_for_map", missing=", ".join(robot.missing_maps)))
    elif robot.accepts_goals:
        notices.append(notice(Severity.INFO, "robot_plans_round_borders"))
    elif robot.has_navigation and robot.has_driver:
        notices.append(notice(Severity.WARNING, "robot_plans_through_borders"))
    elif robot.has_navigation:
        notices.append(notice(Severity.ERROR, "robot_ignores_borders"))
    if robot.unheard_topics:
        notices.append(notice(Severity.ERROR, "robot_commands_unheard", topic=", ".join(robot.unheard_topics)))
    has_map_of_its_own = values["map"] in robot.maps
    if robot.name and robot.accepts_goals and robot.maps and not has_map_of_its_own:
        notices.append(notice(Severity.INFO, "robot_keeps_all_borders"))
    if not robot.is_localized:
        # a driver that is asked to drive reports an unknown pose itself
        severity = Severity.INFO if robot.has_driver else Severity.WARNING
        notices.append(notice(severity, "robot_not_localized"))
    notices.append(notice(Severity.INFO, _obedience(robot)))
    return notices


def _obedience(robot: ConnectedRobot) -> str:
    if robot.has_driver:
        return "robot_has_driver"
    if robot.can_be_stopped and robot.obeys_speed:
        return "robot_obeys_by_navigation"
    return "robot_obeys_stop_only" if robot.can_be_stopped else "robot_obeys_borders_only"
