"""How far the robot may still drive: free way by laser scan and by the map with its borders."""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vb_core.grid_map import GridMap
from vb_core.parameters import Parameters, param
from vb_robot.terrain import clearance_grid, sample
from vb_robot.view import to_map
from vb_robot.viewpoint import Pose


@dataclass(frozen=True)
class SafetyParams(Parameters):
    """Size of the robot and how soon it stands."""

    robot_radius: float = param(0.18, "m", above=0.0, high=2.0)
    scan_margin: float = param(0.12, "m", low=0.0, high=1.0, doc="kept from what the scanner sees ahead")
    side_margin: float = param(0.04, "m", low=0.0, high=1.0, doc="beyond the radius to the sides")
    map_margin: float = param(0.05, "m", low=0.0, high=1.0, doc="kept from cells of the map that are occupied")
    map_threshold: int = param(99, "%", low=1, high=100, doc="cells of this occupancy and above are never entered")
    brake: float = param(1.5, "m/s^2", above=0.0, high=10.0, doc="when it must stop")
    reaction: float = param(0.15, "s", low=0.0, high=2.0, doc="until a command takes effect, with the scan's age")
    horizon: float = param(0.8, "m", above=0.0, high=5.0, doc="how far the way is looked at")
    pose_jump: float = param(0.25, "m", above=0.0, doc="a leap of the localisation; a turn of 1 rad counts as 0.5 m")
    pose_doubt: float = param(1.0, "s", low=0.0, high=10.0, doc="after a leap the robot only turns for so long")


def safe_speed(free: float, params: SafetyParams) -> float:
    """The largest speed [m/s] from which the robot stands within a free way [m], reaction time included."""
    if free <= 0.0:
        return 0.0
    # v * reaction + v^2 / (2 brake) = free
    b = params.brake
    return b * (math.sqrt(params.reaction ** 2 + 2.0 * free / b) - params.reaction)


def free_by_scan(points: np.ndarray, forward: bool, params: SafetyParams) -> float:
    """[m] the robot can drive straight on (or back) before it comes within the margin of a scanned point.

    Args:
        points: (N, 2) [m] in the base frame.
    """
    points = np.asarray(points, dtype=float).reshape(-1, 2)
    along = points[:, 0] if forward else -points[:, 0]
    half = params.robot_radius + params.side_margin
    # what lies within the robot is a part of it that the scanner sees
    outside = np.hypot(points[:, 0], points[:, 1]) > 0.5 * params.robot_radius
    inside = (np.abs(points[:, 1]) < half) & (along > 0.0) & outside
    if not inside.any():
        return math.inf
    # the front is round: at the side of the corridor an obstacle may be nearer
    nose = np.sqrt(half ** 2 - points[inside, 1] ** 2)
    return float(np.maximum(along[inside] - nose, 0.0).min() - params.scan_margin + params.side_margin)


def scan_points(
    ranges: np.ndarray, angle_min: float, angle_increment: float, range_min: float, range_max: float
) -> np.ndarray:
    """(M, 2) [m] end points of a scan's valid beams in the scanner's frame."""
    ranges = np.asarray(ranges, dtype=float)
    with np.errstate(invalid="ignore"):
        valid = np.isfinite(ranges) & (ranges >= range_min) & (ranges <= range_max)
    angles = angle_min + angle_increment * np.flatnonzero(valid)
    return ranges[valid][:, None] * np.column_stack([np.cos(angles), np.sin(angles)])


class ForbiddenGround:
    """The cells of the posterior map that the footprint never enters."""

    def __init__(self, grid: GridMap, params: SafetyParams) -> None:
        self._grid = grid
        self._params = params
        # the map's edge is nothing to fear: the map ends there, the floor may go on
        self._clearance = clearance_grid(grid.data >= params.map_threshold, grid.resolution, edge=False)

    def clearance_at(self, points: np.ndarray) -> np.ndarray:
        """(N,) [m] from points (N, 2) to the next forbidden cell; 0 off the map."""
        return sample(self._grid, self._clearance, points)

    def free_way(self, pose: Pose, v: float, w: float) -> float:
        """[m] the robot can drive along the arc of (v, w) [m/s, rad/s] before its footprint comes too near.

        A robot that is too near already may move so that it does not come nearer; one that a new border has
        swallowed may move within it, so that a person can lead it out.
        """
        params = self._params
        steps = np.arange(0.0, params.horizon + 1e-9, 0.02)
        places = arc(pose, steps * math.copysign(1.0, v), w / v if abs(v) > 1e-6 else 0.0)
        clearance = self.clearance_at(places)
        needed = min(params.robot_radius + params.map_margin, float(clearance[0]))
        bad = np.flatnonzero(clearance < needed - 1e-6)
        if not len(bad):
            return math.inf
        return float(max(0.0, steps[bad[0]] - 0.02))


def leap(before: Pose, after: Pose, seconds: float) -> float:
    """[m] by which a pose changed beyond what a robot can drive (1 m/s, 3 rad/s); a turn of 1 rad counts as 0.5 m."""
    moved = max(0.0, math.dist(before[:2], after[:2]) - 1.0 * seconds)
    turned = max(0.0, abs(math.remainder(after[2] - before[2], 2.0 * math.pi)) - 3.0 * seconds)
    return moved + 0.5 * turned


def arc(pose: Pose, lengths: np.ndarray, curvature: float) -> np.ndarray:
    """(N, 2) [m] places after driving signed lengths (N,) [m] along an arc of a curvature [1/m] from a pose."""
    lengths = np.asarray(lengths, dtype=float)
    if abs(curvature) < 1e-6:
        local = np.column_stack([lengths, np.zeros_like(lengths)])
    else:
        angle = lengths * curvature
        local = np.column_stack([np.sin(angle), 1.0 - np.cos(angle)]) / curvature
    return to_map(local, pose)

