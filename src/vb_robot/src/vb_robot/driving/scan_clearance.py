"""Computes from a laser scan how far a robot may drive, and from that distance how fast.

Floor is free only if the scan says so: a direction without a beam is not free, and an echo nearer than the scanner can
measure is an obstacle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from vb_core.geometry import arc_coordinates, transform_points, wrap_angle
from vb_core.robot_profile import Limits

HORIZON = 0.8  # [m] checked length of the arc; a robot that brakes at 1.5 m/s^2 stops from 1 m/s within it
MIN_ARC_RADIUS = 0.3  # [m] on a narrower arc, a robot counts as driving straight
GAP_DEG = 4.0  # [deg] a gap in a scan up to this width hides nothing wider than a hand at arm's length
SELF_ECHO_MARGIN = 0.03  # [m] a scanner's error: an echo this little inside the rim may be an object at the rim


class RequiredGaps(NamedTuple):
    """The gaps [m] that a source must leave to the scan's points ahead and at the sides, and to the map's cells."""

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

    def free_distance(self, v: float, w: float, radius: float, gaps: RequiredGaps) -> float:
        """Returns how far [m] the arc of (v, w) [m/s, rad/s] is clear of scan points, or inf if none is in the way."""
        curvature = w / v
        width = radius + gaps.sides
        checked_curvature = curvature if abs(curvature) <= 1.0 / MIN_ARC_RADIUS else 0.0
        along, across = arc_coordinates(self.points * [np.sign(v), 1.0], checked_curvature)
        in_the_way = (np.abs(across) < width) & (along > 0.0)
        if not in_the_way.any():
            return math.inf
        # the robot's front is round: an obstacle beside the centre line may come nearer
        front = np.sqrt(width**2 - across[in_the_way] ** 2)
        return float((along[in_the_way] - front).min() - gaps.ahead + gaps.sides)

    def sees_path(self, v: float, w: float, radius: float, stopping_distance: float) -> bool:
        """Returns whether beams cover the arc of (v, w) beyond the stopping distance [m]."""
        reach = max(MIN_ARC_RADIUS, radius + stopping_distance)
        half_turn = w / v * reach / 2.0
        bearing = min(max(half_turn, -math.pi / 2), math.pi / 2)
        if v < 0:
            bearing = math.pi - bearing
        return self.covers(bearing, math.atan2(radius, radius + HORIZON))
