"""What a camera sees without a spot: a background updated slowly, never from a spot.

A moving camera is a stationary one over a background that moves along. It is moved tile by tile by whole pixels, and an
image compared with the brightest of the nine pixels around each place, as the motion is not exactly known; it is warped by
parts of a pixel only where something is examined. Then all that is steady is taken from the image itself: nothing is
moved twice and blurred.
"""
from __future__ import annotations

import math
from typing import Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_laser_detect.detection.blocks import BLOCK, Region, block_maxima, mask_of_blocks, max_channel, sample_blocks

_DARKER = 20  # [grey levels] a pixel that became darker by more than this has changed
_NOISE_DEVIATIONS = 6.0  # how far a rise must exceed a block's own noise
_NOISE_TIME = 1.0  # [s] over which a block's noise is averaged
_CYCLE_S = 1.0  # every pixel is blended in once in this time
_ABSORB_S = 1.5  # a change that lasts this long belongs to the background
_WEIGHT = 0.25  # of a frame whenever a strip is blended in
_ABSORB_MOVING = 6  # [images] while the camera moves: what an inexact motion leaves of an edge lasts this long
_MARGIN = 24  # [px] around a region that is examined
_AROUND = 7  # [blocks] the neighbourhood of a spot, whose median is taken for the floor under it
_SQUARE = np.ones((3, 3), np.uint8)
_TILE = 96  # [px] in which a motion is the same to a fraction of a pixel


