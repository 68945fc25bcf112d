"""Interprets an image's numbers: 8-bit pixels from any camera encoding, Bayer images included."""

from __future__ import annotations

import cv2
import numpy as np

from vb_core.errors import CodedError

_YUV = {
    "yuv422": cv2.COLOR_YUV2BGR_UYVY,
    "yuv422_yuy2": cv2.COLOR_YUV2BGR_YUYV,
    "uyvy": cv2.COLOR_YUV2BGR_UYVY,
    "yuyv": cv2.COLOR_YUV2BGR_YUYV,
}
BAYER = {
    "bayer_rggb": cv2.COLOR_BayerRGGB2BGR,
    "bayer_bggr": cv2.COLOR_BayerBGGR2BGR,
    "bayer_gbrg": cv2.COLOR_BayerGBRG2BGR,
    "bayer_grbg": cv2.COLOR_BayerGRBG2BGR,
}


class PixelReader:
    """Converts images to 8-bit pixels; remembers how many bits a camera really uses.

    A camera of 10 or 12 bits sends them in 16: the largest value so far tells how many there are.
    """

    def __init__(self) -> None:
        self._bits = 8

    def read(self, image: np.ndarray, encoding: str) -> np.ndarray:
        """Converts an image to (H, W) mono or Bayer, or (H, W, 3) colours, uint8.

        Args:
            image: the message's pixels as they are.
            encoding: as in sensor_msgs/Image.

        Raises:
            CodedError: "unknown_encoding" for images that no spot can be seen in, such as depth.
        """
        name = encoding.lower()
        if name in _YUV:
            return cv2.cvtColor(image, _YUV[name])
        if image.dtype == np.uint16:
            largest = int(image.max()) if image.size else 0
            while largest >> self._bits and self._bits < 16:
                self._bits += 2
            image = cv2.convertScaleAbs(image, alpha=255.0 / ((1 << self._bits) - 1))
        if image.dtype != np.uint8:
            raise CodedError("unknown_encoding", encoding=encoding)
        return image if image.ndim == 2 else np.ascontiguousarray(image[:, :, :3])


def to_bgr(image: np.ndarray, encoding: str) -> np.ndarray:
    """Converts an image as it came to a bgr copy (H, W, 3).

    Args:
        encoding: as in sensor_msgs/Image.
    """
    image = PixelReader().read(image, encoding)
    if encoding[:10] in BAYER:
        return cv2.cvtColor(image, BAYER[encoding[:10]])
    if image.ndim == 2:
        return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    return cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if encoding.startswith("rgb") else image.copy()


def to_gray(image: np.ndarray, encoding: str) -> np.ndarray:
    """Converts an image as it came to grey levels (H, W) uint8."""
    if image.ndim == 2 and encoding[:10] not in BAYER:
        return PixelReader().read(image, encoding)
    return cv2.cvtColor(to_bgr(image, encoding), cv2.COLOR_BGR2GRAY)
