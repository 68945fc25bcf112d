"""The images of one camera, from a driver's topics or from the camera itself."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any, Callable, NamedTuple, Optional, Tuple

import rospy
import simplejpeg
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from sensor_msgs.srv import SetCameraInfo, SetCameraInfoRequest, SetCameraInfoResponse

from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError
from vb_core.image_format import AnyPicture, PixelReader
from vb_core.ros.images import camera_from_info, decode, info_from_camera, message_from_image
from vb_core.ros.node import Mailbox
from vb_laser_detect.camera import v4l2_controls
from vb_laser_detect.camera.lens_and_settings_files import load_lens, save_lens
from vb_laser_detect.camera.camera_source import CameraSource, CapturedImage, is_device, is_file, without_password
from vb_laser_detect.ros.camera_geometry import require_size, sibling_topic
from vb_laser_detect.ros.detector_diagnostics import DetectorDiagnostics
from vb_laser_detect.camera.v4l2_controls import CaptureParams
from vb_laser_detect.spot_detector_node_params import SpotDetectorNodeParams

SETTINGS_FOLDER = "~/.ros/virtual_borders"


class ReceivedImage(NamedTuple):
    """An image that is not decoded yet. If it arrives too late, it is dropped without being decoded.

    Attributes:
        stamp: when it was taken.
        decode: decodes and returns the picture; raises CodedError "bad_image", "unknown_encoding".
        jpeg: the image as a camera that is read directly sent it; None if it was no JPEG, or a driver published it.
    """

    stamp: rospy.Time
    frame_id: str
    decode: Callable[[], AnyPicture]
    jpeg: Optional[bytes] = None


def lens_path(settings: str, camera: str) -> Path:
    """Returns the path of a camera's lens file: LAB/lenses/CAMERA.yaml if its settings are LAB/detectors/CAMERA.yaml.

    Without a settings file, LAB is SETTINGS_FOLDER.
    """
    own_lab = Path(settings).expanduser().resolve().parent.parent
    lab = own_lab if settings else Path(SETTINGS_FOLDER).expanduser()
    return lab / "lenses" / f"{camera}.yaml"


class LensFile:
    """A camera's lens, read from its file, which may appear late, and change."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._mtime_ns = -1  # modification time of the file that was read last; 0 if there was none, -1 at first
        self._camera: Optional[CameraModel] = None
        self._error: Optional[CodedError] = None

    def model_for(self, size: Tuple[int, int]) -> CameraModel:
        """Returns the model for images of this width and height [px].

        Raises:
            CodedError: "no_camera_info" if there is no file, or one for another image size; "bad_lens_file".
        """
        mtime_ns = self._path.stat().st_mtime_ns if self._path.is_file() else 0
        if mtime_ns != self._mtime_ns:
            self._mtime_ns = mtime_ns
            self._error = None
            try:
                self._camera = load_lens(self._path)
            except CodedError as error:
                self._error = error.without_traceback()
        if self._error is not None:
            raise self._error.without_traceback()
        return require_size(self._camera, size)

    def write(self, request: SetCameraInfoRequest) -> SetCameraInfoResponse:
        """Writes the lens of a request. The answer says whether this succeeded, and if not, why."""
        try:
            save_lens(self._path, self._path.stem, camera_from_info(request.camera_info))
        except CodedError as error:
            return SetCameraInfoResponse(False, str(error))
        return SetCameraInfoResponse(True, f"wrote {self._path}")


