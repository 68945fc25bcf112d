"""A spot detector's parameters that a lab may set."""
from __future__ import annotations

from dataclasses import dataclass

from vb_core.parameters import Parameters, param


@dataclass(frozen=True)
class DetectorParams(Parameters):
    """The defaults are those of a stationary camera; config/*.yaml holds only what differs, with reasons."""

    moving_camera: bool = param(False, doc="the camera may move: its motion is told from the images")
    confirm_frames: int = param(4, "frames", low=1, high=50, doc="a spot must be seen in so many; 1: each image by itself")
    max_spots: int = param(1, "", low=1, high=20, doc="at most so many spots per frame")
    min_rise: float = param(18.0, "grey levels", low=2.0, high=255.0, doc="of a block that is looked at closely")
    min_probability: float = param(0.5, "", above=0.0, high=0.999, doc="the classifier's, for a spot")
    classifier: str = param("", doc="file of a classifier trained for this camera; empty: the one that comes with it")
    min_diameter_mm: float = param(3.0, "mm", low=0.0, high=1000.0, doc="on the floor, where the pose is known")
    max_diameter_mm: float = param(80.0, "mm", low=1.0, high=1000.0, doc="on the floor, where the pose is known")
    hold_s: float = param(25.0, "s", low=10.0, high=3600.0, doc="a spot that shines so long on one place is a lamp")

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_order("min_diameter_mm", "max_diameter_mm")

    @classmethod
    def stationary(cls, **changes) -> "DetectorParams":
        """For a camera that does not move."""
        return cls(**changes)

    @classmethod
    def mobile(cls, **changes) -> "DetectorParams":
        """For a camera on a robot."""
        return cls(**{**dict(moving_camera=True, confirm_frames=3), **changes})
