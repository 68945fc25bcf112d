"""The figures of the simulated cameras and of the laser, read from config/models.yaml.

The defaults here are the same as in that file, which gives their sources.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Mapping, Tuple, Union

import numpy as np

from vb_core.parameters import Parameters, param
from vb_sim.room.bodies import AVERAGE, BodyProportions
from vb_sim.room.models import MODELS, load_models, read_section


@dataclass(frozen=True)
class Optics(Parameters):
    """The laser on the floor and what lens, sensor and exposure make of it."""

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
        """Returns the share (3,) of the laser's light behind the red, green and blue filter."""
        return np.array(self.green_response if color == "green" else self.red_response)


@dataclass(frozen=True)
class CameraNoise(Parameters):
    """Noise of the ceiling cameras' sensors."""

    read_sigma: float = param(1.0, "grey levels", low=0.0, high=50.0)
    full_well_e: float = param(10000.0, "electrons", above=0.0)
    prnu: float = param(0.006, "", low=0.0, high=0.5)
    frames: int = param(5, "", low=1, high=32)

    def sigma(self, level: Any) -> Any:
        """Returns the standard deviation [grey levels] at a brightness [grey levels]: read noise and photon noise."""
        return np.sqrt(self.read_sigma**2 + np.maximum(level, 0.0) * 255.0 / self.full_well_e)


@dataclass(frozen=True)
class RobotCamera(Parameters):
    """Noise of the robot's colour and depth camera."""

    read_sigma: float = param(1.6, "grey levels", low=0.0, high=50.0)
    full_well_e: float = param(6000.0, "electrons", above=0.0)
    depth_min: float = param(0.4, "m", low=0.0)
    depth_max: float = param(4.5, "m", above=0.0)
    depth_sigma: float = param(0.0012, "m", low=0.0)
    depth_sigma_quadratic: float = param(0.0019, "1/m", low=0.0)
    depth_grazing_deg: float = param(80.0, "deg", low=0.0, high=90.0)
    depth_holes: float = param(0.004, "", low=0.0, high=1.0)
    depth_every: int = param(2, "frames", low=1, high=50)


@dataclass(frozen=True)
class CameraModels:
    """All sections that the cameras read."""

    optics: Optics = field(default_factory=Optics)
    noise: CameraNoise = field(default_factory=CameraNoise)
    robot_camera: RobotCamera = field(default_factory=RobotCamera)
    body: BodyProportions = field(default_factory=BodyProportions)

    @property
    def hand_height(self) -> float:
        """Height [m] at which this person holds the pointer."""
        return self.optics.pointer_height * self.body.height / AVERAGE.height


def load_camera_models(path: Union[str, Path] = MODELS) -> CameraModels:
    """Reads the sections `optics`, `camera_noise`, `robot_camera` and `body`; others belong to others.

    Raises:
        CodedError: "no_models" if there is no such file, "bad_models" if it is not YAML.
        ParameterError: names the key that is wrong.
    """
    return read_camera_models(load_models(path))


def read_camera_models(document: Mapping[str, Any]) -> CameraModels:
    """Reads the same sections of a document."""
    return CameraModels(
        read_section(document, "optics", Optics),
        read_section(document, "camera_noise", CameraNoise),
        read_section(document, "robot_camera", RobotCamera),
        read_section(document, "body", BodyProportions),
    )


def make_generator(seed: int, name: str) -> np.random.Generator:
    """Makes the random numbers of one thing of the world: the same for the same seed and name."""
    return np.random.default_rng([int(seed) & 0xFFFFFFFF, zlib.crc32(name.encode("utf-8"))])
