"""Where the spot is for a robot that follows it, and the resulting command."""
from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Callable, Deque, Optional, Tuple

import numpy as np

from vb_core import geometry
from vb_robot.driving.servoing import Servo, Wish
from vb_robot.spots import Sighting
from vb_robot.dispatching.view import FloorView


@dataclass(frozen=True)
class Frames:
    """Where the robot is: 4x4 transforms, None where one is not known (yet).

    Attributes:
        odom_from_map: T_odom_map at a time [s].
        base_from_odom: T_base_odom now.
    """

    odom_from_map: Callable[[float], Optional[np.ndarray]]
    base_from_odom: Callable[[], Optional[np.ndarray]]


class Following:
    """Visual servoing on the spot that the robot's own camera sees.

    The spot is kept in the odom frame: there it stays in place on the floor while the robot moves, and a pose jump of
    the localisation does not move it.
    """

    def __init__(self) -> None:
        self._servo = Servo()
        self._pending: Deque[Sighting] = deque(maxlen=10)  # not in the odom frame yet
        self._spot: Optional[Tuple[float, np.ndarray]] = None  # stamp [s], (2,) [m] in the odom frame
        self.view: Optional[FloorView] = None

    def add(self, sighting: Sighting) -> None:
        """Takes a spot of the robot's own camera."""
        self._pending.append(sighting)

    def forget(self) -> None:
        """Forgets the spot: the state has ended, and what was seen in it guides no robot."""
        self._pending.clear()
        self._spot = None

    def rest(self) -> None:
        """Rests: the robot does not follow now."""
        self._servo.reset()

    def wish(self, now: float, dt: float, frames: Frames) -> Wish:
        """What the robot would do to keep the spot in view, at a time [s], `dt` [s] after the last step."""
        if self.view is None:
            return Wish(0.0, 0.0, "no_camera")
        for sighting in reversed(self._pending):
            T = frames.odom_from_map(sighting.stamp)
            if T is not None:
                self._spot = (sighting.stamp, geometry.apply(T, np.array([*sighting.position, 0.0]))[:2])
                while self._pending and self._pending[0].stamp <= sighting.stamp:
                    self._pending.popleft()
                break
        T = frames.base_from_odom() if self._spot is not None else None
        if self._spot is None or T is None:
            return self._servo.step(dt, None, 0.0, self.view)
        stamp, place = self._spot
        # a clock that differs by a little must not make the spot come from the future
        age = now - stamp
        age = max(age, 0.0) if age > -0.1 else age
        return self._servo.step(dt, geometry.apply(T, np.array([*place, 0.0]))[:2], age, self.view)
