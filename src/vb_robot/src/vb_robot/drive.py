"""From a wish to a command: bounded accelerations, and never faster than the free way allows."""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable, Optional

from vb_robot.safety import SafetyParams, safe_speed

UNKNOWN_WAY = "the way is not known"
IN_THE_WAY = "something is in the way"


@dataclass(frozen=True)
class Motion:
    """A command: forward speed [m/s], turn rate [rad/s], and what keeps it from being what was wished, if anything."""

    v: float
    w: float
    reason: str = ""


# how far [m] the arc of (v, w) may be driven; None if that cannot be known
FreeWay = Callable[[float, float], Optional[float]]


class SafeDrive:
    """Keeps the last command, since accelerations are bounded.

    Args:
        acceleration: [m/s^2]
        turn_acceleration: [rad/s^2]
    """

    def __init__(self, acceleration: float, turn_acceleration: float, safety: SafetyParams) -> None:
        self._acceleration = acceleration
        self._turn_acceleration = turn_acceleration
        self._safety = safety
        self.reset()

    def reset(self) -> None:
        """The robot stands."""
        self.v = self.w = 0.0

    def step(self, dt: float, v: float, w: float, free_way: FreeWay, most: float = math.inf) -> Motion:
        """The command for the next dt [s] if (v, w) [m/s, rad/s] is wished for.

        Args:
            dt: since the last step; longer than 0.2 s counts as 0.2 s.
            free_way: asked before the robot drives.
            most: [m/s] no faster than this, for another reason than the way.
        """
        dt = min(max(dt, 0.0), 0.2)
        w = _towards(self.w, w, self._turn_acceleration * dt)
        wanted = _towards(self.v, v, self._acceleration * dt)
        reason = ""
        if wanted != 0.0:
            free = free_way(wanted, w)
            if free is None:
                allowed, why = 0.0, UNKNOWN_WAY
            else:
                allowed, why = safe_speed(free, self._safety), IN_THE_WAY
            if most < allowed:
                allowed, why = most, ""
            if abs(wanted) > allowed:
                # what must be slower is braked harder than what may be
                limited = math.copysign(allowed, wanted)
                wanted, reason = _towards(self.v, limited, self._safety.brake * dt), why
        self.v, self.w = wanted, w
        return Motion(wanted, w, reason)

    def brake(self, dt: float, reason: str) -> Motion:
        """The command for the next dt [s] if the robot is to stand."""
        dt = min(max(dt, 0.0), 0.2)
        self.v = _towards(self.v, 0.0, self._safety.brake * dt)
        self.w = _towards(self.w, 0.0, 4.0 * self._turn_acceleration * dt)
        return Motion(self.v, self.w, reason)


def _towards(value: float, target: float, step: float) -> float:
    return min(max(target, value - step), value + step)
