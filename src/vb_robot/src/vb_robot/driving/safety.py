"""Computes how far and how fast a robot may drive, from what its scanner covers and sees, and the map of speed limits.

Floor is free only if a sensor or a map says so. A direction without a beam is not free, an echo nearer than the
scanner can measure is an obstacle, and floor without a map is unknown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional

import numpy as np

from vb_core import geometry
from vb_core.grid_layers import crop
from vb_core.grid_map import GridMap
from vb_core.geometry import Pose, to_base, to_map
from vb_core.robot_profile import Limits

HORIZON = 0.8  # [m] how far along its arc a robot is checked: from 1 m/s it stops within that at 1.5 m/s^2
MIN_ARC_RADIUS = 0.3  # [m] on arcs narrower than this a robot counts as driving straight on
GAP_DEG = 4.0  # [deg] gaps in a scan up to this hide nothing wider than a hand at arm's length
OWN_MARGIN = 0.03  # [m] a scanner's error: an echo this close inside the rim may be something that touches the robot
MAX_POSE_JUMP = 0.25  # [m] of the localisation: ten times what AMCL corrects; a turn of 1 rad counts as 0.5 m


@dataclass(frozen=True)
class Clearance:
    """The clearance [m] of a source of commands: ahead and to the sides from scan points, and from the map's cells."""

    ahead: float
    sides: float
    cells: float


def safe_speed(free: float, limits: Limits, delay: float) -> float:
    """Returns the highest speed [m/s] from which a robot stops within a free distance [m] after a delay [s]."""
    # v * delay + v^2 / (2 deceleration) = free
    b, free = limits.deceleration, max(free, 0.0)
    return b * (math.sqrt(delay**2 + 2.0 * free / b) - delay)


def stop_distance(v: float, limits: Limits, delay: float) -> float:
    """Returns the distance [m] that a robot needs to stop from a speed [m/s]; inverse of `safe_speed`."""
    return abs(v) * delay + v * v / (2.0 * limits.deceleration)


