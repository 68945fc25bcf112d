"""Simulates one robot's true motion, its odometry, and the pose that localisation reports."""

from __future__ import annotations

import math
from typing import Callable, Tuple

import numpy as np

from vb_core import geometry
from vb_core.geometry import Pose
from vb_sim.model_params import Models
from vb_sim.world import Robot


def advance(pose: Pose, distance: float, turn: float) -> Pose:
    """Returns the pose [m, m, rad] after driving along an arc by `distance` [m] and `turn` [rad]."""
    x, y, yaw = pose
    # the chord of the arc; exact even if `turn` is 0
    chord = distance * float(np.sinc(turn / 2.0 / math.pi))
    mean_yaw = yaw + turn / 2.0
    x += chord * math.cos(mean_yaw)
    y += chord * math.sin(mean_yaw)
    return x, y, geometry.wrap_angle(yaw + turn)


def approach_value(value: float, target: float, faster: float, slower: float) -> float:
    """Moves `value` towards `target`, by at most `faster` away from zero or `slower` towards zero."""
    limit = faster if abs(target) > abs(value) and target * value >= 0 else slower
    return value + min(max(target - value, -limit), limit)


class RobotBody:
    """A differential drive on the floor of a room.

    Args:
        clearance: returns the distance [m] from a point to the nearest obstacle.
        rng: generates all noise.
    """

    def __init__(
        self, robot: Robot, models: Models, clearance: Callable[[float, float], float], rng: np.random.Generator
    ) -> None:
        self._radius = robot.radius
        self._model, localisation = models.robot, models.localisation
        self._sigmas = np.array([localisation.position_sigma, localisation.position_sigma, localisation.yaw_sigma])
        self._correlation_time = localisation.correlation_time
        self._clearance = clearance
        self._rng = rng
        self.pose: Pose = robot.start_pose()
        self.odometry: Pose = (0.0, 0.0, 0.0)
        self.velocity: Tuple[float, float] = (0.0, 0.0)  # [m/s, rad/s]
        self.collisions = 0
        self._touching = False
        self._command: Tuple[float, float] = (0.0, 0.0)
        self._command_time = -math.inf
        # encoders and wheel diameters have small systematic errors
        self._scale = 1.0 + self._model.odometry_scale_sigma * rng.standard_normal(2)
        self._error = self._sigmas * rng.standard_normal(3)

    def command(self, speed: float, turn_rate: float, now: float) -> None:
        """Sets a velocity command [m/s, rad/s] that is valid until `command_timeout` after time `now` [s]."""
        self._command, self._command_time = (speed, turn_rate), now

    # ------------------------------------------------------------ motion
    def step(self, dt: float, now: float) -> None:
        """Moves the robot for `dt` [s], up to time `now` [s]."""
        speed, turn_rate = self._velocity_after(dt, now)
        distance, turn = speed * dt, turn_rate * dt
        pose = advance(self.pose, distance, turn)
        gap = self._clearance(pose[0], pose[1])
        # a robot that touches an obstacle may still back away from it
        is_pushing = gap < self._radius and gap < self._clearance(self.pose[0], self.pose[1]) + 1e-9
        if is_pushing and distance != 0.0:
            if not self._touching:
                self.collisions += 1
            self._touching = True
            speed = distance = 0.0
            pose = advance(self.pose, 0.0, turn)
        elif gap > self._radius + 0.02:
            # because of the extra distance, a robot that pushes repeatedly against an obstacle collides only once
            self._touching = False
        self.pose = pose
        self.velocity = (speed, turn_rate)
        if distance != 0.0 or turn != 0.0:
            self._update_odometry(distance, turn)
            self._update_error(dt)

    def _velocity_after(self, dt: float, now: float) -> Tuple[float, float]:
        model = self._model
        is_current = now - self._command_time <= model.command_timeout
        target_speed, target_turn = self._command if is_current else (0.0, 0.0)
        target_speed = min(max(target_speed, -model.max_speed), model.max_speed)
        target_turn = min(max(target_turn, -model.max_turn_rate), model.max_turn_rate)
        speed = approach_value(self.velocity[0], target_speed, model.acceleration * dt, model.deceleration * dt)
        turn_step = model.turn_acceleration * dt
        turn_rate = approach_value(self.velocity[1], target_turn, turn_step, turn_step)
        return speed, turn_rate

    def _update_odometry(self, distance: float, turn: float) -> None:
        model = self._model
        distance_noise, turn_noise, drift_noise = self._rng.standard_normal(3)
        # random walks: their variance grows in proportion to distance and turn
        root_distance = math.sqrt(abs(distance))
        root_turn = math.sqrt(abs(turn))
        measured_distance = distance * self._scale[0] + model.odometry_distance_noise * root_distance * distance_noise
        measured_turn = turn * self._scale[1] + model.odometry_turn_noise * root_turn * turn_noise
        measured_turn += model.odometry_drift_noise * root_distance * drift_noise
        self.odometry = advance(self.odometry, measured_distance, measured_turn)

    # ------------------------------------------------------------ localisation
    def _update_error(self, dt: float) -> None:
        # an Ornstein-Uhlenbeck process; constant while the robot stands, because AMCL updates only when it moves
        share = dt / self._correlation_time
        change = self._sigmas * math.sqrt(2.0 * share) * self._rng.standard_normal(3)
        self._error = self._error * (1.0 - share) + change

    def estimated_pose(self) -> Pose:
        """Returns the pose that localisation reports, (x, y, yaw) [m, m, rad], map frame."""
        x, y, yaw = self.pose
        return x + self._error[0], y + self._error[1], geometry.wrap_angle(yaw + self._error[2])

    def map_to_odom(self) -> np.ndarray:
        """Returns T_map_odom, 4x4, which transforms odometry into the estimate."""
        odometry = geometry.transform_from_pose2d(*self.odometry)
        return geometry.transform_from_pose2d(*self.estimated_pose()) @ geometry.invert_transform(odometry)
