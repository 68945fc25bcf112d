"""Reads a robot's profile from the parameter server, where the launch files put it."""

from __future__ import annotations

import rospy

from vb_core.robot_profile import RobotProfile

PARAMETER = "robot_profile"


def read_radius(robot: str, default: float) -> float:
    """Reads a robot's radius [m] from its profile. Returns `default` if no profile is set.

    For nodes that need nothing else from the profile.

    Args:
        robot: the robot's name; empty for the only robot.
    """
    values = rospy.get_param(f"/{robot}/{PARAMETER}" if robot else f"/{PARAMETER}", {})
    return RobotProfile.from_mapping(values, PARAMETER).radius if values else default


def read(robot: str = "") -> RobotProfile:
    """Reads a robot's profile. Returns a TurtleBot 2's if none is set.

    Args:
        robot: the robot's name, which is its namespace; empty for the node's own namespace.

    Raises:
        ParameterError: names the key that is wrong.
    """
    name = rospy.resolve_name(f"{robot}/{PARAMETER}" if robot else PARAMETER)
    values = rospy.get_param(name, {})
    if not values:
        rospy.logwarn("%s: %s is not set: taken to be a TurtleBot 2", rospy.get_name(), name)
    return RobotProfile.from_mapping(values, name)
