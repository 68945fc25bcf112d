"""The colour of a candidate's light, in colour images and in a Bayer camera's mosaic."""
from __future__ import annotations

from functools import lru_cache
from typing import Tuple

import cv2
import numpy as np

_WHITE = 240.0  # [grey levels] a pixel whose weakest channel is above says nothing about colour
_GREY = 0.85  # a floor is grey if its weakest channel has this share of the strongest
_SQUARE, _QUAD = np.ones((3, 3), np.uint8), np.ones((2, 2), np.uint8)
_HALO = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))


def means_over(
    mask: np.ndarray, image: np.ndarray, background: np.ndarray
) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean rise, level and floor (C,) of each channel over a mask (H, W), which must not be empty.

    The four places in a Bayer image's pattern count as channels, in the order of the first two rows.
    """
    if image.ndim == 3:
        level, floor = (np.array(cv2.mean(picture, mask)[:3]) for picture in (image, background))
    else:
        parts = _at_places(mask)
        if not all(map(cv2.countNonZero, parts)):
            parts = _at_places(cv2.dilate(mask, _SQUARE))  # nine pixels hold all four places
        level, floor = (np.array([cv2.mean(picture, part)[0] for part in parts]) for picture in (image, background))
    return np.maximum(level - floor, 0.0), level, floor


def tint_of(blob: np.ndarray, smooth: np.ndarray, image: np.ndarray, background: np.ndarray) -> np.ndarray:
    """Each channel's share (C,) of a blob's light; 1 for the strongest, and for all of them if the light is white.

    White paper on a brown floor rises most in blue, and still looks white: a laser's light rises most in its own colour
    and has that colour. Where the core is white, since it saturates every channel, the light around it must show the
    colour; that counts on a grey floor only, where white things rise evenly.

    Args:
        blob: (H, W) uint8 mask.
        smooth: (H, W) the rise of the brightest channel, smoothed.
        image, background: (H, W) or (H, W, C) uint8; a Bayer image's window starts on an even row and column.
    """
    rise, level, _ = means_over(blob, image, background)
    core = rise / max(rise.max(), 1.0)
    looks = 1.0 - level.min() / max(level.max(), 1.0)
    if looks < chroma(core):
        core = 1.0 - (1.0 - core) * looks / chroma(core)
    weakest = cv2.erode(image, _QUAD) if image.ndim == 2 else np.minimum.reduce(cv2.split(image))
    bright = cv2.compare(smooth, 0.12 * cv2.minMaxLoc(smooth, blob)[1], cv2.CMP_GT)
    halo = cv2.bitwise_and(cv2.dilate(blob, _HALO), cv2.bitwise_and(bright, cv2.compare(weakest, _WHITE, cv2.CMP_LT)))
    if cv2.countNonZero(halo) < 6:
        return core
    _, level, floor = means_over(halo, image, background)
    if floor.min() < _GREY * floor.max():
        return core
    rise = np.maximum(level - _shade(cv2.bitwise_or(bright, blob), image, background) * floor, 0.0)
    if rise.max() < 4.0:
        return core
    rim = rise / rise.max()
    return rim if chroma(rim) > chroma(core) else core


def _shade(lit: np.ndarray, image: np.ndarray, background: np.ndarray) -> float:
    """What is left of the floor's light, 0 ... 1: in a person's shadow a white light would seem to rise unevenly."""
    beside = lit == 0
    if not beside.any():
        return 1.0
    now, before = (middle_of(picture[beside].ravel()) for picture in (image, background))
    return min(1.0, now / max(before, 1.0))


def middle_of(values: np.ndarray) -> float:
    """The upper median of values (N,): np.median also looks for NaN and takes the mean of two, in three times the time."""
    half = len(values) // 2
    return float(np.partition(values, half)[half])


def chroma(tint: np.ndarray) -> float:
    """How coloured a light is: 0 for white, 1 if a channel shows nothing of it."""
    return float(1.0 - tint.min() / max(tint.max(), 1e-6))


def _at_places(mask: np.ndarray) -> Tuple[np.ndarray, ...]:
    """A mask's pixels at each of the four places of a Bayer pattern."""
    height, width = mask.shape
    places = _places(-(-max(height, width) // 256) * 256)
    return tuple(cv2.bitwise_and(mask, place[:height, :width]) for place in places)


@lru_cache(maxsize=None)
def _places(size: int) -> Tuple[np.ndarray, ...]:
    """(size, size) uint8 masks of the four places, the first two rows' order."""
    masks = tuple(np.zeros((size, size), np.uint8) for _ in range(4))
    for number, mask in enumerate(masks):
        mask[number // 2 :: 2, number % 2 :: 2] = 255
    return masks
