"""What a spot looks like and how it behaves, in figures."""
from __future__ import annotations

from dataclasses import dataclass

from vb_core.parameters import Parameters, param


NEVER, BAYER, ALWAYS = "never", "bayer", "always"


@dataclass(frozen=True)
class DetectorParams(Parameters):
    """What a spot looks like and how it behaves. See config/*.yaml for the reasons."""

    moving_camera: bool = param(False, doc="the camera moves: no background is learnt")
    confirm_frames: int = param(4, "frames", low=1, high=50, doc="a spot must be seen in so many; 1: at once")
    max_spots: int = param(1, "", low=1, high=20, doc="at most so many spots per frame, the most certain ones")
    min_rise: float = param(18.0, "grey levels", low=2.0, high=255.0, doc="a block's rise that is looked at")
    # limits of `judgement`: what alone refuses a candidate
    min_peak: float = param(22.0, "grey levels", low=1.0, high=255.0, doc="a spot's own rise, smoothed")
    min_rise_unsaturated: float = param(60.0, "grey levels", low=1.0, high=255.0, doc="of a pixel, if none saturates")
    # 255 stands for the camera's white
    min_level: float = param(190.0, "grey levels", low=0.0, high=255.0, doc="the brightest pixel of a spot")
    max_elongation: float = param(3.2, "", low=1.0, high=20.0, doc="longest over shortest axis")
    min_compactness: float = param(0.78, "", low=0.0, high=1.0)
    max_flatness: float = param(0.6, "", low=0.0, high=1.0, doc="of spots that do not saturate the sensor")
    max_surround: float = param(0.27, "", low=0.0, high=1.0)
    min_contrast: float = param(0.15, "", low=-1.0, high=1.0)
    max_contrast: float = param(1.7, "", low=1.0, high=100.0)
    min_likeness: float = param(-0.1, "", low=-1.0, high=1.0)
    min_edge: float = param(0.4, "", low=0.0, high=1.0, doc="of spots up to 24 px")
    min_edge_large: float = param(0.55, "", low=0.0, high=1.0, doc="of spots from 48 px on")
    max_darker: float = param(0.25, "", low=0.0, high=1.0)
    max_busy: float = param(0.3, "of the image", low=0.0, high=1.0, doc="change elsewhere")
    max_neighbours: int = param(80, "blocks", low=0, high=1000, doc="brighter blocks within 6 blocks of the spot")
    # limits that refuse whatever the rest looks like
    ask_colour: str = param("bayer", choices=(NEVER, BAYER, ALWAYS), doc="of which images a spot must be coloured")
    min_chroma: float = param(0.4, "", low=0.0, high=1.0, doc="how coloured its light must be then")
    min_diameter_mm: float = param(3.0, "mm", low=0.0, high=1000.0, doc="on the floor, where the pose is known")
    max_diameter_mm: float = param(80.0, "mm", low=1.0, high=1000.0, doc="on the floor, where the pose is known")
    min_diameter_px: float = param(2.5, "px", low=0.0, high=1000.0, doc="smaller blobs are noise")
    max_diameter_share: float = param(0.09, "of the image's diagonal", low=0.001, high=1.0, doc="where no pose is known")
    # how it moves, and what is learnt
    max_speed: float = param(8.0, "m/s", above=0.0, high=100.0, doc="of a spot on the floor")
    max_gap_s: float = param(0.25, "s", low=0.0, high=10.0, doc="a spot may be hidden so long")
    max_change: float = param(0.3, "of the image", low=0.01, high=1.0, doc="brighter, or twice as much darker: learn anew")
    cycle_s: float = param(1.0, "s", above=0.0, high=60.0, doc="the background takes in each pixel once per cycle")
    absorb_s: float = param(1.5, "s", low=0.1, high=60.0, doc="a change that lasts so long becomes background")
    hold_s: float = param(25.0, "s", low=10.0, high=3600.0, doc="a spot that shines so long on one place is a lamp")
    max_candidates: int = param(12, "", low=1, high=200, doc="looked at per frame, the brightest ones")

    def __post_init__(self) -> None:
        super().__post_init__()
        for low, high in (("min_diameter_mm", "max_diameter_mm"), ("min_contrast", "max_contrast"), ("absorb_s", "hold_s")):
            self.require_order(low, high)

    @classmethod
    def stationary(cls, **changes) -> "DetectorParams":
        """For a camera that does not move."""
        return cls(**changes)

    @classmethod
    def mobile(cls, **changes) -> "DetectorParams":
        """For a camera on a robot. There is no background to tell paper from light: the light's colour has to."""
        return cls(**{**dict(moving_camera=True, confirm_frames=3, min_rise=30.0, min_level=225.0,
                             ask_colour=ALWAYS, min_chroma=0.2), **changes})
