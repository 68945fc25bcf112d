"""Reading a robot's profile from the parameter server, where the launch files put it."""
from __future__ import annotations

import rospy

from vb_core.robot_profile import RobotProfile

PARAMETER = "robot_profile"


def radius(robot: str, otherwise: float) -> float:
    """[m] a robot's radius by its profile, or `otherwise` where no profile is set: for nodes that need nothing else.

    Args:
        robot: its name; empty for the only one.
    """
    found = rospy.get_param(f"/{robot}/{PARAMETER}" if robot else f"/{PARAMETER}", {})
    return RobotProfile.from_mapping(found, PARAMETER).radius if found else otherwise


def read(robot: str = "") -> RobotProfile:
    """The profile of a robot; that of the node's own namespace without a name. TurtleBot 2's if none is set.

    Args:
        robot: its name, which is its namespace.

    Raises:
        ParameterError: names the key that is wrong.
    """
    name = rospy.resolve_name(f"{robot}/{PARAMETER}" if robot else PARAMETER)
    found = rospy.get_param(name, {})
    if not found:
        rospy.logwarn("%s: %s is not set: taken to be a TurtleBot 2", rospy.get_name(), name)
    return RobotProfile.from_mapping(found, name)
