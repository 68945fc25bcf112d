"""Turns a robot towards navigation's path before navigation drives it.

DWA, move_base's local planner, compares the poses at which short turns end. If a robot faces away from its path, turns
to either side end equally far from the path, and the robot turns back and forth in place for minutes. Therefore, while
the path starts behind the robot, the shim (Nav2's term) turns the robot the shorter way until the path is ahead. A
round robot can always turn in place.

The shim acts only while navigation's controller drives forwards or turns, and the path continues. It does not disturb a
rotating recovery, which would never end if it were turned back, nor the robot's heading at the goal.
"""

from __future__ import annotations

import math
from typing import Optional

import numpy as np

from vb_core.geometry import Pose, look_ahead
from vb_robot.driving.velocity import VelocityRequest

LOOK_AHEAD = 0.3  # [m] along the path to the point that gives its direction
MIN_REMAINING_PATH = 0.5  # [m] with less, the shim does not act: twice the usual tolerance
RECOVERY = 20.0  # [s] for a recovery's full turn, which takes 16 s at 0.4 rad/s; a driving command ends it earlier
MAX_PATH_DISTANCE = 0.5  # [m] from the path; a robot farther from it must be following another path
START_ANGLE = 0.5 * math.pi  # [rad] off the robot's heading, at which a turn starts
END_ANGLE = math.radians(30)  # [rad] at which a turn ends: DWA can then tell which direction is better
MIN_TURN_RATE = 0.5  # [rad/s]


class RotationShim:
    """Passes navigation's requests on, except while the path is behind the robot.

    Attributes:
        path: (N, 2) [m] navigation's newest path, map frame; None while it is not known, when all requests pass.
    """

    def __init__(self) -> None:
        self.path: Optional[np.ndarray] = None
        self._direction = 0.0  # 1 for a turn to the left, -1 to the right, 0 without a turn
        self._recovering_until = -math.inf

    def recover(self, now: float) -> None:
        """Records that navigation started a recovery at time `now` [s]."""
        self._recovering_until = now + RECOVERY
        self._direction = 0.0

    def align(self, request: VelocityRequest, pose: Optional[Pose], now: float) -> VelocityRequest:
        """Returns navigation's request at time `now` [s], or a turn towards its path instead.

        Args:
            pose: (x, y, yaw) [m, m, rad], map frame; if it is None, all requests pass.
        """
        if request.v != 0.0:
            self._recovering_until = -math.inf
        is_recovering = 0.0 < self._recovering_until - now <= RECOVERY
        if request.v < 0.0 or is_recovering:
            return request
        angle = self._angle_to_path(pose) if pose is not None else None
        is_stop = request.v == 0.0 and request.w == 0.0
        if angle is None or abs(angle) < END_ANGLE:
            self._direction = 0.0
        elif abs(angle) > START_ANGLE:
            self._direction = self._direction or math.copysign(1.0, angle)
        elif is_stop:
            self._direction = 0.0  # a stop ends the turn
        if is_stop or self._direction == 0.0:
            return request
        return VelocityRequest(0.0, self._direction * max(abs(request.w), MIN_TURN_RATE))

    def _angle_to_path(self, pose: Pose) -> Optional[float]:
        """Returns the angle [rad] from the heading to the path's direction, or None if no path can be followed here."""
        if self.path is None or not len(self.path):
            return None
        target, path_distance, remaining = look_ahead(self.path, pose[:2], LOOK_AHEAD)
        is_on_path = path_distance <= MAX_PATH_DISTANCE
        if not is_on_path or remaining + path_distance < MIN_REMAINING_PATH:
            return None
        x, y = target - np.asarray(pose[:2])
        return math.remainder(math.atan2(y, x) - pose[2], 2.0 * math.pi)
