"""Reads from robot_monitor's messages what is connected, and keeps the lab's capabilities that follow from it."""

from __future__ import annotations

from typing import Callable, Optional, Tuple

import rospy

from vb_core import names
from vb_core.capabilities import Capabilities, ConnectedRobot, Connections, derive_capabilities
from vb_msgs.msg import RobotStatus, RobotStatusArray

_SILENCE = 4.0  # [s] ROS time; robot_monitor publishes every second


def robot_from_status(message: RobotStatus) -> ConnectedRobot:
    """Converts the message about one robot."""
    return ConnectedRobot(
        name=message.robot,
        has_navigation=bool(message.move_base),
        plans_round_borders=message.plans_round_borders,
        has_driver=message.driver,
        is_localized=message.localized,
        obeys_stop=message.obeys_stop,
        obeys_speed=message.obeys_speed,
        maps=tuple(message.maps),
        missing_maps=tuple(message.missing_maps),
        unheard_topics=tuple(message.unheard),
    )


def connections_from_message(message: RobotStatusArray) -> Connections:
    """Converts the message about a whole lab."""
    return Connections(tuple(map(robot_from_status, message.robots)), bool(message.cameras), message.interaction)


class CapabilitiesListener:
    """Keeps the capabilities derived from robot_monitor's newest message, until robot_monitor falls silent.

    Args:
        on_message: called from rospy's thread after each message.
    """

    def __init__(self, on_message: Callable[[], None] = lambda: None) -> None:
        self._on_message = on_message
        self._newest: Optional[Tuple[float, RobotStatusArray, Capabilities]] = None  # begins with its arrival time [s]
        rospy.Subscriber(names.ROBOTS, RobotStatusArray, self._on_robots, queue_size=1, tcp_nodelay=True)

    def current(self) -> Optional[Tuple[RobotStatusArray, Capabilities]]:
        """Returns the newest message and the capabilities derived from it; None if there is none or it is too old."""
        newest = self._newest
        if newest is None or not 0.0 <= rospy.get_time() - newest[0] <= _SILENCE:
            return None
        return newest[1:]

    def _on_robots(self, message: RobotStatusArray) -> None:
        self._newest = (rospy.get_time(), message, derive_capabilities(connections_from_message(message)))
        self._on_message()
