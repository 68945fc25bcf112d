"""A camera's image for the page, fetched only while a browser shows it. Needs a node."""

from __future__ import annotations

from typing import Optional

import rospy
from sensor_msgs.msg import Image

from vb_core.image_format import PixelReader
from vb_core.ros.images import array_from_image
from vb_web import images

_IMAGE_TIMEOUT = 2.0  # [s] for a camera's next image


def fetch_jpeg(detector: Optional[str]) -> Optional[bytes]:
    """Returns the next debug image of a detector, by its node's name; None if there is no detector, or nothing arrives.

    Raises:
        CodedError: "bad_image", "unknown_encoding" for an image that shows nothing.
    """
    if detector is None:
        return None
    try:
        image = rospy.wait_for_message(f"{detector}/debug_image", Image, timeout=_IMAGE_TIMEOUT)
    except rospy.ROSException:
        return None
    return images.encode_jpeg(PixelReader().read(array_from_image(image), image.encoding).bgr())
