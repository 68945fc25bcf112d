"""What an image's numbers mean: 8-bit pixels from any camera encoding, and whether they are a mosaic."""
from __future__ import annotations

import cv2
import numpy as np

from vb_core.errors import CodedError

_MOSAIC = 2.0  # [grey levels] by which the means of places in a grey image's tiles may differ
_YUV = {"yuv422": cv2.COLOR_YUV2BGR_UYVY, "yuv422_yuy2": cv2.COLOR_YUV2BGR_YUYV, "uyvy": cv2.COLOR_YUV2BGR_UYVY,
        "yuyv": cv2.COLOR_YUV2BGR_YUYV}


class PixelReader:
    """Converts images to 8-bit pixels; remembers how many bits a camera really uses.

    A camera of 10 or 12 bits sends them in 16: the largest value so far tells how many there are.
    """

    def __init__(self) -> None:
        self._bits = 8

    def read(self, image: np.ndarray, encoding: str) -> np.ndarray:
        """(H, W) mono or Bayer, or (H, W, 3) colours, uint8.

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
        return image


def is_mosaic(image: np.ndarray, encoding: str = "") -> bool:
    """Whether an image (H, W) comes from a Bayer camera: neighbouring pixels show different colours.

    Args:
        encoding: as in sensor_msgs/Image. Empty: not known; then the pixels tell, and a white-balanced camera over
            a colourless floor counts as a grey one.
    """
    if encoding or image.ndim != 2:
        return encoding.startswith("bayer")
    # the means of tiles 32 pixels wide, of each place in the pattern
    rows, columns = image.shape[0] // 32, image.shape[1] // 32
    whole = image[: 32 * rows, : 32 * columns]
    means = np.stack([
        cv2.resize(np.ascontiguousarray(whole[y::2, x::2]), (columns, rows), interpolation=cv2.INTER_AREA)
        for y in (0, 1) for x in (0, 1)
    ]).astype(np.float32)
    spread = means.max(axis=0) - means.min(axis=0)
    return bool(np.median(spread) > _MOSAIC + 0.04 * np.median(means))
