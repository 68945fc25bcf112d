"""Models what a camera sees without a spot, and finds the regions of an image that differ from it, by blocks of pixels.

Each image is compared with a keyframe, which never includes a spot. A stationary camera's averages one image a second,
except where something has just changed; a moving camera's is replaced every few images. Whole images are compared only by
blocks, which must stay cheap.
"""

from __future__ import annotations

import math
from functools import reduce
from typing import List, Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_core.image_format import AnyPicture
from vb_laser_detect.detection.stage_results import BLOCK, Box, ChangedRegion, Changes, ExpectedSpot, Part, Spot

_BAND_BYTES = 240_000  # [bytes] of one pixel row of all blocks in a band: small enough for a core's cache
# half of a block's rows are read, in half the time, as a spot covers several rows
_COLOR_ROWS = (1, 3, 5, 7)
_MOSAIC_ROWS = (1, 2, 5, 6)  # in pairs, as two Bayer rows hold all colours
# [grey levels] limits of `Background.bright_level`, in very dark and very bright rooms
_DARKEST, _BRIGHTEST = 64.0, 191.0
_BRIGHT = 99.0  # [%] of the background are darker than what counts as bright
_NOISE_DEVIATIONS = 6.0  # how far a rise must exceed a block's own noise
_PERIOD = 1.0  # [s] between two keyframes of a stationary camera; a block's noise is averaged over it
_WEIGHT = 0.25  # share of a new image in a stationary camera's keyframe: averaging reduces noise
_ABSORPTION_TIME = 1.5  # [s] a change that lasts longer becomes background
_GHOST_TIME = _ABSORPTION_TIME + _PERIOD  # [s] after this time a removed object has left the background
_UNSEEN = 1.0  # [s] time between two images in which a hand could take something away
_KEYFRAME = 6  # [images] for which a moving camera's background is kept: people walk on
_KEYFRAME_PART = 0.1  # share of its width by which the image may have moved: floor new in view is not in the keyframe
_MIN_FLICKER = 0.1  # under flickering lamps, the light of an image's rows differs by at least this share
_MIN_CHANGE = 0.15  # share of `bright_level`; smaller differences become part of the background
_MAX_CHANGE = 0.15  # if this share of the image is brighter, or twice as much darker, the light was switched
_HALF_LEVEL = 0.8  # a spot of few pixels keeps at least this share of its level in the halved image
_MAX_REGIONS = 24  # walking people cause fewer, and examining more would take longer than an image period
_LARGE = 14  # [blocks] larger regions are cut down to their brightest parts
_SQUARE = np.ones((3, 3), np.uint8)


