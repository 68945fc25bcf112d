"""Finds laser spots in cameras' images and publishes their floor positions in the map (paper, Sect. 4.3).

A process serves up to eight cameras. With 24 cameras at 1080p on two cores, separate processes take 3.4 ms per image instead
of 2.8 ms, because the processor's caches then hold the program 24 times.
"""

from __future__ import annotations

import threading
import time
import traceback
from collections import deque
from functools import partial
from typing import Any, Deque, List, Optional, Sequence, Union

import cv2
import rospy
from geometry_msgs.msg import Point
from sensor_msgs.msg import Image

from vb_core import names
from vb_core.errors import CodedError, ParameterError
from vb_core.image_format import AnyPicture
from vb_core.notices import Notice, Severity
from vb_core.ros.images import message_from_image
from vb_core.ros import messages, node, parameters
from vb_core.ros.node import Mailbox, Queue, Worker
from vb_core.ros.notices import NoticePublisher
from vb_core.ros.reconfigure import ReconfigureServer
from vb_core.ros.transforms import TransformLookup
from vb_laser_detect.ros.camera_feed import CameraFeed, LensFile, ReceivedImage, subscribe_images
from vb_laser_detect.detection.debug_image import draw_candidates
from vb_laser_detect.detection.spot_detector import DetectorParams, Spot, SpotDetector
from vb_laser_detect.spot_detector_node_params import SpotDetectorNodeParams, image_topic
from vb_laser_detect.detection.projection import FloorProjection, ProjectionParams
from vb_laser_detect.ros.camera_geometry import CameraGeometry, DepthTopic, InfoTopic, is_rectified, sibling_topic
from vb_laser_detect.ros.detector_diagnostics import DetectorDiagnostics
from vb_msgs.msg import DetectorStatus, LaserSpot

# when a spot is confirmed, its spots in all of these images are published at once
_MAX_UNCONFIRMED_IMAGES = 256
_MAX_WAITING_IMAGES = 2  # with one, each pause of the computer that is longer than an image period would lose an image
_DEBUG_PERIOD = 0.2  # [s] between two debug images, as drawing one takes longer than the detection


class SpotDetectorNode:
    """Detects the spot in cameras' images. If they come too fast, only the newest are searched; others are counted.

    A camera with bad parameters is reported, and left out. If none has good parameters, the node ends.

    Subscribed topics, for each camera:
        <image> (sensor_msgs/Image), <image>/compressed (sensor_msgs/CompressedImage): one of the two, unless `source` is
            set: then the node reads the camera directly
        <camera>/camera_info (sensor_msgs/CameraInfo): next to the image; may arrive late, and change
        <depth> (sensor_msgs/Image, 16UC1 [mm] or 32FC1 [m]), <depth>/camera_info (sensor_msgs/CameraInfo): only if a
            depth topic is set; camera_info is next to the depth image
        /virtual_borders/detectors (vb_msgs/DetectorStatus): to find another camera with the same frame
        /map (nav_msgs/OccupancyGrid): optional; spots outside it are rejected
        /tf, /tf_static (tf2_msgs/TFMessage): <robot>/base_link and a moving camera's frame to map at the image's time;
            a stationary camera's frame to map
    Published topics, for each camera:
        /virtual_borders/spots (vb_msgs/LaserSpot): stamped with the image's time. A stroke's first spots are
            published when it is confirmed, in order and with their own times
        /virtual_borders/detectors (vb_msgs/DetectorStatus): once a second
        <image> (sensor_msgs/Image), <image>/compressed (sensor_msgs/CompressedImage), <camera>/camera_info
            (sensor_msgs/CameraInfo): only with a `source`, and while there are subscribers
        /virtual_borders/notices (vb_msgs/NoticeArray): the camera's faults: no images and why, no lens, no pose,
            another camera's frame, too bright, too slow, clocks that differ
        <namespace>/debug_image (sensor_msgs/Image): spots, and rejected candidates with the reason; only if there are subscribers
    Services:
        <camera>/set_camera_info (sensor_msgs/SetCameraInfo): only with a `source`: writes the lens file
    Parameters:
        ~cameras: the namespaces of the cameras' parameters; by default only the node's own
        config/stationary.yaml: in a ceiling camera's namespace. dynamic_reconfigure can change the parameters in its
            detector, projection and capture while the node runs, except moving_camera, width, height, rate and
            pixel_format
        config/mobile.yaml: for a camera on a robot
        <robot>/robot_profile: a robot's size
    """

    def __init__(self, namespaces: Sequence[str]) -> None:
        cv2.setNumThreads(1)  # one thread per image: more would only compete for the cores
        node.disable_heap_trimming()
        # one thread searches the images of all cameras in turn: several would wait for Python's interpreter lock
        self._cameras_with_new_image: Queue[CameraDetector] = Queue()
        transforms = TransformLookup()
        self._cameras: List[CameraDetector] = []
        self._left_out: List[NoticePublisher] = []
        refusals: List[CodedError] = []
        for namespace in dict.fromkeys(rospy.resolve_name(name).rstrip("/") for name in namespaces):
            try:
                params = parameters.read(SpotDetectorNodeParams, namespace)
                self._cameras.append(CameraDetector(namespace, params, self._cameras_with_new_image, transforms))
            except CodedError as error:
                refusals.append(error.without_traceback())
                self._left_out.append(NoticePublisher(namespace))
                camera = str(rospy.get_param(f"{namespace}/camera", ""))
                self._left_out[-1].set([Notice.from_error(error, Severity.ERROR, camera)])
        if not self._cameras:
            raise refusals[0] if refusals else ParameterError(rospy.resolve_name("~cameras"), "no camera is named")
        Worker(self._cameras_with_new_image, CameraDetector.detect_next_image)

    def close(self) -> None:
        """Stops searching, releases the cameras, and withdraws the notices."""
        self._cameras_with_new_image.close()
        for resource in (*self._cameras, *self._left_out):
            resource.close()


