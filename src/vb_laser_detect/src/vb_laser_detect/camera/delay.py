"""Measures how late a camera's images are: a light blinks at known times, and the images show it later."""

from __future__ import annotations

from typing import Sequence, Tuple

import cv2
import numpy as np

from vb_core.errors import CodedError

_GRID = (24, 14)  # columns and rows of the image's parts, at least one of which shows the light
_DELAYS = np.arange(-0.1, 3.0, 0.004)  # [s] that are tried
_MIN_CORRELATION = 0.75
_MIN_IMAGES = 50
_MIN_SWITCHES = 8


def brightness(gray: np.ndarray) -> np.ndarray:
    """Returns the mean brightness of each part of an image (H, W), as a vector."""
    return cv2.resize(gray, _GRID, interpolation=cv2.INTER_AREA).astype(np.float32).ravel()


def measure_delay(switch_times: Sequence[float], images: Sequence[Tuple[float, np.ndarray]]) -> Tuple[float, float]:
    """Returns the delay [s] at which some part of the images follows the light best, and its uncertainty [s].

    Args:
        switch_times: [s] when the light was switched, on first. They are irregular, so that no other delay fits as well.
        images: stamp [s] and `brightness` of each image.

    Raises:
        CodedError: "no_blinking" if no part of the images follows the light.
    """
    if len(images) < _MIN_IMAGES or len(switch_times) < _MIN_SWITCHES:
        raise CodedError("no_blinking")
    stamps = np.array([stamp for stamp, _ in images])
    levels = np.array([level for _, level in images], float)
    levels -= levels.mean(axis=0)
    norms = np.linalg.norm(levels, axis=0) + 1e-6
    # a camera is exposed for part of the time between two images, usually about half of it
    exposure_time = 0.5 * float(np.median(np.diff(stamps)))
    offsets = np.linspace(-0.5, 0.5, 5) * exposure_time
    correlations = np.zeros(len(_DELAYS))
    for number, delay in enumerate(_DELAYS):
        # it is lit after an odd number of switches
        light = np.mean([np.searchsorted(switch_times, stamps - delay + offset) % 2 for offset in offsets], axis=0)
        light -= light.mean()
        correlations[number] = (light @ levels / (norms * (np.linalg.norm(light) + 1e-6))).max()
    best = int(np.argmax(correlations))
    if correlations[best] < _MIN_CORRELATION or not 0 < best < len(correlations) - 1:
        raise CodedError("no_blinking")
    nearly_best = np.flatnonzero(correlations > correlations[best] - 0.01)
    delays = _DELAYS[nearly_best]
    weights = correlations[nearly_best] - correlations[best] + 0.011
    delay = np.sum(delays * weights) / np.sum(weights)
    uncertainty = np.ptp(delays) / 2.0 + 0.002
    return float(delay), float(uncertainty)
