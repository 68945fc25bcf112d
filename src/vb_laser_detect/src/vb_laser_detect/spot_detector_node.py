"""Finds laser spots in one camera's images and publishes them on the floor of the map (paper, Sect. 4.3)."""
from __future__ import annotations

import threading
import time
import traceback
from collections import deque
from dataclasses import dataclass
from functools import partial
from typing import Any, Deque, List, Optional, Tuple

import cv2
import diagnostic_updater
import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from vb_core import names
from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError, ParameterError
from vb_core.parameters import Parameters, param
from vb_core.ros import messages, parameters
from vb_core.ros.node import Mailbox, Worker
from vb_core.ros.transforms import TransformLookup
from vb_laser_detect import projection
from vb_laser_detect.blocks import sample_blocks
from vb_laser_detect.debug_image import draw
from vb_laser_detect.detector import DetectorParams, Spot, SpotDetector
from vb_laser_detect.frame import Frame, search
from vb_laser_detect.projection import FloorPoint, FloorProjector, ProjectionParams
from vb_laser_detect.statistics import Statistics
from vb_msgs.msg import DetectorStatus, LaserSpot

_SOURCES = {
    projection.GROUND_PLANE: LaserSpot.GROUND_PLANE,
    projection.DEPTH: LaserSpot.DEPTH,
    projection.GROUND_PLANE_FALLBACK: LaserSpot.GROUND_PLANE_FALLBACK,
}
_SILENCE_S = 2.0  # without an image for so long, diagnostics call the camera silent


@dataclass(frozen=True)
class NodeParams(Parameters):
    """The node's own parameters; see config/*.yaml."""

    camera: str = param("", doc="name of the camera")
    image: str = param("", doc="image topic; empty: <camera>/image_raw")
    camera_info: str = param("", doc="empty: camera_info beside the image topic")
    depth: str = param("", doc="depth image topic; empty: the floor is a plane")
    depth_info: str = param("", doc="empty: camera_info beside the depth topic")
    frame: str = param("", doc="optical frame; empty: what the images say")
    image_transport: str = param("raw", choices=("raw", "compressed"))
    tf_wait_s: float = param(0.1, "s", low=0.0, high=2.0, doc="how long to wait for a pose at the image's time")
    pose_refresh_s: float = param(2.0, "s", above=0.0, high=3600.0, doc="a stationary camera's pose is looked up so often")
    depth_age_s: float = param(0.08, "s", low=0.0, high=5.0, doc="largest time between image and depth image")
    debug_hz: float = param(5.0, "1/s", above=0.0, high=100.0, doc="of ~debug_image")
    ignore_regions: list = param([], "m", doc="polygons in the map frame where no spot counts")


