"""One robot as the dispatcher sees it: where it is, and its navigation."""
from __future__ import annotations

from typing import Callable, Optional

import rospy
from sensor_msgs.msg import CameraInfo

from vb_core import geometry, names
from vb_core.errors import CodedError
from vb_core.robot_profile import RobotProfile
from vb_core.ros.cameras import camera_from_info
from vb_core.ros.transforms import TransformLookup
from vb_robot.dispatch import RobotStatus
from vb_robot.navigation_client import NavigationClient
from vb_robot.view import FloorView
from vb_robot.viewpoint import Pose, Viewpoint


class DispatchedRobot:
    """One robot; its name, if it has one, precedes its frame and its action.

    Action client:
        [<name>/]move_base (move_base_msgs/MoveBaseAction)
    """

    def __init__(
        self, name: str, profile: RobotProfile, transforms: TransformLookup,
        set_view: Callable[[str, FloorView], None],
    ) -> None:
        prefix = f"{name}/" if name else ""
        self.name = name
        self.who = f"robot {name}" if name else "the robot"
        self.navigation = NavigationClient(f"{prefix}move_base")
        self._base_frame = prefix + profile.frames.base
        self._transforms = transforms
        self._max_range, self._set_view = profile.camera.max_range, set_view
        self._info: Optional[CameraInfo] = None
        self._camera = rospy.Subscriber(prefix + profile.camera.info, CameraInfo, self._on_camera, queue_size=1)

    def _on_camera(self, message: CameraInfo) -> None:
        if self._info is not None and message.K == self._info.K:
            return
        try:
            T = self._transforms.lookup(self._base_frame, message.header.frame_id, rospy.Time(0), timeout_s=0.0)
            view = FloorView(camera_from_info(message), T, self._max_range)
        except CodedError as error:
            rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: the camera of {self.who} is not usable yet: {error}")
            return
        self._info = message
        self._set_view(self.name, view)

    def status(self, wanted: bool) -> RobotStatus:
        """How it is now; where it is only if a robot is wanted."""
        navigation = self.navigation
        server = navigation.alive()
        if server and navigation.cancel_leftovers():
            rospy.logwarn("%s: cancelled a goal that %s had from before a restart", rospy.get_name(), self.who)
        pose = self._pose() if wanted else None
        return RobotStatus(pose, server, navigation.status(), navigation.busy(), navigation.goal_place())

    def pose_for(self, viewpoint: Viewpoint) -> Pose:
        """(x, y, yaw) that the robot is to be sent to for a viewpoint, map frame."""
        return viewpoint.pose_from(self._pose() if viewpoint.turns_only else None)

    def _pose(self) -> Optional[Pose]:
        """(x, y, yaw), map frame; None if it is not localised."""
        try:
            T = self._transforms.lookup(names.MAP_FRAME, self._base_frame, rospy.Time(0), timeout_s=0.0)
        except CodedError as error:
            rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: {self.who} is not localised: {error}")
            return None
        return geometry.transform_pose2d(T)
