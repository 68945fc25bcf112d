"""Finds a camera's pose, lens and depth image for the time of an image."""

from __future__ import annotations

import math
import time
from collections import deque
from functools import partial
from typing import Any, Deque, List, Optional, Sequence, Tuple

import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, Image

from vb_core import names
from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError
from vb_core.ros import robot_profile
from vb_core.ros.images import array_from_image, camera_from_info
from vb_core.ros.transforms import TransformLookup
from vb_laser_detect.detection.projection import Depth, FloorProjection, ImageGeometry, RobotCylinder
from vb_laser_detect.ros.detector_diagnostics import DetectorDiagnostics

# [s] between lookups of a camera's lens and pose: a recalibration is soon noticed, and no image waits for it
_LOOKUP_PERIOD = 0.5
_TF_TIMEOUT = 0.15  # [s] to wait for a pose, because odometry arrives after the image
_TF_LATE = rospy.Duration(0.5)  # after which a pose that has not arrived will not come
_MAX_DEPTH_AGE = 0.08  # [s] largest time difference between colour and depth image
_POSE_UNCERTAINTY = 0.05  # [m] of a robot's localisation; its driver assumes this too if nothing else is known
_MAX_POSE_AGE = 0.5  # [s] of a robot's newest pose; later the robot may be elsewhere, or switched off


def sibling_topic(topic: str, name: str) -> str:
    """Returns the topic `name` in the namespace of `topic`, as image_transport pairs image and camera_info."""
    return topic.rsplit("/", 1)[0] + "/" + name


def is_rectified(topic: str) -> bool:
    """Returns whether a topic's images are already undistorted, judging by image_proc's topic names."""
    return "rect" in topic.rsplit("/", 1)[-1].split("_")


def require_size(camera: CameraModel, size: Tuple[int, int]) -> CameraModel:
    """Returns the model if it is for images of this width and height. Raises CodedError "no_camera_info" otherwise."""
    if (camera.width, camera.height) != size:
        expected = f"{camera.width} x {camera.height}"
        raise CodedError("no_camera_info", f"camera_info is for images of {expected}, not of {size[0]} x {size[1]}")
    return camera


class InfoTopic:
    """The newest camera_info, which may arrive late, and change.

    Subscribed topics:
        <topic> (sensor_msgs/CameraInfo)

    Args:
        report: receives faults, such as a camera_info that describes no camera.
        rectified: whether the images are already undistorted.
    """

    def __init__(self, topic: str, report: DetectorDiagnostics, rectified: bool = False) -> None:
        self._report = report
        self._rectified = rectified
        self._last_fields: Optional[list] = None  # the last message without its header
        # the model, or why there is none
        self._latest: Tuple[Optional[CameraModel], str] = (None, f"no camera_info on {topic}")
        rospy.Subscriber(topic, CameraInfo, self._on_info, queue_size=1)

    def model_for(self, size: Tuple[int, int]) -> CameraModel:
        """Returns the model for images of this width and height [px].

        Raises:
            CodedError: "no_camera_info" if none has arrived yet, or it describes no camera or another image size.
        """
        camera, reason = self._latest
        if camera is None:
            raise CodedError("no_camera_info", reason)
        return require_size(camera, size)

    def _on_info(self, message: CameraInfo) -> None:
        # the stamp always differs, and must stay: this process's other subscribers get the same message
        fields = [getattr(message, name) for name in message.__slots__ if name != "header"]
        if fields == self._last_fields:
            return
        self._last_fields = fields
        try:
            self._latest = camera_from_info(message, self._rectified), ""
        except CodedError as error:
            self._report.report_fault(error)
            self._latest = None, error.message


class DepthTopic:
    """The newest depth images, registered to the colour image.

    Subscribed topics:
        <topic> (sensor_msgs/Image, 16UC1 [mm] or 32FC1 [m]), camera_info next to it (sensor_msgs/CameraInfo)
    """

    def __init__(self, topic: str, report: DetectorDiagnostics) -> None:
        self._report = report
        self._images: Deque[Image] = deque(maxlen=12)  # a busy computer searches an image late
        self._info = InfoTopic(sibling_topic(topic, "camera_info"), report)
        rospy.Subscriber(topic, Image, self._images.append, queue_size=1, buff_size=2**22)

    def nearest(self, stamp: rospy.Time, color_frame: str) -> Depth:
        """Returns the depth image (h, w) nearest to a time, and its camera's model, or None for what is missing.

        A depth image with another frame than the colour image is not registered to it.
        """
        # a copy, because images arrive in the meantime
        nearest = min(list(self._images), key=lambda image: abs((image.header.stamp - stamp).to_sec()), default=None)
        if nearest is None or abs((nearest.header.stamp - stamp).to_sec()) > _MAX_DEPTH_AGE:
            return None, None
        try:
            if nearest.header.frame_id.lstrip("/") != color_frame.lstrip("/"):
                raise CodedError("depth_not_registered", depth=nearest.header.frame_id, color=color_frame)
            depth = depth_array(nearest)
        except CodedError as error:
            self._report.report_fault(error)
            return None, None
        try:
            return depth, self._info.model_for(depth.shape[::-1])
        except CodedError:  # registered depth has the colour camera's model, scaled to its size
            return depth, None


