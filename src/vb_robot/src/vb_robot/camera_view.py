"""What a robot's camera sees of the floor, from camera_info and tf."""
from __future__ import annotations

from typing import Callable, Optional

import rospy
from sensor_msgs.msg import CameraInfo

from vb_core.errors import CodedError
from vb_core.ros.cameras import camera_from_info
from vb_core.ros.transforms import TransformLookup
from vb_robot.dispatching.view import FloorView


class CameraView:
    """Gives a robot's floor view to `take`, at first and whenever the lens or the mount's frame changes."""

    def __init__(
        self, topic: str, base_frame: str, max_range: float, transforms: TransformLookup,
        take: Callable[[FloorView], None],
    ) -> None:
        self._base, self._max_range, self._transforms, self._take = base_frame, max_range, transforms, take
        self._known: Optional[tuple] = None
        self._subscriber = rospy.Subscriber(topic, CameraInfo, self._on_info, queue_size=1)

    def _on_info(self, message: CameraInfo) -> None:
        key = (message.K, message.header.frame_id)
        if key == self._known:
            return
        try:
            T = self._transforms.lookup(self._base, message.header.frame_id, rospy.Time(0), timeout_s=0.0)
            self._take(FloorView(camera_from_info(message), T, self._max_range))
        except CodedError as error:
            rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: the camera's view is not known yet: {error}")
            return
        self._known = key
