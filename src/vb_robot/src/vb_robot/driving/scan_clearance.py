"""Computes how far and how fast a robot may drive, from its laser scan and the map of speed limits.

Floor is free only if a sensor or a map says so. A direction without a beam is not free, an echo nearer than the
scanner can measure is an obstacle, and floor that is not on a map is unknown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional

import numpy as np

from vb_core.geometry import Pose, arc_coordinates, base_to_map, map_to_base, transform_points, wrap_angle
from vb_core.grid_map import GridMap, crop
from vb_core.robot_profile import Limits

HORIZON = 0.8  # [m] checked length of the arc; a robot that brakes at 1.5 m/s^2 stops from 1 m/s within it
MIN_ARC_RADIUS = 0.3  # [m] on a narrower arc, a robot counts as driving straight
GAP_DEG = 4.0  # [deg] a gap in a scan up to this width hides nothing wider than a hand at arm's length
SELF_ECHO_MARGIN = 0.03  # [m] a scanner's error: an echo this little inside the rim may be an object at the rim
MAX_POSE_JUMP = 0.25  # [m] ten times AMCL's usual correction; a turn of 1 rad counts as 0.5 m


@dataclass(frozen=True)
class Clearance:
    """The clearance [m] that a source keeps from the scan's points ahead and at the sides, and from the map's cells."""

    ahead: float
    sides: float
    cells: float


def safe_speed(free: float, limits: Limits, delay: float) -> float:
    """Returns the highest speed [m/s] from which a robot stops within a free distance [m] after a delay [s]."""
    # v * delay + v^2 / (2 deceleration) = free
    b = limits.deceleration
    return b * (math.sqrt(delay**2 + 2.0 * max(free, 0.0) / b) - delay)


def stop_distance(v: float, limits: Limits, delay: float) -> float:
    """Returns the distance [m] that a robot needs to stop from a speed [m/s]; inverse of `safe_speed`."""
    return abs(v) * delay + v * v / (2.0 * limits.deceleration)


class Scan:
    """One scan in the robot's base frame: its echoes as points, and the bearings of its beams.

    Args:
        ranges: (N,) [m] as in sensor_msgs/LaserScan; nan is an invalid beam, inf one without an echo.
        angle_min, angle_increment: [rad]; range_min, range_max: [m].
        mount: T_base_scanner, 4x4.
        radius: [m] of the robot. Echoes more than SELF_ECHO_MARGIN within it come from the robot's own parts.
        no_return: what stands for no echo besides inf: "zero" or "nan". Otherwise, a range of 0 is an echo too near.
    """

    def __init__(
        self,
        ranges: np.ndarray,
        angle_min: float,
        angle_increment: float,
        range_min: float,
        range_max: float,
        mount: np.ndarray,
        radius: float,
        no_return: str = "inf",
    ) -> None:
        if no_return != "inf":
            has_no_echo = ranges == 0.0 if no_return == "zero" else np.isnan(ranges)
            ranges = np.where(has_no_echo, np.inf, ranges)
        angles = angle_min + angle_increment * np.arange(len(ranges))
        directions = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))])
        with np.errstate(invalid="ignore"):
            too_near = ranges < range_min
            valid = (ranges >= range_min) & (ranges <= range_max)
        origin = transform_points(mount, np.zeros(3))
        beams = (transform_points(mount, directions) - origin)[:, :2]
        points = origin[:2] + ranges[valid, None] * beams[valid]
        points = points[np.hypot(*points.T) > radius - SELF_ECHO_MARGIN]
        # an obstacle that is too near to be measured may touch the robot
        nearest = origin[:2] + np.maximum(ranges[too_near, None], 0.0) * beams[too_near]
        is_outside = np.hypot(*nearest.T)[:, None] > radius
        nearest = np.where(is_outside, nearest, radius * beams[too_near])
        self.points = np.vstack([points, nearest])
        x, y = beams[~np.isnan(ranges)].T
        self._bearings = np.arctan2(y, x)
        self._gap = max(math.radians(GAP_DEG), 3.0 * abs(angle_increment))

    def covers(self, bearing: float, half_angle: float) -> bool:
        """Returns whether beams, without wide gaps, cover all directions within `half_angle` [rad] of a bearing."""
        offsets = wrap_angle(self._bearings - bearing)
        offsets = np.sort(offsets[np.abs(offsets) <= half_angle + self._gap])
        reach = half_angle - self._gap
        covers_sides = len(offsets) and offsets[0] <= -reach and reach <= offsets[-1]
        return bool(covers_sides and (np.diff(offsets) <= self._gap).all())

    def free_distance(self, v: float, w: float, radius: float, clearance: Clearance) -> float:
        """Returns how far [m] the arc of (v, w) [m/s, rad/s] is clear of scan points, or inf if none is in the way."""
        curvature = w / v
        width = radius + clearance.sides
        checked_curvature = curvature if abs(curvature) <= 1.0 / MIN_ARC_RADIUS else 0.0
        along, across = arc_coordinates(self.points * [np.sign(v), 1.0], checked_curvature)
        in_the_way = (np.abs(across) < width) & (along > 0.0)
        if not in_the_way.any():
            return math.inf
        # the robot's front is round: an obstacle beside the centre line may come nearer
        front = np.sqrt(width**2 - across[in_the_way] ** 2)
        return float((along[in_the_way] - front).min() - clearance.ahead + clearance.sides)

    def sees_path(self, v: float, w: float, radius: float, stopping_distance: float) -> bool:
        """Returns whether beams cover the arc of (v, w) beyond the stopping distance [m]."""
        reach = max(MIN_ARC_RADIUS, radius + stopping_distance)
        half_turn = w / v * reach / 2.0
        bearing = min(max(half_turn, -math.pi / 2), math.pi / 2)
        if v < 0:
            bearing = math.pi - bearing
        return self.covers(bearing, math.atan2(radius, radius + HORIZON))


def lowest_speed_limit(limits: GridMap, position, reach: float) -> float:
    """Returns the lowest speed limit [m/s] within `reach` [m] of a position (2,) [m], or inf without a limit.

    Args:
        limits: the map that map_integrator publishes [cm/s]; 0 means no limit.
    """
    x, y = position
    reach += 2.0 * limits.resolution  # distances are to the cells' centres, not to their edges
    surroundings = crop(limits, (x - reach, y - reach, x + reach, y + reach))
    cells = np.argwhere(surroundings.data > 0)
    offsets = surroundings.cell_to_world(cells) - position
    cells = cells[np.hypot(*offsets.T) <= reach]
    if not len(cells):
        return math.inf
    return float(surroundings.data[tuple(cells.T)].min()) / 100.0


@dataclass(frozen=True)
class Fix:
    """A robot's pose (x, y, yaw) [m, m, rad] at time `stamp` [s], on the map and, if known, in odometry's frame."""

    stamp: float
    pose: Pose
    odometry: Optional[Pose] = None


def pose_jump(earlier: Fix, later: Fix) -> float:
    """Measures by how much [m] the pose changed beyond the odometry's change. A turn of 1 rad counts as 0.5 m.

    Without odometry, what counts is the change beyond what any robot may move in that time, at 1 m/s and 3 rad/s.
    """
    expected = earlier.pose
    elapsed = later.stamp - earlier.stamp
    if earlier.odometry is not None and later.odometry is not None:
        motion = map_to_base(later.odometry[:2], earlier.odometry)
        position = base_to_map(motion, earlier.pose)[0]
        expected = (*position, earlier.pose[2] + later.odometry[2] - earlier.odometry[2])
        elapsed = 0.0
    distance = max(0.0, math.dist(expected[:2], later.pose[:2]) - elapsed)
    rotation = abs(math.remainder(later.pose[2] - expected[2], 2.0 * math.pi))
    return distance + 0.5 * max(0.0, rotation - 3.0 * elapsed)


def arc_positions(pose: Pose, lengths: np.ndarray, curvature: float) -> np.ndarray:
    """Returns the positions (N, 2) [m] at signed lengths (N,) [m] along an arc of a curvature [1/m] from a pose."""
    lengths = np.asarray(lengths, dtype=float)
    if abs(curvature) < 1e-6:
        local_points = np.column_stack([lengths, np.zeros_like(lengths)])
    else:
        angle = lengths * curvature
        local_points = np.column_stack([np.sin(angle), 1.0 - np.cos(angle)]) / curvature
    return base_to_map(local_points, pose)
