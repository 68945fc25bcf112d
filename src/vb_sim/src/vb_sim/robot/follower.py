"""Follows a path with a differential drive: pure pursuit, turning on the spot where the path demands it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Tuple

import numpy as np

from vb_core import geometry
from vb_core.parameters import Parameters, param

Pose = Tuple[float, float, float]


@dataclass(frozen=True)
class FollowerParams(Parameters):
    """Limits and gains of path following."""

    max_speed: float = param(0.5, "m/s", above=0.0, high=2.0)
    max_turn_rate: float = param(1.2, "rad/s", above=0.0, high=5.0)
    acceleration: float = param(0.6, "m/s^2", above=0.0)
    deceleration: float = param(0.5, "m/s^2", above=0.0)
    lookahead: float = param(0.35, "m", above=0.05, high=2.0)
    turn_on_spot_above: float = param(0.8, "rad", above=0.0, high=3.2)
    drive_again_below: float = param(0.3, "rad", above=0.0, high=3.2)
    turn_gain: float = param(2.5, "1/s", above=0.0)
    goal_distance: float = param(0.06, "m", above=0.0, high=1.0)
    goal_angle: float = param(0.08, "rad", above=0.0, high=3.2)
    robot_radius: float = param(0.18, "m", above=0.0, high=2.0)
    obstacle_margin: float = param(0.03, "m", low=0.0, high=1.0)


@dataclass(frozen=True)
class Motion:
    """The command for now.

    Attributes:
        speed, turn_rate: [m/s, rad/s] to be sent as cmd_vel.
        arrived: the goal is reached.
        blocked: something blocks the path.
        off_path: [m] distance from the path.
    """

    speed: float = 0.0
    turn_rate: float = 0.0
    arrived: bool = False
    blocked: bool = False
    off_path: float = 0.0


class Follower:
    """Follows one path at a time; what it remembers of a goal outlives a new path to the same goal."""

    def __init__(self, params: FollowerParams = FollowerParams()) -> None:
        self._params = params
        self._path = np.zeros((0, 2))
        self._arc = np.zeros(0)
        self._goal: Optional[Pose] = None
        self._turning = False
        self._at_goal = False
        self._speed = 0.0

    def set_goal(self, goal: Pose) -> None:
        """Begins a new goal (x, y, yaw) [m, m, rad]."""
        self._goal = goal
        self._path = np.zeros((0, 2))
        self._turning = self._at_goal = False

    def set_path(self, path: np.ndarray) -> None:
        """Sets the path (N, 2) [m], N >= 1, from about where the robot is to the goal."""
        self._path = np.asarray(path, dtype=float)
        self._arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self._path, axis=0), axis=1))])

    def remaining(self, pose: Pose) -> np.ndarray:
        """Returns the rest (M, 2) [m] of the path."""
        return self._path[self._nearest(pose) :] if len(self._path) else self._path

    def halt(self) -> None:
        """Records that another node stopped the robot."""
        self._speed = 0.0

    def step(self, pose: Pose, obstacles: np.ndarray, dt: float) -> Motion:
        """Decides how to move now.

        Args:
            pose: (x, y, yaw) [m, m, rad], map frame.
            obstacles: (N, 2) [m] what the scanner sees, robot's frame.
            dt: [s] since the last step.
        """
        p = self._params
        if self._goal is None or not len(self._path):
            self._speed = 0.0
            return Motion()
        end = self._path[-1]
        to_end = math.hypot(end[0] - pose[0], end[1] - pose[1])
        # once there it stays there: turning on the spot shifts the estimate by a centimetre or so
        self._at_goal = to_end < (3.0 if self._at_goal else 1.0) * p.goal_distance
        if self._at_goal:
            return self._turn_at_goal(pose)
        nearest = self._nearest(pose)
        off_path = float(np.linalg.norm(self._path[nearest] - pose[:2]))
        ahead = int(np.searchsorted(self._arc, self._arc[nearest] + p.lookahead))
        target = self._path[min(ahead, len(self._path) - 1)]
        error = geometry.wrap_angle(math.atan2(target[1] - pose[1], target[0] - pose[0]) - pose[2])
        self._turning = abs(error) > (p.drive_again_below if self._turning else p.turn_on_spot_above)
        if self._turning:
            self._speed = 0.0
            return Motion(0.0, self._turn(error), off_path=off_path)
        remaining = float(self._arc[-1] - self._arc[nearest])
        distance = max(math.hypot(target[0] - pose[0], target[1] - pose[1]), 1e-3)
        curvature = 2.0 * math.sin(error) / distance
        speed = min(
            p.max_speed, self._speed + p.acceleration * dt, math.sqrt(2.0 * p.deceleration * max(remaining, 0.01))
        )
        if abs(curvature) > 1e-6:
            speed = min(speed, p.max_turn_rate / abs(curvature))
        gap = self._gap(obstacles, curvature)
        safe = math.sqrt(2.0 * p.deceleration * gap) if gap > 0.0 else 0.0
        blocked = safe < 0.02
        if blocked:
            self._speed = 0.0
            # turning on the spot is safe for a round robot, and may free the path
            return Motion(0.0, self._turn(error) if abs(error) > 0.1 else 0.0, blocked=True, off_path=off_path)
        self._speed = max(min(speed, safe), 0.03)
        return Motion(self._speed, self._speed * curvature, off_path=off_path)

    def _turn_at_goal(self, pose: Pose) -> Motion:
        self._speed = 0.0
        assert self._goal is not None
        error = geometry.wrap_angle(self._goal[2] - pose[2])
        if abs(error) < self._params.goal_angle:
            return Motion(arrived=True)
        return Motion(0.0, self._turn(error))

    def _turn(self, error: float) -> float:
        p = self._params
        rate = max(min(p.turn_gain * error, p.max_turn_rate), -p.max_turn_rate)
        # below this a real base does not turn at all
        return math.copysign(max(abs(rate), 0.15), error)

    def _nearest(self, pose: Pose) -> int:
        return int(np.argmin(np.linalg.norm(self._path - np.array(pose[:2]), axis=1)))

    def _gap(self, obstacles: np.ndarray, curvature: float) -> float:
        """Returns the free distance [m] along the arc before the robot's body reaches the margin; inf if free."""
        p = self._params
        if not len(obstacles):
            return math.inf
        width = p.robot_radius + p.obstacle_margin
        along, across = geometry.along_arc(obstacles, curvature)
        reach = 1.5
        ahead = (along > 0.0) & (along < reach) & (np.abs(across) < width)
        if not ahead.any():
            return math.inf
        # where a disc of that radius first touches the point
        return float((along[ahead] - np.sqrt(np.maximum(width**2 - across[ahead] ** 2, 0.0))).min())
