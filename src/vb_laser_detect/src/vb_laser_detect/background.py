"""What a stationary camera sees without a spot, learnt slowly and never from a spot."""
from __future__ import annotations

import math

import cv2
import numpy as np

from vb_laser_detect.blocks import BLOCK, block_maxima, mask_of_blocks, max_channel, sample_blocks

_DARKER = 20  # [grey levels] a pixel that became darker by more than this has changed
_MOSAIC = 2.0  # [grey levels] by which the means of places in a grey image's tiles may differ
_NOISE_DEVIATIONS = 6.0  # how far a rise must stand out of a block's own noise
_NOISE_TIME = 1.0  # [s] in which a block's noise is learnt
_WEIGHT = 0.25  # of a frame whenever a strip is blended in


class Background:
    """The background of one camera at full resolution, and each block's noise.

    The image is blended in strip by strip, so that every frame costs the same. Blocks that changed are left out
    until they stayed changed for `absorb_s`; then they are taken over in one step. Blocks that show a spot are
    left out for `hold_s`.

    Args:
        image: (H, W) or (H, W, C) uint8, the first image.
        cycle_s: [s] time in which every pixel is blended in once.
        absorb_s: [s] how long a change must last to belong to the background.
        hold_s: [s] how long a spot may shine on the same place before it is taken for a lamp.
    """

    def __init__(self, image: np.ndarray, cycle_s: float, absorb_s: float, hold_s: float) -> None:
        self.image = image.copy()
        self._cycle_s, self._absorb_s, self._hold_s = cycle_s, absorb_s, hold_s
        self._sample = sample_blocks(image)
        blocks = (image.shape[0] // BLOCK, image.shape[1] // BLOCK)
        self._noise = np.zeros(blocks, np.float32)
        self._deviation = np.zeros(blocks, np.float32)
        self._changed_s = np.zeros(blocks, np.float32)
        self._held_s = np.zeros(blocks, np.float32)
        self._holding = False
        self._row = 0
        self._owed_rows = 0.0

    def retime(self, cycle_s: float, absorb_s: float, hold_s: float) -> None:
        """Goes on with other times; see the class."""
        self._cycle_s, self._absorb_s, self._hold_s = cycle_s, absorb_s, hold_s

    def rise(self, image: np.ndarray) -> np.ndarray:
        """(H // 8, W // 8) uint8: by how much each block's brightest change is above the background."""
        # a colour image carries so much data that every second row has to do: spots cover several
        return block_maxima(image, self.image, row_step=1 if image.ndim == 2 else 2, brightest=True)

    def darker_blocks(self, image: np.ndarray) -> np.ndarray:
        """(H // 8, W // 8) bool: blocks that became darker, judged by one pixel of each."""
        return max_channel(cv2.subtract(self._sample, sample_blocks(image))) > _DARKER

    def learn_noise(self, maxima: np.ndarray) -> None:
        """Takes the whole scene's noise for each block's; to be called with the second frame's rise."""
        middle = float(np.median(maxima))
        self._noise[:] = middle
        self._deviation[:] = max(1.5, 1.5 * float(np.median(np.abs(maxima - middle))))

    def hot_blocks(self, maxima: np.ndarray, least: float) -> np.ndarray:
        """(rows, columns) bool: blocks whose rise is at least `least` and stands out of the block's own noise."""
        return maxima >= np.maximum(np.float32(least), self._noise + np.float32(_NOISE_DEVIATIONS) * self._deviation)

    def erase(self, u: float, v: float, diameter: float) -> None:
        """Puts the median of its surroundings where a spot was shining when the background was taken."""
        inner = 2 * int(math.ceil(0.5 * diameter) + 2)
        outer = 2 * inner
        height, width = self.image.shape[:2]
        # even bounds keep each pixel's place in a Bayer image's pattern; there each place has a median of its own
        u, v = 2 * int(u / 2), 2 * int(v / 2)
        top, bottom, left, right = max(0, v - outer), min(height, v + outer), max(0, u - outer), min(width, u + outer)
        window = self.image[top:bottom, left:right]
        filled = window.copy()
        steps = [(0, 0, 1)] if self.image.ndim == 3 else [(y, x, 2) for y in (0, 1) for x in (0, 1)]
        for y, x, step in steps:
            plane = np.ascontiguousarray(window[y::step, x::step])
            filled[y::step, x::step] = cv2.medianBlur(plane, min(2 * outer // step - 1, 255))
        rows = slice(max(0, v - inner) - top, v + inner - top)
        columns = slice(max(0, u - inner) - left, u + inner - left)
        window[rows, columns] = filled[rows, columns]
        self._sample = sample_blocks(self.image)

    def learn(self, image: np.ndarray, rise: np.ndarray, changed: np.ndarray, spots: np.ndarray, dt: float) -> None:
        """Takes a frame in.

        Args:
            rise: (rows, columns) of the blocks.
            changed, spots: (rows, columns) bool; blocks that changed, and blocks that show a spot.
            dt: [s] since the last frame.
        """
        dt32 = np.float32(dt)
        if spots.any() or self._holding:
            self._held_s = np.where(spots, self._held_s + dt32, np.maximum(self._held_s - dt32, 0.0))
            self._holding = bool(self._held_s.any())
        held = spots & (self._held_s < self._hold_s)
        steady = ~(changed | held)
        self._changed_s += dt32
        self._changed_s *= ~(steady | held)
        if dt > 0:
            mask = steady.view(np.uint8)
            weight = 1.0 - math.exp(-dt / _NOISE_TIME)
            values = rise.astype(np.float32)
            cv2.accumulateWeighted(values, self._noise, weight, mask)
            cv2.accumulateWeighted(cv2.absdiff(values, self._noise), self._deviation, weight, mask)
        absorbed = self._changed_s > self._absorb_s
        if absorbed.any():
            self._absorb(image, absorbed)
        self._blend(image, steady, dt)

    def _absorb(self, image: np.ndarray, blocks: np.ndarray) -> None:
        rows = np.flatnonzero(blocks.any(axis=1))
        first, last = int(rows[0]), int(rows[-1]) + 1
        top, bottom = first * BLOCK, last * BLOCK
        mask = mask_of_blocks(blocks[first:last], bottom - top, image.shape[1])
        cv2.copyTo(image[top:bottom], mask, self.image[top:bottom])
        self._sample[first:last] = sample_blocks(self.image[top:bottom])
        self._changed_s[blocks] = 0.0

    def _blend(self, image: np.ndarray, steady: np.ndarray, dt: float) -> None:
        rows = image.shape[0] // BLOCK
        self._owed_rows += rows * min(1.0, dt / self._cycle_s)
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


def is_mosaic(image: np.ndarray) -> bool:
    """Whether an image (H, W) comes from a Bayer camera: neighbouring pixels show different colours.

    A camera that is balanced to white over a floor without any colour is taken for a grey one.
    """
    if image.ndim != 2:
        return False
    # the means of tiles 32 pixels wide, of each place in the pattern
    rows, columns = image.shape[0] // 32, image.shape[1] // 32
    whole = image[: 32 * rows, : 32 * columns]
    means = np.stack([
        cv2.resize(np.ascontiguousarray(whole[y::2, x::2]), (columns, rows), interpolation=cv2.INTER_AREA)
        for y in (0, 1) for x in (0, 1)
    ]).astype(np.float32)
    spread = means.max(axis=0) - means.min(axis=0)
    return bool(np.median(spread) > _MOSAIC + 0.04 * np.median(means))
