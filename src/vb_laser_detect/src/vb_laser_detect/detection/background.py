"""Models what a camera sees without a spot, and finds the regions of an image that differ from it, by blocks of pixels.

Each image is compared with a keyframe, which never includes a spot. A stationary camera's keyframe averages one image a
second, except where something has just changed. A moving camera's keyframe is replaced every few images. Whole images
are compared by blocks only, because every image must be compared.
"""

from __future__ import annotations

import math
from typing import List, Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_core.image_format import AnyPicture
from vb_laser_detect.detection.blocks import block_maxima, blocks_around, mask_of_blocks, max_channel, pixels_of
from vb_laser_detect.detection.blocks import sample_blocks
from vb_laser_detect.detection.stage_results import BLOCK, Box, ChangedRegion, Comparison, ExpectedSpot, Motion, Part
from vb_laser_detect.detection.stage_results import Spot

# [grey levels] limits of `Background.bright_level`, in very dark and very bright rooms
_DARKEST, _BRIGHTEST = 64.0, 191.0
_BRIGHT = 99.0  # [%] of the background are darker than what counts as bright
_NOISE_DEVIATIONS = 6.0  # how far a rise must exceed a block's own noise
_PERIOD = 1.0  # [s] between two keyframes of a stationary camera; a block's noise is averaged over it
_WEIGHT = 0.25  # share of a new image in a stationary camera's keyframe: averaging reduces noise
_ABSORPTION_TIME = 1.5  # [s] after which a change becomes background
_GHOST_TIME = _ABSORPTION_TIME + _PERIOD  # [s] after which a removed object has left the background
_UNSEEN = 1.0  # [s] between two images, in which a hand could take something away
_KEYFRAME = 6  # [images] after which a moving camera's keyframe is replaced, because people walk on
_KEYFRAME_PART = 0.1  # share of its width by which the image may move before the keyframe lacks too much floor
_MIN_FLICKER = 0.1  # under flickering lamps, the light of an image's rows differs by at least this share
_MIN_CHANGE = 0.15  # share of `bright_level`; smaller differences become part of the background
_MAX_CHANGE = 0.15  # share of the image: if more is brighter, or twice as much darker, the light was switched
_HALF_LEVEL = 0.8  # a spot of few pixels keeps at least this share of its level in the halved image
_MAX_REGIONS = 24  # walking people cause fewer; to examine more would take longer than an image period
_LARGE = 14  # [blocks] side above which a region is cut down to its brightest parts
_SQUARE = np.ones((3, 3), np.uint8)


