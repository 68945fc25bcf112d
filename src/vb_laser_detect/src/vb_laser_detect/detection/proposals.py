"""Regions worth examining: what became brighter than the scene was, for every camera.

One idea: a moving camera is a stationary one over a background that moves along (`background`); `image_registration`
estimates its motion. The first image of a scene is its background: what shines there may be a lamp, and only its motion
can tell. When a light is switched, the floor under a spot that was followed until then is known in the old light.
"""

from __future__ import annotations

import math
from typing import List, NamedTuple, Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_laser_detect.detection.background import Background
from vb_laser_detect.detection.blocks import BLOCK, Region, blocks_around, halve, find_regions
from vb_laser_detect.detection.features import relight
from vb_laser_detect.detector_params import DetectorParams
from vb_laser_detect.detection.image_registration import ImageRegistration, is_still
from vb_laser_detect.detection.tracking import Expected, Spot

_MIN_LEVEL = 0.86  # of what is bright in the room; no spot of a clip or scene is darker, 3 of 464 in clips set dark are
_MIN_CHANGE = 0.15  # of the same; what differs by less from the background is not examined, and becomes part of it
_DARKEST, _BRIGHTEST = 64.0, 191.0  # [grey levels] in black and in white rooms too a spot is told by its light
_WHITE = 235.0  # [grey levels] video's white: brighter regions are white alike
_MAX_REGIONS = 12  # regions: people who walk leave fewer, and examining more would take longer than an image lasts
_MAX_CHANGE = 0.15  # of the image became brighter, or twice as much darker: a light, nothing known holds any more


class Proposal(NamedTuple):
    """A region [px] to examine; which expected spot may be in it; why it is not examined."""

    region: Region
    expected: Optional[Expected] = None
    rejection: str = ""

    @property
    def middle(self) -> Tuple[float, float]:
        """The region's middle (u, v) [px]."""
        left, top, right, bottom = self.region
        return (left + right) / 2.0, (top + bottom) / 2.0


class SearchedImage(NamedTuple):
    """An image, and what is known of the scene.

    Attributes:
        reference: what the image would show without a spot where it is examined, the same shape.
        proposals: the most promising first.
        rise: (rows, columns) uint8, of each block; changed: bool, those that became brighter or darker.
        bright: [grey levels] what is bright in this room, see `ImageTraits`.
    """

    image: np.ndarray
    reference: np.ndarray
    proposals: Sequence[Proposal]
    rise: np.ndarray
    changed: np.ndarray
    bright: float

    def change_elsewhere(self, u: float, v: float, diameter: float) -> float:
        """Measures how much else changed in the image, apart from a blob and its own light."""
        own = blocks_around(self.changed.shape, u, v, 1.25 * diameter + BLOCK)
        return math.sqrt((np.count_nonzero(self.changed) - np.count_nonzero(self.changed[own])) / self.changed.size)