class Scan:
    """One scan in the robot's base frame: the points that it hit, and the bearings of its beams.

    Args:
        ranges: (N,) [m] as in sensor_msgs/LaserScan; nan is an invalid beam, inf one without an echo.
        angle_min, angle_increment: [rad]; range_min, range_max: [m].
        mount: T_base_scanner, 4x4.
        radius: [m] of the robot. Echoes more than OWN_MARGIN within it are the robot's own parts.
        no_return: the range that stands for no echo, besides inf: "zero" or "nan". Otherwise 0 is an echo too near to
            be measured, and nan an invalid beam.
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
            ranges = np.where(ranges == 0.0 if no_return == "zero" else np.isnan(ranges), np.inf, ranges)
        angles = angle_min + angle_increment * np.arange(len(ranges))
        units = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))])
        with np.errstate(invalid="ignore"):
            near = ranges < range_min
            hit = (ranges >= range_min) & (ranges <= range_max)
        origin = geometry.apply(mount, np.zeros(3))
        beams = (geometry.apply(mount, units) - origin)[:, :2]
        ends = origin[:2] + ranges[hit, None] * beams[hit]
        ends = ends[np.hypot(*ends.T) > radius - OWN_MARGIN]
        # too near to be measured: it may touch the robot
        close = origin[:2] + np.maximum(ranges[near, None], 0.0) * beams[near]
        close = np.where(np.hypot(*close.T)[:, None] > radius, close, radius * beams[near])
        self.points = np.vstack([ends, close])
        x, y = beams[~np.isnan(ranges)].T
        self._bearings = np.arctan2(y, x)
        self._gap = max(math.radians(GAP_DEG), 3.0 * abs(angle_increment))

    def covers(self, bearing: float, half: float) -> bool:
        """Returns whether beams cover all directions within `half` [rad] of a bearing [rad], without a wide gap."""
        off = geometry.wrap_angle(self._bearings - bearing)
        off = np.sort(off[np.abs(off) <= half + self._gap])
        if not len(off) or off[0] > -half + self._gap or off[-1] < half - self._gap:
            return False
        return bool((np.diff(off) <= self._gap).all())

    def free_distance(self, v: float, w: float, radius: float, clearance: Clearance) -> float:
        """Returns how far [m] the arc of (v, w) [m/s, rad/s] leads before it is too near to a point; inf: to none."""
        bend, width = w / v, radius + clearance.sides
        along, across = geometry.along_arc(
            self.points * [np.sign(v), 1.0], bend if abs(bend) <= 1.0 / MIN_ARC_RADIUS else 0.0
        )
        hit = (np.abs(across) < width) & (along > 0.0)
        if not hit.any():
            return math.inf
        # the front is round: off the centre line an obstacle may come nearer
        nose = np.sqrt(width**2 - across[hit] ** 2)
        return float((along[hit] - nose).min() - clearance.ahead + clearance.sides)

    def sees_path(self, v: float, w: float, radius: float, needed: float) -> bool:
        """Returns whether beams cover the arc of (v, w) beyond the stop distance `needed` [m]."""
        reach = max(MIN_ARC_RADIUS, radius + needed)
        turn = w / v * reach / 2.0
        bearing = min(max(turn, -math.pi / 2), math.pi / 2)
        if v < 0:
            bearing = math.pi - bearing
        return self.covers(bearing, math.atan2(radius, radius + HORIZON))


def limit_around(limits: GridMap, position, reach: float) -> float:
    """Returns the lowest speed limit [m/s] within `reach` [m] of a position (2,) [m]; inf if there is none.

    Args:
        limits: the map that map_integrator publishes [cm/s]; 0 means no limit.
    """
    x, y = position
    reach += 2.0 * limits.resolution  # distances are to the cells' centres, not to their edges
    near = crop(limits, (x - reach, y - reach, x + reach, y + reach))
    cells = np.argwhere(near.data > 0)
    cells = cells[np.hypot(*(near.cell_to_world(cells) - position).T) <= reach]
    return float(near.data[tuple(cells.T)].min()) / 100.0 if len(cells) else math.inf


@dataclass(frozen=True)
class Fix:
    """Where a robot was at a time [s]: (x, y, yaw) [m, m, rad] by its localisation and, if any, by its odometry."""

    stamp: float
    pose: Pose
    odometry: Optional[Pose] = None


def pose_jump(before: Fix, after: Fix) -> float:
    """Measures by how much [m] the pose changed beyond what the odometry tells; a turn of 1 rad counts as 0.5 m.

    Without odometry it is the change beyond what any robot can have driven since then (1 m/s, 3 rad/s).
    """
    expected, spare = before.pose, after.stamp - before.stamp
    if before.odometry is not None and after.odometry is not None:
        moved = to_map(to_base(after.odometry[:2], before.odometry), before.pose)[0]
        expected, spare = (*moved, before.pose[2] + after.odometry[2] - before.odometry[2]), 0.0
    off = max(0.0, math.dist(expected[:2], after.pose[:2]) - spare)
    turned = abs(math.remainder(after.pose[2] - expected[2], 2.0 * math.pi))
    return off + 0.5 * max(0.0, turned - 3.0 * spare)


def arc(pose: Pose, lengths: np.ndarray, curvature: float) -> np.ndarray:
    """Returns the positions (N, 2) [m] after signed lengths (N,) [m] along an arc of a curvature [1/m] from a pose."""
    lengths = np.asarray(lengths, dtype=float)
    if abs(curvature) < 1e-6:
        local = np.column_stack([lengths, np.zeros_like(lengths)])
    else:
        angle = lengths * curvature
        local = np.column_stack([np.sin(angle), 1.0 - np.cos(angle)]) / curvature
    return to_map(local, pose)