def depth_array(message: Image) -> np.ndarray:
    """Returns a depth image's readings, (h, w) uint16 [mm] or float [m].

    Raises:
        CodedError: "bad_depth" for another encoding, or without a single reading.
    """
    try:
        depth = array_from_image(message)
    except CodedError as error:
        raise CodedError("bad_depth", f"depth: {error.message}") from None
    if depth.ndim != 2 or depth.dtype not in (np.dtype(np.uint16), np.dtype(np.float32)):
        raise CodedError("bad_depth", f"expected depth images of 16UC1 or 32FC1, got '{message.encoding}'")
    with np.errstate(invalid="ignore"):
        if not (np.isfinite(depth) & (depth > 0)).any():
            raise CodedError("bad_depth", "the depth images hold no reading at all: the floor's plane is used instead")
    return depth


class CameraGeometry:
    """Finds each image's geometry: the camera's lens and pose, and on demand depth and robots.

    Subscribed topics:
        tf: <optical frame> to map, for a moving camera at the image's time; <robot>/base_link to map

    Args:
        camera: name of the camera.
        mobile: whether the camera moves.
        transforms: lookup in tf, shared by all cameras of the process.
        info: source of the lens model, an `InfoTopic` or `LensFile`.
        depth: source of depth images; None: the floor is a plane.
        floor_projection: projection of this camera's spots.
        robots: namespaces of the robots that the camera sees; "/" for a robot without one.
        report: receives faults, and knows the other cameras' frames.

    Attributes:
        focal: [px] focal length of the lens with which spots are located; 0 while it is not known.
    """

    def __init__(
        self,
        camera: str,
        mobile: bool,
        transforms: TransformLookup,
        info: Any,
        depth: Optional[DepthTopic],
        floor_projection: FloorProjection,
        robots: Sequence[str],
        report: DetectorDiagnostics,
    ) -> None:
        self._name = camera
        self._mobile = mobile
        self._info = info
        self._depth = depth
        self._floor_projection = floor_projection
        self._report = report
        self._transforms = transforms
        self.focal = 0.0
        self._profiles = [(f"{name}/".lstrip("/"), robot_profile.read(name)) for name in robots]
        self._pose: Optional[np.ndarray] = None
        self._cached_for = ("", (0, 0))  # frame and size at the last lookup
        self._cached_at = -math.inf  # [s] when that was

    def geometry_at(self, frame_id: str, stamp: rospy.Time, size: Tuple[int, int]) -> ImageGeometry:
        """Returns an image's geometry. A moving camera's pose at the image's time is looked up only if needed.

        Args:
            size: [px] width and height of the image.

        Raises:
            CodedError: "camera_no_frame", "shared_frame"; "no_camera_info"; "no_transform", "bad_transform" if tf does not
                connect map and camera at all.
        """
        now = time.monotonic()
        if self._cached_for != (frame_id, size) or now - self._cached_at >= _LOOKUP_PERIOD:
            self._cached_at = -math.inf  # every image tries again until lens and pose are known
            if not frame_id:
                raise CodedError("camera_no_frame", camera=self._name)
            if not self._mobile:
                # a frame has one pose
                sharing = [name for name, frame in self._report.frames_of_others().items() if frame == frame_id]
                if sharing:
                    cameras = ", ".join(sorted([*sharing, self._name]))
                    raise CodedError("shared_frame", cameras=cameras, frame=frame_id)
            self._camera = self._info.model_for(size)
            self.focal = float(self._camera.matrix[0, 0])
            self._pose = self._newest_pose(frame_id, stamp)
            self._cached_at = now
            self._cached_for = (frame_id, size)
        newest_pose = self._pose

        def find_pose() -> np.ndarray:
            moving = self._mobile
            return self._transforms.lookup(names.MAP_FRAME, frame_id, stamp, _TF_TIMEOUT) if moving else newest_pose

        find_depth = None if self._depth is None else partial(self._depth.nearest, stamp, frame_id)
        find_robots = partial(self.robot_cylinders, stamp)
        return ImageGeometry(self._camera, self._floor_projection, find_pose, find_depth, find_robots)

    def _newest_pose(self, frame_id: str, stamp: rospy.Time) -> np.ndarray:
        """Returns the newest pose (4, 4). A moving camera's only shows that there is one, as most images need none."""
        lookup = partial(self._transforms.lookup, names.MAP_FRAME, frame_id)
        try:
            return lookup(stamp - _TF_LATE if self._mobile else rospy.Time(0), 0.0)
        except CodedError:
            if self._mobile:  # just started, or gone
                return lookup(stamp, _TF_TIMEOUT)
            # a stationary camera is still at its last known pose, even if that is no longer published
            if self._pose is None or frame_id != self._cached_for[0]:
                raise
            return self._pose

    def robot_cylinders(self, stamp: rospy.Time) -> List[RobotCylinder]:
        """Returns cylinders for where robots hide the floor at a time. A robot without a pose hides nothing.

        While a robot's pose has not arrived, its radius grows by how far it may have driven since its last one.
        """
        cylinders = []
        for prefix, profile in self._profiles:
            frame = prefix + profile.frames.base
            newest = self._transforms.newest(names.MAP_FRAME, frame)
            pose_stamp = stamp if newest.is_zero() else min(newest, stamp)
            age = (stamp - pose_stamp).to_sec()
            try:
                if age > _MAX_POSE_AGE:
                    raise CodedError("robot_without_pose")
                x, y = self._transforms.lookup(names.MAP_FRAME, frame, pose_stamp, 0.0)[:2, 3].tolist()
            except CodedError:
                self._report.count_dropped("robot_without_pose")
                continue
            radius = profile.radius + _POSE_UNCERTAINTY + profile.limits.max_speed * age
            cylinders.append(RobotCylinder(x, y, radius, profile.shape.height))
        return cylinders