class CameraDetector:
    """Detects spots in one camera's images, and publishes them. `SpotDetectorNode` lists the topics.

    Args:
        namespace: namespace of the camera's parameters and debug image.
        queue: receives this object whenever the camera has a new image.
        transforms: lookup in tf, shared by all cameras.

    Raises:
        ParameterError: the camera has no name.
    """

    def __init__(
        self, namespace: str, params: SpotDetectorNodeParams, queue: Queue[CameraDetector], transforms: TransformLookup
    ) -> None:
        if not params.camera:
            raise ParameterError(f"{namespace}/camera", "the camera's name must be set")
        self._namespace = namespace
        self._params = params
        self._mobile = params.detector.moving_camera
        self._floor_projection = FloorProjection(params.projection)
        self._detector = SpotDetector(params.detector)
        self._params_lock = threading.Lock()  # parameters change between images, never within one
        # a float of seconds would lose a stamp's nanoseconds
        self._stamps: Deque[rospy.Time] = deque(maxlen=_MAX_UNCONFIRMED_IMAGES)
        self._last_debug: Optional[rospy.Time] = None
        self._mailbox: Mailbox = Mailbox(partial(queue.put, self), _MAX_WAITING_IMAGES)
        self._report = DetectorDiagnostics(namespace, params.camera, self._mailbox, self._mobile, bool(params.source))
        self._spots = rospy.Publisher(names.SPOTS, LaserSpot, queue_size=_MAX_UNCONFIRMED_IMAGES, tcp_nodelay=True)
        self._debug = rospy.Publisher(f"{namespace}/debug_image", Image, queue_size=1)
        self._feed: Optional[CameraFeed] = None
        depth = DepthTopic(rospy.resolve_name(params.depth), self._report) if params.depth else None
        lens_source = self._start_receiving()
        self._camera_geometry = CameraGeometry(
            params.camera,
            self._mobile,
            transforms,
            lens_source,
            depth,
            self._floor_projection,
            params.robots,
            self._report,
        )
        rospy.Subscriber(names.DETECTORS, DetectorStatus, self._report.record_detector, queue_size=20)
        rospy.Subscriber(names.PHYSICAL_MAP, messages.NumpyOccupancyGrid, self._on_map, queue_size=1)
        self._reconfigure_servers = [
            ReconfigureServer(params.detector, f"{namespace}/detector", self._set_detector_params, ("moving_camera",)),
            ReconfigureServer(params.projection, f"{namespace}/projection", self._set_projection_params),
        ]
        if self._feed is not None:
            fixed = ("width", "height", "rate")
            capture_server = ReconfigureServer(params.capture, f"{namespace}/capture", self._feed.set_params, fixed)
            self._reconfigure_servers.append(capture_server)

    def _start_receiving(self) -> Union[InfoTopic, LensFile]:
        """Starts receiving images, and returns the source of their lens model."""
        params, report = self._params, self._report
        image = rospy.resolve_name(image_topic(params.camera, params.image))
        if params.source:
            self._feed = CameraFeed(params, image, self._mailbox, report)
            return self._feed.lens
        rospy.loginfo("%s: camera '%s' on %s", self._namespace, params.camera, image)
        subscribe_images(image, params.image_transport, params.frame, self._mailbox.put)
        # image_rect, image_rect_color: the images are already undistorted
        return InfoTopic(sibling_topic(image, "camera_info"), report, is_rectified(image))

    def close(self) -> None:
        """Drops waiting images, releases the camera, and withdraws the notices."""
        self._mailbox.close()
        if self._feed is not None:
            self._feed.close()
        self._report.close()

    def _on_map(self, message: Any) -> None:
        try:
            self._floor_projection.floor = messages.grid_from_message(message)
        except CodedError as error:
            self._report.report_fault(error)

    # ------------------------------------------------------------- dynamic_reconfigure
    def _set_detector_params(self, params: DetectorParams) -> None:
        with self._params_lock:
            self._detector.set_params(params)

    def _set_projection_params(self, params: ProjectionParams) -> None:
        with self._params_lock:
            self._floor_projection.params = params

    # ------------------------------------------------------------- images
    def detect_next_image(self) -> None:
        """Detects spots in the oldest image that waits."""
        try:
            received = self._mailbox.get()
            if received is not None:  # None while the node shuts down
                with self._params_lock:
                    self._detect_spots(received)
        except CodedError as error:
            self._report.report_fault(error)
        except cv2.error as error:
            self._report.report_fault(CodedError("bad_image", f"cannot search the image: {error}"))
        except Exception:  # an image that reveals a bug must not silence the camera for good
            rospy.logerr_throttle(60.0, f"{self._namespace}: {traceback.format_exc()}")
            self._report.report_fault(CodedError("internal_error"), severe=True)

    def _detect_spots(self, received: ReceivedImage) -> None:
        """Searches an image, and publishes its spots, what is counted, and the image itself."""
        stamp = received.stamp
        if stamp.is_zero():
            raise CodedError("no_stamp", "the images carry no time: they cannot be matched with poses")
        picture = received.decode()
        self._stamps.append(stamp)
        geometry = geometry_error = None
        try:
            geometry = self._camera_geometry.geometry_at(received.frame_id, stamp, picture.size)
        except CodedError as error:  # spots are then found, but not published
            geometry_error = error.without_traceback()
        began = time.perf_counter()
        detection = self._detector.detect(picture, stamp.to_sec(), geometry)
        search_s = time.perf_counter() - began
        located = [spot for spot in detection.spots if spot.floor_point is not None]
        for spot in located:
            self._spots.publish(self._message(spot))
        if detection.lamp_count:
            self._report.report_fault(CodedError("lamp"))
        missing = geometry_error or detection.pose_error
        # rejections are normal: they are counted, without a warning
        rejected = [spot.rejection for spot in detection.candidates if spot.rejection]
        if detection.is_late:
            rejected.append("late_image")
        focal = self._camera_geometry.focal
        self._report.record_image(stamp, received.frame_id, picture, focal, missing, search_s, len(located), rejected)
        if self._debug.get_num_connections() > 0:
            self._publish_debug(picture, detection.candidates, received)
        if self._feed is not None:
            self._feed.publish(received, picture)

    def _message(self, spot: Spot) -> LaserSpot:
        """Converts a located spot."""
        result = LaserSpot()
        point = spot.floor_point
        exact_stamps = (stamp for stamp in reversed(self._stamps) if stamp.to_sec() == spot.stamp)
        result.header.stamp = next(exact_stamps, rospy.Time.from_sec(spot.stamp))  # the stamp may be too old to be kept
        result.header.frame_id = names.MAP_FRAME
        result.camera = self._params.camera
        result.mobile = self._mobile
        result.position = Point(*(float(value) for value in point.position))
        result.u, result.v, result.diameter = spot.u, spot.v, spot.diameter
        result.diameter_m = spot.diameter * point.meters_per_pixel
        result.confidence = spot.confidence
        result.track = spot.track
        result.projection = getattr(LaserSpot, point.source.upper())
        return result

    def _publish_debug(self, picture: AnyPicture, candidates: Sequence[Spot], received: ReceivedImage) -> None:
        now = rospy.Time.now()
        if self._last_debug is not None and 0 <= (now - self._last_debug).to_sec() < _DEBUG_PERIOD:
            return
        self._last_debug = now
        image = draw_candidates(picture, candidates)
        self._debug.publish(message_from_image(image, "bgr8", received.stamp, received.frame_id))


def build() -> SpotDetectorNode:
    """Makes the node for the cameras that its parameters name."""
    return SpotDetectorNode(rospy.get_param("~cameras", ["~"]))
