"""The parameters of the simulated sensors, robots and people, one class for each section of config/models.yaml.

The defaults are the values in that file, which gives their sources.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Tuple

import numpy as np
import rospkg
import yaml

from vb_core.errors import CodedError
from vb_core.parameters import Parameters, param

MODELS_FILE = Path(rospkg.RosPack().get_path("vb_sim")) / "config" / "models.yaml"


@dataclass(frozen=True)
class RobotModel(Parameters):
    """How a robot follows cmd_vel, and the errors of its odometry."""

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
    """The slowly varying error of the pose that AMCL would report."""

    position_sigma: float = param(0.015, "m", low=0.0, high=1.0)
    yaw_sigma: float = param(0.012, "rad", low=0.0, high=1.0)
    correlation_time: float = param(15.0, "s", above=0.0)


@dataclass(frozen=True)
class ScanModel(Parameters):
    """A laser scanner above the robot's centre that scans 360 degrees."""

    beams: int = param(360, "", low=4, high=1440)
    range_min: float = param(0.12, "m", low=0.0)
    range_max: float = param(8.0, "m", above=0.1)
    range_sigma: float = param(0.01, "m", low=0.0, high=1.0)
    height: float = param(0.3, "m", low=0.0)
    person_radius: float = param(0.15, "m", above=0.0, high=1.0)


@dataclass(frozen=True)
class Optics(Parameters):
    """The laser on the floor, and the effects of lens, sensor and exposure."""

    laser_power_mw: float = param(1.0, "mW", low=0.0, high=100.0)
    beam_diameter_mm: float = param(3.0, "mm", above=0.0, high=50.0)
    divergence_mrad: float = param(1.0, "mrad", low=0.0, high=50.0)
    pointer_height: float = param(1.15, "m", above=0.0)
    red_response: Tuple[float, float, float] = param((1.0, 0.06, 0.03), "", low=0.0, high=1.0)
    green_response: Tuple[float, float, float] = param((0.08, 1.0, 0.12), "", low=0.0, high=1.0)
    ambient_w_m2: float = param(0.33, "W/m^2", above=0.0)
    white_level: float = param(230.0, "grey levels", above=0.0, high=255.0)
    exposure_ms: float = param(10.0, "ms", above=0.0, high=40.0)
    exposure_gain: float = param(1.0, "", above=0.0, high=10.0)
    latency_ms: float = param(15.0, "ms", low=0.0, high=200.0)
    psf_sigma_px: float = param(0.7, "px", low=0.1, high=10.0)
    halo_share: float = param(0.06, "", low=0.0, high=1.0)
    halo_scale_px: float = param(3.0, "px", above=0.1, high=50.0)
    vignetting: float = param(0.22, "", low=0.0, high=1.0)
    calibration_points: int = param(8, "", low=4, high=100)
    calibration_point_m: float = param(0.011, "m", low=0.0, high=1.0)

    def response(self, color: str) -> np.ndarray:
        """Returns the share (3,) of the laser's light that passes the red, green and blue filters."""
        return np.array(self.green_response if color == "green" else self.red_response)


@dataclass(frozen=True)
class CameraNoise(Parameters):
    """Noise of the ceiling cameras' sensors."""

    read_sigma: float = param(1.0, "grey levels", low=0.0, high=50.0)
    full_well_e: float = param(10000.0, "electrons", above=0.0)
    prnu: float = param(0.006, "", low=0.0, high=0.5)

    def sigma(self, level: Any) -> Any:
        """Returns the standard deviation of read and photon noise [grey levels] at a brightness [grey levels]."""
        return np.sqrt(self.read_sigma**2 + np.maximum(level, 0.0) * 255.0 / self.full_well_e)


@dataclass(frozen=True)
class RobotCamera(Parameters):
    """Noise and limits of the robot's colour and depth camera."""

    read_sigma: float = param(1.6, "grey levels", low=0.0, high=50.0)
    full_well_e: float = param(6000.0, "electrons", above=0.0)
    depth_min: float = param(0.4, "m", low=0.0)
    depth_max: float = param(4.5, "m", above=0.0)
    depth_sigma: float = param(0.0012, "m", low=0.0)
    depth_sigma_quadratic: float = param(0.0019, "1/m", low=0.0)
    depth_grazing_deg: float = param(80.0, "deg", low=0.0, high=90.0)
    depth_holes: float = param(0.004, "", low=0.0, high=1.0)


@dataclass(frozen=True)
class BodyProportions(Parameters):
    """A person's height and breadth."""

    height: float = param(1.75, "m", low=1.0, high=2.3)
    breadth: float = param(1.0, "", low=0.5, high=2.0)


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


@dataclass(frozen=True)
class Models(Parameters):
    """All sections."""

    robot: RobotModel = param(RobotModel())
    localisation: LocalizationModel = param(LocalizationModel())
    scan: ScanModel = param(ScanModel())
    optics: Optics = param(Optics())
    camera_noise: CameraNoise = param(CameraNoise())
    robot_camera: RobotCamera = param(RobotCamera())
    body: BodyProportions = param(BodyProportions())
    participant: ParticipantModel = param(ParticipantModel())

    @property
    def hand_height(self) -> float:
        """Height [m] at which the person holds the pointer."""
        return self.optics.pointer_height * self.body.height / BodyProportions().height


def load_models() -> Models:
    """Reads this package's models file. Omitted keys have their defaults.

    Raises:
        CodedError: "no_models" or "bad_models"; see `read_document`.
        ParameterError: names the wrong key and its section.
    """
    return Models.from_mapping(read_document(MODELS_FILE, "models"))


def read_document(path: Path, kind: str) -> Any:
    """Reads a YAML file. Returns None if it is empty.

    Args:
        kind: the kind of document, for instance "world", named in codes and sentences.

    Raises:
        CodedError: "no_<kind>" if there is no such file, "bad_<kind>" if it is not YAML.
    """
    try:
        return yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CodedError(f"no_{kind}", f"cannot read the {kind} file '{path}': {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        mark = getattr(error, "problem_mark", None)
        line = f" in line {mark.line + 1}" if mark else ""
        raise CodedError(f"bad_{kind}", f"the {kind} file '{path}' is not valid YAML{line}") from None


def make_generator(seed: int, name: str) -> np.random.Generator:
    """Creates the random generator of one part of the world, which depends on seed and name only."""
    return np.random.default_rng([int(seed) & 0xFFFFFFFF, zlib.crc32(name.encode("utf-8"))])
