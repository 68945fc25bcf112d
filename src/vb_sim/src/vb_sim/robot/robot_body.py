"""One simulated robot: its true motion, its odometry, and the pose that localisation reports."""

from __future__ import annotations

import math
from typing import Callable, Tuple

import numpy as np

from vb_core import geometry
from vb_core.geometry import Pose
from vb_sim.models import Models


def advance(pose: Pose, distance: float, turn: float) -> Pose:
    """Returns the pose [m, m, rad] after driving an arc of length `distance` [m] while turning by `turn` [rad]."""
    x, y, yaw = pose
    # chord of the arc: exact, also for a turn of zero
    chord = distance * float(np.sinc(turn / 2.0 / math.pi))
    middle = yaw + turn / 2.0
    return x + chord * math.cos(middle), y + chord * math.sin(middle), geometry.wrap_angle(yaw + turn)


def toward(value: float, target: float, faster: float, slower: float) -> float:
    """Moves `value` towards `target`, by at most `faster` away from zero and `slower` towards it."""
    limit = faster if abs(target) > abs(value) and target * value >= 0 else slower
    return value + min(max(target - value, -limit), limit)


class RobotBody:
    """A differential drive on the floor of a room.

    Args:
        start: true pose at the beginning, (x, y, yaw) [m, m, rad], map frame.
        radius: [m] of the round body.
        clearance: returns the distance [m] from a point to the nearest obstacle.
        rng: the generator of all its noise.
    """

    def __init__(
        self,
        start: Pose,
        radius: float,
        models: Models,
        clearance: Callable[[float, float], float],
        rng: np.random.Generator,
    ) -> None:
        self._radius = radius
        self._model, figures = models.robot, models.localisation
        self._sigmas = np.array([figures.position_sigma, figures.position_sigma, figures.yaw_sigma])
        self._correlation_time = figures.correlation_time
        self._clearance = clearance
        self._rng = rng
        self.pose: Pose = start
        self.odometry: Pose = (0.0, 0.0, 0.0)
        self.velocity: Tuple[float, float] = (0.0, 0.0)  # [m/s, rad/s]
        self.collisions = 0
        self._touching = False
        self._command: Tuple[float, float] = (0.0, 0.0)
        self._command_time = -math.inf
        # encoders and wheel diameters are slightly off, always by the same amount
        self._scale = 1.0 + self._model.odometry_scale_sigma * rng.standard_normal(2)
        self._error = self._sigmas * rng.standard_normal(3)

    # ------------------------------------------------------------ commands
    def command(self, speed: float, turn_rate: float, now: float) -> None:
        """Sets a velocity command [m/s, rad/s] that holds until `command_timeout` after `now` [s]."""
        self._command, self._command_time = (speed, turn_rate), now

    # ------------------------------------------------------------ motion
    def step(self, dt: float, now: float) -> None:
        """Moves the robot on by `dt` [s], to the time `now` [s]."""
        speed, turn_rate = self._velocity_after(dt, now)
        distance, turn = speed * dt, turn_rate * dt
        after = advance(self.pose, distance, turn)
        room = self._clearance(after[0], after[1])
        # a robot that already touches something may still back away from it
        if room < self._radius and room < self._clearance(self.pose[0], self.pose[1]) + 1e-9 and distance != 0.0:
            if not self._touching:
                self.collisions += 1
            self._touching = True
            speed = distance = 0.0
            after = advance(self.pose, 0.0, turn)
        elif room > self._radius + 0.02:
            # pushing on in small steps is still the same collision
            self._touching = False
        self.pose = after
        self.velocity = (speed, turn_rate)
        if distance != 0.0 or turn != 0.0:
            self._count_wheels(distance, turn)
            self._vary_error(dt)

    def _velocity_after(self, dt: float, now: float) -> Tuple[float, float]:
        m = self._model
        alive = now - self._command_time <= m.command_timeout
        target_speed, target_turn = self._command if alive else (0.0, 0.0)
        target_speed = min(max(target_speed, -m.max_speed), m.max_speed)
        target_turn = min(max(target_turn, -m.max_turn_rate), m.max_turn_rate)
        speed = toward(self.velocity[0], target_speed, m.acceleration * dt, m.deceleration * dt)
        turn_rate = toward(self.velocity[1], target_turn, m.turn_acceleration * dt, m.turn_acceleration * dt)
        return speed, turn_rate

    def _count_wheels(self, distance: float, turn: float) -> None:
        m = self._model
        noise = self._rng.standard_normal(3)
        measured = distance * self._scale[0] + m.odometry_distance_noise * math.sqrt(abs(distance)) * noise[0]
        turned = turn * self._scale[1] + m.odometry_turn_noise * math.sqrt(abs(turn)) * noise[1]
        turned += m.odometry_drift_noise * math.sqrt(abs(distance)) * noise[2]
        self.odometry = advance(self.odometry, measured, turned)

    # ------------------------------------------------------------ localisation
    def _vary_error(self, dt: float) -> None:
        # Ornstein-Uhlenbeck process; it rests while the robot does, since AMCL updates only on motion
        share = dt / self._correlation_time
        change = self._sigmas * math.sqrt(2.0 * share) * self._rng.standard_normal(3)
        self._error = self._error * (1.0 - share) + change

    def estimate(self) -> Pose:
        """Returns the pose that localisation reports, (x, y, yaw) [m, m, rad], map frame."""
        x, y, yaw = self.pose
        return x + self._error[0], y + self._error[1], geometry.wrap_angle(yaw + self._error[2])

    def map_to_odom(self) -> np.ndarray:
        """Returns T_map_odom, 4x4, which transforms odometry into the estimate."""
        odometry = geometry.transform_from_pose2d(*self.odometry)
        return geometry.transform_from_pose2d(*self.estimate()) @ geometry.invert(odometry)
