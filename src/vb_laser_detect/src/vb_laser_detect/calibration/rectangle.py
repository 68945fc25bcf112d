"""Estimates a camera's pose and focal length from the four corners of a rectangle of known size on the floor.

For a first try without a calibrated lens: the lens is assumed to be free of distortion, its axis through the middle of
the image. A rectangle determines the focal length only if it is seen at a slant (Zhang, 2000); otherwise a usual one is
assumed, and its value then hardly matters.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Tuple

import cv2
import numpy as np

from vb_core.camera_model import CameraModel, floor_points
from vb_core.errors import CodedError
from vb_laser_detect.calibration.pose import planar_poses, project

_CLICK_SIGMA = 1.0  # [px] how exactly a person marks a corner
_USUAL_FOCAL, _FOCAL_SIGMA = 0.75, 0.35  # of the image's width, and deviation of its logarithm: webcams and phones
_FOCALS = np.geomspace(0.3, 3.0, 48)
_MAX_ERROR = 0.02  # of the image's diagonal; with more, the corners are in another order, or of something else
_DRAWS = 16


class FloorView(NamedTuple):
    """A camera, and its pose (4, 4): the map's origin is the first corner, its x axis points to the second one."""

    camera: CameraModel
    T_map_camera: np.ndarray


def view_rectangle(pixels: np.ndarray, size: Tuple[float, float], image: Tuple[int, int]) -> FloorView:
    """Finds the camera that sees a rectangle's corners at these pixels.

    Args:
        pixels: (4, 2) [px] the corners, in order round the rectangle.
        size: [m] from the first corner to the second one, from the second to the third.
        image: its width and height [px].

    Raises:
        CodedError: "bad_rectangle" if they cannot be the corners of such a rectangle on the floor.
    """
    pixels = np.asarray(pixels, float).reshape(4, 2)
    hull = cv2.convexHull(pixels.astype(np.float32), returnPoints=False)
    turns = float(cv2.contourArea(pixels.astype(np.float32), oriented=True))
    if len(hull) != 4 or abs(turns) < 25.0 or min(size) <= 0.0:
        raise CodedError("bad_rectangle")
    # seen from above and going clockwise, the second side goes to the map's negative y
    width, depth = size[0], -math.copysign(size[1], turns)
    points = np.array([[0.0, 0.0], [width, 0.0], [width, depth], [0.0, depth]])
    found = [_view(pixels, points, image, factor * image[0]) for factor in _FOCALS]
    costs = [
        (error / _CLICK_SIGMA) ** 2 * 4 + (math.log(factor / _USUAL_FOCAL) / _FOCAL_SIGMA) ** 2
        for factor, (_, error) in zip(_FOCALS, found)
    ]
    view, error = found[int(np.argmin(costs))]
    if not error < _MAX_ERROR * math.hypot(*image):
        raise CodedError("bad_rectangle")
    return view


def _view(pixels: np.ndarray, points: np.ndarray, image: Tuple[int, int], focal: float) -> Tuple[FloorView, float]:
    """Returns the view from above the floor with this focal length [px], and the corners' rms error [px]."""
    camera = CameraModel.ideal(image[0], image[1], focal)
    best = (FloorView(camera, np.eye(4)), math.inf)
    for T in planar_poses(camera.rays(pixels), points):
        error = float(np.sqrt(np.mean(np.sum((project(camera, T, points) - pixels) ** 2, axis=1))))
        if T[2, 3] > 0.0 and error < best[1]:
            best = (FloorView(camera, T), error)
    return best


def uncertainty(pixels: np.ndarray, size: Tuple[float, float], image: Tuple[int, int], places: np.ndarray) -> float:
    """Returns the rms error [m] of a spot at the worst of `places` (N, 2) [px], as people click inexactly."""
    random = np.random.default_rng(1)
    drawn = []
    for _ in range(_DRAWS):
        moved = np.asarray(pixels, float) + random.normal(0.0, _CLICK_SIGMA, (4, 2))
        try:
            view = view_rectangle(moved, size, image)
        except CodedError:
            return math.inf
        drawn.append(floor_points(view.camera, view.T_map_camera, places)[:, :2])
    spread = np.array(drawn)
    with np.errstate(invalid="ignore"):
        return float(np.nanmax(np.sqrt(np.mean(np.sum((spread - np.nanmean(spread, axis=0)) ** 2, axis=2), axis=0))))
