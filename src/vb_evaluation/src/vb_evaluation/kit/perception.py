"""Detects spots in recorded images with today's detectors."""
from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Deque, Dict, Iterator, List, Optional, Sequence, Tuple

import numpy as np
import rospy
import tf2_ros

from vb_core import names
from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError
from vb_core.ros.cameras import camera_from_info
from vb_core.ros.images import compressed_encoding, compressed_image_array, image_array
from vb_core.ros import messages
from vb_evaluation.kit import bags
from vb_evaluation.kit.recording import Recording
from vb_evaluation.kit.replay import Event
from vb_evaluation.kit.session import ROBOT_IMAGES
from vb_fusion.collector import Spot
from vb_laser_detect.detector import DetectorParams, SpotDetector
from vb_laser_detect.detector import Spot as DetectedSpot
from vb_laser_detect.image_geometry import Frame, placed, search
from vb_laser_detect.image_format import PixelReader
from vb_laser_detect.projection import FloorProjector, ProjectionParams

_KEPT_DEPTHS = 4


@dataclass
class CameraCounts:
    """What one camera saw: images, spots that today's detector finds in them, and spots that were recorded."""

    images: int = 0
    today: int = 0
    recorded: int = 0


class RecordedCamera:
    """One camera's detector over recorded images, wired as the node wires it.

    Args:
        name: in the spots.
        mobile: on a robot.
        transforms: all recorded ones.
    """

    def __init__(self, name: str, mobile: bool, transforms: tf2_ros.BufferCore) -> None:
        values = bags.config("vb_laser_detect", "mobile" if mobile else "stationary")
        self.name = name
        self._mobile = mobile
        self._depth_age_s = float(values.get("depth_age_s", 0.08))
        self._transforms = transforms
        self._detector = SpotDetector(DetectorParams.from_mapping(values.get("detector") or {}))
        self.projector = FloorProjector(
            ProjectionParams.from_mapping(values.get("projection")), None, values.get("ignore_regions") or ()
        )
        self._reader = PixelReader()
        self.model: Optional[CameraModel] = None
        self.depth_model: Optional[CameraModel] = None
        self.depths: Deque[Tuple[float, np.ndarray]] = deque(maxlen=_KEPT_DEPTHS)

    def search(self, image: np.ndarray, stamp: rospy.Time, frame: str, encoding: str = "") -> List[Spot]:
        """The spots of one image, in an encoding of sensor_msgs/Image, on the floor.

        Raises:
            CodedError: if the image cannot be searched or the camera's place is unknown.
        """
        if self.model is None:
            raise CodedError("no_camera_info", f"{self.name}: no camera_info was recorded before the first image")
        pose = self._pose(frame, stamp)
        geometry = Frame(
            self.model,
            lambda: pose,
            self.projector,
            (lambda: self._depth_at(stamp.to_sec())) if self._mobile else None,
            stamp.to_sec(),
        )
        image = self._reader.read(image, encoding)
        spots = search(self._detector, image, stamp.to_sec(), geometry, encoding)
        return [self._on_floor(*found) for found in placed(self._detector, spots, geometry)]

    def _on_floor(self, frame: Frame, spot: DetectedSpot) -> Spot:
        x, y = (float(value) for value in frame.point(spot.u, spot.v).position[:2])
        return Spot(frame.stamp, x, y, self.name, float(spot.confidence), self._mobile)

    def _pose(self, frame: str, stamp: rospy.Time) -> np.ndarray:
        try:
            found = self._transforms.lookup_transform_core(names.MAP_FRAME, frame, stamp)
        except tf2_ros.TransformException as error:
            raise CodedError("no_transform", f"{self.name}: no transform from '{frame}': {error}") from None
        return messages.matrix_from_transform(found.transform)

    def _depth_at(self, stamp: float) -> Tuple[Optional[np.ndarray], Optional[CameraModel]]:
        near = min(self.depths, key=lambda entry: abs(entry[0] - stamp), default=None)
        if near is None or abs(near[0] - stamp) > self._depth_age_s:
            return None, None
        fits = self.depth_model is not None and (self.depth_model.height, self.depth_model.width) == near[1].shape[:2]
        return near[1], self.depth_model if fits else None


