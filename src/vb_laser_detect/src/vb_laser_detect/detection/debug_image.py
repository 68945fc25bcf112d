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
    for candidate in candidates:
        color, line = (_REJECTED, 1) if candidate.rejection else (_SPOT, 2)
        center = (int(round(candidate.u)), int(round(candidate.v)))
        radius = int(max(6, 0.5 * candidate.diameter + 4))
        cv2.circle(image, center, radius, color, line, cv2.LINE_AA)
        text = candidate.rejection or f"{candidate.confidence:.2f}"
        corner = (center[0] + radius + 3, center[1] + 4)
        cv2.putText(image, text, corner, cv2.FONT_HERSHEY_SIMPLEX, scale, color, 1, cv2.LINE_AA)
    return image
