"""Finishes turns that navigation makes back and forth.

DWA compares where short turns end. A robot that faces away from its path ends equally far from it whichever way it
turns, so it turns back and forth on the spot, for minutes. The idea: a turn that has changed direction several times on
one spot is finished in one direction; once the path is no longer behind the robot, DWA finds the better way.
"""

from __future__ import annotations

import math
from typing import Optional, Tuple

from vb_robot.driving.spot_follower import VelocityRequest
from vb_robot.poses import Pose

MAX_REVERSALS = 3  # changes of direction; one or two are corrections
REVERSAL_INTERVAL = 5.0  # [s] after the one before, or it is another turn
MAX_DRIFT = 0.05  # [m] a robot that has come farther drives
CREEP_SPEED = 0.03  # [m/s] DWA creeps while it turns
TURN_RATE = 0.5  # [rad/s]
FINISHED_ANGLE = 0.6 * math.pi  # [rad] after which a path that was behind the robot is beside it, and coming ahead


class TurnFinisher:
    """Passes navigation's requests on, and finishes turns that it makes back and forth."""

    def __init__(self) -> None:
        self._spot: Optional[Tuple[float, float]] = None
        self._direction, self._changes, self._changed_at = 0.0, 0, -math.inf
        self._left, self._yaw = 0.0, 0.0  # [rad] of a turn that is kept up, and the heading so far

    def finish(self, now: float, request: VelocityRequest, pose: Optional[Pose]) -> VelocityRequest:
        """Returns what navigation requests at a time [s], or the turn that is kept up.

        Args:
            pose: (x, y, yaw) [m, m, rad]; without one nothing is kept up.
        """
        if (
            pose is None
            or abs(request.v) > CREEP_SPEED
            or self._spot is None
            or math.dist(self._spot, pose[:2]) > MAX_DRIFT
        ):
            self._spot = pose[:2] if pose is not None else None
            self._direction, self._changes, self._left = 0.0, 0, 0.0
            return request
        if request.w == 0.0:
            return request  # navigation wants to stop
        if self._left > 0.0:
            self._left -= abs(math.remainder(pose[2] - self._yaw, 2.0 * math.pi))
            self._yaw = pose[2]
            if self._left > 0.0:
                return VelocityRequest(0.0, math.copysign(max(abs(request.w), TURN_RATE), self._direction))
        elif request.w * self._direction < 0.0:
            self._changes = self._changes + 1 if 0.0 <= now - self._changed_at <= REVERSAL_INTERVAL else 1
            self._changed_at = now
            if self._changes == MAX_REVERSALS:
                self._changes, self._left, self._yaw = 0, FINISHED_ANGLE, pose[2]
        self._direction = math.copysign(1.0, request.w)
        return request