class Background:
    """The background of one camera at full resolution, and each block's noise.

    Blocks that changed are left out of a stationary camera's keyframe until the change has lasted 1.5 s.
    The first image of a scene is its background. A light in it may be a lamp, and becomes a spot only when it moves.

    Call `compare` for each image, then `update` with the comparison.

    Attributes:
        bright_level: [grey levels] of the brightest surfaces in it, see `SearchedImage`.
        ghost_s: see `SearchedImage`.
        is_keyframe: whether the last image became the keyframe.
    """

    def __init__(self) -> None:
        self.is_keyframe = False
        self.bright_level = 0.0
        # the keyframe, and what is derived from it
        self._image: Optional[np.ndarray] = None
        self._sample = np.zeros((0, 0), np.uint8)
        self._brightest: Optional[np.ndarray] = None  # maxima of 3 x 3 pixels
        self._min_change = 0.0  # [grey levels]
        self._age = 0.0  # [s]
        self._images = 0  # compared with it
        self._forget_blocks((0, 0))

    def _forget_blocks(self, shape: Tuple[int, int]) -> None:
        """Forgets the noise and the changes of all blocks."""
        self._noise = np.zeros(shape, np.float32)
        self._deviation = np.zeros(shape, np.float32)
        self._limit: Optional[np.ndarray] = None  # smallest rise that is clear, and exceeds the noise
        self._noise_s = 0.0  # [s] since the noise was learnt
        self._noise_known = False
        self._changed_s = np.zeros(shape, np.float32)
        self.ghost_s = np.zeros(shape, np.float32)

    def _adopt(self, image: np.ndarray) -> None:
        """Makes an image the keyframe."""
        self._image = image
        self.is_keyframe = True
        self._sample = sample_blocks(image)
        self._brightest = None
        self._limit = None
        self._age = 0.0
        self._images = 0
        # of the room's brightest surfaces, not of single lamps, which are less than a hundredth of the image;
        # neighbouring pixels of a Bayer image see different colours
        cells = image if image.ndim == 3 else cv2.dilate(image, np.ones((2, 2), np.uint8), anchor=(0, 0))
        bright = float(np.percentile(max_channel(sample_blocks(cells)), _BRIGHT))
        self.bright_level = min(max(bright, _DARKEST), _BRIGHTEST)
        self._min_change = _MIN_CHANGE * self.bright_level

    def compare(self, picture: AnyPicture, motion: Motion, expected: Sequence[ExpectedSpot]) -> Comparison:
        """Compares a picture with the background. The first one begins a new scene, and so does switching the light.

        Args:
            motion: since the keyframe.
            expected: the spots that a new background should not include.
        """
        self.is_keyframe = False
        comparison = None if self._image is None else self._compare(picture.search_pixels, motion)
        if comparison is None or _is_global(comparison):
            self._begin_scene(picture, motion, expected)
            comparison = self._compare(picture.search_pixels, None)
        return comparison

    def _begin_scene(self, picture: AnyPicture, motion: Motion, expected: Sequence[ExpectedSpot]) -> None:
        """Makes a picture the background and forgets the noise. Under an expected spot, the old background stays, relit."""
        keyframe = picture.search_pixels.copy()
        blocks = keyframe.shape[0] // BLOCK, keyframe.shape[1] // BLOCK
        for spot in expected:
            rows, columns = blocks_around(blocks, *spot.position, spot.reach + spot.max_width, picture.scale)
            part = pixels_of(rows, columns)
            if keyframe[part].size:
                floor = self._moved_part(part, motion, keyframe)
                keyframe[part] = match_lighting(floor, keyframe[part], spot.max_width / picture.scale)
        self._forget_blocks(blocks)
        self._adopt(keyframe)

    def _compare(self, image: np.ndarray, motion: Motion) -> Comparison:
        """Compares an image with the background, which flickering lamps may light row by row.

        While the camera moves, no block counts as darker, because a new keyframe soon includes the change.
        """
        if motion is not None:
            if self._brightest is None:
                self._brightest = cv2.dilate(self._image, _SQUARE)
            # a fraction of a pixel does not matter to the maximum of nine
            reference = _warp(self._brightest, motion, image.copy(), cv2.INTER_NEAREST)
            rise = block_maxima(image, reference)
            brighter = self._exceeds_noise(rise, motion)
            return Comparison(rise, brighter, np.zeros(rise.shape, bool), reference, motion)
        sample = sample_blocks(image)
        comparison = self._compare_stationary(image, sample, self._image)
        if _is_global(comparison):
            relit = self._relight_rows(sample)
            if relit is not None:
                return self._compare_stationary(image, sample, relit)
        return comparison

    def _compare_stationary(self, image: np.ndarray, sample: np.ndarray, reference: np.ndarray) -> Comparison:
        """Compares an image, with a sample of its blocks, with a reference."""
        sample_before = self._sample if reference is self._image else sample_blocks(reference)
        rise = block_maxima(image, reference)
        fall = max_channel(cv2.subtract(sample_before, sample))
        return Comparison(rise, self._exceeds_noise(rise, None), fall > self._min_change, reference)

    def _relight_rows(self, now: np.ndarray) -> Optional[np.ndarray]:
        """Returns the background with each row lit as in the image, whose sampled blocks are `now`.

        Returns None if the light changed equally in all rows. A rolling shutter exposes its rows one after another, so
        that flickering lamps light them differently.
        """
        light = max_channel(now).astype(np.float32) + 1.0
        light_before = max_channel(self._sample).astype(np.float32) + 1.0
        gains = np.median(light / light_before, axis=1)
        if np.ptp(gains) < _MIN_FLICKER * gains.mean():
            return None
        return _apply_row_gains(self._image, gains)

    def _moved_part(self, part: Part, motion: Motion, image: np.ndarray) -> np.ndarray:
        """Returns a part of the background as the camera sees it now, or of the image where the background ends."""
        if motion is None:
            return self._image[part]
        rows, columns = part
        shift = np.array([[1.0, 0.0, -columns.start], [0.0, 1.0, -rows.start], [0.0, 0.0, 1.0]])
        return _warp(self._image, shift @ motion, image[part].copy(), cv2.INTER_CUBIC)

    def _exceeds_noise(self, rise: np.ndarray, motion: Motion) -> np.ndarray:
        """Finds the blocks (rows, columns) bool whose rise is no small change, and exceeds the block's own noise."""
        if not self._noise_known:
            if self._images == 0:
                return rise >= self._min_change
            # from the second image: the noise of the whole scene
            middle = float(np.median(rise))
            self._noise[:] = middle
            self._deviation[:] = max(1.5, 1.5 * float(np.median(np.abs(rise - middle))))
            self._noise_known = True
        if motion is not None:
            # a block's noise depends on the edges that it showed: while the camera moves, the mean of all blocks counts
            mean_noise = float((self._noise + _NOISE_DEVIATIONS * self._deviation).mean())
            return rise >= max(self._min_change, mean_noise)
        if self._limit is None:
            # in whole grey levels, like the rise: comparing bytes is four times faster
            noise = np.minimum(255.0, self._noise + _NOISE_DEVIATIONS * self._deviation)
            self._limit = cv2.max(np.ceil(noise).astype(np.uint8), math.ceil(self._min_change))
        return cv2.compare(rise, self._limit, cv2.CMP_GE) > 0

    def update(self, picture: AnyPicture, comparison: Comparison, spots: Sequence[Spot], dt: float) -> None:
        """Adds a picture that was compared, except where it shows these spots.

        Args:
            dt: [s] since the last image.
        """
        changed = comparison.brighter | comparison.darker
        shows_spot = np.zeros_like(changed)
        for spot in spots:
            reach = 1.25 * spot.diameter + BLOCK * picture.scale
            shows_spot[blocks_around(changed.shape, spot.u, spot.v, reach, picture.scale)] = True
        moved = changed & ~shows_spot
        # between images far apart, anything may have happened
        self.ghost_s = np.where(moved | (dt >= _UNSEEN), _GHOST_TIME, self.ghost_s - dt)
        self._age += dt
        self._images += 1
        if comparison.motion is not None:
            self._update_moving(picture.search_pixels, shows_spot, comparison.motion)
            return
        self._changed_s = cv2.copyTo(cv2.add(self._changed_s, dt), moved.view(np.uint8))
        unsteady = changed | shows_spot
        self._learn_noise(comparison.rise, ~unsteady, dt)
        self._update_stationary(picture.search_pixels, unsteady)

    def _update_stationary(self, image: np.ndarray, unsteady: np.ndarray) -> None:
        """Averages the image into the keyframe once a period, except blocks that show a spot or changed only just now."""
        if self._age < _PERIOD:
            return
        lasting = self._changed_s > _ABSORPTION_TIME
        kept = unsteady & ~lasting
        self._changed_s[lasting] = 0.0
        keyframe = cv2.addWeighted(image, _WEIGHT, self._image, 1.0 - _WEIGHT, 0.0)
        for blocks, source in ((lasting, image), (kept, self._image)):
            if blocks.any():
                cv2.copyTo(source, mask_of_blocks(blocks, *image.shape[:2]), keyframe)
        self._adopt(keyframe)

    def _update_moving(self, image: np.ndarray, shows_spot: np.ndarray, motion: np.ndarray) -> None:
        """Makes the image the keyframe after some images or much motion. Where it shows a spot, the background stays."""
        height, width = image.shape[:2]
        middle = np.array([[[0.5 * width, 0.5 * height]]])
        distance = np.abs(cv2.perspectiveTransform(middle, motion) - middle).max()
        if distance <= _KEYFRAME_PART * width and self._images < _KEYFRAME:
            return
        keyframe = image.copy()
        self._changed_s[:] = 0.0
        self._noise[:] = self._noise.mean()
        self._deviation[:] = self._deviation.mean()
        left, top, wide, high = cv2.boundingRect(shows_spot.view(np.uint8))
        if wide:
            rows, columns = slice(top, top + high), slice(left, left + wide)
            part = pixels_of(rows, columns)
            mask = mask_of_blocks(np.ascontiguousarray(shows_spot[rows, columns]), *keyframe[part].shape[:2])
            cv2.copyTo(self._moved_part(part, motion, image), mask, keyframe[part])
        self._adopt(keyframe)

    def _learn_noise(self, rise: np.ndarray, steady: np.ndarray, dt: float) -> None:
        """Averages the rise of steady blocks and its deviation. Both change slowly, so not every image is used."""
        self._noise_s += dt
        if self._noise_s < _PERIOD / 8:
            return
        weight = 1.0 - math.exp(-self._noise_s / _PERIOD)
        mask = steady.view(np.uint8)
        values = rise.astype(np.float32)
        cv2.accumulateWeighted(values, self._noise, weight, mask)
        cv2.accumulateWeighted(cv2.absdiff(values, self._noise), self._deviation, weight, mask)
        self._noise_s = 0.0
        self._limit = None


