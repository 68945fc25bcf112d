"""Pixels of any camera encoding, for display and for the board's detector."""
from __future__ import annotations

import cv2
import numpy as np

from vb_laser_detect.detection.image_format import BAYER, PixelReader


def to_bgr(image: np.ndarray, encoding: str) -> np.ndarray:
    """A bgr copy (H, W, 3) of an image as it came.

    Args:
        encoding: as in sensor_msgs/Image.
    """
    image = PixelReader().read(image, encoding)
    if encoding[:10] in BAYER:
        return cv2.cvtColor(image, BAYER[encoding[:10]])
    if image.ndim == 2:
        return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    if encoding.startswith("rgb"):
        return cv2.cvtColor(image[:, :, :3], cv2.COLOR_RGB2BGR)
    return image[:, :, :3].copy()


def to_grey(image: np.ndarray, encoding: str) -> np.ndarray:
    """(H, W) uint8 likewise."""
    if image.ndim == 2 and encoding[:10] not in BAYER:
        return PixelReader().read(image, encoding)
    return cv2.cvtColor(to_bgr(image, encoding), cv2.COLOR_BGR2GRAY)
