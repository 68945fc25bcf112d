"""Publishes the poses of calibrated ceiling cameras as static transforms, and reports unreliable cameras."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Union

import rospy
import tf2_ros

from vb_core import names
from vb_core.errors import CodedError, ParameterError
from vb_core.parameters import Parameters, param
from vb_core.ros import messages, node, parameters
from vb_core.ros.notices import NoticePublisher
from vb_laser_detect.calibration.pose_file import CameraPose, calibration_path
from vb_laser_detect.calibration.camera_faults import CameraFaultFinder, DetectorReport, read_files
from vb_msgs.msg import DetectorStatus, LaserSpot


@dataclass(frozen=True)
class CameraPosesParams(Parameters):
    """The node's parameters."""

    calibration_dir: str = param("", doc="folder of <camera>.yaml; empty: other nodes publish the poses")
    cameras: str = param("", doc="names of the cameras that should be there, separated by spaces")


class CameraPosesNode:
    """Publishes the camera poses from calibrate_camera's files, again whenever these change; monitors the cameras.

    If a file can no longer be used, its last good pose stays.

    Subscribed topics:
        /virtual_borders/detectors (vb_msgs/DetectorStatus): whether each detector runs, and fits the calibration
        /virtual_borders/spots (vb_msgs/LaserSpot): to compare the positions at which overlapping cameras see the laser
    Published topics:
        /tf_static (tf2_msgs/TFMessage): the frames that the files name, usually map -> <camera>_optical_frame
        /virtual_borders/notices (vb_msgs/NoticeArray): missing detectors, files that cannot be used or do not fit the
            images, computers whose clocks differ, cameras that disagree
    Parameters:
        ~* CameraPosesParams
    """

    def __init__(self, params: CameraPosesParams) -> None:
        self._cameras = params.cameras.split()
        if not self._cameras:
            raise ParameterError(rospy.resolve_name("~cameras"), "the names of cameras must be set")
        self._folder = params.calibration_dir
        self._contents: Dict[str, bytes] = {}  # each camera's file as last read
        self._files: Dict[str, Union[CameraPose, CodedError]] = {}
        # by camera: the published pose, and the contents that it was read from
        self._poses: Dict[str, CameraPose] = {}
        self._pose_contents: Dict[str, bytes] = {}
        self._lock = threading.Lock()
        node.wait_for_clock()
        self._fault_finder = CameraFaultFinder(self._cameras, rospy.get_time())
        self._broadcaster = tf2_ros.StaticTransformBroadcaster()
        self._notices = NoticePublisher()
        rospy.Subscriber(names.DETECTORS, DetectorStatus, self._on_status, queue_size=50)
        rospy.Subscriber(names.SPOTS, LaserSpot, self._on_spot, queue_size=100)
        self._update()
        self._timer = node.WakeTimer(1.0)
        node.Worker(self._timer, lambda _: self._update())

    def close(self) -> None:
        """Stops the updates, and withdraws the notices."""
        self._timer.close()
        self._notices.close()

    def _on_status(self, message: DetectorStatus) -> None:
        now = rospy.get_time()
        age = now - message.header.stamp.to_sec()
        with self._lock:
            self._fault_finder.report(message.camera, DetectorReport(now, message.frame_id, message.focal_px, age))

    def _on_spot(self, message: LaserSpot) -> None:
        if not message.mobile:
            with self._lock:
                x, y = message.position.x, message.position.y
                self._fault_finder.add_spot(message.camera, message.header.stamp.to_sec(), x, y)

    def _update(self) -> None:
        """Publishes what has changed in the files, and the notices."""
        if self._folder:
            self._publish_changed_files()
        with self._lock:
            now = rospy.get_time()
            notices = self._fault_finder.find_missing_detectors(now)
            notices += self._fault_finder.find_calibration_faults(self._files, list(self._poses), now)
            notices += self._fault_finder.find_wrong_clocks(now) + self._fault_finder.find_disagreements(now)
        self._notices.set(notices)

    def _publish_changed_files(self) -> None:
        """Reads all files together if any of them changed, so that their order does not matter, and publishes all poses."""
        contents = {camera: _read_file(calibration_path(self._folder, camera)) for camera in self._cameras}
        if contents == self._contents:
            return
        self._contents = contents
        self._files = read_files(self._folder, self._cameras)
        for camera, file in self._files.items():
            if isinstance(file, CameraPose) and self._pose_contents.get(camera) != contents[camera]:
                self._poses[camera] = file
                self._pose_contents[camera] = contents[camera]
                with self._lock:
                    self._fault_finder.forget_spots(camera, rospy.get_time())
                position = " ".join(f"{value:.3f}" for value in file.T[:3, 3])
                rospy.loginfo("%s: %s is at %s in %s", rospy.get_name(), file.frame, position, file.parent)
        # all poses in one message: a latched topic keeps only its last one
        now = rospy.Time.now()
        convert = messages.message_from_transform
        transforms = [convert(pose.T, pose.parent, pose.frame, now) for pose in self._poses.values()]
        if transforms:
            self._broadcaster.sendTransform(transforms)


def _read_file(path: Path) -> bytes:
    """Returns a file's contents, or b"" if it cannot be read."""
    try:
        return path.read_bytes()
    except OSError:  # `read_files` reports why
        return b""


def build() -> CameraPosesNode:
    """Reads the parameters and makes the node."""
    return CameraPosesNode(parameters.read(CameraPosesParams))
