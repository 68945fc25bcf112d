"""What a stationary camera sees without a spot: a background updated slowly, never from a spot."""
from __future__ import annotations

import math
from typing import Optional, Sequence

import cv2
import numpy as np

from vb_laser_detect.blocks import BLOCK, Region, block_maxima, blocks_around, mask_of_blocks, max_channel, sample_blocks

_DARKER = 20  # [grey levels] a pixel that became darker by more than this has changed
_NOISE_DEVIATIONS = 6.0  # how far a rise must exceed a block's own noise
_NOISE_TIME = 1.0  # [s] over which a block's noise is averaged
_CYCLE_S = 1.0  # every pixel is blended in once in this time
_ABSORB_S = 1.5  # a change that lasts this long belongs to the background
_WEIGHT = 0.25  # of a frame whenever a strip is blended in
_ABSORB_MOVING = 6  # [images] while the camera moves: what an inexact motion leaves of an edge lasts this long
_MARGIN = 24  # [px] around a region that is examined
_SQUARE = np.ones((3, 3), np.uint8)
_EVEN = np.zeros((5, 5), np.uint8)  # the same for the places of a Bayer pattern
_EVEN[::2, ::2] = 1


class Background:
    """The background of one camera at full resolution, and each block's noise.

    The image is blended in strip by strip, so that every frame costs the same. Blocks that changed are left out
    until the change has lasted 1.5 s; then they are adopted in one step. Blocks that show a spot are left
    out for `hold_s`.

    Args:
        image: (H, W) or (H, W, C) uint8, the first image.
        hold_s: [s] how long a spot may shine in the same place before it counts as a lamp.

    Attributes:
        image: the background itself.
        reference: what the next image is compared with.
        moved: whether the camera moved since the last image.
    """

    def __init__(self, image: np.ndarray, hold_s: float) -> None:
        self.image = image.copy()
        self.hold_s = hold_s
        self._sample = sample_blocks(image)
        blocks = (image.shape[0] // BLOCK, image.shape[1] // BLOCK)
        self._noise = np.zeros(blocks, np.float32)
        self._deviation = np.zeros(blocks, np.float32)
        self._changed_s = np.zeros(blocks, np.float32)
        self._nothing = np.zeros(blocks, np.float32)
        self._held_s = np.zeros(blocks, np.float32)
        self._guessed = np.zeros(blocks, np.uint8)
        self._limit: Optional[np.ndarray] = None  # of a rise that exceeds the noise, once that is known
        self._noise_s = 0.0
        self._holding = False
        self._row = 0
        self._owed_rows = 0.0
        self.reference = self.image  # what the next image is compared with
        self.moved = False

    def move(self, motion: Optional[np.ndarray], image: np.ndarray, mosaic: bool) -> None:
        """Moves the background with the camera; what was out of view is taken from the image.

        Args:
            motion: (3, 3) maps the background's pixels to the image's; None: the camera is stationary.
        """
        self.moved = motion is not None
        self.reference = self.image
        if motion is None:
            return
        self._before, self._motion = None if mosaic else self.image, motion
        self.image = _warped(self.image, motion, image, mosaic, cv2.INTER_CUBIC if mosaic else cv2.INTER_NEAREST)
        size = self._noise.shape[::-1]
        of_blocks = np.diag((1.0 / BLOCK, 1.0 / BLOCK, 1.0)) @ motion @ np.diag((float(BLOCK), float(BLOCK), 1.0))
        for name in ("_noise", "_deviation", "_changed_s", "_held_s", "_guessed"):
            values = getattr(self, name)
            border = float(values.mean()) if name in ("_noise", "_deviation") else 0.0
            setattr(self, name, cv2.warpPerspective(
                values, of_blocks, size, flags=cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=border))
        self._limit = None
        # motion is only known to a fraction of a pixel: a pixel is compared with its brightest neighbour
        around = _EVEN if mosaic else _SQUARE
        self.reference = cv2.dilate(self.image, around)
        self._sample = sample_blocks(cv2.erode(self.image, around))

    def refine(self, regions: Sequence[Region], image: np.ndarray) -> None:
        """Moves the background exactly around examined regions only: everywhere, this would be the main cost."""
        if not self.moved or self._before is None:
            return
        for left, top, right, bottom in regions:
            x0, y0 = max(0, left - _MARGIN), max(0, top - _MARGIN)
            part = (slice(y0, bottom + _MARGIN), slice(x0, right + _MARGIN))
            there = np.array([[1.0, 0.0, -x0], [0.0, 1.0, -y0], [0.0, 0.0, 1.0]])
            self.image[part] = _warped(self._before, there @ self._motion, image[part], False, cv2.INTER_CUBIC)
            self.reference[part] = cv2.dilate(self.image[part], _SQUARE)

    def rise(self, image: np.ndarray) -> np.ndarray:
        """(H // 8, W // 8) uint8: each block's largest rise above the background."""
        # a colour image has so much data that every second row must do: spots cover several
        return block_maxima(image, self.reference, row_step=1 if image.ndim == 2 else 2, brightest=True)

    def darker_blocks(self, image: np.ndarray) -> np.ndarray:
        """(H // 8, W // 8) bool: blocks that became darker, judged by one pixel of each."""
        return max_channel(cv2.subtract(self._sample, sample_blocks(image))) > _DARKER

    def learn_noise(self, maxima: np.ndarray) -> None:
        """Sets each block's noise to the whole scene's; call it with the second frame's rise."""
        middle = float(np.median(maxima))
        self._noise[:] = middle
        self._deviation[:] = max(1.5, 1.5 * float(np.median(np.abs(maxima - middle))))
        self._limit = None

    def hot_blocks(self, maxima: np.ndarray, least: float) -> np.ndarray:
        """(rows, columns) bool: blocks whose rise is at least `least` and exceeds the block's own noise."""
        if self._limit is None:
            # whole grey levels, as the rise has: comparing bytes is four times faster
            self._limit = np.ceil(np.minimum(255.0, self._noise + _NOISE_DEVIATIONS * self._deviation)).astype(np.uint8)
        return cv2.compare(maxima, cv2.max(self._limit, math.ceil(least)), cv2.CMP_GE) > 0

    def guess(self, floor: np.ndarray, u: float, v: float, diameter: float) -> None:
        """Inserts a guess of the floor (H, W) or (H, W, C) where something has shone from the beginning."""
        reach = int(0.75 * diameter) + 4
        top, left = max(0, int(v) - reach), max(0, int(u) - reach)
        part = (slice(top, int(v) + reach), slice(left, int(u) + reach))
        self.image[part] = floor[part]
        self._sample = sample_blocks(self.image)
        self._guessed[blocks_around(self._guessed.shape, u, v, reach)] = 1

    def is_guessed(self, u: float, v: float) -> bool:
        """Whether the floor at a pixel was never seen."""
        # a motion by part of a block moves marks by whole blocks: neighbours count too
        return bool(self._guessed[blocks_around(self._guessed.shape, u, v, BLOCK)].any())

    def learn(self, image: np.ndarray, rise: np.ndarray, changed: np.ndarray, spots: np.ndarray, dt: float) -> None:
        """Adds a frame.

        Args:
            rise: (rows, columns) of the blocks.
            changed, spots: (rows, columns) bool; blocks that changed, and blocks that show a spot.
            dt: [s] since the last frame.
        """
        dt32 = np.float32(dt)
        if spots.any() or self._holding:
            self._held_s = cv2.max(self._held_s + (spots * np.float32(2.0 * dt) - dt32), 0.0)
            self._holding = bool(self._held_s.any())
        held = spots & (self._held_s < self.hold_s)
        steady = ~(changed | held)
        if cv2.countNonZero(self._guessed):
            self._guessed[steady] = 0
        self._changed_s += dt32
        cv2.copyTo(self._nothing, (steady | held).view(np.uint8), self._changed_s)
        self._noise_s += dt
        if self._noise_s >= _NOISE_TIME / 8:
            # noise changes slowly: not updated with each image
            weight, mask = 1.0 - math.exp(-self._noise_s / _NOISE_TIME), steady.view(np.uint8)
            values = rise.astype(np.float32)
            cv2.accumulateWeighted(values, self._noise, weight, mask)
            cv2.accumulateWeighted(cv2.absdiff(values, self._noise), self._deviation, weight, mask)
            self._noise_s, self._limit = 0.0, None
        absorbed = self._changed_s > (min(_ABSORB_S, _ABSORB_MOVING * dt) if self.moved else _ABSORB_S)
        if absorbed.any():
            self._absorb(image, absorbed)
        if self.moved:
            # nothing that is still there is warped twice: that would blur it more with each image
            mask = mask_of_blocks(steady, image.shape[0], image.shape[1])
            cv2.copyTo(image, mask, self.image)
            self._sample = sample_blocks(self.image)
        else:
            self._blend(image, steady, dt)

    def _absorb(self, image: np.ndarray, blocks: np.ndarray) -> None:
        rows = np.flatnonzero(blocks.any(axis=1))
        first, last = int(rows[0]), int(rows[-1]) + 1
        top, bottom = first * BLOCK, last * BLOCK
        mask = mask_of_blocks(blocks[first:last], bottom - top, image.shape[1])
        cv2.copyTo(image[top:bottom], mask, self.image[top:bottom])
        self._sample[first:last] = sample_blocks(self.image[top:bottom])
        self._changed_s[blocks] = 0.0
        self._guessed[blocks] = 0

    def _blend(self, image: np.ndarray, steady: np.ndarray, dt: float) -> None:
        rows = image.shape[0] // BLOCK
        self._owed_rows += rows * min(1.0, dt / _CYCLE_S)
        while self._owed_rows >= 1.0:
            if self._row >= rows:
                self._row = 0
            last = min(rows, self._row + int(self._owed_rows))
            self._owed_rows -= last - self._row
            top, bottom = self._row * BLOCK, last * BLOCK
            strip = self.image[top:bottom]
            blended = cv2.addWeighted(image[top:bottom], _WEIGHT, strip, 1.0 - _WEIGHT, 0.0)
            mask = mask_of_blocks(steady[self._row : last], bottom - top, image.shape[1])
            cv2.copyTo(blended, mask, strip)
            self._sample[self._row : last] = sample_blocks(strip)
            self._row = last


def _warped(background: np.ndarray, motion: np.ndarray, image: np.ndarray, mosaic: bool, how: int) -> np.ndarray:
    """The background as the camera sees it now; the image itself where nothing was seen before.

    Args:
        how: OpenCV's interpolation; linear would blur what a spot hides, image by image, until a bright thing stood out.
    """
    if mosaic:
        height, width = image.shape[0] & ~1, image.shape[1] & ~1
        planes = [np.dstack([picture[y:height:2, x:width:2] for y in (0, 1) for x in (0, 1)])
                  for picture in (background, image)]
        halved = np.diag((0.5, 0.5, 1.0)) @ motion @ np.diag((2.0, 2.0, 1.0))
        warped, result = _warped(planes[0], halved, planes[1], False, how), image.copy()
        for number in range(4):
            result[number // 2 : height : 2, number % 2 : width : 2] = warped[:, :, number]
        return result
    result, size = image.copy(), (image.shape[1], image.shape[0])
    if np.array_equal(motion[2], (0.0, 0.0, 1.0)):
        return cv2.warpAffine(background, motion[:2], size, result, how, cv2.BORDER_TRANSPARENT)
    return cv2.warpPerspective(background, motion, size, result, how, cv2.BORDER_TRANSPARENT)
