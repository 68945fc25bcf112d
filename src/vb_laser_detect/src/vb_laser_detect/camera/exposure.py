"""Measures saturation, and finds an exposure time at which the floor is grey, so that only a spot is white."""

from __future__ import annotations

import math
from typing import Callable, List, NamedTuple

import numpy as np

from vb_core.errors import CodedError

TOO_BRIGHT = 0.05  # saturated share of an image; no spot can be seen on saturated surfaces
_SATURATED = 250  # [grey levels]
_STEP = 8  # [px] between the pixels that are read: the share is that of surfaces, not of points
FLOOR = 90.0  # [grey levels] wanted median of all pixels: a spot rises far above it, and shadows are not black
_MIN_EXPOSURE, _MAX_EXPOSURE = 1, 2000  # [0.1 ms]; longer ones smear the spot and slow the camera down
_NEAR = 10.0  # [grey levels] tolerated difference from FLOOR
_STEPS = 12
_WHITE_SHARE = 0.005  # share of the image that may be white
WHITE = 245.0  # [grey levels] a spot's core has at least


def saturated_share(image: np.ndarray) -> float:
    """Returns the share of an image's (H, W) or (H, W, C) values that are saturated; 0 for an empty one."""
    sample = image[::_STEP, ::_STEP]
    return float((sample >= _SATURATED).mean()) if sample.size else 0.0


class Brightness(NamedTuple):
    """The median grey level of an image, and the share of it that is white."""

    middle: float
    white: float


def measure_brightness(image: np.ndarray) -> Brightness:
    """Measures an image (H, W, 3) or (H, W) uint8."""
    return Brightness(float(np.median(image[::_STEP, ::_STEP])), saturated_share(image))


def find_exposure(try_exposure: Callable[[int], Brightness], tell: Callable[[str], None] = lambda text: None) -> int:
    """Finds the exposure time [0.1 ms] by bisection; a longer one only makes the image brighter.

    Args:
        try_exposure: sets an exposure time and measures an image.
        tell: called with a sentence for each step.

    Raises:
        CodedError: "too_dark", "too_bright" if no exposure time is right; "exposure_ignored" if none changes the image.
    """
    low, high = math.log(_MIN_EXPOSURE), math.log(_MAX_EXPOSURE)
    seen: List[float] = []
    for _ in range(_STEPS):
        exposure = max(1, round(math.exp((low + high) / 2.0)))
        look = try_exposure(exposure)
        seen.append(look.middle)
        tell(
            f"{exposure / 10.0:g} ms: the floor is at {look.middle:.0f} of 255, {100 * look.white:.1f} % of the image is white"
        )
        dark_enough = look.white <= _WHITE_SHARE
        if abs(look.middle - FLOOR) <= _NEAR and dark_enough:
            return exposure
        if look.middle > FLOOR or not dark_enough:
            high = math.log(exposure)
        else:
            low = math.log(exposure)
        if high - low < 0.02:
            break
    if max(seen) - min(seen) < 3.0:
        raise CodedError("exposure_ignored")
    if seen[-1] > FLOOR + _NEAR:
        raise CodedError("too_bright")
    if seen[-1] < FLOOR / 2.0 and look.white <= _WHITE_SHARE:
        raise CodedError("too_dark")
    return exposure  # a window or a lamp rules out a longer one