def _is_global(comparison: Comparison) -> bool:
    """Returns whether so much changed that the background no longer holds.

    A person close to the camera darkens much of the image too, and must not become its background.
    """
    changed = max(np.count_nonzero(comparison.brighter), 0.5 * np.count_nonzero(comparison.darker))
    return changed > _MAX_CHANGE * comparison.brighter.size


def _warp(image: np.ndarray, motion: np.ndarray, target: np.ndarray, interpolation: int) -> np.ndarray:
    """Warps an image by a motion (3, 3) onto another image, which stays where nothing covers it."""
    return cv2.warpAffine(image, motion[:2], target.shape[1::-1], target, interpolation, cv2.BORDER_TRANSPARENT)


def _apply_row_gains(image: np.ndarray, gains: np.ndarray) -> np.ndarray:
    """Returns an image multiplied by the gains of its rows of blocks, interpolated between the blocks' middles."""
    middles = BLOCK * (np.arange(len(gains)) + 0.5) - 0.5
    rows = np.interp(np.arange(len(image)), middles, gains).astype(np.float32)
    return cv2.convertScaleAbs(image * rows.reshape((-1, 1) + (1,) * (image.ndim - 2)))


def match_lighting(background: np.ndarray, image: np.ndarray, max_width: float) -> np.ndarray:
    """Returns a background with the brightness of an image, except that of light narrower than `max_width` [px]."""
    half = 2 * math.ceil(max_width / 4)
    size = 2 * half + 1
    kernel = np.zeros((size, size), np.uint8)
    # every second pixel of a Bayer image has the same colour
    step = 2 if image.ndim == 2 else 1
    kernel[::step, ::step] = 1
    gain = (image + np.float32(1.0)) / (background + np.float32(1.0))
    gain = cv2.morphologyEx(gain, cv2.MORPH_OPEN, kernel)
    return cv2.multiply(background, gain, dtype=cv2.CV_8U)


