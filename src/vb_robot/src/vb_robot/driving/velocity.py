"""The velocity that a source requests from a robot's base, and how a robot is steered to a point."""

from __future__ import annotations

import math
from typing import NamedTuple, Tuple

MAX_SPEED = 0.2  # [m/s] forwards and backwards: the paper's limit for a guided robot, and a spot's usual speed
MAX_TURN = 0.8  # [rad/s]; 0.5 would suffice for a spot at 1 m that moves sideways at 0.5 m/s
DRIVE_CONE = math.radians(25.0)  # if the point is farther off the axis, the robot only turns
TURN_GAIN = 1.8  # [1/s]


class VelocityRequest(NamedTuple):
    """A source's request: forward speed [m/s], turn rate [rad/s], and the reason as a code."""

    v: float = 0.0
    w: float = 0.0
    code: str = "driving"


def steer(bearing: float, speed: float) -> Tuple[float, float]:
    """Computes (v, w) [m/s, rad/s] that turn the robot to a bearing [rad]. The smaller the bearing, the larger v."""
    v = speed * max(0.0, 1.0 - abs(bearing) / DRIVE_CONE)
    w = min(max(TURN_GAIN * bearing, -MAX_TURN), MAX_TURN)
    return v, w