class CameraFeed:
    """Reads a camera, and publishes its images while there are subscribers.

    Published topics:
        <image> (sensor_msgs/Image), <image>/compressed (sensor_msgs/CompressedImage), camera_info
            (sensor_msgs/CameraInfo): only while there are subscribers
    Services:
        set_camera_info (sensor_msgs/SetCameraInfo): writes the lens file when a user of camera_calibration presses COMMIT

    Args:
        params: parameters of the camera's detector.
        image: topic of its images.
        mailbox: receives each image.
        report: receives faults, and the reason why there are no images.
    """

    def __init__(
        self, params: SpotDetectorNodeParams, image: str, mailbox: Mailbox, report: DetectorDiagnostics
    ) -> None:
        self._camera = params.camera
        self.lens = LensFile(lens_path(params.settings, params.camera))
        self._frame = params.frame or f"{params.camera}_optical_frame"
        self._mailbox = mailbox
        self._report = report
        self._raw = rospy.Publisher(image, Image, queue_size=1)
        self._compressed = rospy.Publisher(f"{image}/compressed", CompressedImage, queue_size=1)
        self._info = rospy.Publisher(sibling_topic(image, "camera_info"), CameraInfo, queue_size=1)
        rospy.Service(sibling_topic(image, "set_camera_info"), SetCameraInfo, self.lens.write)
        self._settings_lock = threading.Lock()
        self._source = CameraSource(params.source, params.capture, self._on_image, self._on_source_state)
        self._source.start()  # the thread may call back at once

    def close(self) -> None:
        """Releases the camera."""
        self._source.close()

    def set_params(self, params: CaptureParams) -> None:
        """Changes delay, exposure and white balance of the running camera.

        Raises:
            CodedError: as `v4l2_controls.set_controls`; only what the camera has accepted is then changed.
        """
        with self._settings_lock:
            if is_device(self._source.address):
                v4l2_controls.set_controls(self._source.address, params)
            elif params.exposure or params.white_balance:
                address = without_password(self._source.address)
                raise CodedError("control_refused", source=address, why_code="only_devices")
            self._source.params = params
        self._report.clear_refused_setting()

    def publish(self, image: ReceivedImage, picture: AnyPicture) -> None:
        """Publishes an image on those topics that have subscribers."""
        if self._raw.get_num_connections():
            self._raw.publish(message_from_image(picture.pixels, "bgr8", image.stamp, image.frame_id))
        if self._compressed.get_num_connections():
            message = CompressedImage(format="bgr8; jpeg compressed bgr8")
            message.header.stamp, message.header.frame_id = image.stamp, image.frame_id
            message.data = image.jpeg or simplejpeg.encode_jpeg(picture.pixels, quality=90, colorspace="BGR")
            self._compressed.publish(message)
        if self._info.get_num_connections():
            try:
                model = self.lens.model_for(picture.size)
            except CodedError:
                return  # the detector reports why
            self._info.publish(info_from_camera(model, image.stamp, image.frame_id))

    def _on_image(self, image: CapturedImage) -> None:
        for code in image.skipped_codes:
            self._report.count_dropped(code)
        # the camera's clock does not follow simulated time
        stamp = rospy.Time.now() - rospy.Duration.from_sec(time.time() - image.stamp)
        self._mailbox.put(ReceivedImage(stamp, self._frame, image.picture, image.jpeg))
        if is_file(self._source.address):
            self._mailbox.wait_until_taken()

    def _on_source_state(self, error: Optional[CodedError]) -> None:
        is_silent = error is not None
        if not is_silent:
            rospy.loginfo("%s: reads %s", self._camera, without_password(self._source.address))
            try:
                self.set_params(self._source.params)  # a camera just opened has its own exposure and white balance
            except CodedError as refusal:
                error = refusal.without_traceback()
        self._report.set_source_fault(error, is_silent)


def subscribe_images(image: str, transport: str, frame: str, put: Callable[[ReceivedImage], Any]) -> str:
    """Subscribes to <image> (sensor_msgs/Image) or <image>/compressed (sensor_msgs/CompressedImage), and returns the topic.

    Args:
        transport: "compressed" or "raw".
        frame: replaces the images' own frame_id, unless it is empty.
    """
    reader = PixelReader()

    def on_message(message: Any) -> None:
        header = message.header
        put(ReceivedImage(header.stamp, frame or header.frame_id, lambda: decode(message, reader)))

    kind, topic = (CompressedImage, f"{image}/compressed") if transport == "compressed" else (Image, image)
    # the buffer must hold a whole image, else rospy delivers images older than the newest one
    rospy.Subscriber(topic, kind, on_message, queue_size=1, buff_size=2**24, tcp_nodelay=True)
    return topic
