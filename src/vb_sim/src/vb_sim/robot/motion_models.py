"""Parameters of the robot's body, its odometry, its localisation and its laser scanner.

The source of each default is beside the value in config/models.yaml.
"""

from __future__ import annotations

from dataclasses import dataclass

from vb_core.parameters import Parameters, param


@dataclass(frozen=True)
class RobotModel(Parameters):
    """How the body follows cmd_vel, and what the wheel encoders make of it."""

    max_speed: float = param(0.65, "m/s", above=0.0, high=5.0)
    max_turn_rate: float = param(3.14, "rad/s", above=0.0, high=20.0)
    acceleration: float = param(0.8, "m/s^2", above=0.0)
    deceleration: float = param(1.5, "m/s^2", above=0.0)
    turn_acceleration: float = param(4.0, "rad/s^2", above=0.0)
    command_timeout: float = param(0.16, "s", above=0.0, high=5.0)
    odometry_scale_sigma: float = param(0.005, "", low=0.0, high=0.2)
    odometry_distance_noise: float = param(0.005, "m/sqrt(m)", low=0.0)
    odometry_turn_noise: float = param(0.01, "rad/sqrt(rad)", low=0.0)
    odometry_drift_noise: float = param(0.01, "rad/sqrt(m)", low=0.0)


@dataclass(frozen=True)
class LocalizationModel(Parameters):
    """The error of the pose that AMCL would report: a slowly varying bias, correlated in time."""

    position_sigma: float = param(0.015, "m", low=0.0, high=1.0)
    yaw_sigma: float = param(0.012, "rad", low=0.0, high=1.0)
    correlation_time: float = param(15.0, "s", above=0.0)


@dataclass(frozen=True)
class ScanModel(Parameters):
    """A laser scanner above the robot's middle, which looks all round."""

    beams: int = param(360, "", low=4, high=1440)
    range_min: float = param(0.12, "m", low=0.0)
    range_max: float = param(8.0, "m", above=0.1)
    range_sigma: float = param(0.01, "m", low=0.0, high=1.0)
    height: float = param(0.3, "m", low=0.0)
    person_radius: float = param(0.15, "m", above=0.0, high=1.0)