class Background:
    """The background of one camera at full resolution, and each block's noise.

    A stationary camera's image is blended in strip by strip, so that every frame costs the same. Blocks that changed are
    left out until the change has lasted 1.5 s; then they are adopted in one step. Blocks that show a spot are left
    out for a longer time.

    Args:
        image: (H, W) or (H, W, 3) uint8, the first image.

    Attributes:
        image: the background itself.
        reference: what an image is compared with where it is examined.
        blocks: their rows and columns.
        moved: whether the camera moved since the last image.
    """

    def __init__(self, image: np.ndarray) -> None:
        self.image = self.reference = image.copy()
        self.moved = False
        self._sample = sample_blocks(image)
        self.blocks = blocks = (image.shape[0] // BLOCK, image.shape[1] // BLOCK)
        self._noise, self._deviation, self._changed_s, self._held_s = np.zeros((4,) + blocks, np.float32)
        self._limit: Optional[np.ndarray] = None  # of a rise that exceeds the noise, once that is known
        self._noise_s, self._noise_known = 0.0, False
        self._strip = 0.0  # part of the image that was blended in

    def guess(self, where: np.ndarray) -> None:
        """Replaces blocks, (rows, columns) bool, by the median of their neighbourhood: the spot on them is no floor."""
        # edges of carpets, next to which spots are drawn, stay in a median; a Bayer image's places have their own
        floor = np.empty_like(self.image)
        for place in [np.s_[y::2, x::2] for y in (0, 1) for x in (0, 1)] if floor.ndim == 2 else [np.s_[:, :]]:
            means = cv2.resize(np.ascontiguousarray(self.image[place]), where.shape[::-1], interpolation=cv2.INTER_AREA)
            floor[place] = cv2.resize(cv2.medianBlur(means, _AROUND), floor[place].shape[1::-1])
        self._take(floor, where, 1.0)

    def rise(self, image: np.ndarray, motion: Optional[np.ndarray]) -> Tuple[np.ndarray, np.ndarray]:
        """Each block's largest rise above the background, (rows, columns) uint8, and which became darker, bool.

        Args:
            motion: (3, 3) maps the background's pixels to the image's; None: the camera is stationary.
        """
        self.moved = motion is not None
        self.reference = self.image
        if self.moved:
            self._move(motion, image)
        # a colour image has so much data that every second row must do: spots cover several
        rise = block_maxima(image, self.reference, row_step=1 if image.ndim == 2 else 2)
        darker = max_channel(cv2.subtract(self._sample, sample_blocks(image))) > _DARKER
        return rise, darker

    def _move(self, motion: np.ndarray, image: np.ndarray) -> None:
        """Moves all that is known with the camera; what was out of view is taken from the image."""
        of_blocks = np.diag((1.0 / BLOCK, 1.0 / BLOCK, 1.0)) @ motion @ np.diag((float(BLOCK), float(BLOCK), 1.0))
        times = cv2.warpPerspective(np.dstack([self._changed_s, self._held_s]), of_blocks, self.blocks[::-1],
                                    flags=cv2.INTER_NEAREST)
        self._changed_s, self._held_s = cv2.split(times)
        # a block's noise belongs to the edges that it showed
        self._noise[:], self._deviation[:], self._limit = self._noise.mean(), self._deviation.mean(), None
        self._before, self._motion = self.image, motion
        self.image = _shifted(self.image, motion, image)
        self.reference = cv2.dilate(self.image, _SQUARE)
        self._sample = sample_blocks(self.image)

    def examine(self, regions: Sequence[Region], image: np.ndarray) -> None:
        """Makes the reference exact around regions [px]."""
        for left, top, right, bottom in regions if self.moved else ():
            x, y = max(0, left - _MARGIN), max(0, top - _MARGIN)
            part = slice(y, bottom + _MARGIN), slice(x, right + _MARGIN)
            there = np.array([[1.0, 0.0, -x], [0.0, 1.0, -y], [0.0, 0.0, 1.0]]) @ self._motion
            # linear would blur what a spot hides, image by image, until a bright thing stood out
            result = image[part].copy()
            self.image[part] = cv2.warpPerspective(
                self._before, there, result.shape[1::-1], result, cv2.INTER_CUBIC, cv2.BORDER_TRANSPARENT)
            self.reference[part] = cv2.dilate(self.image[part], _SQUARE)

    def hot_blocks(self, maxima: np.ndarray, least: float) -> np.ndarray:
        """(rows, columns) bool: blocks whose rise is at least `least` and exceeds the block's own noise."""
        if not self._noise_known:
            # the second image's: the whole scene's
            middle = float(np.median(maxima))
            self._noise[:], self._deviation[:] = middle, max(1.5, 1.5 * float(np.median(np.abs(maxima - middle))))
            self._limit, self._noise_known = None, True
        if self._limit is None:
            # whole grey levels, as the rise has: comparing bytes is four times faster
            self._limit = np.ceil(np.minimum(255.0, self._noise + _NOISE_DEVIATIONS * self._deviation)).astype(np.uint8)
        return cv2.compare(maxima, cv2.max(self._limit, math.ceil(least)), cv2.CMP_GE) > 0

    def learn(self, image: np.ndarray, rise: np.ndarray, changed: np.ndarray, spots: np.ndarray, hold_s: float, dt: float) -> None:
        """Adds a frame.

        Args:
            rise: (rows, columns) of the blocks.
            changed, spots: (rows, columns) bool; blocks that changed, and blocks that show a spot.
            hold_s: [s] how long a spot may shine in the same place before it counts as a lamp.
            dt: [s] since the last frame.
        """
        dt32 = np.float32(dt)
        self._held_s = cv2.max(self._held_s + (spots * np.float32(2.0 * dt) - dt32), 0.0)
        held = spots & (self._held_s < hold_s)
        steady = ~(changed | held)
        self._changed_s = (self._changed_s + dt32) * ~(steady | held)
        self._noise_s += dt
        if self._noise_s >= _NOISE_TIME / 8:
            # noise changes slowly: not updated with each image
            weight, mask = 1.0 - math.exp(-self._noise_s / _NOISE_TIME), steady.view(np.uint8)
            values = rise.astype(np.float32)
            cv2.accumulateWeighted(values, self._noise, weight, mask)
            cv2.accumulateWeighted(cv2.absdiff(values, self._noise), self._deviation, weight, mask)
            self._noise_s, self._limit = 0.0, None
        absorbed = self._changed_s > (min(_ABSORB_S, _ABSORB_MOVING * dt) if self.moved else _ABSORB_S)
        self._changed_s[absorbed] = 0.0
        if self.moved:
            # all at once: what is moved again and again would blur
            self._take(image, steady | absorbed, 1.0)
            return
        if absorbed.any():
            self._take(image, absorbed, 1.0)
        first, self._strip = self._strip, self._strip + min(1.0, dt / _CYCLE_S)
        self._take(image, steady, _WEIGHT, *(int(round(min(1.0, part) * len(steady))) for part in (first, self._strip)))
        if self._strip >= 1.0:
            self._strip = 0.0

    def _take(self, image: np.ndarray, blocks: np.ndarray, weight: float, first: int = 0, last: Optional[int] = None) -> None:
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


def _shifted(background: np.ndarray, motion: np.ndarray, image: np.ndarray) -> np.ndarray:
    """The background as the camera sees it now, each tile moved by whole pixels; the image where nothing was in view.

    A warp takes five times as long.
    """
    result, (height, width) = image.copy(), image.shape[:2]
    corners = np.array([(x, y) for y in range(0, height, _TILE) for x in range(0, width, _TILE)])
    middles = corners[None] + 0.5 * _TILE
    # numpy's inverse starts threads
    shifts = np.rint(cv2.perspectiveTransform(middles, cv2.invert(motion)[1]) - middles)[0].astype(int)
    for (x, y), (across, down) in zip(corners.tolist(), shifts.tolist()):
        left, right = max(x, -across), min(x + _TILE, width, width - across)
        top, bottom = max(y, -down), min(y + _TILE, height, height - down)
        if left < right and top < bottom:
            result[top:bottom, left:right] = background[top + down : bottom + down, left + across : right + across]
    return result
