"""Rigid transforms, robot poses and polygonal chains.

Transforms are 4x4 float64 matrices; `T_a_b` maps coordinates in frame b to frame a.
Quaternions are in ROS's order (x, y, z, w).
"""

from __future__ import annotations

import math
from typing import Tuple

import numpy as np

Pose = Tuple[float, float, float]  # (x, y, yaw) [m, m, rad], map frame


def wrap_angle(angle: float) -> float:
    """Returns the equivalent angle within (-pi, pi] [rad]."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


def rotation_from_quaternion(quaternion) -> np.ndarray:
    """Converts a quaternion (x, y, z, w) to a rotation matrix (3, 3). Inverse of `quaternion_from_rotation`.

    Raises:
        ValueError: if the quaternion is zero or not finite.
    """
    q = np.asarray(quaternion, dtype=float)
    norm = float(np.linalg.norm(q))
    if not np.isfinite(norm) or norm < 1e-9:
        raise ValueError(f"not a rotation: quaternion {quaternion}")
    x, y, z, w = q / norm
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_from_rotation(rotation: np.ndarray) -> np.ndarray:
    """Converts a rotation matrix (3, 3) to a quaternion (x, y, z, w), w >= 0. Inverse of `rotation_from_quaternion`."""
    m = np.asarray(rotation, dtype=float)
    # `products` is 4 q q^T. Each row is a multiple of q, and the row with the largest square gives q most exactly
    xx, yy, zz = np.diag(m)
    squares = [1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz, 1 + xx + yy + zz]
    products = np.zeros((4, 4))
    products[:3, :3] = m + m.T
    difference = m - m.T
    products[:3, 3] = difference[2, 1], difference[0, 2], difference[1, 0]
    products[3, :3] = products[:3, 3]
    np.fill_diagonal(products, squares)
    q = products[int(np.argmax(squares))]
    q = q / np.linalg.norm(q)
    return -q if q[3] < 0 else q


def yaw_from_quaternion(quaternion) -> float:
    """Returns the yaw about z [rad] of a quaternion (x, y, z, w). Inverse of `quaternion_from_yaw`."""
    x, y, z, w = quaternion
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def quaternion_from_yaw(yaw: float) -> np.ndarray:
    """Returns the quaternion (x, y, z, w) of a rotation about z [rad]. Inverse of `yaw_from_quaternion`."""
    return np.array([0.0, 0.0, math.sin(yaw / 2.0), math.cos(yaw / 2.0)])


def rotation_from_rpy(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Returns the matrix (3, 3) that rotates about the fixed axes x, then y, then z [rad], as in URDF and REP 103."""
    cr, sr = math.cos(roll), math.sin(roll)
    cp, sp = math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    rx = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    rz = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return rz @ ry @ rx


def make_transform(rotation: np.ndarray, translation) -> np.ndarray:
    """Makes a 4x4 transform from a rotation (3, 3) and a translation (3,) [m]."""
    result = np.eye(4)
    result[:3, :3] = rotation
    result[:3, 3] = translation
    return result


def invert_transform(T: np.ndarray) -> np.ndarray:
    """Inverts a rigid 4x4 transform."""
    rotation = T[:3, :3].T
    return make_transform(rotation, -rotation @ T[:3, 3])


