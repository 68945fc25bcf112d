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


def look_ahead(path: np.ndarray, place, distance: float) -> Tuple[np.ndarray, float, float]:
    """Finds the point of a path (N, 2) [m] that lies a distance [m] ahead of the point nearest to a place (2,) [m].

    Returns:
        The point (2,) [m], the path's end if that is nearer; how far [m] the place is from the path; and how long [m] the
        rest of the path is.
    """
    distances = np.linalg.norm(path - np.asarray(place), axis=1)
    nearest = int(np.argmin(distances))
    rest = path[nearest:]
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(rest, axis=0), axis=1))])
    return rest[min(int(np.searchsorted(along, distance)), len(rest) - 1)], float(distances[nearest]), float(along[-1])
