"""A spot detector's parameters that a lab may set."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Mapping

from vb_core.parameters import Parameters, param
from vb_laser_detect.detection.projection import ProjectionParams


@dataclass(frozen=True)
class SpotDetectorNodeParams(Parameters):
    """The node's own parameters; see config/*.yaml."""

    camera: str = param("")
    image: str = param("")
    depth: str = param("")
    frame: str = param("")
    image_transport: str = param("raw", choices=("raw", "compressed"))
    ignore_regions: list = param([], "m")
    robots: list = param([])


@dataclass(frozen=True)
class DetectorParams(Parameters):
    """The detector's parameters, by default those of a stationary camera.

    config/stationary.yaml lists them with their meanings, config/mobile.yaml those that differ.
    """

    moving_camera: bool = param(False)
    confirm_frames: int = param(4, "frames", low=1, high=50, doc="number of images in which a spot must be seen")
    difference_threshold: float = param(
        18.0,
        "grey levels",
        low=2.0,
        high=255.0,
        doc="difference from the background above which a block of pixels is examined",
    )
    min_probability: float = param(
        0.5, "", above=0.0, high=0.999, doc="probability that the classifier must give to a spot"
    )
    classifier: str = param("")
    min_diameter_mm: float = param(3.0, "mm", low=0.0, high=1000.0, doc="smallest diameter of a spot on the floor")
    max_diameter_mm: float = param(80.0, "mm", low=1.0, high=1000.0, doc="largest diameter of a spot on the floor")
    max_dwell_time: float = param(
        25.0, "s", low=10.0, high=3600.0, doc="time after which a light that stays in one place is a lamp, not a spot"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_order("min_diameter_mm", "max_diameter_mm")

    @classmethod
    def stationary(cls, **changes) -> "DetectorParams":
        """Returns the parameters for a camera that does not move."""
        return cls(**changes)

    @classmethod
    def mobile(cls, **changes) -> "DetectorParams":
        """Returns the parameters for a camera on a robot."""
        return cls(**{**dict(moving_camera=True, confirm_frames=3), **changes})


# the parameters of a node that are below a separate key
GROUPS = {"detector": DetectorParams, "projection": ProjectionParams}


def check(values: Mapping[str, Any], where: str) -> None:
    """Checks all parameters of a spot detector, before it is started with them.

    Args:
        values: as a YAML file holds them.
        where: put before the key in errors.

    Raises:
        ParameterError: for an unknown key, a wrong type, a value out of range.
    """
    SpotDetectorNodeParams.from_mapping(values, where, tuple(GROUPS))
    for name, group in GROUPS.items():
        group.from_mapping(values.get(name), f"{where.rstrip('/')}/{name}")