class Background:
    """The background of one camera at full resolution, and each block's noise.

    Blocks that changed are left out of a stationary camera's keyframe until the change has lasted 1.5 s.
    The first image of a scene is its background. A light in it may be a lamp; only if it moves is it a spot.

    Attributes:
        bright_level: [grey levels] of the brightest surfaces in it, see `SearchedImage`.
        motion: (3, 3) maps the background's pixels to those of the last image; None if the camera was stationary.
        reference: what the last image was compared with: the background as moved and lit in it.
        ghost_s: see `SearchedImage`.
        is_keyframe: whether the last image became the keyframe.
    """

    def __init__(self) -> None:
        self._image: Optional[np.ndarray] = None
        self.motion: Optional[np.ndarray] = None
        self.is_keyframe = False

    def _adopt(self, image: np.ndarray) -> None:
        """Makes an image the background."""
        self._image = image
        self.is_keyframe = True
        self._sample = sample_blocks(image)
        self.motion = None
        self._brightest: Optional[np.ndarray] = None  # maxima of 3 x 3 pixels
        self._limit: Optional[np.ndarray] = None  # smallest rise that is clear, and exceeds the noise
        self._age, self._images = 0.0, 0
        # the room's brightest surfaces: single lamps are less than a hundredth of the image. Neighbouring pixels of a
        # Bayer image see different colours
        cells = image if image.ndim == 3 else cv2.dilate(image, np.ones((2, 2), np.uint8), anchor=(0, 0))
        bright = float(np.percentile(max_channel(sample_blocks(cells)), _BRIGHT))
        self.bright_level = min(max(bright, _DARKEST), _BRIGHTEST)
        self._min_change = _MIN_CHANGE * self.bright_level

    def compare(self, picture: AnyPicture, motion: Optional[np.ndarray], expected: Sequence[ExpectedSpot]) -> Changes:
        """Compares a picture with the background. If it is the first one, or the light was switched, a new scene begins.

        Args:
            motion: (3, 3) maps the background's pixels to the searched ones; None: the camera is stationary.
            expected: the spots that a new background should not include.
        """
        self.is_keyframe = False
        changes = None if self._image is None else self._compare(picture.search_pixels, motion)
        if changes is None or _is_global(changes):
            self._begin_scene(picture, expected)
            changes = self._compare(picture.search_pixels, None)
        return changes

    def _begin_scene(self, picture: AnyPicture, expected: Sequence[ExpectedSpot]) -> None:
        """Makes a picture the background and forgets the noise. Under an expected spot, the old background stays, relit."""
        keyframe = picture.search_pixels.copy()
        blocks = keyframe.shape[0] // BLOCK, keyframe.shape[1] // BLOCK
        for spot in expected:
            rows, columns = blocks_around(blocks, *spot.position, spot.reach + spot.max_width, picture.scale)
            part = _pixels_of(rows, columns)
            if keyframe[part].size:
                floor = self._moved_part(part, keyframe)
                keyframe[part] = match_lighting(floor, keyframe[part], spot.max_width / picture.scale)
        self._noise = np.zeros(blocks, np.float32)
        self._deviation = np.zeros(blocks, np.float32)
        self._changed_s = np.zeros(blocks, np.float32)
        self.ghost_s = np.zeros(blocks, np.float32)
        self._noise_s = 0.0
        self._noise_known = False
        self._adopt(keyframe)

    def _compare(self, image: np.ndarray, motion: Optional[np.ndarray]) -> Changes:
        """Compares an image with the background, which flickering lamps may light row by row.

        While the camera moves, no block counts as darker, as a new keyframe soon includes the change.
        """
        self.motion = motion
        if motion is not None:
            if self._brightest is None:
                self._brightest = cv2.dilate(self._image, _SQUARE)
            # a fraction of a pixel does not matter to the maximum of nine
            self.reference = _warp(self._brightest, motion, image.copy(), cv2.INTER_NEAREST)
            self._rise = block_maxima(image, self.reference)
            return Changes(self._rise, self._exceeds_noise(self._rise), np.zeros(self._rise.shape, bool))
        self.reference = self._image
        now = sample_blocks(image)
        changes = self._changes(image, now, self._sample)
        if _is_global(changes) and self._relight_rows(now):
            changes = self._changes(image, now, sample_blocks(self.reference))
        return changes

    def _changes(self, image: np.ndarray, sample: np.ndarray, sample_before: np.ndarray) -> Changes:
        """Compares an image with the reference; `sample` and `sample_before` are those of their blocks."""
        self._rise = block_maxima(image, self.reference)
        fall = max_channel(cv2.subtract(sample_before, sample))
        return Changes(self._rise, self._exceeds_noise(self._rise), fall > self._min_change)

    def _relight_rows(self, now: np.ndarray) -> bool:
        """Gives each row of the reference the light of the image, whose sampled blocks are `now`; returns whether that was needed.

        A rolling shutter exposes its rows one after the other, so that flickering lamps light them differently.
        """
        light = max_channel(now).astype(np.float32) + 1.0
        light_before = max_channel(self._sample).astype(np.float32) + 1.0
        gains = np.median(light / light_before, axis=1)
        if np.ptp(gains) < _MIN_FLICKER * gains.mean():
            return False
        self.reference = _apply_row_gains(self._image, gains)
        return True

    def _moved_part(self, part: Part, image: np.ndarray) -> np.ndarray:
        """Returns a part of the background as the camera sees it now; where it does not reach, the image."""
        if self.motion is None:
            return self._image[part]
        to_part = np.array([[1.0, 0.0, -part[1].start], [0.0, 1.0, -part[0].start], [0.0, 0.0, 1.0]]) @ self.motion
        return _warp(self._image, to_part, image[part].copy(), cv2.INTER_CUBIC)

    def _exceeds_noise(self, rise: np.ndarray) -> np.ndarray:
        """Finds the blocks (rows, columns) bool whose rise is no small change, and exceeds the block's own noise."""
        if not self._noise_known:
            if self._images == 0:
                return rise >= self._min_change
            # from the second image: the noise of the whole scene
            middle = float(np.median(rise))
            self._noise[:] = middle
            self._deviation[:] = max(1.5, 1.5 * float(np.median(np.abs(rise - middle))))
            self._noise_known = True
        if self.motion is not None:
            # a block's noise depends on the edges that it showed: while the camera moves, the mean of all blocks counts
            return rise >= max(self._min_change, float((self._noise + _NOISE_DEVIATIONS * self._deviation).mean()))
        if self._limit is None:
            # in whole grey levels, like the rise: comparing bytes is four times faster
            noise = np.ceil(np.minimum(255.0, self._noise + _NOISE_DEVIATIONS * self._deviation)).astype(np.uint8)
            self._limit = cv2.max(noise, math.ceil(self._min_change))
        return cv2.compare(rise, self._limit, cv2.CMP_GE) > 0

    def update(self, picture: AnyPicture, changed: np.ndarray, spots: Sequence[Spot], dt: float) -> None:
        """Adds the picture that was compared last, except where it shows these spots.

        Args:
            changed: (rows, columns) bool, blocks that changed.
            dt: [s] since the last image.
        """
        shows_spot = np.zeros_like(changed)
        for spot in spots:
            reach = 1.25 * spot.diameter + BLOCK * picture.scale
            shows_spot[blocks_around(changed.shape, spot.u, spot.v, reach, picture.scale)] = True
        moved = changed & ~shows_spot
        # nothing is known of what happened between images far apart
        self.ghost_s = np.where(moved | (dt >= _UNSEEN), _GHOST_TIME, self.ghost_s - dt)
        self._age += dt
        self._images += 1
        if self.motion is not None:
            self._update_moving(picture.search_pixels, shows_spot)
            return
        self._changed_s = cv2.copyTo(cv2.add(self._changed_s, dt), moved.view(np.uint8))
        unsteady = changed | shows_spot
        self._learn_noise(~unsteady, dt)
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

    def _update_moving(self, image: np.ndarray, shows_spot: np.ndarray) -> None:
        """Makes the image the keyframe after some images or much motion; where it shows a spot, the background stays."""
        height, width = image.shape[:2]
        middle = np.array([[[0.5 * width, 0.5 * height]]])
        distance = np.abs(cv2.perspectiveTransform(middle, self.motion) - middle).max()
        if distance <= _KEYFRAME_PART * width and self._images < _KEYFRAME:
            return
        keyframe = image.copy()
        self._changed_s[:] = 0.0
        self._noise[:] = self._noise.mean()
        self._deviation[:] = self._deviation.mean()
        left, top, wide, high = cv2.boundingRect(shows_spot.view(np.uint8))
        if wide:
            rows, columns = slice(top, top + high), slice(left, left + wide)
            part = _pixels_of(rows, columns)
            mask = mask_of_blocks(np.ascontiguousarray(shows_spot[rows, columns]), *keyframe[part].shape[:2])
            cv2.copyTo(self._moved_part(part, image), mask, keyframe[part])
        self._adopt(keyframe)

    def _learn_noise(self, steady: np.ndarray, dt: float) -> None:
        """Averages the rise of steady blocks, and its deviation; both change slowly, so not every image is used."""
        self._noise_s += dt
        if self._noise_s < _PERIOD / 8:
            return
        weight = 1.0 - math.exp(-self._noise_s / _PERIOD)
        mask = steady.view(np.uint8)
        values = self._rise.astype(np.float32)
        cv2.accumulateWeighted(values, self._noise, weight, mask)
        cv2.accumulateWeighted(cv2.absdiff(values, self._noise), self._deviation, weight, mask)
        self._noise_s = 0.0
        self._limit = None


