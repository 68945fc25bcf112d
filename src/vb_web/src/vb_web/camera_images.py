"""Camera images for the page, fetched only while a browser shows them. Needs a node."""

from __future__ import annotations

import threading
import time
from typing import Callable, List, Optional, Union

import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from vb_core import names
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.image_format import PixelReader
from vb_core.ros.images import camera_from_info, decode
from vb_core.ros.transforms import TransformLookup
from vb_web import page_images

_TRANSPORTS = {"raw": ("image_raw", Image), "compressed": ("image_raw/compressed", CompressedImage)}
_IMAGE_TIMEOUT = 2.0  # [s] for a camera's next image
_FLOOR_LIFETIME = 5.0  # [s] for which all browsers get the same image of the floor, if no camera is missing in it


def to_bgr(message: Union[Image, CompressedImage]) -> np.ndarray:
    """Converts an image message to (H, W, 3) bgr uint8.

    Raises CodedError "bad_image", or "unknown_encoding" for an image that is not a picture, such as depth.
    """
    return decode(message, PixelReader()).bgr()


class CameraImages:
    """Makes two kinds of images for browsers: the detectors' debug images, and the floor as the ceiling cameras see it.

    Args:
        find_detector: returns the namespace of a camera's detector, or None for an unknown camera.
        cameras: names of the ceiling cameras.
        transport: "raw" or "compressed".
        find_map: returns the map, or None as long as there is none.
    """

    def __init__(
        self,
        find_detector: Callable[[str], Optional[str]],
        cameras: List[str],
        transport: str,
        find_map: Callable[[], Optional[GridMap]],
        transforms: TransformLookup,
    ) -> None:
        self._find_detector = find_detector
        self._find_map = find_map
        self._cameras = cameras
        self._transforms = transforms
        self._topic, self._message_type = _TRANSPORTS[transport]
        self._floor_lock = threading.Lock()
        self._floor: Optional[bytes] = None
        self._floor_at = -1e9

    def camera_jpeg(self, camera: str) -> Optional[bytes]:
        """Returns the newest debug image of a camera, or None if the camera is unknown or nothing arrives."""
        detector = self._find_detector(camera)
        if detector is None:
            return None
        try:
            message = rospy.wait_for_message(f"{detector}/debug_image", Image, timeout=_IMAGE_TIMEOUT)
            return page_images.encode_jpeg(to_bgr(message))
        except rospy.ROSException:
            return None

    def floor_webp(self) -> Optional[bytes]:
        """Draws the floor as all ceiling cameras see it now. Returns None without a map or if no camera sends images."""
        with self._floor_lock:
            if self._floor is None or time.monotonic() - self._floor_at > _FLOOR_LIFETIME:
                grid = self._find_map()
                images = [image for image in map(self._receive, self._cameras) if image is not None]
                self._floor = page_images.draw_floor(grid, images).encoded if grid is not None and images else None
                # if a camera is missing, it may be about to start: the next request draws the image again
                is_complete = len(images) == len(self._cameras)
                self._floor_at = time.monotonic() if is_complete else -1e9
            return self._floor

    def _receive(self, camera: str) -> Optional[page_images.CeilingImage]:
        try:
            info = rospy.wait_for_message(f"/{camera}/camera_info", CameraInfo, timeout=_IMAGE_TIMEOUT)
            topic = f"/{camera}/{self._topic}"
            image = to_bgr(rospy.wait_for_message(topic, self._message_type, timeout=_IMAGE_TIMEOUT))
            model = camera_from_info(info)
            T_camera_map = self._transforms.lookup(f"{camera}_optical_frame", names.MAP_FRAME, rospy.Time(0))
        except (rospy.ROSException, CodedError) as error:
            rospy.logwarn_throttle(60.0, f"{rospy.get_name()}: the floor's image is without camera {camera}: {error}")
            return None
        height, width = image.shape[:2]
        return page_images.CeilingImage(image, model.scaled_to(width, height), T_camera_map)
