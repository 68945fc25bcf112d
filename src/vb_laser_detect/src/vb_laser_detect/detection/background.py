"""Models what a camera sees without a spot: a background that is updated slowly, never from a spot.

One idea for cameras that move: a keyframe. The background stays where it was taken, and each image is compared with it
through one motion, from the keyframe to now, so that nothing is resampled twice and no error adds up. Every few images
the image itself becomes the keyframe; only what a spot hides is brought along. What shone in the keyframe within a
pixel, the uncertainty of that motion, is not new.
"""

from __future__ import annotations

import math
from typing import Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_laser_detect.detection.blocks import (
    BLOCK,
    Region,
    block_maxima,
    halve,
    mask_of_blocks,
    max_channel,
    sample_blocks,
)

_NOISE_DEVIATIONS = 6.0  # how far a rise must exceed a block's own noise
_CYCLE_TIME = 1.0  # [s] every pixel is blended in once in this time, and a block's noise is averaged over it
_ABSORPTION_TIME = 1.5  # [s] a change that lasts this long belongs to the background
_BRIGHT = 99.0  # [%] of the background are darker than what counts as bright in it
_WEIGHT = 0.25  # of a frame whenever a strip is blended in
_KEYFRAME = 6  # [images] a moving camera's background is kept for: people walk on
_KEYFRAME_PART = 0.1  # of the image's width that it may have moved by: what comes into view is not in the keyframe
_BANDS = 0.1  # the rows' light differs by this part at least where lamps flicker
_MARGIN = 24  # [px] around a region that is examined
# half the rows must do, in half the time: spots cover several. In a Bayer image's pattern two neighbours hold all
# colours
_COLOR_ROWS, _MOSAIC_ROWS = (1, 3, 5, 7), (1, 2, 5, 6)
_SQUARE = np.ones((3, 3), np.uint8)
_HALF = np.diag((0.5, 0.5, 1.0))


