"""Drives a robot away from a border or obstacle that is too near, so that navigation finds a path again.

Navigation's planner requires PATH_MARGIN more clearance than its controller, which may therefore stop the robot where
no path can start. The robot then drives straight to the nearest position with enough clearance.
"""

from __future__ import annotations

import math
from typing import Optional

import numpy as np

from vb_core.geometry import Pose, wrap_angle
from vb_core.navigation_parameters import PATH_MARGIN
from vb_robot.driving.velocity import MAX_SPEED, VelocityRequest, steer
from vb_robot.driving.workspace import Workspace

START_CLEARANCE = PATH_MARGIN + 0.02  # [m] beyond the radius, below which an escape starts
END_CLEARANCE = (
    PATH_MARGIN + 0.04
)  # [m] beyond the radius, from which it has ended; larger, because single cells flicker
TARGET_CLEARANCE = END_CLEARANCE + 0.05  # [m] so that a robot that stops a few centimetres short of the target is free
REACH = 0.5  # [m] to the farthest target; a robot that has no target within it is trapped, not pinched
PINCHED_AFTER = 1.5  # [s] for which navigation must have had a goal without moving the robot
TRIES_FOR = 10.0  # [s] after which the escape gives up
RESTS_FOR = 20.0  # [s] after which it then tries again, as the obstacle may have moved


class Escape:
    """Frees a pinched robot. A pinched robot has a goal, but is not moved by navigation, and something is too near it.

    A robot whose centre is inside a border is not pinched, because a person drew the border around it or drove it in.

    Args:
        radius: [m] of the robot.
    """

    def __init__(self, radius: float) -> None:
        self._radius = radius
        self._idle_since, self._started = math.inf, -math.inf
        self._target: Optional[np.ndarray] = None  # (2,) [m]; None if the robot needs no help

    def interrupt(self, now: float) -> None:
        """Resets the escape when a person stops or drives the robot, which may be elsewhere afterwards."""
        self._target = None
        self._started = -math.inf
        self._idle_since = now

    def compute_request(
        self, now: float, pose: Pose, workspace: Workspace, has_goal: bool, moves: bool
    ) -> Optional[VelocityRequest]:
        """Computes the robot's motion at time `now` [s], or None if it needs no help.

        Args:
            has_goal: whether navigation has a goal, and nobody draws or guides.
            moves: whether navigation moves the robot.
        """
        begins_later = now < self._idle_since  # at the start, or if time was set back
        if moves or not has_goal or begins_later:
            self._idle_since = now
        gap = workspace.distance_to_blocked(pose) - self._radius
        clearance = START_CLEARANCE if self._target is None else END_CLEARANCE
        is_too_near = -self._radius < gap < clearance
        if not has_goal or not is_too_near:
            self._target = None
            return None
        if self._target is None:
            is_resting = 0.0 <= now - self._started < TRIES_FOR + RESTS_FOR
            if is_resting or not now - self._idle_since >= PINCHED_AFTER:
                return None
            self._started = now
            self._target = workspace.nearest_free_position(pose, self._radius + TARGET_CLEARANCE, REACH)
        if self._target is None or not 0.0 <= now - self._started < TRIES_FOR:
            self._target = None
            return None
        x, y = self._target - pose[:2]
        bearing = wrap_angle(math.atan2(y, x) - pose[2])
        speed = min(MAX_SPEED, 0.8 * math.hypot(x, y) + 0.03)
        return VelocityRequest(*steer(bearing, speed))
