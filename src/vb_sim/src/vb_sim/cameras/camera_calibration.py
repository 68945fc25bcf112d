"""The pose of a ceiling camera as its calibration found it, with the errors that a calibration leaves."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import least_squares

from vb_core import geometry
from vb_core.camera_model import CameraModel, floor_points, intersect_floor
from vb_core.errors import CodedError
from vb_sim.models import Optics, make_generator
from vb_sim.room.world import CeilingCamera

_RIM = 0.85  # share of the distance from the centre of the view to its rim, at which a person marks points
_MAX_DISTANCE = 8.0  # [m] a person would not choose a floor point farther from the camera


def calibrated_pose(camera: CeilingCamera, optics: Optics, seed: int) -> np.ndarray:
    """Estimates T_map_optical, 4x4: the pose that best fits points that a person measured in the map.

    Position and angles come out wrong by centimetres and tenths of a degree that compensate each other: the camera puts
    the floor where the person measured it, so that its points on the floor are more accurate than one measured point.
    """
    rng = make_generator(seed, f"calibration of {camera.name}")
    true = camera.pose()
    rays = camera.model().rays(_marked_places(camera.model(), true, optics.calibration_points, rng))

    def moved(x: np.ndarray) -> np.ndarray:
        return true @ geometry.transform(geometry.rotation_from_rpy(*x[:3]), x[3:])

    def on_floor(pose: np.ndarray) -> np.ndarray:
        points = intersect_floor(pose, rays)[:, :2]
        # rays of a trial pose may miss the floor
        return np.nan_to_num(points, nan=1e3)

    measured = on_floor(true) + rng.normal(0.0, optics.calibration_point_m, (len(rays), 2))
    return moved(least_squares(lambda x: (on_floor(moved(x)) - measured).ravel(), np.zeros(6), method="lm").x)


def _marked_places(model: CameraModel, pose: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Chooses points (count, 2) [px] all round, near the rim of the floor that the camera sees."""
    grid = np.stack(np.meshgrid(np.linspace(0.0, 1.0, 33), np.linspace(0.0, 1.0, 33)), axis=-1).reshape(-1, 2)
    size = np.array([model.width - 1.0, model.height - 1.0])
    seen = grid[_on_near_floor(model, pose, grid * size)]
    if not len(seen):
        raise CodedError("no_floor", "a ceiling camera sees no floor within reach: its pitch is too small")
    middle = seen.mean(axis=0)
    turns = math.pi / 4.0 + 2.0 * math.pi * (np.arange(count) + rng.uniform(-0.15, 0.15, count)) / count
    steps = np.linspace(0.0, 1.0, 101)
    places = []
    for turn in turns:
        ray = middle + math.sqrt(2.0) * steps[:, None] * (math.cos(turn), math.sin(turn))
        inside = ((ray >= 0.0) & (ray <= 1.0)).all(axis=1) & _on_near_floor(model, pose, ray * size)
        rim = steps[inside].max(initial=0.0)
        places.append(middle + math.sqrt(2.0) * _RIM * rim * np.array([math.cos(turn), math.sin(turn)]))
    return np.array(places) * size


def _on_near_floor(model: CameraModel, pose: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Returns (N,) bool: which pixels (N, 2) [px] look at the floor near the camera."""
    points = floor_points(model, pose, pixels)
    return np.linalg.norm(np.nan_to_num(points, nan=1e6) - pose[:3, 3], axis=1) < _MAX_DISTANCE
