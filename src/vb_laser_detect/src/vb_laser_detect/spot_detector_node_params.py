"""The parameters of the node `spot_detector` for one camera."""

from __future__ import annotations

from dataclasses import dataclass

from vb_core.parameters import Parameters, param
from vb_laser_detect.camera.v4l2_controls import CaptureParams
from vb_laser_detect.detection.projection import ProjectionParams
from vb_laser_detect.detection.spot_detector import DetectorParams


def image_topic(camera: str, image: str) -> str:
    """Returns the topic of a camera's images, given its parameter `image`."""
    return image or f"{camera}/image_raw"


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