# ------------------------------------------------------------------ regions
def find_regions(
    picture: AnyPicture, comparison: Comparison, min_level: float, expected: Sequence[ExpectedSpot]
) -> List[ChangedRegion]:
    """Finds an image's regions that became brighter, the brightest first; those darker than `min_level` have no boxes."""
    image = picture.search_pixels
    boxes = find_boxes(comparison.rise, comparison.brighter)
    # sorted by level, not by rise: on a bright floor, a person can rise more than the white spot
    boxes.sort(key=lambda box: -_max_in_box(image, box))
    return [_region(picture, box, min_level, expected) for box in boxes[:_MAX_REGIONS]]


def _region(picture: AnyPicture, box: Box, min_level: float, expected: Sequence[ExpectedSpot]) -> ChangedRegion:
    """Makes a region from a box of the searched pixels. The last blocks include the pixels left over at the edges."""
    left, top, right, bottom = box
    height, width = picture.search_pixels.shape[:2]
    if width - right < BLOCK:
        right = width
    if height - bottom < BLOCK:
        bottom = height
    box = picture.scale * left, picture.scale * top, picture.scale * right, picture.scale * bottom
    if picture.is_fully_decoded:
        level = _max_in_box(picture.pixels, box)
    else:  # the highest level that is possible
        level = _max_in_box(picture.search_pixels, (left, top, right, bottom)) / _HALF_LEVEL
    for spot in expected:
        part = _part_within_reach(box, spot)
        if part is not None:
            return ChangedRegion(box, [box, part] if level >= min_level else [], spot)
    return ChangedRegion(box, [box] if level >= min_level else [], None)


