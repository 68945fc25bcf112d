"""Types passed between the stages of the detection, in the order in which they are made.

The tracker makes `ExpectedSpot` and, in the end, `DetectionResult`. Positions and regions are in pixels of the full
image, even if it is searched at half its size.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple, Optional, Sequence, Tuple

import numpy as np

from vb_core.errors import CodedError
from vb_core.image_format import AnyPicture

BLOCK = 8  # [px] edge of a block; whole images are compared by blocks
Box = Tuple[int, int, int, int]  # left, top, right, bottom [px]; right and bottom are excluded
Part = Tuple[slice, slice]  # rows and columns [px]
Motion = Optional[np.ndarray]  # (3, 3) maps an image's pixels to a later one's; None: the camera was stationary


class ExpectedSpot(NamedTuple):
    """Where a confirmed spot should be in the next image if it keeps moving as before."""

    position: Tuple[float, float]  # (u, v) [px]
    reach: float  # [px] radius round `position` in which to look for it
    max_width: float  # [px] width above which light cannot be the spot


@dataclass(frozen=True, eq=False)
class Comparison:
    """How an image differs from the background.

    Attributes:
        rise: (rows, columns) uint8, each block's largest rise above the reference.
        brighter, darker: (rows, columns) bool, blocks that clearly became so.
        reference: what the image was compared with: the background as moved and lit in it.
        motion: the camera's motion since the background.
    """

    rise: np.ndarray
    brighter: np.ndarray
    darker: np.ndarray
    reference: np.ndarray
    motion: Motion = None

    @cached_property
    def changed(self) -> np.ndarray:
        """(rows, columns) bool, blocks that became brighter or darker."""
        return self.brighter | self.darker


class ChangedRegion(NamedTuple):
    """A part of an image that became brighter, and must be examined.

    Attributes:
        boxes: the boxes to search: the whole region, then the part where a spot is expected. A dark region has none.
        expected: the spot that should be in the region, if there is one.
    """

    box: Box
    boxes: Sequence[Box]
    expected: Optional[ExpectedSpot]


class SearchedImage(NamedTuple):
    """An image, and what is new in it.

    Attributes:
        diagonal: [px] diagonal of the picture.
        bright_level: [grey levels] of the room's bright surfaces at the current exposure; spots are judged relative to it.
        min_level: [grey levels] lowest level of a spot's brightest sample.
        regions: regions to examine, the brightest first.
        reference: what the searched pixels would show without anything new.
        shifted: whether the camera has moved since the reference was taken.
        changed: (rows, columns) bool, blocks that became brighter or darker.
        ghost_s: (rows, columns) [s] time for which a block may still show the ghost of an object other than a spot.
    """

    picture: AnyPicture
    diagonal: float
    bright_level: float
    min_level: float
    regions: Sequence[ChangedRegion]
    reference: np.ndarray
    shifted: bool
    changed: np.ndarray
    ghost_s: np.ndarray


@dataclass(frozen=True)
class FloorPoint:
    """A point on the floor."""

    position: np.ndarray  # (3,) [m], map frame; z is the height that was measured
    meters_per_pixel: float  # [m/px] floor length of a pixel there
    source: str  # `projection.GROUND_PLANE`, `DEPTH` or `GROUND_PLANE_FALLBACK`


@dataclass(frozen=True)
class Spot:
    """A laser spot in an image, or a rejected candidate.

    Attributes:
        u, v: [px] column and row, sub-pixel; the centre of the first pixel is 0.
        diameter: [px]
        confidence: 0 ... 1
        track: number of the spot in this camera's images; it stays while the spot is followed.
        rejection: code of the reason why it is not published, or "".
        tint: see `features.BlobLight.tint`; None: without colour, or rejected.
        stamp: [s] time of the image; 0 until the spot is tracked.
        floor_point: its position on the floor; None if camera or pose are unknown.
    """

    u: float
    v: float
    diameter: float
    confidence: float = 0.0
    track: int = 0
    rejection: str = ""
    tint: Optional[np.ndarray] = field(default=None, compare=False)
    stamp: float = 0.0
    floor_point: Optional[FloorPoint] = field(default=None, compare=False)


class DetectionResult(NamedTuple):
    """The result of one image.

    Attributes:
        spots: confirmed spots, oldest first. At most one is the image's own; when a stroke begins, those of earlier images
            come before it, with their own stamps and positions.
        candidates: all that was examined in the image; `rejection` says why it is no spot, or why it is not published.
        lamp_count: number of published tracks that turned out to be lamps.
        is_late: whether the image was left out because it came after a later one.
        pose_error: why the camera's pose is unknown, if it was needed; no spot of the image is then accepted.
    """

    spots: Sequence[Spot] = ()
    candidates: Sequence[Spot] = ()
    lamp_count: int = 0
    is_late: bool = False
    pose_error: Optional[CodedError] = None
