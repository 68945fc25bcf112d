"""Parameters of the simulated person. The sources of the defaults are in config/models.yaml."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Tuple

from vb_core.parameters import Parameters, param


@dataclass(frozen=True)
class ParticipantModel(Parameters):
    """How a person walks, points, speaks and reacts."""

    walking_speed: float = param(1.0, "m/s", above=0.0, high=3.0)
    turning_speed: float = param(3.0, "rad/s", above=0.0)
    body_radius: float = param(0.22, "m", above=0.0, high=1.0)
    reach: float = param(2.5, "m", above=0.5)
    reaction_time: float = param(0.35, "s", low=0.0, high=5.0)
    speaking_time: float = param(1.2, "s", low=0.0, high=10.0)
    drawing_speed: Tuple[float, float] = param((0.3, 0.5), "m/s", above=0.0, high=3.0)
    stroke_scale: float = param(0.0, "", low=0.0, high=3.0)
    tremor: float = param(0.010, "m", low=0.0, high=0.2)
    tremor_band: Tuple[float, float] = param((0.3, 3.0), "1/s", above=0.0, high=20.0)
    aim_sigma: float = param(0.010, "m", low=0.0, high=0.2)
    late_start: float = param(0.02, "m", low=0.0, high=0.5)
    overlap: float = param(0.05, "m", low=0.0, high=0.5)
    notice_time: float = param(0.35, "s", low=0.0, high=5.0)
    patience: float = param(10.0, "s", above=0.0)
    retries: int = param(3, "", low=0)
    seed_time: float = param(2.0, "s", low=0.0)
    tries: int = param(3, "", low=1)
    time_limit: float = param(300.0, "s", above=1.0)
    leading_speed: float = param(0.3, "m/s", above=0.0, high=2.0)
    leading_distance: float = param(0.9, "m", above=0.3)
    leading_distance_max: float = param(1.5, "m", above=0.3)
    robot_drawing_speed: float = param(0.2, "m/s", above=0.0, high=2.0)
    slip: float = param(0.0, "", low=0.0, high=1.0)
    slip_size: float = param(0.4, "m", above=0.0, high=2.0)
    wrong_side: float = param(0.0, "", low=0.0, high=1.0)
    wrong_word: float = param(0.0, "", low=0.0, high=1.0)
    look_time: float = param(0.0, "s", low=0.0, high=30.0)
