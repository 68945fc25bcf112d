"""Whether a robot follows the spot now, where the spot is for it, and the command that comes of it."""
from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from typing import Callable, Deque, Iterable, Optional, Tuple

import numpy as np

from vb_core import geometry
from vb_core.parameters import Parameters, param
from vb_robot import sightings
from vb_robot.drive import FreeWay, Motion
from vb_robot.servoing import Servo
from vb_robot.sightings import Sighting, Sightings

FOLLOW = ("auto", "true", "false")


@dataclass(frozen=True)
class GuidingParams(Parameters):
    """Whose spots lead the robot, and when."""

    camera: str = param("robot", doc="name of this robot's camera in the spots")
    mobile_cameras: tuple = param(("robot",), doc="names of cameras on robots")
    auto_wait: float = param(1.0, "s", low=0.0, high=10.0, doc="for a stationary camera to see the spot too")


@dataclass(frozen=True)
class Frames:
    """Where the robot is: 4x4 transforms, None where one is not known (yet).

    Attributes:
        odom_from_map: T_odom_map at a time [s].
        base_from_odom: T_base_odom now.
    """

    odom_from_map: Callable[[float], Optional[np.ndarray]]
    base_from_odom: Callable[[], Optional[np.ndarray]]


class Guiding:
    """Visual servoing on the spot that the robot's own camera sees. May be fed and asked by different threads.

    The robot follows in Guide always. In Border and Seed it does with `follow` "true", and with "auto" if no stationary
    camera has seen the spot in this interaction. Of several robots only the one follows whose camera has seen the
    spot longest.

    The spot is kept in the odom frame: there it stays where it is on the floor while the robot moves, and a leap of
    the localisation does not move it.

    Args:
        follow: one of FOLLOW.
    """

    def __init__(self, params: GuidingParams, follow: str, servo: Servo) -> None:
        self._params = params
        self._follow = follow
        self._servo = servo
        self._lock = threading.Lock()
        self._sightings = Sightings(mobile_cameras=(*params.mobile_cameras, params.camera))
        self._pending: Deque[Sighting] = deque(maxlen=10)  # not in the odom frame yet
        self._spot: Optional[Tuple[float, np.ndarray]] = None  # stamp [s], (2,) [m] in the odom frame
        self.active = False

    # ------------------------------------------------------------- what comes in
    def set_state(self, state: int, interaction_id: str, entered: float) -> None:
        """Takes the interaction's state, entered at a time [s]."""
        with self._lock:
            if self._sightings.set_state(state, interaction_id, entered):
                self._pending.clear()
                self._spot = None

    def add(self, sighting: Sighting) -> None:
        """Takes a spot of any camera."""
        with self._lock:
            self._sightings.add(sighting)
            if sighting.mobile and sighting.camera == self._params.camera:
                self._pending.append(sighting)

    def contributed(self, interaction_id: str, cameras: Iterable[str]) -> None:
        """Learns which cameras have contributed to an interaction, for instance before this program was started."""
        with self._lock:
            if interaction_id == self._sightings.key[0]:
                self._sightings.contributed(cameras)

    # ------------------------------------------------------------- what comes out
    def wanted(self, now: float) -> bool:
        """Whether the robot is to follow the spot."""
        with self._lock:
            known = self._sightings
            known.forget_after(now)
            if known.leader(now) not in (None, self._params.camera):
                return False
            if known.state == sightings.GUIDE:
                return True
            if known.state not in (sightings.BORDER, sightings.SEED) or self._follow == "false":
                return False
            if self._follow == "true":
                return True
            if known.stationary_seen or known.first_mobile is None:
                return False
            return now - known.first_mobile >= self._params.auto_wait

    def step(self, now: float, dt: float, frames: Frames, free_way: FreeWay) -> Optional[Motion]:
        """The command for the next dt [s]; None if the robot is somebody else's. `active` tells which it is.

        When the guiding ends the robot is told once to stand.
        """
        was, self.active = self.active, self.wanted(now)
        if self.active != was:
            self._servo.reset()
        if not self.active:
            return Motion(0.0, 0.0, "ends") if was else None
        spot, age = self._spot_in_base(now, frames)
        return self._servo.step(dt, spot, age, free_way)

    def reset(self) -> None:
        """The robot stands, whatever it was told last."""
        self._servo.reset()

    def _spot_in_base(self, now: float, frames: Frames) -> Tuple[Optional[np.ndarray], float]:
        """((2,) [m] where the spot is in the base frame now, its age [s]); None without a spot or a transform."""
        with self._lock:
            waiting = list(self._pending)
        for sighting in reversed(waiting):
            T = frames.odom_from_map(sighting.stamp)
            if T is not None:
                self._keep(sighting, T)
                break
        with self._lock:
            kept = self._spot
        T = frames.base_from_odom() if kept is not None else None
        if kept is None or T is None:
            return None, 0.0
        stamp, place = kept
        # a clock that differs by a little must not make the spot come from the future
        age = now - stamp
        return geometry.apply(T, np.array([*place, 0.0]))[:2], max(age, 0.0) if age > -0.1 else age

    def _keep(self, sighting: Sighting, T_odom_map: np.ndarray) -> None:
        with self._lock:
            if sighting not in self._pending:
                return  # the state has ended meanwhile
            self._spot = (sighting.stamp, geometry.apply(T_odom_map, np.array([*sighting.position, 0.0]))[:2])
            while self._pending and self._pending[0].stamp <= sighting.stamp:
                self._pending.popleft()
