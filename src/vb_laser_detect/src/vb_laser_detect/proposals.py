"""Regions worth examining: what became brighter than the scene was, for every camera.

One idea: a moving camera is a stationary one over a background that moves along. The background is updated
slowly, and never from a spot; `registration` estimates a robot camera's motion, and the background is warped by
it before the image is compared. In the first image of a scene, when nothing is known of the floor, the median of each
place's surroundings replaces it; what shines there may be a lamp, and only its motion can tell (`tracking`).
"""
from __future__ import annotations

from typing import List, NamedTuple, Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_laser_detect.background import Background
from vb_laser_detect.blocks import BLOCK, Region, block_maxima, blocks_around, max_channel, regions
from vb_laser_detect.features import Surroundings
from vb_laser_detect.registration import Registration
from vb_laser_detect.tracking import Expected

LARGE = 14  # [blocks] regions that are larger are cut down to their brightest parts
_NEAR = 6  # [blocks] whose changes count as nearby
_LEAST_LEVEL = 0.74  # of the camera's white: a spot saturates, unless it is smaller than a pixel
_SATURATED = 0.97
_MAX_CHANGE = 0.3  # of the image became brighter, or twice as much darker: a light, nothing known holds any more
_MAX_CHANGE_LOST = 0.12  # the same, for a moving camera whose motion is not known
_LOCAL_RISE = 30.0  # [grey levels] over the median of the neighbouring blocks


class Proposal(NamedTuple):
    """A region [px] to examine; which expected spot may be in it, and in which part; why it is not examined."""

    region: Region
    expected: Optional[Expected] = None
    part: Optional[Region] = None
    refusal: str = ""


class View(NamedTuple):
    """An image, and what is known of the scene.

    Attributes:
        reference: what the image would show without a spot, the same shape.
        proposals: the most promising first.
        hot, changed: (rows, columns) bool, blocks that became brighter; and those, or darker.
        known: False in the first image of a scene: the reference is a guess.
        moved: the camera moved since the last image.
        white: [grey levels] the brightest value of this image where it was examined.
    """

    image: np.ndarray
    reference: np.ndarray
    proposals: Tuple[Proposal, ...]
    hot: np.ndarray
    changed: np.ndarray
    known: bool
    moved: bool
    white: float

    def around(self, u: float, v: float, diameter: float) -> Surroundings:
        """What else changed, apart from a blob and its own light."""
        own = blocks_around(self.hot.shape, u, v, 1.25 * diameter + BLOCK)
        near = blocks_around(self.hot.shape, u, v, _NEAR * BLOCK)
        busy = np.count_nonzero(self.changed) - np.count_nonzero(self.changed[own])
        return Surroundings(busy / self.hot.size, np.count_nonzero(self.hot[near]) - np.count_nonzero(self.hot[own]))


