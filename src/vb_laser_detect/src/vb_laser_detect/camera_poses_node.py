"""Publishes the poses of calibrated ceiling cameras as static transforms."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, Tuple

import rospy
import tf2_ros
from geometry_msgs.msg import TransformStamped

from vb_core.errors import CodedError, ParameterError
from vb_core.parameters import Parameters, param
from vb_core.ros import messages, parameters
from vb_laser_detect.calibration import file as calibration_file


@dataclass(frozen=True)
class CameraPosesParams(Parameters):
    """The node's parameters."""

    folder: str = param("", doc="of the calibration files, <camera>.yaml")
    cameras: str = param("", doc="names of the cameras, separated by spaces")
    look_s: float = param(2.0, "s", above=0.0, high=3600.0, doc="the files are looked at so often")


class CameraPosesNode:
    """Reads calibrate_camera's files, and again whenever they change.

    A camera without a file, or with a broken one, is named in a warning; its last good pose stays.

    Published topics:
        tf_static: the frames that the files name, usually map -> <camera>_optical_frame
    Parameters:
        ~* CameraPosesParams
    """

    def __init__(self, params: CameraPosesParams) -> None:
        self._cameras = params.cameras.split()
        if not params.folder or not self._cameras:
            raise ParameterError(rospy.resolve_name("~folder"), "a folder and the names of cameras must be set")
        self._folder = params.folder
        self._known: Dict[str, Tuple[int, int]] = {}
        self._transforms: Dict[str, TransformStamped] = {}
        self._broadcaster = tf2_ros.StaticTransformBroadcaster()
        self._look()
        self._timer = rospy.Timer(rospy.Duration(params.look_s), self._look, reset=True)

    def _look(self, _event: Any = None) -> None:
        changed = False
        for camera in self._cameras:
            path = calibration_file.calibration_path(self._folder, camera)
            try:
                state = path.stat()
                version = (state.st_mtime_ns, state.st_ino)
            except OSError:
                version = (0, 0)
            if self._known.get(camera) == version:
                continue
            self._known[camera] = version
            try:
                pose = calibration_file.load(path)
                frames = {name: other.child_frame_id for name, other in self._transforms.items()}
                # a shared one can be right for neither
                self._transforms = {name: other for name, other in self._transforms.items() if frames[name] != pose.frame or name == camera}
                calibration_file.require_own_frame(camera, pose.frame, frames)
            except CodedError as error:
                rospy.logwarn("%s: %s", rospy.get_name(), error)
                continue
            place = " ".join(f"{value:.3f}" for value in pose.T[:3, 3])
            rospy.loginfo("%s: %s is at %s in %s (%s)", rospy.get_name(), pose.frame, place, pose.parent, path)
            self._transforms[camera] = messages.transform_message(pose.T, pose.parent, pose.frame, rospy.Time.now())
            changed = True
        if changed:
            # all of them: a latched topic keeps its last message only
            self._broadcaster.sendTransform(list(self._transforms.values()))


def build() -> CameraPosesNode:
    """Reads the parameters and makes the node."""
    return CameraPosesNode(parameters.read(CameraPosesParams))
