"""Follows the laser spot with the robot's own camera (paper, Sect. 5.1: visual servoing).

The control is position-based: the error is the spot's position in the robot's base frame, measured by the camera. The
robot begins to move only when the spot leaves the zone ahead or the range of good distances, and moves until the spot
is well inside again. So it does not follow every small stroke. The spot's position on the floor stays the same while
the robot moves; the gate checks how old the position is, and whether the localisation has jumped.
"""

from __future__ import annotations

import enum
import math
from typing import Optional, Tuple

import numpy as np

from vb_core.geometry import Pose, map_to_base
from vb_robot.driving.velocity import MAX_SPEED, VelocityRequest, steer

# [m] from the base to the spot; with a usual mount the image ends at 0.45 m, which an approaching spot soon reaches
FAR_DISTANCE = 1.3  # beyond it, the robot drives nearer ...
GOOD_DISTANCE = 1.0  # ... until the spot is this near
NEAR_DISTANCE = 0.75  # below it, the robot backs off ...
BACK_TO_DISTANCE = 0.9  # ... until the spot is this far away
INNER_ZONE = math.radians(14.0)  # half of a usual camera's view; if the spot's bearing is larger, the robot turns ...
SETTLED_ZONE = math.radians(4.0)  # ... until the bearing is smaller than this
DISTANCE_GAIN = 0.8  # [1/s]
OVERSHOOT = 0.05  # [m] a motion aims this far beyond the distance at which it ends, or it would slow down and never end


class DriveMotion(enum.Enum):
    """What the robot does to keep the spot at a good distance."""

    NONE = "none"
    NEARER = "nearer"
    BACK = "back"


class SpotFollower:
    """Visual servoing on the spot that the robot's own camera sees.

    Attributes:
        spot: (x, y) [m] of the followed spot, map frame, or None.
    """

    def __init__(self) -> None:
        self.spot: Optional[Tuple[float, float]] = None
        self._stop()

    def _stop(self) -> None:
        self._turning = False
        self._motion = DriveMotion.NONE

    def compute_request(self, pose: Optional[Pose]) -> VelocityRequest:
        """Computes the motion that keeps the spot in the robot's view; `pose` is None if it is not known."""
        if pose is None or self.spot is None:
            self._stop()
            return VelocityRequest(code="spot_lost")
        v, w = self._servo(map_to_base(np.array(self.spot), pose).ravel())
        code = "driving" if v or w else "spot_in_view"
        return VelocityRequest(min(max(v, -MAX_SPEED), MAX_SPEED), w, code)

    def _servo(self, spot: np.ndarray) -> Tuple[float, float]:
        """Computes (v, w) [m/s, rad/s] for a spot (2,) [m] in the base frame."""
        bearing = math.atan2(spot[1], spot[0])
        distance = float(np.hypot(*spot))
        if abs(bearing) > INNER_ZONE:
            self._turning = True
        elif abs(bearing) < SETTLED_ZONE:
            self._turning = False
        self._motion = self._choose_motion(distance)
        # the robot also steers while it drives, so that the spot stays ahead
        if self._motion is DriveMotion.NEARER:
            return steer(bearing, DISTANCE_GAIN * (distance - GOOD_DISTANCE + OVERSHOOT))
        _, w = steer(bearing, 0.0)
        w = w if self._turning else 0.0
        if self._motion is DriveMotion.BACK:
            return DISTANCE_GAIN * (distance - BACK_TO_DISTANCE - OVERSHOOT), w
        return 0.0, w

    def _choose_motion(self, distance: float) -> DriveMotion:
        """Chooses the motion for a distance [m]. A motion that has begun goes on until the distance is good again."""
        if distance > FAR_DISTANCE:
            return DriveMotion.NEARER
        if distance < NEAR_DISTANCE:
            return DriveMotion.BACK
        if self._motion is DriveMotion.NEARER and distance > GOOD_DISTANCE:
            return DriveMotion.NEARER
        if self._motion is DriveMotion.BACK and distance < BACK_TO_DISTANCE:
            return DriveMotion.BACK
        return DriveMotion.NONE
