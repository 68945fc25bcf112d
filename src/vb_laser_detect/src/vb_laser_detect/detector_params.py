"""A spot detector's parameters that a lab may set."""

from __future__ import annotations

from dataclasses import dataclass

from vb_core.parameters import Parameters, param
from vb_laser_detect.detection.projection import ProjectionParams


def image_topic(camera: str, image: str) -> str:
    """Returns the topic of a camera's images, given its parameter `image`."""
    return image or f"{camera}/image_raw"


@dataclass(frozen=True)
class DetectorParams(Parameters):
    """The detector's parameters, by default those of a stationary camera.

    config/stationary.yaml lists them with their meanings, config/mobile.yaml those that differ.
    """

    moving_camera: bool = param(False)
    confirm_frames: int = param(4, "frames", low=1, high=50, doc="number of images in which a spot must be seen")
    min_probability: float = param(
        0.5, "", above=0.0, high=0.999, doc="probability that the classifier must give to a spot"
    )
    max_diameter_mm: float = param(80.0, "mm", low=1.0, high=1000.0, doc="largest diameter of a spot on the floor")
    max_dwell_time: float = param(
        25.0, "s", low=10.0, high=3600.0, doc="time after which a light that stays in one place is a lamp, not a spot"
    )

    @classmethod
    def mobile(cls, **changes) -> "DetectorParams":
        """Returns the parameters for a camera on a robot."""
        return cls(**{**dict(moving_camera=True, confirm_frames=3), **changes})


@dataclass(frozen=True)
class CaptureParams(Parameters):
    """How a camera is read; see config/stationary.yaml."""

    width: int = param(1280, "px", low=0, high=16384)
    height: int = param(720, "px", low=0, high=16384)
    rate: float = param(0.0, "images/s", low=0.0, high=1000.0)
    pixel_format: str = param("mjpeg")
    delay_ms: float = param(0.0, "ms", low=0.0, high=5000.0, doc="time from an image to its arrival")
    exposure: int = param(0, "0.1 ms", low=0, high=100000, doc="a device's exposure time; 0: automatic")
    white_balance: int = param(0, "K", low=0, high=20000, doc="a device's white balance; 0: automatic")


@dataclass(frozen=True)
class SpotDetectorNodeParams(Parameters):
    """All parameters of the node; see config/*.yaml."""

    camera: str = param("")
    source: str = param("")
    settings: str = param("")
    image: str = param("")
    depth: str = param("")
    frame: str = param("")
    image_transport: str = param("raw", choices=("raw", "compressed"))
    robots: list = param([])
    detector: DetectorParams = param(DetectorParams())
    projection: ProjectionParams = param(ProjectionParams())
    capture: CaptureParams = param(CaptureParams())
