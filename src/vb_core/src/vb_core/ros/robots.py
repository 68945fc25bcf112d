"""What is connected, to and from messages: robot_monitor publishes it, page, display and check_lab make the offer of it."""

from __future__ import annotations

from vb_core.offer import ConnectedRobot, Connections
from vb_msgs.msg import RobotStatus, RobotStatusArray


def robot_from_status(message: RobotStatus) -> ConnectedRobot:
    """Converts what is connected to one robot."""
    return ConnectedRobot(
        message.robot,
        bool(message.move_base),
        message.plans_round_borders,
        message.driver,
        message.localized,
        message.obeys_stop,
        message.obeys_speed,
        tuple(message.maps),
        tuple(message.missing_maps),
        tuple(message.unheard),
    )


def connections_from_message(message: RobotStatusArray) -> Connections:
    """Converts what is connected to a lab."""
    return Connections(tuple(map(robot_from_status, message.robots)), bool(message.cameras), message.interaction)
