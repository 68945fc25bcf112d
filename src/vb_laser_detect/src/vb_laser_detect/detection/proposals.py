"""Regions worth examining: what became brighter than the scene was, for every camera.

One idea for all cameras: a keyframe, which is never taken from a spot. The background stays where it was taken, and each image
is compared with it, through one motion from the keyframe to now if the camera moves (`image_registration` estimates it), so
that nothing is resampled twice and no error adds up. Every second, or every few images of a camera that moves, the image
itself becomes the keyframe, except where it shows a spot or has just changed. What shone in the keyframe within a pixel, the
uncertainty of that motion, is not new.

The first image of a scene is its background: what shines there may be a lamp, and only its motion can tell. When a light is
switched, the floor under a spot that was followed until then is known in the old light.
"""

from __future__ import annotations

import math
from typing import Dict, NamedTuple, Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_core.image_format import AnyPicture
from vb_laser_detect.detection.blocks import (
    BLOCK,
    Region,
    block_maxima,
    blocks_around,
    brightest,
    find_regions,
    mask_of_blocks,
    max_channel,
    sample_blocks,
)
from vb_laser_detect.detection.features import relight
from vb_laser_detect.detection.image_registration import ImageRegistration
from vb_laser_detect.detection.tracking import Expected, Spot

_MIN_CHANGE = 0.15  # of what is bright in the room; what differs by less from the background becomes part of it
_DARKEST, _BRIGHTEST = (
    64.0,
    191.0,
)  # [grey levels] the reference brightness stays within them in very dark and very bright rooms
_HALF_LEVEL = 0.8  # of its level, at least, a spot of few pixels has left in the half of an image
_STILL = 0.02  # of what is `busy` in an image; where more is, ghosts may be left
_UNSEEN = 1.0  # [s] between two images, in which a hand takes something away
_MAX_REGIONS = 24  # people who walk leave fewer, and examining more would take longer than an image lasts
_MAX_CHANGE = 0.15  # of the image became brighter, or twice as much darker: the light was switched, so it starts again
_NOISE_DEVIATIONS = 6.0  # how far a rise must exceed a block's own noise
_PERIOD = 1.0  # [s] between two keyframes of a stationary camera; a block's noise is averaged over it
_WEIGHT = 0.25  # of the image in a stationary camera's keyframe: the mean of some images has less noise
_ABSORPTION_TIME = 1.5  # [s] a change that lasts this long belongs to the background
_GHOST_TIME = _ABSORPTION_TIME + _PERIOD  # [s] at the latest then what somebody took away is out of it
_BRIGHT = 99.0  # [%] of the background are darker than what counts as bright in it
_KEYFRAME = 6  # [images] a moving camera's background is kept for: people walk on
_KEYFRAME_PART = 0.1  # of the image's width that it may have moved by: what comes into view is not in the keyframe
_BANDS = 0.1  # the rows' light differs by this part at least where lamps flicker
_SQUARE = np.ones((3, 3), np.uint8)


