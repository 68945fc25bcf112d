"""Measures how late a camera's images are: a light blinks at known times, and the images show it later."""

from __future__ import annotations

from typing import Sequence, Tuple

import cv2
import numpy as np

from vb_core.errors import CodedError

_GRID = (24, 14)  # parts of the image, at least one of which shows the light
_LAGS = np.arange(-0.1, 3.0, 0.004)  # [s]
_MIN_CORRELATION = 0.75
_MIN_IMAGES = 50
_EDGE = 1e-3  # [s] between the light's two states


def brightness(gray: np.ndarray) -> np.ndarray:
    """Returns the mean brightness of each part of an image (H, W), as a vector."""
    return cv2.resize(gray, _GRID, interpolation=cv2.INTER_AREA).astype(np.float32).ravel()


def measure_delay(switched: Sequence[float], seen: Sequence[Tuple[float, np.ndarray]]) -> Tuple[float, float]:
    """Returns the delay [s] at which some part of the images follows the light best, and its uncertainty [s].

    Args:
        switched: [s] when the light was switched, on first; irregularly, so that no other delay fits as well.
        seen: stamp [s] and `brightness` of each image.

    Raises:
        CodedError: "no_blinking" if no part of the images follows the light.
    """
    if len(seen) < _MIN_IMAGES or len(switched) < 8:
        raise CodedError("no_blinking")
    stamps = np.array([stamp for stamp, _ in seen])
    values = np.array([value for _, value in seen], float)
    values -= values.mean(axis=0)
    norms = np.linalg.norm(values, axis=0) + 1e-6
    # a camera is exposed for part of the time between two images, usually about half of it
    gathering = 0.5 * float(np.median(np.diff(stamps)))
    times = np.repeat(np.array(switched, float), 2) + np.tile([-_EDGE, _EDGE], len(switched))
    states = np.tile([0.0, 1.0, 1.0, 0.0], len(switched) // 2 + 1)[: len(times)]
    scores = np.zeros(len(_LAGS))
    for number, lag in enumerate(_LAGS):
        offsets = np.linspace(-0.5, 0.5, 5) * gathering
        light = np.mean([np.interp(stamps - lag + offset, times, states) for offset in offsets], axis=0)
        light -= light.mean()
        scores[number] = (light @ values / (norms * (np.linalg.norm(light) + 1e-6))).max()
    best = int(np.argmax(scores))
    if scores[best] < _MIN_CORRELATION or not 0 < best < len(scores) - 1:
        raise CodedError("no_blinking")
    near = np.flatnonzero(scores > scores[best] - 0.01)
    weights = scores[near] - scores[best] + 0.011
    return float(np.sum(_LAGS[near] * weights) / np.sum(weights)), float(np.ptp(_LAGS[near]) / 2.0 + 0.002)