class SpotDetectorNode:
    """One camera's spot detector. The newest image wins: what comes while one is searched is replaced, and counted.

    Subscribes:
        <image> (sensor_msgs/Image), or <image>/compressed (sensor_msgs/CompressedImage)
        <camera_info> (sensor_msgs/CameraInfo): may come late and change
        <depth> (sensor_msgs/Image, 16UC1 [mm] or 32FC1 [m]), <depth_info>: only if a depth topic is set
        /map (nav_msgs/OccupancyGrid): optional; spots outside it are refused
        tf: <optical frame> to map, at the image's time for a moving camera
    Publishes:
        /virtual_borders/spots (vb_msgs/LaserSpot), stamped with the image's time
        /virtual_borders/detectors (vb_msgs/DetectorStatus), once a second
        /diagnostics (diagnostic_msgs/DiagnosticArray)
        ~debug_image (sensor_msgs/Image): spots, and candidates with the reason of their refusal; only if listened to
    Parameters:
        ~* NodeParams, ~detector/* DetectorParams, ~projection/* ProjectionParams
    """

    def __init__(self, params: NodeParams, detector: DetectorParams, projection_params: ProjectionParams) -> None:
        # one process per camera: threads within each would only fight for the cores
        cv2.setNumThreads(1)
        if not params.camera:
            raise ParameterError(rospy.resolve_name("~camera"), "the camera's name must be set")
        self._params = params
        self._mobile = detector.moving_camera
        self._lock = threading.Lock()
        self._info_key: Any = None
        self._info: Optional[CameraModel] = None
        self._depth_info_key: Any = None
        self._depth_camera: Optional[CameraModel] = None
        self._depths: Deque[Image] = deque(maxlen=4)
        self._projector = FloorProjector(projection_params, None, params.ignore_regions)
        self._detector = SpotDetector(detector)
        self._transforms = TransformLookup()
        self._pose: Optional[np.ndarray] = None
        self._pose_frame = ""
        self._pose_at: Optional[rospy.Time] = None
        self._statistics = Statistics()
        self._last_image: Optional[np.ndarray] = None
        self._last_debug: Optional[rospy.Time] = None
        self._started = rospy.Time.now()
        self._spots = rospy.Publisher(names.SPOTS, LaserSpot, queue_size=20, tcp_nodelay=True)
        self._status = rospy.Publisher(names.DETECTORS, DetectorStatus, queue_size=5)
        self._debug = rospy.Publisher("~debug_image", Image, queue_size=1)
        self._updater = diagnostic_updater.Updater()
        self._updater.setHardwareID(params.camera)
        self._updater.add(f"spot detector of camera {params.camera}", self._diagnose)
        self._mailbox: Mailbox = Mailbox()
        self._worker = Worker(self._mailbox, self._search)
        self._subscribers = self._subscribe()
        self._timer = rospy.Timer(rospy.Duration(1.0), self._report, reset=True)

    def _subscribe(self) -> List[rospy.Subscriber]:
        p = self._params
        image = rospy.resolve_name(p.image or f"{p.camera}/image_raw")
        info = rospy.resolve_name(p.camera_info or beside(image, "camera_info"))
        subscribers = [
            rospy.Subscriber(info, CameraInfo, self._on_info, queue_size=1),
            rospy.Subscriber(names.PHYSICAL_MAP, messages.OccupancyGridArray, self._on_map, queue_size=1),
        ]
        if p.depth:
            depth = rospy.resolve_name(p.depth)
            depth_info = rospy.resolve_name(p.depth_info or beside(depth, "camera_info"))
            subscribers.append(rospy.Subscriber(depth_info, CameraInfo, self._on_depth_info, queue_size=1))
            subscribers.append(rospy.Subscriber(depth, Image, self._on_depth, queue_size=1, buff_size=2**22))
        kind = Image
        if p.image_transport == "compressed":
            image, kind = image + "/compressed", CompressedImage
        rospy.loginfo("%s: camera '%s' on %s", rospy.get_name(), p.camera, image)
        # the buffer must hold a whole image, else rospy hands over images that are older than the newest one
        subscribers.append(
            rospy.Subscriber(image, kind, self._mailbox.put, queue_size=1, buff_size=2**24, tcp_nodelay=True)
        )
        return subscribers

    def close(self) -> None:
        """Stops the worker."""
        self._mailbox.close()

    # ------------------------------------------------------------- what comes in
    def _on_info(self, message: CameraInfo) -> None:
        key = _key(message)
        if key == self._info_key:
            return
        self._info_key = key
        camera = self._camera(message)
        with self._lock:
            self._info = camera

    def _on_depth_info(self, message: CameraInfo) -> None:
        key = _key(message)
        if key == self._depth_info_key:
            return
        self._depth_info_key = key
        camera = self._camera(message)
        with self._lock:
            self._depth_camera = camera

    def _camera(self, message: CameraInfo) -> Optional[CameraModel]:
        try:
            return messages.camera_from_info(message)
        except CodedError as error:
            self._refuse(error)
            return None

    def _on_depth(self, message: Image) -> None:
        with self._lock:
            self._depths.append(message)

    def _on_map(self, message: Any) -> None:
        try:
            self._projector.floor = messages.grid_from_message(message)
        except CodedError as error:
            self._refuse(error)

    # ------------------------------------------------------------- the search
    def _search(self, message: Any) -> None:
        try:
            self._search_image(message)
        except CodedError as error:
            self._refuse(error)
        except cv2.error as error:
            self._refuse(CodedError("bad_image", f"cannot search the image: {error}"))
        except Exception:  # a frame that shows a fault of ours must not silence the camera for good
            self._statistics.refuse("internal_error")
            rospy.logerr_throttle(10.0, f"{rospy.get_name()}: {traceback.format_exc()}")

    def _search_image(self, message: Any) -> None:
        stamp = message.header.stamp
        if stamp.is_zero():
            raise CodedError("no_stamp", "the images carry no time: they cannot be matched with poses")
        compressed = self._params.image_transport == "compressed"
        image = messages.compressed_image_array(message) if compressed else messages.image_array(message)
        frame_id = self._params.frame or message.header.frame_id
        camera = self._camera_for(image.shape)
        frame = self._place(camera, frame_id, stamp)
        began = time.perf_counter()
        spots = search(self._detector, image, stamp.to_sec(), frame)
        took = time.perf_counter() - began
        for candidate in self._detector.candidates:
            # these are everyday events: counted, but not worth a warning
            if candidate.refusal:
                self._statistics.refuse(candidate.refusal)
        if frame is not None:
            for spot in spots:
                self._spots.publish(self._message(spot, frame.point(spot.u, spot.v), stamp))
        elif spots:
            self._refuse(_why_unknown(camera, frame_id, image.shape))
            spots = []
        self._statistics.frame(rospy.Time.now().to_sec(), stamp.to_sec(), took, len(spots))
        self._last_image = image
        if self._debug.get_num_connections() > 0:
            self._publish_debug(image, "bgr8" if compressed else message.encoding, message.header)

    def _message(self, spot: Spot, point: FloorPoint, stamp: rospy.Time) -> LaserSpot:
        result = LaserSpot()
        result.header.stamp = stamp
        result.header.frame_id = names.MAP_FRAME
        result.camera = self._params.camera
        result.mobile = self._mobile
        result.position = Point(*(float(value) for value in point.position))
        result.u, result.v, result.diameter = spot.u, spot.v, spot.diameter
        result.diameter_m = spot.diameter * point.metres_per_pixel
        result.confidence = spot.confidence
        result.projection = _SOURCES[point.source]
        return result

    # ------------------------------------------------------------- geometry
    def _place(self, camera: Optional[CameraModel], frame_id: str, stamp: rospy.Time) -> Optional[Frame]:
        """The image's geometry; None while camera or pose are unknown."""
        if camera is None or not (self._mobile or self._stationary_pose(frame_id) is not None):
            return None
        depth = partial(self._depth_near, stamp) if self._params.depth else None
        return Frame(camera, partial(self._camera_pose, frame_id, stamp), self._projector, depth)

    def _camera_for(self, shape: Tuple[int, ...]) -> Optional[CameraModel]:
        """The camera model, if one came that fits images of this shape."""
        with self._lock:
            camera = self._info
        if camera is None or (camera.height, camera.width) != tuple(shape[:2]):
            return None
        return camera

    def _camera_pose(self, frame_id: str, stamp: rospy.Time) -> np.ndarray:
        """(4, 4) T_map_camera at a time."""
        if not self._mobile:
            pose = self._stationary_pose(frame_id)
            if pose is None:
                raise CodedError("no_transform", f"no transform from '{frame_id}' to '{names.MAP_FRAME}'")
            return pose
        return self._transforms.lookup(names.MAP_FRAME, frame_id, stamp, self._params.tf_wait_s)

    def _stationary_pose(self, frame_id: str) -> Optional[np.ndarray]:
        now = rospy.Time.now()
        fresh = self._pose_at is not None and abs((now - self._pose_at).to_sec()) < self._params.pose_refresh_s
        if fresh and frame_id == self._pose_frame:
            return self._pose
        try:
            pose: Optional[np.ndarray] = self._transforms.lookup(names.MAP_FRAME, frame_id, rospy.Time(0), 0.0)
            self._transforms.rest_on_static(names.MAP_FRAME, frame_id)
        except CodedError as error:
            # a camera that does not move stays where it was last seen, whatever became of its publisher
            pose = self._pose if frame_id == self._pose_frame else None
            if pose is None:
                self._refuse(error)
                self._pose_frame = ""
                return None
        self._pose, self._pose_frame, self._pose_at = pose, frame_id, now
        return pose

    def _depth_near(self, stamp: rospy.Time) -> Tuple[Optional[np.ndarray], Optional[CameraModel]]:
        with self._lock:
            depths, camera = list(self._depths), self._depth_camera
        best = min(depths, key=lambda message: abs((message.header.stamp - stamp).to_sec()), default=None)
        if best is None or abs((best.header.stamp - stamp).to_sec()) > self._params.depth_age_s:
            return None, None
        try:
            depth = messages.image_array(best)
        except CodedError as error:
            self._refuse(error)
            return None, None
        if camera is not None and (camera.height, camera.width) != depth.shape[:2]:
            camera = None
        return depth, camera

    # ------------------------------------------------------------- what one can see of it
    def _publish_debug(self, image: np.ndarray, encoding: str, header: Any) -> None:
        now = rospy.Time.now()
        if self._last_debug is not None and 0 <= (now - self._last_debug).to_sec() < 1.0 / self._params.debug_hz:
            return
        self._last_debug = now
        picture = draw(image, encoding, self._detector.candidates)
        self._debug.publish(messages.image_message(picture, "bgr8", header.stamp, header.frame_id))

    def _refuse(self, error: CodedError) -> None:
        self._statistics.refuse(error.code)
        rospy.logwarn_throttle(10.0, f"{rospy.get_name()}: {error}")

    def _report(self, _event: Any) -> None:
        now = rospy.Time.now()
        summary = self._statistics.summary(now.to_sec())
        status = DetectorStatus()
        status.header.stamp = now
        status.camera = self._params.camera
        status.received, status.dropped = self._mailbox.received, self._mailbox.dropped
        status.processed, status.detected, status.spots = summary.processed, summary.detected, summary.spots
        status.refusals, status.refusal_counts = list(summary.refusals), list(summary.refusals.values())
        status.rate_hz, status.search_ms = summary.rate_hz, summary.search_ms
        status.latency_ms, status.latency_p95_ms = summary.latency_ms, summary.latency_p95_ms
        self._status.publish(status)
        self._updater.force_update()

    def _diagnose(self, status: Any) -> Any:
        now = rospy.Time.now()
        summary = self._statistics.summary(now.to_sec())
        with self._lock:
            known = self._info is not None
        if summary.rate_hz == 0.0 and (now - self._started).to_sec() > _SILENCE_S:
            status.summary(DiagnosticStatus.ERROR, "no images")
        elif not known:
            status.summary(DiagnosticStatus.ERROR, "no usable camera_info")
        elif not self._mobile and self._pose is None:
            status.summary(DiagnosticStatus.ERROR, "the camera's pose in the map is unknown")
        else:
            status.summary(DiagnosticStatus.OK, f"{summary.rate_hz:.1f} images per second")
        status.add("rate [1/s]", f"{summary.rate_hz:.1f}")
        status.add("latency, median [ms]", f"{summary.latency_ms:.1f}")
        status.add("latency, 95th percentile [ms]", f"{summary.latency_p95_ms:.1f}")
        status.add("search, median [ms]", f"{summary.search_ms:.2f}")
        status.add("images received", str(self._mailbox.received))
        status.add("images dropped", str(self._mailbox.dropped))
        status.add("spots published", str(summary.spots))
        for code, count in summary.refusals.items():
            status.add(f"refused: {code}", str(count))
        image = self._last_image
        if image is not None:
            status.add("saturated part of the image", f"{float((sample_blocks(image) >= 250).mean()):.3f}")
        return status


def _why_unknown(camera: Optional[CameraModel], frame_id: str, shape: Tuple[int, ...]) -> CodedError:
    """Why the place of a spot in an image of this shape is unknown."""
    if camera is not None:
        return CodedError("no_transform", f"the pose of '{frame_id}' in the map is unknown")
    height, width = shape[:2]
    return CodedError("no_camera_info", f"no camera_info that fits an image of {width} x {height}")


def beside(topic: str, name: str) -> str:
    """The topic of another name in the same namespace, as image_transport pairs image and camera_info."""
    return topic.rsplit("/", 1)[0] + "/" + name


def _key(info: CameraInfo) -> Tuple:
    roi = info.roi
    return (info.width, info.height, info.distortion_model, tuple(info.K), tuple(info.D), info.binning_x,
            info.binning_y, roi.width, roi.height)


def build() -> SpotDetectorNode:
    """Reads the parameters and makes the node."""
    return SpotDetectorNode(
        parameters.read(NodeParams, "~", ignore=("detector", "projection")),
        parameters.read(DetectorParams, "~detector"),
        parameters.read(ProjectionParams, "~projection"),
    )