class Background:
    """The background of one camera at full resolution, and each block's noise.

    Blocks that changed are left out of a stationary camera's keyframe until the change has lasted 1.5 s; blocks that show a
    spot are left out of any.

    Args:
        image: (H, W) or (H, W, 3) uint8, the first image as it is searched.
        whole: the same at the camera's own size, if `image` is the half of it.

    Attributes:
        image: the background itself.
        whole: the same at the camera's own size; None if that is searched.
        reference: what the last image was compared with.
        blocks: their rows and columns.
        bright: [grey levels] of the brightest surfaces in it, see `ImageTraits`.
        motion: (3, 3) maps the background's pixels to those of the last image; None if the camera was stationary.
    """

    def __init__(self, image: np.ndarray, whole: Optional[np.ndarray] = None) -> None:
        self.blocks = blocks = (image.shape[0] // BLOCK, image.shape[1] // BLOCK)
        self._noise, self._deviation, self._changed_s = np.zeros((3,) + blocks, np.float32)
        self._limit: Optional[np.ndarray] = None  # of a rise that exceeds the noise, once that is known
        self._noise_s, self._noise_known = 0.0, False
        self.whole = whole
        self._adopt(image.copy())
        self.reference = self.image
        self._gains: Optional[np.ndarray] = None  # of the rows of blocks, where the last image's light differs

    def _adopt(self, image: np.ndarray) -> None:
        """Makes an image the background."""
        self.image, self._sample = image, sample_blocks(image)
        self.motion: Optional[np.ndarray] = None
        self._brightest: Optional[np.ndarray] = None  # of nine pixels each
        self._age, self._images = 0.0, 0
        # of the room's brightest surfaces: single lamps are less than a hundredth of the image. The places in a Bayer
        # image's pattern see different colours
        seen = image if self.whole is None else self.whole
        cells = seen if seen.ndim == 3 else cv2.dilate(seen, np.ones((2, 2), np.uint8), anchor=(0, 0))
        bright = float(np.percentile(max_channel(sample_blocks(cells)), _BRIGHT))
        self.bright = min(max(bright, _DARKEST), _BRIGHTEST)

    def subtract_background(self, image: np.ndarray, motion: Optional[np.ndarray]) -> Tuple[np.ndarray, np.ndarray]:
        """Compares an image with the background.

        Args:
            motion: (3, 3) maps the background's pixels to the image's; None: the camera is stationary.

        Returns:
            Each block's largest rise above the background, and by how much a sample of it became darker, (rows, columns)
            uint8. While the camera moves nothing is called darker: what became so is taken from the image soon.
        """
        self.motion, self.reference, self._gains = motion, self.image, None
        if motion is None:
            return block_maxima(image, self.image), max_channel(cv2.subtract(self._sample, sample_blocks(image)))
        if self._brightest is None:
            self._brightest = cv2.dilate(self.image, _SQUARE)
        # fractions of a pixel do not matter to the brightest of nine
        self.reference = _warp(self._brightest, motion, image.copy(), cv2.INTER_NEAREST)
        rise = block_maxima(image, self.reference)
        return rise, np.zeros_like(rise)

    def subtract_bands(self, image: np.ndarray) -> Optional[Tuple[np.ndarray, np.ndarray]]:
        """Compares an image with the background in the light of each of its rows; None if all rows have the same.

        Lamps that flicker light the rows of a rolling shutter one after the other.
        """
        now, before = (max_channel(sample).astype(np.float32) + 1.0 for sample in (sample_blocks(image), self._sample))
        gains = np.median(now / before, axis=1)
        if np.ptp(gains) < _BANDS * gains.mean():
            return None
        self._gains, self.reference = gains, _in_light(self.image, gains, BLOCK)
        darker = cv2.subtract(sample_blocks(self.reference), sample_blocks(image))
        return block_maxima(image, self.reference), max_channel(darker)

    def whole_reference(self) -> np.ndarray:
        """Returns the reference at the camera's own size."""
        if self.whole is None:
            return self.reference
        return self.whole if self._gains is None else _in_light(self.whole, self._gains, 2 * BLOCK)

    def moved_part(self, part: Tuple[slice, slice], image: np.ndarray) -> np.ndarray:
        """Returns a part of the background as the camera sees it now; of the image where nothing was in view."""
        if self.motion is None:
            return self.image[part]
        there = np.array([[1.0, 0.0, -part[1].start], [0.0, 1.0, -part[0].start], [0.0, 0.0, 1.0]]) @ self.motion
        return _warp(self.image, there, image[part].copy(), cv2.INTER_CUBIC)

    def foreground_blocks(self, maxima: np.ndarray, threshold: float) -> np.ndarray:
        """Finds the blocks (rows, columns) bool whose rise is at least `threshold` and exceeds the block's own noise."""
        if not self._noise_known:
            # the second image's: the whole scene's
            middle = float(np.median(maxima))
            self._noise[:], self._deviation[:] = middle, max(1.5, 1.5 * float(np.median(np.abs(maxima - middle))))
            self._limit, self._noise_known = None, True
        if self.motion is not None:
            # a block's noise belongs to the edges that it showed
            return maxima >= max(threshold, float((self._noise + _NOISE_DEVIATIONS * self._deviation).mean()))
        if self._limit is None:
            # whole grey levels, as the rise has: comparing bytes is four times faster
            self._limit = np.ceil(np.minimum(255.0, self._noise + _NOISE_DEVIATIONS * self._deviation)).astype(np.uint8)
        return cv2.compare(maxima, cv2.max(self._limit, math.ceil(threshold)), cv2.CMP_GE) > 0

    def update(self, picture: AnyPicture, rise: np.ndarray, changed: np.ndarray, spots: np.ndarray, dt: float) -> bool:
        """Adds a frame.

        Args:
            picture: one that is searched at half its size is decoded whole for each keyframe.
            rise: (rows, columns) of the blocks.
            changed, spots: (rows, columns) bool; blocks that changed, and blocks that show a spot.
            dt: [s] since the last frame.

        Returns:
            Whether the image became the keyframe.
        """
        image = picture.searched
        self._age, self._images = self._age + dt, self._images + 1
        if self.motion is None:
            self._changed_s = cv2.copyTo(cv2.add(self._changed_s, dt), (changed & ~spots).view(np.uint8))
            self._learn_noise(rise, ~(changed | spots), dt)
            if self._age < _PERIOD:
                return False
            lasting = self._changed_s > _ABSORPTION_TIME
            kept = (changed | spots) & ~lasting
            self._changed_s[lasting] = 0.0
            if self.whole is not None:
                self.whole = self._renewed(self.whole, picture.pixels, lasting, kept)
            self._adopt(self._renewed(self.image, image, lasting, kept))
            return True
        middle = np.array([[[0.5 * image.shape[1], 0.5 * image.shape[0]]]])
        far = np.abs(cv2.perspectiveTransform(middle, self.motion) - middle).max() > _KEYFRAME_PART * image.shape[1]
        if not far and self._images < _KEYFRAME:
            return False
        floor = image.copy()
        self._changed_s[:] = 0.0
        # a block's noise belongs to the edges that it showed
        self._noise[:], self._deviation[:], self._limit = self._noise.mean(), self._deviation.mean(), None
        left, top, wide, high = cv2.boundingRect(spots.view(np.uint8))
        if wide:
            part = slice(BLOCK * top, BLOCK * (top + high)), slice(BLOCK * left, BLOCK * (left + wide))
            mask = mask_of_blocks(
                np.ascontiguousarray(spots[top : top + high, left : left + wide]), *floor[part].shape[:2]
            )
            cv2.copyTo(self.moved_part(part, image), mask, floor[part])
        self._adopt(floor)
        return True

    def _renewed(self, floor: np.ndarray, image: np.ndarray, lasting: np.ndarray, kept: np.ndarray) -> np.ndarray:
        """Returns a stationary camera's keyframe, at the size that is searched or the camera's own, with an image added.

        Args:
            lasting, kept: (rows, columns) bool, blocks that become as the image is, and that stay as they are.
        """
        result = cv2.addWeighted(image, _WEIGHT, floor, 1.0 - _WEIGHT, 0.0)
        for blocks, source in ((lasting, image), (kept, floor)):
            if blocks.any():
                mask = mask_of_blocks(blocks, *self.image.shape[:2])
                cv2.copyTo(source, cv2.resize(mask, image.shape[1::-1], interpolation=cv2.INTER_NEAREST), result)
        return result

    def _learn_noise(self, rise: np.ndarray, steady: np.ndarray, dt: float) -> None:
        """Averages the rise of steady blocks, and its deviation; both change slowly, and not with each image."""
        self._noise_s += dt
        if self._noise_s < _PERIOD / 8:
            return
        weight, mask, values = 1.0 - math.exp(-self._noise_s / _PERIOD), steady.view(np.uint8), rise.astype(np.float32)
        cv2.accumulateWeighted(values, self._noise, weight, mask)
        cv2.accumulateWeighted(cv2.absdiff(values, self._noise), self._deviation, weight, mask)
        self._noise_s, self._limit = 0.0, None


def _warp(image: np.ndarray, motion: np.ndarray, into: np.ndarray, how: int) -> np.ndarray:
    """Moves an image by a motion (3, 3), in place of all pixels of another one that it covers."""
    return cv2.warpAffine(image, motion[:2], into.shape[1::-1], into, how, cv2.BORDER_TRANSPARENT)


def _in_light(image: np.ndarray, gains: np.ndarray, edge: int) -> np.ndarray:
    """Returns an image in the light of each row of its blocks, of an edge [px]."""
    rows = np.interp(np.arange(len(image)), edge * (np.arange(len(gains)) + 0.5) - 0.5, gains).astype(np.float32)
    return cv2.convertScaleAbs(image * rows.reshape((-1, 1) + (1,) * (image.ndim - 2)))


class SearchedImage(NamedTuple):
    """An image, and what is known of the scene. Places and regions are the picture's own pixels, whatever is searched.

    Attributes:
        background: what the picture is compared with.
        regions: to examine, the brightest first.
        rise: (rows, columns) uint8, of each block; changed: bool, those that became brighter or darker; restless: bool, those
            that something other than a spot changed so short a time ago that it may have left a ghost there.
    """

    picture: AnyPicture
    background: Background
    regions: Sequence[Region]
    rise: np.ndarray
    changed: np.ndarray
    restless: np.ndarray

    @property
    def edge(self) -> int:
        """Of a block [px]."""
        return BLOCK * self.picture.scale

    def brightest(self, region: Region) -> float:
        """Returns how bright [grey levels] the brightest sample of a region is, or may be while only a half is decoded."""
        if self.picture.whole:
            return brightest(self.picture.pixels, region)
        return brightest(self.picture.searched, tuple(side // self.picture.scale for side in region)) / _HALF_LEVEL

    def surroundings(self, u: float, v: float, diameter: float) -> Dict[str, float]:
        """Returns what a blob's surroundings say of it, by the names of `features.FEATURES`.

        "busy" is how much else changed in the image, apart from the blob and its own light. "edge" is NaN where the blob is
        no ghost, whose outline is in the background alone and which is left by something that moved: where the camera did
        not, less else changes, and nothing passed beside it while a ghost lasts, there is none, and a spot on the edge of a
        white sheet has such an outline too.
        """
        reach = 1.25 * diameter + self.edge
        own, around = (blocks_around(self.changed.shape, u, v, size, self.edge) for size in (reach, 2.0 * reach))
        elsewhere = np.count_nonzero(self.changed) - np.count_nonzero(self.changed[own])
        busy = math.sqrt(elsewhere / self.changed.size)
        passed = np.count_nonzero(self.restless[around]) > np.count_nonzero(self.restless[own])
        is_ghost = busy >= _STILL or passed or self.background.motion is not None
        return {"busy": busy} if is_ghost else {"busy": busy, "edge": math.nan}


class Proposer:
    """Finds regions in one camera's images, and keeps its background; if the camera may move its motion is found in them."""

    def __init__(self, moving_camera: bool) -> None:
        self._registration = ImageRegistration() if moving_camera else None
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
        return SearchedImage(picture, self._background, regions, rise, hot | darker, self._restless_s > 0.0)

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
    def _least_change(self) -> float:
        """What has changed differs by more than this [grey levels]."""
        return _MIN_CHANGE * self._background.bright

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
        self._restless_s = np.where(moved, _GHOST_TIME, self._restless_s - elapsed)
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