def _is_global(changes: Changes) -> bool:
    """Returns whether so much changed that the background no longer holds.

    A person close to the camera darkens much of the image too, and must not become its background.
    """
    changed = max(np.count_nonzero(changes.brighter), 0.5 * np.count_nonzero(changes.darker))
    return changed > _MAX_CHANGE * changes.brighter.size


def _warp(image: np.ndarray, motion: np.ndarray, target: np.ndarray, interpolation: int) -> np.ndarray:
    """Warps an image by a motion (3, 3) onto another image, which stays where nothing covers it."""
    return cv2.warpAffine(image, motion[:2], target.shape[1::-1], target, interpolation, cv2.BORDER_TRANSPARENT)


def _apply_row_gains(image: np.ndarray, gains: np.ndarray) -> np.ndarray:
    """Returns an image times the gains of its rows of blocks, interpolated."""
    rows = np.interp(np.arange(len(image)), BLOCK * (np.arange(len(gains)) + 0.5) - 0.5, gains).astype(np.float32)
    return cv2.convertScaleAbs(image * rows.reshape((-1, 1) + (1,) * (image.ndim - 2)))


def match_lighting(background: np.ndarray, image: np.ndarray, max_width: float) -> np.ndarray:
    """Returns a background with the brightness of an image, in which light narrower than `max_width` [px] is ignored."""
    half = 2 * math.ceil(max_width / 4)
    size = 2 * half + 1
    kernel = np.zeros((size, size), np.uint8)
    # the colours of a Bayer image are not mixed
    step = 2 if image.ndim == 2 else 1
    kernel[::step, ::step] = 1
    gain = (image + np.float32(1.0)) / (background + np.float32(1.0))
    gain = cv2.morphologyEx(gain, cv2.MORPH_OPEN, kernel)
    return cv2.multiply(background, gain, dtype=cv2.CV_8U)


