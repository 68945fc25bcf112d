"""Models what a camera sees without a spot, and compares images with it, by blocks of BLOCK x BLOCK pixels.

Each image is compared with a keyframe, which never includes a spot. A stationary camera's keyframe averages one image a
second, except where something has just changed. A moving camera's keyframe is replaced every few images. Whole images
are compared by blocks only, because every image must be compared.
"""

from __future__ import annotations

import math
from functools import reduce
from typing import Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_core.image_format import AnyPicture
from vb_laser_detect.detection.stage_results import BLOCK, Comparison, ExpectedSpot, Motion, Part, Spot

_BAND_BYTES = 240_000  # [bytes] of one pixel row of all blocks in a band: small enough for a core's cache
# half of a block's rows are read, in half the time, because a spot covers several rows
_COLOR_ROWS = (1, 3, 5, 7)
_MOSAIC_ROWS = (1, 2, 5, 6)  # in pairs, because two Bayer rows hold all colours
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
            part = _pixels_of(rows, columns)
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
        changed = comparison.changed
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
            part = _pixels_of(rows, columns)
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


# ------------------------------------------------------------------ blocks
def block_maxima(image: np.ndarray, background: np.ndarray) -> np.ndarray:
    """Computes each block's largest rise above the background, of any channel, in half of its rows.

    Works in bands, so that each step finds the previous one's result in the processor's cache: over twice as fast.

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
    if image.shape[0] % BLOCK:  # in half of 1080 rows, for example, the rows left over belong to the last blocks
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
    if not any(rest):
        return mask
    # pixels left over at the edges belong to the last blocks
    return cv2.copyMakeBorder(mask, 0, rest[0], 0, rest[1], cv2.BORDER_REPLICATE)
