"""Following the laser spot with the robot's own camera (paper, Sect. 5.1: visual servoing).

Position-based: the error is the spot's place in the robot's base frame, measured through the camera. The robot
moves only when the spot is about to leave the inner zone of the image or the good distance, and then until the spot
is well inside again, so that small strokes do not make it restless.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Tuple

import numpy as np

from vb_core.errors import ParameterError
from vb_core.parameters import Parameters, param
from vb_robot.drive import FreeWay, Motion, SafeDrive
from vb_robot.safety import SafetyParams
from vb_robot.view import FloorView


@dataclass(frozen=True)
class ServoParams(Parameters):
    """Gains and limits."""

    max_speed: float = param(0.2, "m/s", above=0.0, high=0.5, doc="while a person leads the robot")
    max_back_speed: float = param(0.2, "m/s", low=0.0, high=0.5)
    max_turn: float = param(0.8, "rad/s", above=0.0, high=3.0)
    acceleration: float = param(0.4, "m/s^2", above=0.0, high=5.0)
    turn_acceleration: float = param(2.0, "rad/s^2", above=0.0, high=20.0)
    good_distance: float = param(1.0, "m", above=0.0, doc="from base_link to the spot: it drives to this")
    far_distance: float = param(1.3, "m", above=0.0, doc="from here on it drives nearer")
    near_distance: float = param(0.75, "m", above=0.0, doc="below this it backs off ...")
    back_to_distance: float = param(0.9, "m", above=0.0, doc="... to this")
    inner_zone: float = param(0.45, above=0.0, high=1.0, doc="part of the image's width in which nothing is done")
    settled_zone: float = param(0.12, above=0.0, high=1.0, doc="part of the width into which a turn brings the spot")
    drive_cone_deg: float = param(25.0, "deg", above=0.0, high=90.0, doc="off the axis by this it only turns")
    distance_gain: float = param(0.8, "1/s", above=0.0)
    turn_gain: float = param(1.8, "1/s", above=0.0)
    late_after: float = param(0.04, "s", low=0.0, high=1.0, doc="a spot so much older than usual slows it down ...")
    gone_after: float = param(0.16, "s", above=0.0, high=1.0, doc="... and so much older lets it stand")
    max_age: float = param(0.5, "s", above=0.0, high=2.0, doc="a spot older than this is gone, whatever is usual")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.near_distance < self.back_to_distance < self.good_distance < self.far_distance:
            order = "near_distance < back_to_distance < good_distance < far_distance"
            raise ParameterError("good_distance", f"must keep the order {order}")
        if self.late_after >= self.gone_after:
            raise ParameterError("late_after", f"must be below gone_after {self.gone_after}, got {self.late_after}")
        if self.settled_zone >= self.inner_zone:
            raise ParameterError("settled_zone", f"must be below inner_zone {self.inner_zone}, got {self.settled_zone}")


class Servo:
    """The control law."""

    def __init__(self, params: ServoParams, safety: SafetyParams, view: FloorView) -> None:
        self.params = params
        self._drive = SafeDrive(params.acceleration, params.turn_acceleration, safety)
        self._view = view
        self._width = view.params.image_width
        self.reset()

    def reset(self) -> None:
        """The robot stands; nothing is being followed."""
        self._drive.reset()
        self._turning = False
        self._driving = 0  # 1 forward, -1 back
        self._usual: Optional[float] = None  # [s] age at which spots come
        self._age = 0.0

    def step(self, dt: float, spot: Optional[np.ndarray], age: float, free_way: FreeWay) -> Motion:
        """The command for the next dt [s].

        Args:
            dt: since the last step.
            spot: (2,) [m] where the spot is in the base frame now, None if there never was one.
            age: [s] of the image in which it was found.
            free_way: asked before the robot drives.
        """
        if spot is None or not 0.0 <= age <= self.params.max_age or not np.isfinite(spot).all():
            self._turning, self._driving = False, 0
            return self._drive.brake(dt, "the spot is gone")
        v, w = self._wish(np.asarray(spot, dtype=float))
        trust = self._trust(dt, age)
        motion = self._drive.step(dt, v, trust * w, free_way, trust * self.params.max_speed)
        return motion if v or w or motion.reason else Motion(motion.v, motion.w, "the spot is well in view")

    def _trust(self, dt: float, age: float) -> float:
        """0 .. 1: how far the spot's place may be relied upon; less when the next image is overdue.

        What is overdue depends on how long images take from the lens to here, which is learnt on the way: a robot
        with a quick camera stands 0.3 s after its last image, and one with a slow computer does not crawl.
        """
        if self._usual is None:
            self._usual = age
        elif age < self._age + 0.5 * dt:
            # a newer image has come
            self._usual += 0.1 * (min(age, self.params.max_age) - self._usual)
        self._age = age
        params = self.params
        return min(1.0, max(0.0, (self._usual + params.gone_after - age) / (params.gone_after - params.late_after)))

    def _wish(self, spot: np.ndarray) -> Tuple[float, float]:
        """What would be good for seeing, without regard to accelerations and obstacles."""
        params = self.params
        bearing = math.atan2(spot[1], spot[0])
        distance = float(np.hypot(*spot))
        # part of half the image's width by which the spot is off the middle; 2 where it is behind the camera
        column = float(self._view.pixels(spot[None])[0, 0])
        off = 2.0 if not math.isfinite(column) else abs(2.0 * (column + 0.5) / self._width - 1.0)
        if off > params.inner_zone:
            self._turning = True
        elif off < params.settled_zone:
            self._turning = False
        if distance > params.far_distance:
            self._driving = 1
        elif distance < params.near_distance:
            self._driving = -1
        elif (self._driving == 1 and distance <= params.good_distance) or (
            self._driving == -1 and distance >= params.back_to_distance
        ):
            self._driving = 0
        # while it drives it also steers: the spot ahead stays ahead
        w = params.turn_gain * bearing if self._turning or self._driving == 1 else 0.0
        v = 0.0
        if self._driving == 1:
            cone = math.radians(params.drive_cone_deg)
            v = params.distance_gain * (distance - params.good_distance + 0.05) * max(0.0, 1.0 - abs(bearing) / cone)
        elif self._driving == -1:
            v = params.distance_gain * (distance - params.back_to_distance - 0.05)
        v = min(max(v, -params.max_back_speed), params.max_speed)
        return v, min(max(w, -params.max_turn), params.max_turn)
