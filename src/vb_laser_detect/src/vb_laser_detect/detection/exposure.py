"""Checks whether an image is too bright for a spot to show in it."""

from __future__ import annotations

import numpy as np

TOO_BRIGHT = 0.05  # share of an image that is saturated; no spot can be seen there
_SATURATED = 250  # [grey levels]
_STEP = 8  # [px] between the pixels that are read: the share is that of surfaces, not of points


def saturated_share(image: np.ndarray) -> float:
    """Returns the share of an image's (H, W) or (H, W, C) values that are saturated; 0 for an empty one."""
    sample = image[::_STEP, ::_STEP]
    return float((sample >= _SATURATED).mean()) if sample.size else 0.0