def transform_points(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Applies a 4x4 transform to points (N, 3) or (3,) [m]. Returns them in the same shape."""
    points = np.asarray(points, dtype=float)
    return points @ T[:3, :3].T + T[:3, 3]


def transform_from_pose2d(x: float, y: float, yaw: float) -> np.ndarray:
    """Makes a 4x4 transform from a planar pose [m, m, rad]. Inverse of `pose2d_from_transform`."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1]], dtype=float)


def pose2d_from_transform(T: np.ndarray) -> Pose:
    """Returns the pose (x, y, yaw) [m, m, rad] of a planar transform. Inverse of `transform_from_pose2d`."""
    return float(T[0, 3]), float(T[1, 3]), math.atan2(T[1, 0], T[0, 0])


def map_to_base(points: np.ndarray, pose) -> np.ndarray:
    """Transforms map points (N, 2) [m] to the base frame of a robot at a pose. Inverse of `base_to_map`."""
    x, y, yaw = pose
    c, s = math.cos(yaw), math.sin(yaw)
    return (np.asarray(points, dtype=float).reshape(-1, 2) - (x, y)) @ np.array([[c, -s], [s, c]])


def base_to_map(points: np.ndarray, pose) -> np.ndarray:
    """Transforms base-frame points (N, 2) [m] of a robot at a pose to the map frame. Inverse of `map_to_base`."""
    x, y, yaw = pose
    c, s = math.cos(yaw), math.sin(yaw)
    return np.asarray(points, dtype=float).reshape(-1, 2) @ np.array([[c, s], [-s, c]]) + (x, y)


def pose_distance(a, b) -> float:
    """Returns the distance [m] between two poses. A rotation counts as the motion of a point 0.2 m from its axis."""
    return math.dist(a[:2], b[:2]) + 0.2 * abs(wrap_angle(a[2] - b[2]))


def optical_rotation() -> np.ndarray:
    """Returns the rotation (3, 3) from an optical frame (z forward, x right, y down) to a body frame (REP 103)."""
    return np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def arc_coordinates(points: np.ndarray, curvature: float) -> Tuple[np.ndarray, np.ndarray]:
    """Converts points (N, 2) [m] to coordinates along an arc.

    The arc starts at the origin in the direction of x and bends to the left by `curvature` [1/m].

    Returns:
        The points' distances along the arc, (N,) [m], and their distances to its left, (N,) [m].
    """
    x, y = points[:, 0], points[:, 1]
    if abs(curvature) < 1e-3:
        return x, y
    radius = 1.0 / curvature
    side = math.copysign(1.0, curvature)
    across = (abs(radius) - np.hypot(x, y - radius)) * side
    return np.arctan2(x, (radius - y) * side) * abs(radius), across


def arc_positions(pose: Pose, lengths: np.ndarray, curvature: float) -> np.ndarray:
    """Returns the positions (N, 2) [m] at signed lengths (N,) [m] along an arc of a curvature [1/m] from a pose."""
    if abs(curvature) < 1e-6:
        local_points = np.column_stack([lengths, np.zeros_like(lengths)])
    else:
        angle = lengths * curvature
        local_points = np.column_stack([np.sin(angle), 1.0 - np.cos(angle)]) / curvature
    return base_to_map(local_points, pose)


def chain_length(points: np.ndarray, closed: bool = False) -> float:
    """Returns the length [m] of a polygonal chain (N, 2), with its closing segment if it is closed."""
    points = np.asarray(points, dtype=float).reshape(-1, 2)
    if closed:
        points = np.vstack([points, points[:1]])
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def arc_lengths(points: np.ndarray) -> np.ndarray:
    """Returns the length (N,) [m] of a polygonal chain (N, 2) from its start to each of its points."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))


def bounding_diagonal(points: np.ndarray) -> float:
    """Returns the diagonal [m] of the smallest axis-parallel box round points (N, 2)."""
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def resample_chain(points: np.ndarray, spacing: float, closed: bool = False) -> np.ndarray:
    """Resamples a chain (N, 2) to points (M, 2) [m] at most `spacing` apart along it. Keeps its ends.

    A closed chain's closing segment is sampled too; its first point is not repeated.
    """
    points = np.asarray(points, dtype=float)
    if closed:
        points = np.vstack([points, points[:1]])
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    points = points[np.concatenate([[True], lengths > 0])]
    arc = arc_lengths(points)
    if arc[-1] == 0.0:
        return points[:1].copy()
    segments = max(1, int(math.ceil(arc[-1] / spacing - 1e-9)))
    positions = np.linspace(0.0, arc[-1], segments + 1)
    sampled = np.column_stack([np.interp(positions, arc, points[:, i]) for i in range(2)])
    return sampled[:-1] if closed else sampled


def look_ahead(path: np.ndarray, position, distance: float) -> Tuple[np.ndarray, float, float]:
    """Finds the point of a path (N, 2) [m] that is `distance` [m] ahead of the path point nearest to `position` (2,) [m].

    Returns:
        The point (2,) [m], or the path's end if the path is shorter; the distance [m] from `position` to the path; and the
        length [m] of the remaining path.
    """
    distances = np.linalg.norm(path - np.asarray(position), axis=1)
    nearest = int(np.argmin(distances))
    remainder = path[nearest:]
    along = arc_lengths(remainder)
    ahead = min(int(np.searchsorted(along, distance)), len(remainder) - 1)
    return remainder[ahead], float(distances[nearest]), float(along[-1])
