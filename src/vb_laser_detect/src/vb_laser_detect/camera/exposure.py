"""Measures saturation, and finds an exposure time at which the floor is grey, so that only a spot is white."""

from __future__ import annotations

import math
from typing import Callable, Dict

import numpy as np

from vb_core.errors import CodedError

TOO_BRIGHT = 0.05  # saturated share of an image; no spot can be seen on saturated surfaces
_SATURATED = 250  # [grey levels]
_SPACING = 8  # [px] between the pixels that are read: the share is that of surfaces, not of points
SPOT_LEVEL = 245.0  # [grey levels] of a spot's core, at least
_FLOOR_LEVEL = 90.0  # [grey levels] median of all pixels: a spot rises far above it, and shadows are not black
_FLOOR_TOLERANCE = 10.0  # [grey levels]
_MAX_WHITE_SHARE = 0.005  # share of the image
_MIN_EXPOSURE, _MAX_EXPOSURE = 1, 2000  # [0.1 ms]; longer ones smear the spot and slow the camera down
_MAX_TRIALS = 12


def saturated_share(image: np.ndarray) -> float:
    """Returns the share of an image's (H, W) or (H, W, C) values that are saturated, or 0 for an empty one."""
    sample = image[::_SPACING, ::_SPACING]
    return float((sample >= _SATURATED).mean()) if sample.size else 0.0


def find_exposure(take_image: Callable[[int], np.ndarray], report: Callable[[str], None]) -> int:
    """Finds the exposure time [0.1 ms] by bisection, as a longer one always makes the image brighter.

    Where a window or a lamp is in view, it is the longest one that leaves hardly any of the image white.

    Args:
        take_image: sets an exposure time [0.1 ms], and returns an image (H, W, 3) taken with it.
        report: receives a sentence for each trial.

    Raises:
        CodedError: "too_bright" if even the shortest exposure time is too long; "too_dark" if the floor is nearly black
            with the longest one that is not; "exposure_ignored" if none changes the image.
    """
    low, high = math.log(_MIN_EXPOSURE), math.log(_MAX_EXPOSURE)
    medians: Dict[int, float] = {}  # [grey levels] of each exposure time
    longest = 0  # [0.1 ms] of those that are not too bright
    for _ in range(_MAX_TRIALS):
        exposure = max(1, round(math.exp((low + high) / 2.0)))
        image = take_image(exposure)
        median = float(np.median(image[::_SPACING, ::_SPACING]))
        white_share = saturated_share(image)
        medians[exposure] = median
        white = f"{100 * white_share:.1f} % of the image is white"
        report(f"{exposure / 10.0:g} ms: the floor is at {median:.0f} of 255, {white}")
        if white_share > _MAX_WHITE_SHARE or median > _FLOOR_LEVEL + _FLOOR_TOLERANCE:
            high = math.log(exposure)
        elif median >= _FLOOR_LEVEL - _FLOOR_TOLERANCE:
            return exposure
        else:
            low = math.log(exposure)
            longest = exposure
        if high - low < 0.02:
            break
    if max(medians.values()) - min(medians.values()) < 3.0:
        raise CodedError("exposure_ignored")
    if not longest:
        raise CodedError("too_bright")
    if medians[longest] < _FLOOR_LEVEL / 2.0:
        raise CodedError("too_dark")
    return longest
