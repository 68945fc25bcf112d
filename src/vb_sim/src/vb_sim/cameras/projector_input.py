"""Receives the floor projector's images, for the camera nodes."""

from __future__ import annotations

from typing import Any, List, Optional

import rospy
from sensor_msgs.msg import Image

from vb_core import names
from vb_core.errors import CodedError
from vb_core.ros.images import array_from_image
from vb_sim.room.camera_models import Optics
from vb_sim.room.projected_light import FloorLight, floor_light
from vb_sim.room.world import World


class ProjectorInput:
    """Hands each view the newest light of a world's projector; a world without one costs nothing.

    Subscribes:
        /virtual_borders/projector (sensor_msgs/Image, rgb8), if the world has a projector.

    Args:
        views: of the cameras; each has a method `set_floor_light`.
    """

    def __init__(self, world: World, optics: Optics, views: List[Any]) -> None:
        self._projector, self._optics = world.projector, optics
        self._views = views
        self._light: Optional[FloorLight] = None
        self._shown: List[Optional[FloorLight]] = [None] * len(views)
        if self._projector is not None:
            rospy.Subscriber(names.PROJECTOR, Image, self._on_image, queue_size=1, buff_size=2**24)

    def _on_image(self, message: Image) -> None:
        try:
            image = array_from_image(message)
            if message.encoding != "rgb8":
                raise CodedError("bad_image", f"the projector's image must be rgb8, it is {message.encoding}")
        except CodedError as error:
            rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: {error}")
            return
        self._light = floor_light(image, self._projector, self._optics)

    def update(self, index: int) -> None:
        """Sets the newest light in a view, before its next frame; must be called from the thread that renders."""
        light = self._light
        if light is not self._shown[index]:
            self._shown[index] = light
            self._views[index].set_floor_light(light)
