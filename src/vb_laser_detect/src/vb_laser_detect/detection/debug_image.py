"""Draws what the detector saw."""

from __future__ import annotations

from typing import Iterable

import cv2
import numpy as np

from vb_core.image_format import Picture
from vb_laser_detect.detection.stage_results import Spot

_SPOT, _REJECTED = (0, 220, 0), (0, 140, 255)


def draw_candidates(picture: Picture, candidates: Iterable[Spot]) -> np.ndarray:
    """Draws a green ring round each spot, and the reason beside rejected ones, in a bgr copy (H, W, 3) of the image."""
    image = picture.bgr()
    scale = max(0.4, image.shape[0] / 1500.0)
    for c in candidates:
        color = _REJECTED if c.rejection else _SPOT
        center = (int(round(c.u)), int(round(c.v)))
        radius = int(max(6, 0.5 * c.diameter + 4))
        cv2.circle(image, center, radius, color, 1 if c.rejection else 2, cv2.LINE_AA)
        text = c.rejection or f"{c.confidence:.2f}"
        cv2.putText(
            image, text, (center[0] + radius + 3, center[1] + 4), cv2.FONT_HERSHEY_SIMPLEX, scale, color, 1, cv2.LINE_AA
        )
    return image
