"""The table of image encodings, by their sensor_msgs names; converts bytes to pixels, and pixels to a picture."""

from __future__ import annotations

import re
from functools import cached_property
from typing import Callable, Dict, NamedTuple, Tuple, Union

import cv2
import numpy as np

from vb_core.errors import CodedError

_BAYER_PATTERNS = ("rggb", "bggr", "gbrg", "grbg")
_BAYER = {f"bayer_{pattern}": getattr(cv2, f"COLOR_Bayer{pattern.upper()}2BGR") for pattern in _BAYER_PATTERNS}
# pixel contents other than bgr, with OpenCV's conversion to bgr
_TO_BGR = {"mono": cv2.COLOR_GRAY2BGR, "rgb": cv2.COLOR_RGB2BGR, **_BAYER}
_CHANNELS = {"mono": 1, "bgr": 3, "rgb": 3, "bgra": 4, "rgba": 4, **dict.fromkeys(_BAYER, 1)}
# luminance and chrominance are separate: converted to bgr on reading
_YUV = {
    "uyvy": (2, cv2.COLOR_YUV2BGR_UYVY),
    "yuyv": (2, cv2.COLOR_YUV2BGR_YUYV),
    "nv12": (1, cv2.COLOR_YUV2BGR_NV12),
    "nv21": (1, cv2.COLOR_YUV2BGR_NV21),
}
_GENERAL = re.compile(r"(8|16|32|64)([USF])(?:C([1-9][0-9]?))?")
_KINDS = {"8U": "u1", "8S": "i1", "16U": "u2", "16S": "i2", "32S": "i4", "32F": "f4", "64F": "f8"}


class Encoding(NamedTuple):
    """An image's storage format: numpy type, channels per pixel, and the channels' content ("" if not a picture)."""

    dtype: np.dtype
    channels: int
    color_format: str

    def rows(self, height: int) -> int:
        """Returns how many rows of bytes an image of this height [px] has, since chrominance may be below luminance."""
        return height * 3 // 2 if self.color_format in ("nv12", "nv21") else height


def _table() -> Dict[str, Encoding]:
    table = {name: Encoding(np.dtype("u1"), channels, name) for name, (channels, _) in _YUV.items()}
    table.update({"yuv422": table["uyvy"], "yuv422_yuy2": table["yuyv"]})
    for bits, dtype in ((8, "u1"), (16, "u2")):
        for name, channels in _CHANNELS.items():
            table[f"{name}{bits}"] = Encoding(np.dtype(dtype), channels, name)
        table[f"{bits}UC3"] = table[f"bgr{bits}"]
        table[f"{bits}UC4"] = table[f"bgra{bits}"]
    # 16UC1 is missing because it is depth; a grey image of 16 bits is called mono16
    table.update({"8UC1": table["mono8"], "8U": table["mono8"]})
    return table


_ENCODINGS = _table()


def find_encoding(name: str) -> Encoding:
    """Looks up an encoding by its name. Raises CodedError "bad_image" if it is unknown."""
    encoding = _ENCODINGS.get(name.lower()) or _ENCODINGS.get(name)
    if encoding is not None:
        return encoding
    match = _GENERAL.fullmatch(name)
    dtype = _KINDS.get(match.group(1) + match.group(2)) if match else None
    if dtype is None:
        raise CodedError("bad_image", f"cannot read an image with the unknown encoding '{name}'")
    return Encoding(np.dtype(dtype), int(match.group(3) or 1), "")


class Picture(NamedTuple):
    """An 8-bit image of a visible scene, unlike a depth image for instance."""

    pixels: np.ndarray  # (H, W) or (H, W, 3) uint8, contiguous
    color_format: str  # the pixels' meaning: "mono", "bgr", "rgb", or a Bayer pattern, "bayer_rggb"
    scale = 1  # see `HalvedPicture`
    is_fully_decoded = True

    @property
    def size(self) -> Tuple[int, int]:
        """Width and height [px]."""
        return self.pixels.shape[1], self.pixels.shape[0]

    @property
    def search_pixels(self) -> np.ndarray:
        """The pixels to be searched for spots."""
        return self.pixels

    @property
    def is_bayer(self) -> bool:
        """Whether each pixel holds one colour only."""
        return self.color_format in _BAYER

    def bgr(self) -> np.ndarray:
        """Returns a bgr copy (H, W, 3)."""
        conversion = _TO_BGR.get(self.color_format)
        return self.pixels.copy() if conversion is None else cv2.cvtColor(self.pixels, conversion)

    def gray(self) -> np.ndarray:
        """Returns grey levels (H, W)."""
        return self.pixels if self.color_format == "mono" else cv2.cvtColor(self.bgr(), cv2.COLOR_BGR2GRAY)


class HalvedPicture:
    """A picture that is searched for spots at half size and measured at full size. Each size is decoded when needed.

    Args:
        size: width and height [px], even.
        decode: returns the pixels (H, W, 3) uint8 bgr for a width and a height.

    Attributes:
        color_format, is_bayer: meaning of the pixels, and whether each holds one colour only, as in `Picture`.
        scale: number of full-size pixels per searched pixel, in each direction.
    """

    color_format = "bgr"
    is_bayer = False
    scale = 2

    def __init__(self, size: Tuple[int, int], decode: Callable[[int, int], np.ndarray]) -> None:
        self.size = size
        self._decode = decode

    @property
    def is_fully_decoded(self) -> bool:
        """Whether the full size has been decoded."""
        return "pixels" in vars(self)

    @cached_property
    def pixels(self) -> np.ndarray:
        """The pixels at full size."""
        return self._decode(*self.size)

    @cached_property
    def search_pixels(self) -> np.ndarray:
        """The pixels at half the size, which a codec decodes faster than the full size."""
        return self._decode(self.size[0] // 2, self.size[1] // 2)

    def decode_full_size(self) -> None:
        """Decodes the full size and halves it: faster than decoding both sizes, with a difference of one grey level."""
        half = self.size[0] // 2, self.size[1] // 2
        self.search_pixels = cv2.resize(self.pixels, half, interpolation=cv2.INTER_AREA)

    def bgr(self) -> np.ndarray:
        """Returns a bgr copy (H, W, 3)."""
        return self.pixels.copy()


AnyPicture = Union[Picture, HalvedPicture]


class PixelReader:
    """Converts the images of one camera to 8-bit pixels. Remembers how many bits the camera really uses.

    A camera with 10 or 12 bits sends 16-bit values; the largest value received so far shows how many bits it uses.
    """

    def __init__(self) -> None:
        self._bits = 8

    def read(self, image: np.ndarray, encoding: str) -> Picture:
        """Converts an image to 8-bit pixels.

        Args:
            image: the message's pixels, unconverted.
            encoding: the encoding's name in sensor_msgs/Image.

        Raises:
            CodedError: "unknown_encoding" for images in which no spot can be seen, such as depth.
        """
        color_format = find_encoding(encoding).color_format
        if not color_format:
            raise CodedError("unknown_encoding", encoding=encoding)
        if color_format in _YUV:
            return Picture(cv2.cvtColor(image, _YUV[color_format][1]), "bgr")
        if image.dtype == np.uint16:
            largest = int(image.max()) if image.size else 0
            while largest >> self._bits and self._bits < 16:
                self._bits += 2
            image = cv2.convertScaleAbs(image, alpha=255.0 / ((1 << self._bits) - 1))
        colors = image[:, :, :3] if image.ndim == 3 else image
        return Picture(np.ascontiguousarray(colors), {"bgra": "bgr", "rgba": "rgb"}.get(color_format, color_format))