# ------------------------------------------------------------------ blocks
def block_maxima(image: np.ndarray, background: np.ndarray) -> np.ndarray:
    """Computes each block's largest rise above the background, of any channel, in half of its rows.

    Works in bands: what one step leaves is still in the processor's cache for the next, which saves over half the time.

    Args:
        image, background: (H, W) or (H, W, C) uint8, contiguous. The difference is never stored at full size.

    Returns:
        (H // BLOCK, W // BLOCK) uint8.
    """
    height = BLOCK * max(1, _BAND_BYTES // image[0].nbytes)  # of a band
    bands = []
    for top in range(0, image.shape[0] - BLOCK + 1, height):
        rows = slice(top, top + height)
        bands.append(_band_maxima(image[rows], background[rows]))
    if image.shape[0] % BLOCK:  # half of 1080 rows, for example: the rows left over belong to the last blocks
        last = bands[-1][-1:]
        cv2.max(last, _band_maxima(image[-BLOCK:], background[-BLOCK:]), last)
    maxima = cv2.vconcat(bands)
    if image.shape[1] % BLOCK:  # half of 2028 columns, for example
        strip = np.ascontiguousarray(image[:, -BLOCK:])
        background_strip = np.ascontiguousarray(background[:, -BLOCK:])
        maxima[:, -1:] = cv2.max(maxima[:, -1:], block_maxima(strip, background_strip))
    return maxima


def _band_maxima(image: np.ndarray, background: np.ndarray) -> np.ndarray:
    """Computes `block_maxima` of a band whose height is a multiple of BLOCK; columns left over are ignored."""
    rows, columns = image.shape[0] // BLOCK, image.shape[1] // BLOCK
    # rows are reduced first, where memory is contiguous; the small rest is then transposed and reduced the same way
    now = image[: rows * BLOCK].reshape(rows, -1)
    before = background[: rows * BLOCK].reshape(rows, -1)
    length = now.shape[1] // BLOCK
    read_rows = _MOSAIC_ROWS if image.ndim == 2 else _COLOR_ROWS
    first, *parts = [slice(row * length, (row + 1) * length) for row in read_rows]
    best = cv2.subtract(now[:, first], before[:, first])
    rise = np.empty_like(best)
    for part in parts:
        cv2.subtract(now[:, part], before[:, part], rise)
        cv2.max(best, rise, best)
    best = max_channel(best.reshape((rows,) + image.shape[1:]))
    turned = cv2.transpose(best[:, : columns * BLOCK]).reshape(columns, -1)
    best = np.ascontiguousarray(turned[:, :rows])
    for column in range(1, BLOCK):
        cv2.max(best, turned[:, column * rows : (column + 1) * rows], best)
    return cv2.transpose(best)


def sample_blocks(image: np.ndarray) -> np.ndarray:
    """Samples one pixel of each block, always the same one: (H // BLOCK, W // BLOCK) or (H // BLOCK, W // BLOCK, C)."""
    rows, columns = image.shape[0] // BLOCK, image.shape[1] // BLOCK
    # numpy copies three bytes no faster than thirty
    return cv2.resize(image[: rows * BLOCK, : columns * BLOCK], (columns, rows), interpolation=cv2.INTER_NEAREST)


def blocks_around(shape: Tuple[int, ...], u: float, v: float, reach: float, scale: int) -> Part:
    """Returns the rows and columns of the blocks within `reach` of (u, v), all in pixels of full resolution.

    One searched pixel is `scale` of them wide.
    """
    block = BLOCK * scale
    top = int(max(0.0, v - reach)) // block
    left = int(max(0.0, u - reach)) // block
    bottom = int(max(-1.0, v + reach)) // block + 1
    right = int(max(-1.0, u + reach)) // block + 1
    rows = slice(top, min(shape[0], bottom))
    columns = slice(left, min(shape[1], right))
    return rows, columns


def _pixels_of(rows: slice, columns: slice) -> Part:
    """Returns the pixels of these rows and columns of blocks."""
    return slice(BLOCK * rows.start, BLOCK * rows.stop), slice(BLOCK * columns.start, BLOCK * columns.stop)


def max_channel(image: np.ndarray) -> np.ndarray:
    """Returns the largest channel (H, W) of each pixel; cv2 does this fifty times faster than numpy's max."""
    return image if image.ndim == 2 else reduce(cv2.max, cv2.split(image))


def mask_of_blocks(blocks: np.ndarray, height: int, width: int) -> np.ndarray:
    """Returns a mask (height, width) uint8 of the pixels whose block is set."""
    rows, columns = blocks.shape
    mask = cv2.resize(blocks.view(np.uint8), (columns * BLOCK, rows * BLOCK), interpolation=cv2.INTER_NEAREST)
    rest = height - rows * BLOCK, width - columns * BLOCK
    # pixels left over at the edges belong to the last blocks
    return cv2.copyMakeBorder(mask, 0, rest[0], 0, rest[1], cv2.BORDER_REPLICATE) if any(rest) else mask


# ------------------------------------------------------------------ regions
def find_regions(
    picture: AnyPicture, changes: Changes, min_level: float, expected: Sequence[ExpectedSpot]
) -> List[ChangedRegion]:
    """Finds an image's regions that became brighter, the brightest first; those darker than `min_level` have no boxes."""
    image = picture.search_pixels
    # a spot is white on any floor, but on a bright floor a person next to it rises more
    boxes = sorted(find_boxes(changes.rise, changes.brighter), key=lambda box: -_max_in_box(image, box))
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
