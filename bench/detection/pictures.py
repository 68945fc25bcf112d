#!/usr/bin/env python3
"""Draws the documentation's picture of a spot at two exposures, seen by a ceiling camera.

python3 bench/detection/pictures.py docs/images            exposure.jpg
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from bench.detection.rooms import Rooms, lab
from vb_core.image_format import PixelReader
from vb_laser_detect.detection.projection import pixels_of
from vb_sim.lab_history import Snapshot
from vb_sim.room.camera_models import CameraModels

SPOT = (4.25, 3.0)  # [m] on the wooden floor


def seen(exposure: float, laser=None):
    """Renders what the camera "green" sees at a multiple of the right exposure; returns (H, W, 3) bgr, and its view."""
    models = replace(CameraModels(), optics=replace(CameraModels().optics, exposure_gain=exposure))
    view = Rooms(1, models).view(lab(), "green")
    return PixelReader().read(view.frame(Snapshot(0.0, laser=laser)), view.encoding).bgr().copy(), view


def pixels(view, points) -> np.ndarray:
    """Returns where floor points (N, 2) [m] are seen, (N, 2) [px]."""
    return pixels_of(view.model, view.pose, np.column_stack([points, np.zeros(len(points))]))


def draw_exposures() -> np.ndarray:
    """Shows the spot at the right exposure and at twice that."""
    parts = []
    for exposure in (1.0, 2.0):
        image, view = seen(exposure, SPOT)
        u, v = np.rint(pixels(view, [SPOT])[0]).astype(int)
        parts.append(cv2.resize(image[v - 130 : v + 130, u - 260 : u + 260], None, fx=1.5, fy=1.5))
    return np.hstack(parts)


def main() -> int:
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        print(__doc__)
        return 2
    file = Path(sys.argv[1]) / "exposure.jpg"
    cv2.imwrite(str(file), draw_exposures(), [cv2.IMWRITE_JPEG_QUALITY, 85])
    print(file)
    return 0


if __name__ == "__main__":
    sys.exit(main())
