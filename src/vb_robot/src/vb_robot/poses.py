"""Poses of a robot, and points in its base frame and in the map frame."""

from __future__ import annotations

import math
from typing import Tuple

import numpy as np

from vb_core import geometry

Pose = Tuple[float, float, float]  # (x, y, yaw) [m, m, rad], map frame


def to_base(points: np.ndarray, pose) -> np.ndarray:
    """Transforms map points (N, 2) [m] to the base frame of a robot at a pose; inverse of `to_map`."""
    x, y, yaw = pose
    c, s = math.cos(yaw), math.sin(yaw)
    return (np.asarray(points, dtype=float).reshape(-1, 2) - (x, y)) @ np.array([[c, -s], [s, c]])


def to_map(points: np.ndarray, pose) -> np.ndarray:
    """Transforms base-frame points (N, 2) [m] of a robot at a pose to the map frame; inverse of `to_base`."""
    x, y, yaw = pose
    c, s = math.cos(yaw), math.sin(yaw)
    return np.asarray(points, dtype=float).reshape(-1, 2) @ np.array([[c, s], [-s, c]]) + (x, y)


def pose_distance(a, b) -> float:
    """Measures the distance [m] between two poses; a turn counts as what a point 0.2 m off the axis moves."""
    return math.dist(a[:2], b[:2]) + 0.2 * abs(geometry.wrap_angle(a[2] - b[2]))
