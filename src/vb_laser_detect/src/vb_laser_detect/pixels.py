"""Pixels of any encoding that a camera sends, for the eye and for the board's detector."""
from __future__ import annotations

import cv2
import numpy as np

_BAYER = {
    "bayer_rggb8": cv2.COLOR_BayerRGGB2BGR,
    "bayer_bggr8": cv2.COLOR_BayerBGGR2BGR,
    "bayer_gbrg8": cv2.COLOR_BayerGBRG2BGR,
    "bayer_grbg8": cv2.COLOR_BayerGRBG2BGR,
}


def to_bgr(image: np.ndarray, encoding: str) -> np.ndarray:
    """A bgr copy (H, W, 3) of an image (H, W) or (H, W, 3), uint8.

    Args:
        encoding: as in sensor_msgs/Image.
    """
    if encoding in _BAYER:
        return cv2.cvtColor(image, _BAYER[encoding])
    if image.ndim == 2:
        return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    if encoding.startswith("rgb"):
        return cv2.cvtColor(image[:, :, :3], cv2.COLOR_RGB2BGR)
    return image[:, :, :3].copy()


def to_grey(image: np.ndarray, encoding: str) -> np.ndarray:
    """(H, W) uint8 of the same."""
    if image.ndim == 2 and encoding not in _BAYER:
        return image
    return cv2.cvtColor(to_bgr(image, encoding), cv2.COLOR_BGR2GRAY)