class Proposer:
    """Finds regions in one camera's images, and keeps its background.

    Attributes:
        params: the detector's; they may be changed between images.
    """

    def __init__(self, params: DetectorParams) -> None:
        self.params = params
        # if the camera may move its motion is found in the images
        self._registration = ImageRegistration() if params.moving_camera else None
        self._background: Optional[Background] = None
        self._motion = np.eye(3)  # from the background's pixels to the last image's
        self._half: Optional[np.ndarray] = None

    def estimate_motion(self, image: np.ndarray) -> Optional[np.ndarray]:
        """Estimates how the camera moved since the last image, (3, 3); None if that is not known. Call it before `propose`."""
        if self._registration is None:
            return None
        self._half = halve(image)
        found, before = self._registration.motion_to(image, self._half), self._motion
        # while it is not known the camera is taken to be where it was
        if found is None:
            return None
        self._motion = np.eye(3) if is_still(found, image.shape) else found
        return self._motion @ cv2.invert(before)[1]

    def propose(self, image: np.ndarray, expected: Sequence[Expected]) -> SearchedImage:
        """Compares an image with the background.

        Args:
            expected: where spots should be.
        """
        if self._background is not None:
            still = np.array_equal(self._motion, np.eye(3))
            rise, hot, darker = self._changes(
                *self._background.subtract_background(image, None if still else self._motion, self._half)
            )
            banded = self._background.subtract_bands(image) if still and _much(hot, darker) else None
            if banded is not None:
                rise, hot, darker = self._changes(*banded)
        if self._background is None or _much(hot, darker):
            self._start(image, expected)
            rise, fall = self._background.subtract_background(image, None)
            hot, darker = rise >= self._least_change, fall > self._least_change
        background = self._background
        proposals = self._rank(image, find_regions(rise, hot, 4 * _MAX_REGIONS), expected)
        background.refine_reference([one.region for one in proposals if not one.rejection], image)
        # while the camera moves, what became darker is taken from the image at once
        changed = hot if background.motion is not None else hot | darker
        return SearchedImage(image, background.reference, proposals, rise, changed, self._bright)

    def _changes(self, rise: np.ndarray, fall: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns the blocks' rise, and which of them became brighter than noise does, and darker, bool."""
        least = self._least_change
        return rise, self._background.foreground_blocks(rise, least), fall > least

    def _rank(
        self, image: np.ndarray, found: Sequence[Tuple[Region, float]], expected: Sequence[Expected]
    ) -> List[Proposal]:
        """Proposals of regions with their rise.

        Those where a spot is expected come first. A spot shows the camera's white wherever it falls; by how much it
        rises depends on the floor, and on a bright one a person beside it rises more. So white regions come next,
        among them those that rose most.
        """
        rated = []
        for region, peak in found:
            left, top, right, bottom = region
            part = image[top:bottom, left:right]
            # columns and channels side by side: the brightest sample is all that counts
            rated.append((region, cv2.minMaxLoc(part.reshape(part.shape[0], -1))[1], peak))
        rated.sort(key=lambda one: (-min(one[1], _WHITE), -one[2]))
        proposals = []
        # most of what a person's clothes leave is found too large at once, and must not use up all places
        for region, level, _ in rated[: 2 * _MAX_REGIONS]:
            spot = next((one for one in expected if one.overlaps(region)), None)
            proposals.append(Proposal(region, spot, "" if level >= _MIN_LEVEL * self._bright else "too_dark"))
        # published ones, other expected ones, the rest
        return sorted(
            proposals, key=lambda one: 2 if one.rejection or one.expected is None else int(not one.expected.published)
        )

    def _start(self, image: np.ndarray, expected: Sequence[Expected]) -> None:
        """Begins a background. A spot is no floor: where one is expected, the background before is taken in the new light."""
        floor = image.copy()
        for one in expected:
            rows, columns = blocks_around(self._background.blocks, one.u, one.v, one.reach + one.widest)
            part = slice(BLOCK * rows.start, BLOCK * rows.stop), slice(BLOCK * columns.start, BLOCK * columns.stop)
            if image[part].size:
                floor[part] = relight(self._background.moved_part(part, image), image[part], one.widest)
        self._background = Background(floor)
        self._begin()

    def _begin(self) -> None:
        """Makes the last image the background's keyframe."""
        self._motion = np.eye(3)
        if self._registration is not None:
            self._registration.set_keyframe()

    @property
    def _bright(self) -> float:
        """What is bright in the room [grey levels]: between a dark picture's spot and white itself."""
        return min(max(self._background.bright, _DARKEST), _BRIGHTEST)

    @property
    def _least_change(self) -> float:
        """What has changed differs by more than this [grey levels]."""
        return _MIN_CHANGE * self._bright

    def update_background(self, view: SearchedImage, spots: Sequence[Spot], elapsed: float) -> None:
        """Adds an image, except some spots.

        Args:
            elapsed: [s] since the last image.
        """
        held = np.zeros_like(view.changed)
        for spot in spots:
            held[blocks_around(held.shape, spot.u, spot.v, 1.25 * spot.diameter + BLOCK)] = True
        if self._background.update(view.image, view.rise, view.changed, held, elapsed):
            self._begin()


def _much(hot: np.ndarray, darker: np.ndarray) -> bool:
    """Returns whether so much changed that nothing known holds any more.

    A person close to the camera darkens much of the image too, and must not become its background.
    """
    return max(np.count_nonzero(hot), 0.5 * np.count_nonzero(darker)) > _MAX_CHANGE * hot.size
