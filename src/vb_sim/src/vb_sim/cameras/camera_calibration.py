"""Simulates the calibration of a ceiling camera's pose, with its errors."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import least_squares

from vb_core import geometry
from vb_core.camera_model import CameraModel, project_to_floor, intersect_floor
from vb_core.errors import CodedError
from vb_sim.model_params import Optics, make_generator
from vb_sim.world import CeilingCamera

_RIM = 0.85  # distance of marks from the centre of the view, as a share of the distance to its rim
_MAX_DISTANCE = 8.0  # [m] from the camera, beyond which a person would not mark a floor point


def calibrated_pose(camera: CeilingCamera, optics: Optics, seed: int) -> np.ndarray:
    """Estimates T_map_optical, 4x4, the pose that best fits floor points that a person measured in the map.

    Its position is wrong by centimetres and its angles by tenths of a degree, but on the floor these errors compensate
    each other. Therefore, floor points located with this pose are more accurate than a single measured point.
    """
    rng = make_generator(seed, f"calibration of {camera.name}")
    true = camera.pose()
    rays = camera.model().pixels_to_rays(_choose_marks(camera.model(), true, optics.calibration_points, rng))

    def displace(x: np.ndarray) -> np.ndarray:
        return true @ geometry.make_transform(geometry.rotation_from_rpy(*x[:3]), x[3:])

    def locate(pose: np.ndarray) -> np.ndarray:
        # rays of a trial pose may miss the floor
        return np.nan_to_num(intersect_floor(pose, rays)[:, :2], nan=1e3)

    measured = locate(true) + rng.normal(0.0, optics.calibration_point_m, (len(rays), 2))

    def residuals(x: np.ndarray) -> np.ndarray:
        return (locate(displace(x)) - measured).ravel()

    return displace(least_squares(residuals, np.zeros(6), method="lm").x)


def _choose_marks(model: CameraModel, pose: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Chooses points (count, 2) [px] near the rim of the floor that the camera sees, in all directions."""
    # positions in the image as shares of its size
    shares = np.linspace(0.0, 1.0, 33)
    grid = np.stack(np.meshgrid(shares, shares), axis=-1).reshape(-1, 2)
    size = np.array([model.width - 1.0, model.height - 1.0])
    visible = grid[_on_near_floor(model, pose, grid * size)]
    if not len(visible):
        raise CodedError("no_floor", "a ceiling camera sees no floor within reach: its pitch is too small")
    center = visible.mean(axis=0)
    turns = np.arange(count) + rng.uniform(-0.15, 0.15, count)
    bearings = math.pi / 4.0 + 2.0 * math.pi * turns / count
    steps = np.linspace(0.0, 1.0, 101)
    marks = []
    for bearing in bearings:
        direction = np.array([math.cos(bearing), math.sin(bearing)])
        points = center + math.sqrt(2.0) * steps[:, None] * direction
        is_in_image = ((points >= 0.0) & (points <= 1.0)).all(axis=1)
        is_visible = is_in_image & _on_near_floor(model, pose, points * size)
        rim = steps[is_visible].max(initial=0.0)
        marks.append(center + math.sqrt(2.0) * _RIM * rim * direction)
    return np.array(marks) * size


def _on_near_floor(model: CameraModel, pose: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Returns (N,) bool: whether each pixel (N, 2) [px] shows floor near the camera."""
    points = project_to_floor(model, pose, pixels)
    return np.linalg.norm(np.nan_to_num(points, nan=1e6) - pose[:3, 3], axis=1) < _MAX_DISTANCE