def _part_within_reach(box: Box, spot: ExpectedSpot) -> Optional[Box]:
    """Returns the part of a box in which a spot may be, or None if it is in no part."""
    left, top, right, bottom = box
    u, v = spot.position
    left = max(left, int(u - spot.reach))
    top = max(top, int(v - spot.reach))
    right = min(right, int(u + spot.reach) + 1)
    bottom = min(bottom, int(v + spot.reach) + 1)
    return (left, top, right, bottom) if left < right and top < bottom else None


def _max_in_box(image: np.ndarray, box: Box) -> int:
    """Returns the brightest sample [grey levels] of a box."""
    left, top, right, bottom = box
    return int(image[top:bottom, left:right].max())


def find_boxes(maxima: np.ndarray, hot: np.ndarray) -> List[Box]:
    """Finds the boxes [px] of connected hot blocks, those with the highest peaks first.

    A large region is cut down to the parts above 60 % of its peak, so that no spot is lost in a person's region.
    """
    # few blocks are hot, and they are close together: only their surroundings are processed
    x, y, wide, high = cv2.boundingRect(hot.view(np.uint8))
    if not wide:
        return []
    around = slice(y, y + high), slice(x, x + wide)
    hot = np.ascontiguousarray(hot[around])
    maxima = np.ascontiguousarray(maxima[around])
    labels, stats, peaks = _components(hot, maxima)
    is_large = stats[:, 2:4].max(axis=1) > _LARGE
    is_large[0] = False
    if is_large.any():
        is_dim_part = is_large[labels] & (maxima <= 0.6 * peaks[labels])
        labels, stats, peaks = _components(hot & ~is_dim_part, maxima)
    order = np.argsort(-peaks[1:], kind="stable")
    left, top, width, height = stats[1:][order, :4].T
    boxes = BLOCK * np.column_stack([x + left, y + top, x + left + width, y + top + height])
    return list(map(tuple, boxes.tolist()))


def _components(hot: np.ndarray, maxima: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the connected components: labels (rows, columns), and the statistics of OpenCV and the peak of each."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(hot.view(np.uint8), connectivity=8)
    peaks = np.zeros(len(stats))
    np.maximum.at(peaks, labels[hot], maxima[hot])
    return labels, stats, peaks
