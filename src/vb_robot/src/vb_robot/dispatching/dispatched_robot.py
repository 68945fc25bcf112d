"""One robot as the dispatcher sees it: where it is, and its navigation."""
from __future__ import annotations

import functools
from typing import Callable, Optional

import rospy

from vb_core import geometry, names
from vb_core.errors import CodedError
from vb_core.robot_profile import RobotProfile
from vb_core.ros.transforms import TransformLookup
from vb_robot.camera_view import CameraView
from vb_robot.dispatching.dispatch import RobotStatus
from vb_robot.dispatching.navigation_client import NavigationClient
from vb_robot.dispatching.view import FloorView
from vb_robot.dispatching.viewpoint import Pose


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
        self.name, self.who = name, f"robot {name}" if name else "the robot"
        self.navigation = NavigationClient(f"{prefix}move_base")
        self._base_frame, self._transforms = prefix + profile.frames.base, transforms
        self._camera = CameraView(prefix + profile.camera.info, self._base_frame, profile.camera.max_range, transforms,
                                  functools.partial(set_view, name))

    def status(self, wanted: bool) -> RobotStatus:
        """How it is now; where it is only if a robot is wanted."""
        navigation = self.navigation
        server = navigation.alive()
        if server and navigation.cancel_leftovers():
            rospy.logwarn("%s: cancelled a goal that %s had from before a restart", rospy.get_name(), self.who)
        pose = self._pose() if wanted else None
        return RobotStatus(pose, server, navigation.status(), navigation.busy(), navigation.goal_place())

    def _pose(self) -> Optional[Pose]:
        """(x, y, yaw), map frame; None if it is not localised."""
        try:
            T = self._transforms.lookup(names.MAP_FRAME, self._base_frame, rospy.Time(0), timeout_s=0.0)
        except CodedError as error:
            rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: {self.who} is not localised: {error}")
            return None
        return geometry.transform_pose2d(T)
