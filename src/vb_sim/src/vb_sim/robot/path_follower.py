"""Follows a path with a differential drive: pure pursuit, turning on the spot where the path demands it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional

import numpy as np

from vb_core import geometry
from vb_core.geometry import Pose, look_ahead

ACCELERATION, DECELERATION = 0.6, 0.5  # [m/s^2] the latter towards the goal and obstacles
MAX_TURN_RATE = 1.2  # [rad/s]
_LOOKAHEAD = 0.35  # [m] of pure pursuit
# [rad] heading errors at which the robot turns on the spot, and at which it drives again
_TURN_ON_SPOT_ABOVE, _DRIVE_AGAIN_BELOW = 0.8, 0.3
_TURN_GAIN = 2.5  # [1/s] turn rate per heading error
GOAL_DISTANCE, GOAL_ANGLE = 0.06, 0.08  # [m], [rad] within which the goal is reached
_SEES = 1.5  # [m] along the robot's arc, up to which obstacles count
_OBSTACLE_MARGIN = 0.03  # [m] clearance kept from what the scanner sees ahead


@dataclass(frozen=True)
class Motion:
    """The command of a step, and the state of the drive.

    Attributes:
        speed, turn_rate: [m/s, rad/s] to be sent as cmd_vel.
        arrived: the goal is reached.
        blocked: something blocks the path.
        off_path: [m] distance from the path.
        path: (N, 2) [m] the path planned since the last step, if there is one.
    """

    speed: float = 0.0
    turn_rate: float = 0.0
    arrived: bool = False
    blocked: bool = False
    off_path: float = 0.0
    path: Optional[np.ndarray] = None


class Follower:
    """Follows one path at a time; its state for a goal outlasts a new path to the same goal.

    Args:
        radius: [m] of the robot.
        max_speed, max_turn_rate: [m/s], [rad/s] its limits.
    """

    def __init__(self, radius: float = 0.18, max_speed: float = 0.5, max_turn_rate: float = MAX_TURN_RATE) -> None:
        self._radius, self._max_speed = radius, max_speed
        self._max_turn_rate = min(max_turn_rate, MAX_TURN_RATE)
        self._path = np.zeros((0, 2))
        self._goal: Optional[Pose] = None
        self._turning = False
        self._at_goal = False
        self._speed = 0.0

    def set_goal(self, goal: Pose) -> None:
        """Sets a new goal (x, y, yaw) [m, m, rad]."""
        self._goal = goal
        self._path = np.zeros((0, 2))
        self._turning = self._at_goal = False

    def set_path(self, path: np.ndarray) -> None:
        """Sets the path (N, 2) [m], N >= 1, from about where the robot is to the goal."""
        self._path = np.asarray(path, dtype=float)

    def halt(self) -> None:
        """Records that another node stopped the robot."""
        self._speed = 0.0

    def step(self, pose: Pose, obstacles: np.ndarray, dt: float) -> Motion:
        """Decides how to move now.

        Args:
            pose: (x, y, yaw) [m, m, rad], map frame.
            obstacles: (N, 2) [m] points that the scanner sees, robot's frame.
            dt: [s] since the last step.
        """
        if self._goal is None or not len(self._path):
            self._speed = 0.0
            return Motion()
        end = self._path[-1]
        to_end = math.hypot(end[0] - pose[0], end[1] - pose[1])
        # hysteresis, as turning on the spot shifts the estimated position by a centimetre or so
        self._at_goal = to_end < (3.0 if self._at_goal else 1.0) * GOAL_DISTANCE
        if self._at_goal:
            self._speed = 0.0
            error = geometry.wrap_angle(self._goal[2] - pose[2])
            return Motion(arrived=True) if abs(error) < GOAL_ANGLE else Motion(0.0, self._turn(error))
        target, off_path, remaining = look_ahead(self._path, pose[:2], _LOOKAHEAD)
        error = geometry.wrap_angle(math.atan2(target[1] - pose[1], target[0] - pose[0]) - pose[2])
        self._turning = abs(error) > (_DRIVE_AGAIN_BELOW if self._turning else _TURN_ON_SPOT_ABOVE)
        if self._turning:
            self._speed = 0.0
            return Motion(0.0, self._turn(error), off_path=off_path)
        distance = max(math.hypot(target[0] - pose[0], target[1] - pose[1]), 1e-3)
        curvature = 2.0 * math.sin(error) / distance
        speed = min(
            self._max_speed, self._speed + ACCELERATION * dt, math.sqrt(2.0 * DECELERATION * max(remaining, 0.01))
        )
        if abs(curvature) > 1e-6:
            speed = min(speed, self._max_turn_rate / abs(curvature))
        gap = self._gap(obstacles, curvature)
        safe = math.sqrt(2.0 * DECELERATION * gap) if gap > 0.0 else 0.0
        if safe < 0.02:
            self._speed = 0.0
            # turning on the spot is safe for a round robot, and may free the path
            return Motion(0.0, self._turn(error) if abs(error) > 0.1 else 0.0, blocked=True, off_path=off_path)
        self._speed = max(min(speed, safe), 0.03)
        return Motion(self._speed, self._speed * curvature, off_path=off_path)

    def _turn(self, error: float) -> float:
        rate = max(min(_TURN_GAIN * error, self._max_turn_rate), -self._max_turn_rate)
        # below this a real base does not turn at all
        return math.copysign(max(abs(rate), 0.15), error)

    def _gap(self, obstacles: np.ndarray, curvature: float) -> float:
        """Returns the free distance [m] along the arc before the robot's body reaches the margin; inf if free."""
        width = self._radius + _OBSTACLE_MARGIN
        along, across = geometry.along_arc(obstacles, curvature)
        ahead = (along > 0.0) & (along < _SEES) & (np.abs(across) < width)
        # where a disc of that radius first touches a point
        touched = along[ahead] - np.sqrt(np.maximum(width**2 - across[ahead] ** 2, 0.0))
        return float(touched.min(initial=math.inf))
