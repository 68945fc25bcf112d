"""Regions worth examining: what became brighter than the scene was, for every camera.

One idea: a moving camera is a stationary one over a background that moves along (`background`); `image_registration`
estimates its motion. The first image of a scene is its background: what shines there may be a lamp, and only its motion
can tell. When a light is switched, the floor under a spot that was followed until then is known in the old light.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_core.image_format import AnyPicture
from vb_laser_detect.detection.background import BLOCK, GHOST_TIME, Background, Region, blocks_around, find_regions
from vb_laser_detect.detection.features import brightest, relight
from vb_laser_detect.detector_params import DetectorParams
from vb_laser_detect.detection.image_registration import ImageRegistration
from vb_laser_detect.detection.tracking import Expected, Spot

_MIN_CHANGE = 0.15  # of what is bright in the room; what differs by less from the background becomes part of it
_DARKEST, _BRIGHTEST = (
    64.0,
    191.0,
)  # [grey levels] the reference brightness stays within them in very dark and very bright rooms
_HALF_LEVEL = 0.8  # of its level, at least, a spot of few pixels has left in the half of an image
_UNSEEN = 1.0  # [s] between two images, in which a hand takes something away
_MAX_REGIONS = 24  # people who walk leave fewer, and examining more would take longer than an image lasts
_MAX_CHANGE = 0.15  # of the image became brighter, or twice as much darker: the light was switched, so it starts again


class SearchedImage(NamedTuple):
    """An image, and what is known of the scene. Places and regions are the picture's own pixels, whatever is searched.

    Attributes:
        background: what the picture is compared with.
        regions: to examine, the brightest first.
        rise: (rows, columns) uint8, of each block; changed: bool, those that became brighter or darker; restless: bool, those
            that something other than a spot changed so short a time ago that it may have left a ghost there.
        bright: [grey levels] what is bright in this room, see `ImageTraits`.
    """

    picture: AnyPicture
    background: Background
    regions: Sequence[Region]
    rise: np.ndarray
    changed: np.ndarray
    restless: np.ndarray
    bright: float

    @property
    def edge(self) -> int:
        """Of a block [px]."""
        return BLOCK * self.picture.scale

    def brightest(self, region: Region) -> float:
        """Returns how bright [grey levels] the brightest sample of a region is, or may be while only a half is decoded."""
        if self.picture.whole:
            return brightest(self.picture.pixels, region)
        return brightest(self.picture.searched, tuple(side // self.picture.scale for side in region)) / _HALF_LEVEL

    def change_elsewhere(self, u: float, v: float, diameter: float) -> float:
        """Measures how much else changed in the image, apart from a blob and its own light."""
        own = blocks_around(self.changed.shape, u, v, 1.25 * diameter + self.edge, self.edge)
        return math.sqrt((np.count_nonzero(self.changed) - np.count_nonzero(self.changed[own])) / self.changed.size)

    def was_passed(self, u: float, v: float, diameter: float) -> bool:
        """Returns whether something else moved beside a blob so short a time ago that the blob may be its ghost."""
        reach = 1.25 * diameter + self.edge
        own, around = (
            np.count_nonzero(self.restless[blocks_around(self.restless.shape, u, v, size, self.edge)])
            for size in (reach, 2.0 * reach)
        )
        return around > own


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

    def estimate_motion(self, image: np.ndarray) -> Optional[np.ndarray]:
        """Estimates how the camera moved since the last image, (3, 3); None if that is not known. Call it before `propose`."""
        if self._registration is None:
            return None
        found, before = self._registration.motion_to(image), self._motion
        # while it is not known the camera is taken to be where it was
        if found is None:
            return None
        self._motion = found
        return self._motion @ cv2.invert(before)[1]

    def propose(self, picture: AnyPicture, expected: Sequence[Expected]) -> SearchedImage:
        """Compares a picture with the background.

        Args:
            expected: where spots should be.
        """
        image = picture.searched
        if self._background is not None:
            still = np.array_equal(self._motion, np.eye(3))
            rise, hot, darker = self._changes(
                *self._background.subtract_background(image, None if still else self._motion)
            )
            banded = self._background.subtract_bands(image) if still and _much(hot, darker) else None
            if banded is not None:
                rise, hot, darker = self._changes(*banded)
        if self._background is None or _much(hot, darker):
            self._start(picture, expected)
            rise, fall = self._background.subtract_background(image, None)
            hot, darker = rise >= self._least_change, fall > self._least_change
        # a spot shows the camera's white wherever it falls; by how much it rises depends on the floor, and on a bright one a
        # person beside it rises more
        regions = sorted(find_regions(rise, hot), key=lambda region: -brightest(image, region))[:_MAX_REGIONS]
        regions = [_in_picture(region, picture) for region in regions]
        return SearchedImage(
            picture, self._background, regions, rise, hot | darker, self._restless_s > 0.0, self._bright
        )

    def _changes(self, rise: np.ndarray, fall: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns the blocks' rise, and which of them became brighter than noise does, and darker, bool."""
        least = self._least_change
        return rise, self._background.foreground_blocks(rise, least), fall > least

    def _start(self, picture: AnyPicture, expected: Sequence[Expected]) -> None:
        """Begins a background. A spot is no floor: where one is expected, the background before is taken in the new light."""
        edge, before = BLOCK * picture.scale, self._background
        floors = [picture.searched.copy()] + ([picture.pixels.copy()] if picture.scale > 1 else [])
        for one in expected:
            rows, columns = blocks_around(before.blocks, one.u, one.v, one.reach + one.widest, edge)
            for size, floor in zip((picture.scale, 1), floors):
                part = tuple(slice(edge // size * side.start, edge // size * side.stop) for side in (rows, columns))
                if floor[part].size:
                    old = before.moved_part(part, floor) if floor is floors[0] else before.whole[part]
                    floor[part] = relight(old, floor[part], one.widest / size)
        self._background = Background(*floors)
        self._restless_s = np.zeros(self._background.blocks, np.float32)  # for how long each block will count as that
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
            held[blocks_around(held.shape, spot.u, spot.v, 1.25 * spot.diameter + view.edge, view.edge)] = True
        # of what happened between images far apart nothing is known
        moved = (view.changed & ~held) | (elapsed >= _UNSEEN)
        self._restless_s = np.where(moved, GHOST_TIME, self._restless_s - elapsed)
        if self._background.update(view.picture, view.rise, view.changed, held, elapsed):
            self._begin()


def _in_picture(region: Region, picture: AnyPicture) -> Region:
    """Returns a region of what is searched in the picture's own pixels; what is left at the edges belongs to the last blocks."""
    left, top, right, bottom = (picture.scale * side for side in region)
    width, height = picture.size
    edge = BLOCK * picture.scale
    return left, top, width if width - right < edge else right, height if height - bottom < edge else bottom


def _much(hot: np.ndarray, darker: np.ndarray) -> bool:
    """Returns whether so much changed that nothing known holds any more.

    A person close to the camera darkens much of the image too, and must not become its background.
    """
    return max(np.count_nonzero(hot), 0.5 * np.count_nonzero(darker)) > _MAX_CHANGE * hot.size
