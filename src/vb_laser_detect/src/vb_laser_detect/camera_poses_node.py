"""Publishes the poses of calibrated ceiling cameras as static transforms."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, Tuple

import rospy
import tf2_ros

from vb_core.errors import CodedError, ParameterError
from vb_core.parameters import Parameters, param
from vb_core.ros import messages, parameters
from vb_laser_detect.calibration import calibration_file
from vb_laser_detect.calibration.calibration_file import CameraPose


@dataclass(frozen=True)
class CameraPosesParams(Parameters):
    """The node's parameters."""

    calibration_dir: str = param("", doc="folder of the calibration files, <camera>.yaml")
    cameras: str = param("", doc="names of the cameras, separated by spaces")
    check_period: float = param(2.0, "s", above=0.0, high=3600.0)


class CameraPosesNode:
    """Publishes the camera poses in calibrate_camera's files, and again whenever these change.

    A camera without a file, or with a broken one, is named in a warning; its last good pose stays.

    Published topics:
        /tf_static (tf2_msgs/TFMessage): the frames that the files name, usually map -> <camera>_optical_frame
    Parameters:
        config/camera_poses.yaml
        ~* CameraPosesParams
    """

    def __init__(self, params: CameraPosesParams) -> None:
        self._cameras = params.cameras.split()
        if not params.calibration_dir or not self._cameras:
            raise ParameterError(
                rospy.resolve_name("~calibration_dir"), "a folder and the names of cameras must be set"
            )
        self._calibration_dir = params.calibration_dir
        self._versions: Dict[str, Tuple[int, int]] = {}
        self._poses: Dict[str, CameraPose] = {}
        self._broadcaster = tf2_ros.StaticTransformBroadcaster()
        self._look()
        self._timer = rospy.Timer(rospy.Duration(params.check_period), self._look, reset=True)

    def _look(self, _event: Any = None) -> None:
        """Reads the files that changed, then checks all of them together, so that their order does not matter."""
        paths = {camera: calibration_file.calibration_path(self._calibration_dir, camera) for camera in self._cameras}
        before = self._versions
        self._versions = {camera: _version(path) for camera, path in paths.items()}
        changed = [camera for camera, version in self._versions.items() if before.get(camera) != version]
        for camera in changed:
            try:
                self._poses[camera] = calibration_file.load(paths[camera])
            except CodedError as error:
                # of a camera that was never calibrated lab_monitor says what comes first: its frame, its lens, or its
                # pose
                new = error.code == "no_calibration" and camera not in self._poses
                (rospy.loginfo if new else rospy.logwarn)("%s: no pose of %s: %s", rospy.get_name(), camera, error)
        frames = {camera: pose.frame for camera, pose in self._poses.items()}
        valid = []
        for camera, pose in self._poses.items():
            try:
                calibration_file.require_own_frame(camera, pose.frame, frames)  # a shared one can be right for neither
            except CodedError as error:
                if changed:
                    rospy.logwarn("%s: %s", rospy.get_name(), error)
                continue
            valid.append(messages.message_from_transform(pose.T, pose.parent, pose.frame, rospy.Time.now()))
            if camera in changed:
                place = " ".join(f"{value:.3f}" for value in pose.T[:3, 3])
                rospy.loginfo(
                    "%s: %s is at %s in %s (%s)", rospy.get_name(), pose.frame, place, pose.parent, paths[camera]
                )
        if changed and valid:
            # all of them: a latched topic keeps its last message only
            self._broadcaster.sendTransform(valid)


def _version(path: Path) -> Tuple[int, int]:
    """Differs between two versions of a file; (0, 0): there is none."""
    try:
        state = path.stat()
    except OSError:
        return 0, 0
    return state.st_mtime_ns, state.st_ino


def build() -> CameraPosesNode:
    """Reads the parameters and makes the node."""
    return CameraPosesNode(parameters.read(CameraPosesParams))