def events(
    recording: Recording, cameras: Sequence[str], robots: Sequence[str]
) -> Tuple[List[Event], Dict[str, CameraCounts]]:
    """(states and spots in the order of arrival, counts by camera); the spots are found again in the images.

    Args:
        cameras: names of the ceiling cameras.
        robots: namespaces; "" is the robot without one, whose camera is called "robot".

    Raises:
        CodedError: "bad_recording" if there are no images.
    """
    transforms = _transforms(recording)
    found = {f"/{camera}/image_raw": RecordedCamera(camera, False, transforms) for camera in cameras}
    depths: Dict[str, RecordedCamera] = {}
    for robot in robots:
        name = robot.strip("/")
        prefix = f"/{name}/" if name else "/"
        camera = found[prefix + ROBOT_IMAGES[0]] = RecordedCamera(name or "robot", True, transforms)
        depths[prefix + ROBOT_IMAGES[1]] = camera
    counts = {camera.name: CameraCounts() for camera in found.values()}
    gathered = list(_search(recording, found, depths, counts))
    if not any(count.images for count in counts.values()):
        raise CodedError(
            "bad_recording",
            f"{recording.folder}: no images were recorded: record with record_images:=raw or compressed",
        )
    return gathered, counts


def _search(
    recording: Recording,
    images: Dict[str, RecordedCamera],
    depths: Dict[str, RecordedCamera],
    counts: Dict[str, CameraCounts],
) -> Iterator[Event]:
    infos = {topic.rsplit("/", 1)[0] + "/camera_info": camera for topic, camera in images.items()}
    depth_infos = {topic.rsplit("/", 1)[0] + "/camera_info": camera for topic, camera in depths.items()}
    compressed = {f"{topic}/compressed": camera for topic, camera in images.items()}
    wanted = [names.STATE, names.SPOTS, names.PHYSICAL_MAP, *images, *compressed, *depths, *infos, *depth_infos]
    for topic, message in bags.messages_of(recording, wanted):
        if topic == names.STATE:
            yield bags.state_change(message)
        elif topic == names.SPOTS:
            if message.camera in counts:
                counts[message.camera].recorded += 1
        elif topic == names.PHYSICAL_MAP:
            for camera in images.values():
                camera.projector.floor = messages.grid_from_message(message)
        elif topic in infos:
            infos[topic].model = camera_from_info(message)
        elif topic in depth_infos:
            depth_infos[topic].depth_model = camera_from_info(message)
        elif topic in depths:
            depths[topic].depths.append((message.header.stamp.to_sec(), image_array(message)))
        else:
            camera = images.get(topic) or compressed[topic]
            count = counts[camera.name]
            count.images += 1
            image = image_array(message) if topic in images else compressed_image_array(message)
            try:
                encoding = message.encoding if topic in images else compressed_encoding(message, image)
                spots = camera.search(image, message.header.stamp, message.header.frame_id, encoding)
            except CodedError as error:
                if error.code in ("no_transform", "no_camera_info"):
                    continue  # the first images of a recording precede what they need
                raise
            count.today += len(spots)  # some are returned only once later images have confirmed them
            yield from spots


def _transforms(recording: Recording) -> tf2_ros.BufferCore:
    """All recorded transforms: an image may come before the transform of its time."""
    buffer = tf2_ros.BufferCore(rospy.Duration(24 * 3600))
    for topic, message in bags.messages_of(recording, ("/tf", "/tf_static")):
        for recorded in message.transforms:
            # rosbag makes its own message classes, which tf2 does not accept
            transform = messages.transform_message(
                messages.matrix_from_transform(recorded.transform),
                recorded.header.frame_id,
                recorded.child_frame_id,
                recorded.header.stamp,
            )
            (buffer.set_transform_static if topic == "/tf_static" else buffer.set_transform)(transform, "bag")
    return buffer
