"""Follows the laser spot with the robot's own camera (paper, Sect. 5.1: visual servoing).

Position-based: the error is the spot's place in the robot's base frame, measured through the camera. The robot
moves only when the spot is about to leave the inner zone of the image or the good distance, and then until the spot
is well inside again, so that small strokes do not make it restless.
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Tuple

import numpy as np

from vb_robot.dispatching.view import FloorView

MAX_SPEED = 0.2  # [m/s] the paper's limit while a person guides the robot; also backwards, as fast as a spot is drawn
MAX_TURN = 0.8  # [rad/s] a spot 1 m away that moves sideways at 0.5 m/s needs 0.5
# [m] from the base to the spot. The image of a usual mount ends at 0.45 m: nearer than NEAR_DISTANCE a spot that is
# drawn towards the robot slips under it.
GOOD_DISTANCE, FAR_DISTANCE = 1.0, 1.3  # beyond FAR it drives nearer, to GOOD
NEAR_DISTANCE, BACK_TO_DISTANCE = 0.75, 0.9  # below NEAR it backs off, to BACK_TO
INNER_ZONE, SETTLED_ZONE = 0.45, 0.12  # part of the image's width: outside of INNER it turns, until within SETTLED
DRIVE_CONE = math.radians(25.0)  # if the spot is farther off the axis, the robot only turns
DISTANCE_GAIN, TURN_GAIN = 0.8, 1.8  # [1/s]
# [s] by how much a spot is older than usual: up to LATE they vary at 25 images/s, at GONE four images are missed
LATE, GONE = 0.04, 0.16
MAX_AGE = 0.5  # [s] a spot older than this is gone, whatever the usual age


@dataclass(frozen=True)
class Wish:
    """What a behaviour requests: forward speed [m/s], turn rate [rad/s], and why, as a code."""

    v: float
    w: float
    code: str = "drives"


class Servo:
    """The control law."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Resets: no spot is being followed."""
        self._turning = False
        self._driving = 0  # 1 forward, -1 back
        self._usual: Optional[float] = None  # [s] age at which spots come
        self._age = 0.0

    def step(self, dt: float, spot: Optional[np.ndarray], age: float, view: FloorView) -> Wish:
        """Computes the motion that keeps the spot in view.

        Args:
            dt: [s] since the last step.
            spot: (2,) [m] where the spot is in the base frame now, None if there never was one.
            age: [s] of the image in which it was found.
            view: of the robot's camera.
        """
        if spot is None or not 0.0 <= age <= MAX_AGE or not np.isfinite(spot).all():
            self._turning, self._driving = False, 0
            return Wish(0.0, 0.0, "spot_gone")
        v, w = self._wish(np.asarray(spot, dtype=float), view)
        trust = self._trust(dt, age)
        if not v and not w:
            return Wish(0.0, 0.0, "spot_in_view")
        return Wish(min(max(v, -trust * MAX_SPEED), trust * MAX_SPEED), trust * w)

    def _trust(self, dt: float, age: float) -> float:
        """0 .. 1: how far the spot's place can be trusted; less when the next image is overdue.

        What is overdue depends on the images' latency, which is estimated on the run: a robot
        with a quick camera stops 0.3 s after its last image, and one with a slow computer does not crawl.
        """
        if self._usual is None:
            self._usual = age
        elif age < self._age + 0.5 * dt:
            # a newer image has arrived
            self._usual += 0.1 * (min(age, MAX_AGE) - self._usual)
        self._age = age
        return min(1.0, max(0.0, (self._usual + GONE - age) / (GONE - LATE)))

    def _wish(self, spot: np.ndarray, view: FloorView) -> Tuple[float, float]:
        bearing = math.atan2(spot[1], spot[0])
        distance = float(np.hypot(*spot))
        # share of half the image's width by which the spot is off-centre; 2 where it is behind the camera
        column = float(view.pixels(spot[None])[0, 0])
        off = 2.0 if not math.isfinite(column) else abs(2.0 * (column + 0.5) / view.camera.width - 1.0)
        if off > INNER_ZONE:
            self._turning = True
        elif off < SETTLED_ZONE:
            self._turning = False
        if distance > FAR_DISTANCE:
            self._driving = 1
        elif distance < NEAR_DISTANCE:
            self._driving = -1
        elif (self._driving == 1 and distance <= GOOD_DISTANCE) or (
            self._driving == -1 and distance >= BACK_TO_DISTANCE
        ):
            self._driving = 0
        # while it drives it also steers: the spot ahead stays ahead
        w = TURN_GAIN * bearing if self._turning or self._driving == 1 else 0.0
        v = 0.0
        if self._driving == 1:
            v = DISTANCE_GAIN * (distance - GOOD_DISTANCE + 0.05) * max(0.0, 1.0 - abs(bearing) / DRIVE_CONE)
        elif self._driving == -1:
            v = DISTANCE_GAIN * (distance - BACK_TO_DISTANCE - 0.05)
        v = min(max(v, -MAX_SPEED), MAX_SPEED)
        return v, min(max(w, -MAX_TURN), MAX_TURN)