class Proposer:
    """Keeps the background of one camera.

    Args:
        moving: whether the camera may move; then its motion is found in the images.
        hold_s: [s] how long a spot may shine in one place before it counts as a lamp.
    """

    def __init__(self, moving: bool, hold_s: float) -> None:
        self._registration = Registration() if moving else None
        self._hold_s = hold_s
        self._background: Optional[Background] = None
        self._noise_known = False
        self._fresh = False

    def retune(self, hold_s: float) -> None:
        """Changes that time."""
        self._hold_s = hold_s
        if self._background is not None:
            self._background.hold_s = hold_s

    def motion(self, image: np.ndarray, mosaic: bool) -> Optional[np.ndarray]:
        """(3, 3) how the camera moved since the last image; None if it was stationary. Call it before `look`."""
        background, self._lost, self._fresh = self._background, False, False
        motion = np.eye(3) if self._registration is None else self._registration.motion_to(image)
        if background is None or background.image.shape != image.shape:
            self._start(image)
            return None
        self._lost = motion is None
        stands = self._lost or np.array_equal(motion, np.eye(3))
        if self._registration is not None:
            background.move(None if stands else motion, image, mosaic)
        return None if stands else motion

    def look(self, image: np.ndarray, mosaic: bool, min_rise: float, most: int, white: float,
             expected: Sequence[Expected]) -> View:
        """Compares an image with the background.

        Args:
            mosaic: whether it is a Bayer camera's.
            min_rise: [grey levels] of a block to be examined.
            most: regions, twice as many where some are small.
            white: [grey levels] the brightest that the camera has shown.
            expected: where spots should be.
        """
        background = self._background
        if not self._fresh:
            rise = background.rise(image)
            if not self._noise_known:
                background.learn_noise(rise)
                self._noise_known = True
            hot, darker = background.hot_blocks(rise, min_rise), background.darker_blocks(image)
            limit = _MAX_CHANGE_LOST if self._lost else _MAX_CHANGE
            if max(np.count_nonzero(hot), 0.5 * np.count_nonzero(darker)) <= limit * hot.size:
                found = regions(rise, hot, 4 * most, LARGE) if hot.any() else []
                proposals, brightest = _ranked(image, found, most, white, expected)
                background.refine([one.region for one in proposals if not one.refusal], image)
                self._rise = rise
                return View(image, background.reference, proposals, hot, hot | darker, True, background.moved, brightest)
            # a person close to the camera darkens much of the image too, and must not become its background
            self._start(image)
            if self._registration is not None:
                self._registration.take()
        return self._first(image, mosaic, most, white, expected)

    def learn(self, view: View, spots: Sequence[Tuple[float, float, float]], elapsed: float) -> None:
        """Adds an image, except the blobs (u, v, diameter) [px] of spots.

        Args:
            elapsed: [s] since the last image.
        """
        if not view.known:
            for u, v, diameter in spots:
                self._background.guess(view.reference, u, v, diameter)
            return
        held = np.zeros_like(view.hot)
        for u, v, diameter in spots:
            held[blocks_around(held.shape, u, v, 1.25 * diameter + BLOCK)] = True
        self._background.learn(view.image, self._rise, view.changed, held, elapsed)

    def proven(self, u: float, v: float) -> bool:
        """Whether the floor at a pixel was seen without what shines there now."""
        return not self._fresh and not self._background.is_guessed(u, v)

    def _start(self, image: np.ndarray) -> None:
        self._background, self._noise_known, self._fresh = Background(image, self._hold_s), False, True

    def _first(self, image: np.ndarray, mosaic: bool, most: int, white: float, expected: Sequence[Expected]) -> View:
        """The first image of an unknown scene: a robot's everywhere, else where spots should be."""
        maxima = block_maxima(image)
        # each channel by itself: a bright floor leaves a red spot hardly any room in red, its core rises in the others
        rise = max_channel(cv2.subtract(maxima, cv2.medianBlur(maxima, 7)))
        top = max_channel(maxima)
        brightest = float(top.max())
        hot = (rise >= _LOCAL_RISE) & (top >= _LEAST_LEVEL * max(white, brightest))
        if self._registration is None:
            everywhere, hot = hot, np.zeros_like(hot)
            for one in expected:
                within = blocks_around(hot.shape, one.u, one.v, one.reach)
                hot[within] = everywhere[within]
        found = regions(rise, hot, most, LARGE) if hot.any() else []
        reference = image.copy()
        for (left, upper, right, lower), _ in found:
            reach = int(max(24, 1.5 * max(right - left, lower - upper)))
            # even bounds keep each pixel's place in a Bayer image's pattern
            x0, y0 = max(0, left - reach) & ~1, max(0, upper - reach) & ~1
            _fill(image[y0 : lower + reach, x0 : right + reach], reference[y0 : lower + reach, x0 : right + reach],
                  2 * reach - 7, mosaic)
        proposals, brightest = _ranked(image, found, most, max(white, brightest), expected)
        return View(image, reference, proposals, hot, hot, False, False, brightest)


def _fill(window: np.ndarray, floor: np.ndarray, width: int, mosaic: bool) -> None:
    """Puts the median of each place's surroundings, this wide [px], into `floor`; a mosaic's places have their own."""
    # a median removes the spot and keeps the edges of carpets, next to which spots are drawn
    if not mosaic:
        floor[:] = cv2.medianBlur(np.ascontiguousarray(window), min(width, 255))
        return
    for place in range(4):
        part = (slice(place // 2, None, 2), slice(place % 2, None, 2))
        floor[part] = cv2.medianBlur(np.ascontiguousarray(window[part]), min(width // 2 | 1, 255))


def _ranked(
    image: np.ndarray, found: List[Tuple[Region, float]], most: int, white: float, expected: Sequence[Expected]
) -> Tuple[Tuple[Proposal, ...], float]:
    """Proposals of regions with their rise, and the brightest value in them [grey levels].

    Those where a spot is expected come first. A spot shows the camera's white wherever it falls; by how much it rises
    depends on the floor, and on a bright one a person beside it rises more. So white regions come next, among them those
    that rose most.
    """
    rated = []
    for region, peak in found:
        left, top, right, bottom = region
        part = image[top:bottom, left:right]
        # columns and channels side by side: the brightest sample is all that counts
        rated.append((region, float(cv2.minMaxLoc(part.reshape(part.shape[0], -1))[1]), peak))
    brightest = max([white] + [level for _, level, _ in rated])
    rated.sort(key=lambda one: (-min(one[1], _SATURATED * brightest), -one[2]))
    first, others, dark = [], [], []
    # most of what a person's clothes leave is found too large at once, and must not use up all places
    for region, level, _ in rated[: 2 * most]:
        part, spot = _part_of(region, expected)
        if level < _LEAST_LEVEL * brightest:
            dark.append(Proposal(region, refusal="too_dark"))
        elif part is not None:
            first.append(Proposal(region, spot, part))
        else:
            others.append(Proposal(region))
    first.sort(key=lambda one: not one.expected.published)
    return tuple(first + others + dark), brightest


def _part_of(region: Region, expected: Sequence[Expected]) -> Tuple[Optional[Region], Optional[Expected]]:
    """The part of a region where a spot is expected, and which; None if none is."""
    for one in expected:
        left, top = max(region[0], int(one.u - one.reach)), max(region[1], int(one.v - one.reach))
        right, bottom = min(region[2], int(one.u + one.reach) + 1), min(region[3], int(one.v + one.reach) + 1)
        if left < right and top < bottom:
            return (left, top, right, bottom), one
    return None, None
