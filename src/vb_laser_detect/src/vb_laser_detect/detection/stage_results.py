"""What the stages of the search hand on, in this order: `Expected` by the tracker, `SearchedImage` by the proposer, `Spot` by
those that measure and locate, `Detection` by the tracker.

Positions and regions are in the image's own pixels, even if it is searched at half its size.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import List, NamedTuple, Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_core.image_format import AnyPicture

Box = Tuple[int, int, int, int]  # left, top, right, bottom [px]; right and bottom are excluded


class Expected(NamedTuple):
    """Predicted position of a confirmed spot in the next image, if it keeps moving as before.

    Attributes:
        last: (u, v) [px] where it was last seen.
        step: (u, v) [px] by which it should have moved since.
        reach: [px] around its position.
        max_width: [px] anything wider cannot be the spot.
    """

    last: Tuple[float, float]
    step: Tuple[float, float]
    reach: float
    max_width: float

    @property
    def place(self) -> Tuple[float, float]:
        """(u, v) [px] where it should be now."""
        return self.last[0] + self.step[0], self.last[1] + self.step[1]

    def moved(self, motion: np.ndarray) -> "Expected":
        """Returns where it is expected once the camera's motion (3, 3) has moved the image."""
        return self._replace(last=cv2.perspectiveTransform(np.array([[self.last]]), motion)[0, 0].tolist())

    def holds(self, u: float, v: float) -> bool:
        """Returns whether a place [px] is within reach."""
        return math.hypot(u - self.place[0], v - self.place[1]) <= self.reach

    def clip(self, box: Box) -> Box:
        """Returns the part of a box that is within reach; if none is, left >= right or top >= bottom."""
        (left, top, right, bottom), (u, v), reach = box, self.place, self.reach
        left, top = max(left, int(u - reach)), max(top, int(v - reach))
        return left, top, min(right, int(u + reach) + 1), min(bottom, int(v + reach) + 1)

    def overlaps(self, box: Box) -> bool:
        """Returns whether a part of a box is within reach."""
        left, top, right, bottom = self.clip(box)
        return left < right and top < bottom


class Region(NamedTuple):
    """A part of an image that became brighter, to be examined.

    Attributes:
        bright: whether anything in it may be bright enough for a spot.
        expected: the spot that should be in it, if any.
    """

    box: Box
    bright: bool
    expected: Optional[Expected]

    def boxes(self) -> List[Box]:
        """Returns where to look for a spot: in the whole region, then where one is expected; nowhere if it is dark."""
        boxes = [self.box] if self.expected is None else [self.box, self.expected.clip(self.box)]
        return boxes if self.bright else []


class SearchedImage(NamedTuple):
    """An image, and what is new in it.

    Attributes:
        diagonal: [px] of the picture.
        bright: [grey levels] of the room's bright surfaces, at the current exposure; spots are judged relative to it.
        min_level: [grey levels] of a spot's brightest sample, at least.
        regions: to examine, the brightest first.
        reference: what the picture would show without anything new; None if no region is bright.
        motion: (3, 3) from the last image's pixels to this one's; None if the camera stands still, or it is unknown.
        shifted: whether the camera has moved since the reference was taken.
        changed: (rows, columns) bool, blocks that became brighter or darker.
        ghost_s: (rows, columns) [s] for how long anything but a spot that changed a block may still leave a ghost there.
    """

    picture: AnyPicture
    diagonal: float
    bright: float
    min_level: float
    regions: Sequence[Region]
    reference: Optional[np.ndarray]
    motion: Optional[np.ndarray]
    shifted: bool
    changed: np.ndarray
    ghost_s: np.ndarray


@dataclass(frozen=True)
class FloorPoint:
    """A point on the floor.

    Attributes:
        position: (3,) [m], map frame; z is the height that was measured.
        meters_per_pixel: [m/px] floor length of a pixel there.
        source: `projection.GROUND_PLANE`, `DEPTH` or `GROUND_PLANE_FALLBACK`.
        range: [m] from the camera.
    """

    position: np.ndarray
    meters_per_pixel: float
    source: str
    range: float


@dataclass(frozen=True)
class Spot:
    """A laser spot in an image, or a rejected candidate.

    Attributes:
        u, v: [px] column and row, sub-pixel; the centre of the first pixel is 0.
        diameter: [px]
        confidence: 0 ... 1
        track: number of the spot in this camera's images; it stays while the spot is followed.
        rejection: why it is not published, or "".
        tint: see `features.Light.tint`; None: without colour, or rejected.
        stamp: [s] when the image was taken; 0 until the spot is tracked.
        floor_point: where it is on the floor; None if camera or pose are not known.
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


class Detection(NamedTuple):
    """What became of one image.

    Attributes:
        spots: that it confirmed, oldest first: at most one of the image itself and, when a stroke begins, those of
            earlier images, with their own stamps and positions.
        candidates: all that was examined in the image; each says why it is no spot, or is not published.
        lamps: number of lights that have rested for too long, but had been published as the spot.
        is_late: whether the image was left out because it came after a later one.
    """

    spots: Sequence[Spot] = ()
    candidates: Sequence[Spot] = ()
    lamps: int = 0
    is_late: bool = False