class Background:
    """The background of one camera at full resolution, and each block's noise.

    A stationary camera's image is blended in strip by strip, so that every frame costs the same. Blocks
    that changed are left out until the change has lasted 1.5 s; then they are adopted in one step. Blocks
    that show a spot are left out.

    Args:
        image: (H, W) or (H, W, 3) uint8, the first image.

    Attributes:
        image: the background itself.
        reference: what an image is compared with where it is examined.
        blocks: their rows and columns.
        bright: [grey levels] of the brightest surfaces in it.
        motion: (3, 3) maps the background's pixels to those of the last image; None if the camera was stationary.
    """

    def __init__(self, image: np.ndarray) -> None:
        self.image = self.reference = image.copy()
        self.motion: Optional[np.ndarray] = None
        self._sample = sample_blocks(image)
        self.blocks = blocks = (image.shape[0] // BLOCK, image.shape[1] // BLOCK)
        self._noise, self._deviation, self._changed_s = np.zeros((3,) + blocks, np.float32)
        self._limit: Optional[np.ndarray] = None  # of a rise that exceeds the noise, once that is known
        self._noise_s, self._noise_known = 0.0, False
        self._strip = 0.0  # part of the image that was blended in
        # at half size, the brightest of nine pixels each
        self._brightest: Optional[np.ndarray] = None
        self._images = 0  # since the keyframe, with motion
        self._measure()

    def subtract_background(
        self, image: np.ndarray, motion: Optional[np.ndarray], half: Optional[np.ndarray] = None
    ) -> Tuple[np.ndarray, np.ndarray]:
        """Compares an image with the background.

        Args:
            motion: (3, 3) maps the background's pixels to the image's; None: the camera is stationary.
            half: the image at half size, if the camera is not.

        Returns:
            Each block's largest rise above the background, and by how much a sample of it became darker, (rows, columns) uint8.
        """
        self.motion, self.reference = motion, self.image
        if motion is None:
            rise = block_maxima(image, self.image, _MOSAIC_ROWS if image.ndim == 2 else _COLOR_ROWS)
            return rise, max_channel(cv2.subtract(self._sample, sample_blocks(image)))
        # at half size moving it costs a quarter, and fractions of a pixel matter less: to the nearest one it is moved
        if self._brightest is None:
            self._brightest = cv2.dilate(halve(self.image), _SQUARE)
        self.reference = image.copy()
        shown = warp(self._brightest, _HALF @ motion @ np.diag((2.0, 2.0, 1.0)), half.copy(), cv2.INTER_NEAREST)
        darker = cv2.subtract(sample_blocks(cv2.erode(shown, _SQUARE), BLOCK // 2), sample_blocks(half, BLOCK // 2))
        return block_maxima(half, shown, range(BLOCK // 2), BLOCK // 2), max_channel(darker)

    def subtract_bands(self, image: np.ndarray) -> Optional[Tuple[np.ndarray, np.ndarray]]:
        """Compares an image with the background in the light of each of its rows; None if all rows have the same.

        Lamps that flicker light the rows of a rolling shutter one after the other.
        """
        now, before = (max_channel(sample).astype(np.float32) + 1.0 for sample in (sample_blocks(image), self._sample))
        gains = np.median(now / before, axis=1)
        if np.ptp(gains) < _BANDS * gains.mean():
            return None
        rows = np.interp(np.arange(len(image)), BLOCK * (np.arange(len(gains)) + 0.5) - 0.5, gains).astype(np.float32)
        light = rows.reshape((-1, 1) + (1,) * (image.ndim - 2))
        self.reference = cv2.convertScaleAbs(self.image * light)
        darker = cv2.subtract(sample_blocks(self.reference), sample_blocks(image))
        rise = block_maxima(image, self.reference, _MOSAIC_ROWS if image.ndim == 2 else _COLOR_ROWS)
        return rise, max_channel(darker)

    def refine_reference(self, regions: Sequence[Region], image: np.ndarray) -> None:
        """Makes the reference of a moving camera exact around regions [px]; elsewhere it is the image itself."""
        for left, top, right, bottom in regions if self.motion is not None else ():
            part = (slice(max(0, top - _MARGIN), bottom + _MARGIN), slice(max(0, left - _MARGIN), right + _MARGIN))
            self.reference[part] = cv2.dilate(self.moved_part(part, image), _SQUARE)

    def moved_part(self, part: Tuple[slice, slice], image: np.ndarray) -> np.ndarray:
        """Returns a part of the background as the camera sees it now; of the image where nothing was in view."""
        if self.motion is None:
            return self.image[part]
        there = np.array([[1.0, 0.0, -part[1].start], [0.0, 1.0, -part[0].start], [0.0, 0.0, 1.0]]) @ self.motion
        return warp(self.image, there, image[part].copy(), cv2.INTER_CUBIC)

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

    def update(self, image: np.ndarray, rise: np.ndarray, changed: np.ndarray, spots: np.ndarray, dt: float) -> bool:
        """Adds a frame.

        Args:
            rise: (rows, columns) of the blocks.
            changed, spots: (rows, columns) bool; blocks that changed, and blocks that show a spot.
            dt: [s] since the last frame.

        Returns:
            Whether the image became the keyframe of a camera that moved.
        """
        if self.motion is not None:
            self._images += 1
            middle = np.array([[[0.5 * image.shape[1], 0.5 * image.shape[0]]]])
            far = np.abs(cv2.perspectiveTransform(middle, self.motion) - middle).max() > _KEYFRAME_PART * image.shape[1]
            if not far and self._images < _KEYFRAME:
                return False
            self._begin_keyframe(image, spots)
            return True
        steady = ~(changed | spots)
        self._changed_s = cv2.copyTo(cv2.add(self._changed_s, dt), (changed & ~spots).view(np.uint8))
        self._noise_s += dt
        if self._noise_s >= _CYCLE_TIME / 8:
            # noise changes slowly: not updated with each image
            weight, mask = 1.0 - math.exp(-self._noise_s / _CYCLE_TIME), steady.view(np.uint8)
            values = rise.astype(np.float32)
            cv2.accumulateWeighted(values, self._noise, weight, mask)
            cv2.accumulateWeighted(cv2.absdiff(values, self._noise), self._deviation, weight, mask)
            self._noise_s, self._limit = 0.0, None
        absorbed = self._changed_s > _ABSORPTION_TIME
        if absorbed.any():
            self._changed_s[absorbed] = 0.0
            self._take(image, absorbed, 1.0)
        first, self._strip = self._strip, self._strip + min(1.0, dt / _CYCLE_TIME)
        self._take(image, steady, _WEIGHT, *(int(round(min(1.0, part) * len(steady))) for part in (first, self._strip)))
        if self._strip >= 1.0:
            self._strip = 0.0
            self._measure()
        return False

    def _measure(self) -> None:
        """Notes how bright the room's brightest surfaces are; single lamps are less than a hundredth of the image."""
        # the places in a Bayer image's pattern see different colours
        cells = self.image if self.image.ndim == 3 else cv2.dilate(self.image, np.ones((2, 2), np.uint8), anchor=(0, 0))
        self.bright = float(np.percentile(max_channel(sample_blocks(cells, 2 * BLOCK)), _BRIGHT))

    def _begin_keyframe(self, image: np.ndarray, spots: np.ndarray) -> None:
        """Makes the image the background, except under spots."""
        left, top, wide, high = (BLOCK * number for number in cv2.boundingRect(spots.view(np.uint8)))
        kept = image.copy()
        if wide:
            part = slice(top, top + high), slice(left, left + wide)
            rows, columns = (slice(one.start // BLOCK, one.stop // BLOCK) for one in part)
            cv2.copyTo(
                self.moved_part(part, image),
                mask_of_blocks(np.ascontiguousarray(spots[rows, columns]), high, wide),
                kept[part],
            )
        self.image, self._sample = kept, sample_blocks(kept)
        self._brightest = self.motion = None
        self._measure()
        self._changed_s[:], self._images = 0.0, 0
        self._noise[:], self._deviation[:], self._limit = self._noise.mean(), self._deviation.mean(), None

    def _take(
        self, image: np.ndarray, blocks: np.ndarray, weight: float, first: int = 0, last: Optional[int] = None
    ) -> None:
        """Blends blocks of the image in, of some rows of blocks."""
        blocks = blocks[first:last]
        rows = np.flatnonzero(blocks.any(axis=1))
        if not len(rows):
            return
        first, blocks = first + int(rows[0]), blocks[rows[0] : rows[-1] + 1]
        part = slice(first * BLOCK, (first + len(blocks)) * BLOCK)
        strip = self.image[part]
        new = image[part] if weight == 1.0 else cv2.addWeighted(image[part], weight, strip, 1.0 - weight, 0.0)
        cv2.copyTo(new, mask_of_blocks(blocks, *strip.shape[:2]), strip)
        self._sample[first : first + len(blocks)] = sample_blocks(strip)
        self._brightest = None


def warp(image: np.ndarray, motion: np.ndarray, into: np.ndarray, how: int) -> np.ndarray:
    """Warps an image by a motion (3, 3), in place of all pixels of another one that it covers."""
    if np.array_equal(motion[2], (0.0, 0.0, 1.0)):  # in half the time
        return cv2.warpAffine(image, motion[:2], into.shape[1::-1], into, how, cv2.BORDER_TRANSPARENT)
    return cv2.warpPerspective(image, motion, into.shape[1::-1], into, how, cv2.BORDER_TRANSPARENT)
