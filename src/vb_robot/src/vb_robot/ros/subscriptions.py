"""The inputs that both nodes read: maps, borders, spots; and the message class of contact sensors."""

from __future__ import annotations

from typing import Any, Callable, List

import numpy as np
import rospy
from roslib.message import get_message_class

from vb_core import names
from vb_core.errors import CodedError, ParameterError
from vb_core.grid_map import GridMap
from vb_core.robot_profile import Contact
from vb_core.ros.messages import NumpyOccupancyGrid, array_from_points, grid_from_message
from vb_core.zones import zone_by_number
from vb_msgs.msg import LaserSpot, VirtualBorder, VirtualBorderArray
from vb_robot.driving.workspace import LETHAL_THRESHOLD
from vb_robot.monitoring.goal_checker import KnownBorder
from vb_robot.spot_sightings import Sighting


def subscribe_map(topic: str, on_map: Callable[[GridMap], None]) -> rospy.Subscriber:
    """Passes every map of a topic to `on_map`. Malformed ones are logged and refused."""

    def on_message(message: NumpyOccupancyGrid) -> None:
        try:
            grid = grid_from_message(message)
        except CodedError as error:
            rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: map refused: {error}")
        else:
            on_map(grid)

    return rospy.Subscriber(topic, NumpyOccupancyGrid, on_message, queue_size=1, buff_size=2**24)


def keep_out_borders_for(robot: str, message: VirtualBorderArray) -> List[KnownBorder]:
    """Returns the borders in force that a robot must not enter."""
    return [
        KnownBorder(
            name=border.name or border.id,
            points=array_from_points(border.points),
            seed=np.array([border.seed.x, border.seed.y]),
            is_polygon=border.kind == VirtualBorder.POLYGON,
        )
        for border in message.borders
        if border.in_force
        and len(border.points)
        and (not border.robots or robot in border.robots)
        and zone_by_number(border.zone).value(border.occupancy) >= LETHAL_THRESHOLD
    ]


def subscribe_spots(on_spot: Callable[[Sighting], None]) -> rospy.Subscriber:
    """Passes every spot with a position in the map to `on_spot`. The others are logged and rejected."""

    def on_message(message: LaserSpot) -> None:
        position = (message.position.x, message.position.y)
        if message.header.frame_id != names.MAP_FRAME or not np.isfinite(position).all():
            got = f"frame '{message.header.frame_id}', position {position}"
            expected = f"expected finite values in '{names.MAP_FRAME}'"
            rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: spot rejected: {got}; {expected}")
        else:
            stamp = message.header.stamp.to_sec()
            on_spot(Sighting(stamp, position, message.camera, message.mobile, message.confidence))

    return rospy.Subscriber(names.SPOTS, LaserSpot, on_message, queue_size=100)


def contact_message_class(contact: Contact) -> Any:
    """Returns a contact sensor's message class.

    Raises:
        ParameterError: if the sensor cannot be read. A robot must not drive with a bumper that nobody hears.
    """
    kind = get_message_class(contact.type)
    if kind is None:
        raise ParameterError("robot_profile/contacts", f"the message type {contact.type} is not installed")
    fields = [name for name in (contact.field, contact.sensor) if name]
    missing = [name for name in fields if not hasattr(kind(), name)]
    if missing:
        raise ParameterError("robot_profile/contacts", f"{contact.type} has no field {missing[0]}")
    return kind
