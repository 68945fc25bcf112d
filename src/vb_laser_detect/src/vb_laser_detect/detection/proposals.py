"""Proposes regions to examine: those that became brighter than the scene was.

Any camera's background is a keyframe, which never includes a spot. Each image is compared with it: a moving camera's
through a single motion from the keyframe to the image (`ImageRegistration` estimates it), so that nothing is resampled
twice and no error accumulates. Once a second, an image is averaged into a stationary camera's keyframe, except where it
shows a spot or has just changed; every few images, one replaces a moving camera's, except where it shows a spot.
Light within one pixel of light in the keyframe is not new: the motion is known no better than that.

The first image of a scene is its background: a light in it may be a lamp, and only its motion can tell. When a light is
switched, the floor under a tracked spot is known from the old background, which is relit.
"""

from __future__ import annotations

import math
from typing import Dict, List, NamedTuple, Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_core.image_format import AnyPicture
from vb_laser_detect.detection.background import BLOCK, GHOST_TIME, Background, Region, relight
from vb_laser_detect.detection.tracking import Expected, Spot

_MIN_CHANGE = 0.15  # of what is bright in the room; smaller differences become part of the background
_HALF_LEVEL = 0.8  # a spot of few pixels keeps at least this share of its level in the halved image
_MIN_BUSY = 0.02  # from this value of `busy` on, ghosts may be left
_UNSEEN = 1.0  # [s] between two images: long enough for a hand to take something away
_MAX_REGIONS = 24  # walking people cause fewer, and examining more would take longer than an image period
_LARGE = 14  # [blocks] regions that are larger are cut down to their brightest parts
_MAX_CHANGE = 0.15  # of the image brighter, or twice as much darker: the light was switched, a new background begins
_WIDTH = 240  # [px] at least, of the images in which corners are tracked
_MAX_CORNERS, _MIN_CORNERS = 48, 12  # looked for; needed to estimate a motion
_AGREE_PX = 0.7  # [px of the small image] corners that are farther off do not agree
_MIN_AGREEING = 0.35  # of the corners must agree
_MIN_MOTION_PX = 0.35  # [px] if no part of the image has moved this far, the camera is stationary
_FLOW = dict(
    winSize=(11, 11),
    maxLevel=2,
    criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 12, 0.02),
    flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
)


class SearchedImage(NamedTuple):
    """An image, and what is known of the scene. Positions and regions are in the picture's own pixels, even if halved.

    Attributes:
        background: what the picture is compared with.
        regions: to examine, the brightest first.
        rise: (rows, columns) uint8, of each block.
        changed: (rows, columns) bool, blocks that became brighter or darker.
        recently_changed: (rows, columns) bool, blocks that anything but a spot changed so recently that it may have
            left a ghost there.
    """

    picture: AnyPicture
    background: Background
    regions: Sequence[Region]
    rise: np.ndarray
    changed: np.ndarray
    recently_changed: np.ndarray

    @property
    def block_px(self) -> int:
        """Edge of a block [px]."""
        return BLOCK * self.picture.scale

    def brightest(self, region: Region) -> float:
        """Returns the brightest sample [grey levels] of a region; an upper bound while only the half is decoded."""
        if self.picture.whole:
            return brightest(self.picture.pixels, region)
        return brightest(self.picture.searched, tuple(side // self.picture.scale for side in region)) / _HALF_LEVEL

    def surroundings(self, u: float, v: float, diameter: float) -> Dict[str, float]:
        """Returns the features that a blob's surroundings determine, by the names of `features.FEATURES`.

        "busy" is how much else changed in the image, apart from the blob and its own light. "edge" is NaN where the
        blob cannot be a ghost (the trace of an object that moved away): the camera is stationary, little else changes,
        and nothing passed by recently. A real spot on the edge of a white sheet could otherwise look like a ghost.
        """
        reach = 1.25 * diameter + self.block_px
        own, around = (blocks_around(self.changed.shape, u, v, size, self.block_px) for size in (reach, 2.0 * reach))
        elsewhere = np.count_nonzero(self.changed) - np.count_nonzero(self.changed[own])
        busy = math.sqrt(elsewhere / self.changed.size)
        passed = np.count_nonzero(self.recently_changed[around]) > np.count_nonzero(self.recently_changed[own])
        may_be_ghost = busy >= _MIN_BUSY or passed or self.background.motion is not None
        return {"busy": busy} if may_be_ghost else {"busy": busy, "edge": math.nan}


class ImageRegistration:
    """Estimates one camera's motion since a keyframe: shift, rotation and scale, which suffice over a few images.

    Corners of the keyframe are tracked into each image (sparse optical flow), and enough of them agree on one motion;
    those on people and the laser spot, which move by themselves, do not agree and are left out (RANSAC).
    """

    def __init__(self) -> None:
        self._keyframe: Optional[np.ndarray] = None
        self._latest: Optional[np.ndarray] = None
        self._corners: Optional[np.ndarray] = None
        self._motion = np.eye(3)  # since the keyframe

    def motion_to(self, image: np.ndarray) -> Optional[np.ndarray]:
        """Estimates the motion (3, 3) from pixels of the keyframe to those of this image; None if it is not known.

        The first image becomes the keyframe.

        Args:
            image: (H, W) or (H, W, 3) uint8.
        """
        gray, scale = image, 1.0
        while gray.shape[1] >= 2 * _WIDTH:
            height, width = (number // 2 for number in gray.shape[:2])
            gray = cv2.resize(gray[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)
            scale *= 0.5
        self._latest = gray if gray.ndim == 2 else cv2.cvtColor(gray, cv2.COLOR_BGR2GRAY)
        if self._keyframe is None:
            self.set_keyframe()
        motion = self._follow()
        if motion is None:
            return None
        shrink = np.array([[scale, 0, 0.5 * scale - 0.5], [0, scale, 0.5 * scale - 0.5], [0, 0, 1.0]])
        # numpy's inverse starts threads
        motion = cv2.invert(shrink)[1] @ motion @ shrink
        height, width = image.shape[:2]
        corners = np.array([[(0, 0), (width, 0), (0, height), (width, height)]], float)
        still = np.abs(cv2.perspectiveTransform(corners, motion) - corners).max() < _MIN_MOTION_PX
        return np.eye(3) if still else motion

    def set_keyframe(self) -> None:
        """Makes the last image the keyframe."""
        self._keyframe = self._latest
        # the exact position of a corner does not matter
        half = cv2.resize(self._latest, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        found = cv2.goodFeaturesToTrack(half, _MAX_CORNERS, 0.01, 4)
        self._corners = np.zeros((0, 1, 2), np.float32) if found is None else 2.0 * found + np.float32(0.5)
        self._motion = np.eye(3)

    def _follow(self) -> Optional[np.ndarray]:
        """Finds the motion since the keyframe on which the most corners agree; None if too few do."""
        if len(self._corners) < _MIN_CORNERS:
            return None
        ahead = cv2.perspectiveTransform(self._corners, self._motion)
        found, good, _ = cv2.calcOpticalFlowPyrLK(self._keyframe, self._latest, self._corners, ahead, **_FLOW)
        good = good.ravel() > 0
        if good.sum() < _MIN_CORNERS:
            return None
        # RANSAC, by default
        motion, agree = cv2.estimateAffinePartial2D(self._corners[good], found[good], ransacReprojThreshold=_AGREE_PX)
        if motion is None or agree.sum() < max(_MIN_CORNERS, _MIN_AGREEING * good.sum()):
            return None
        self._motion = np.vstack([motion, (0.0, 0.0, 1.0)])
        return self._motion


class Proposer:
    """Finds regions in one camera's images, and keeps its background; estimates the camera's motion if it may move."""

    def __init__(self, moving_camera: bool) -> None:
        self._registration = ImageRegistration() if moving_camera else None
        self._background: Optional[Background] = None
        self._motion = np.eye(3)  # from the background's pixels to the last image's

    def estimate_motion(self, image: np.ndarray) -> Optional[np.ndarray]:
        """Estimates the camera's motion (3, 3) since the last image; None if unknown. Call it before `propose`."""
        if self._registration is None:
            return None
        found, before = self._registration.motion_to(image), self._motion
        # while the motion is unknown, the camera is taken to be where it was
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
            banded = self._background.subtract_bands(image) if still and _is_global_change(hot, darker) else None
            if banded is not None:
                rise, hot, darker = self._changes(*banded)
        if self._background is None or _is_global_change(hot, darker):
            self._start(picture, expected)
            rise, fall = self._background.subtract_background(image, None)
            hot, darker = rise >= self._least_change, fall > self._least_change
        # the brightest first: a spot is white on any floor, but its rise depends on the floor, and a person beside it
        # rises more on a bright one
        regions = sorted(find_regions(rise, hot), key=lambda region: -brightest(image, region))[:_MAX_REGIONS]
        regions = [_in_picture(region, picture) for region in regions]
        return SearchedImage(picture, self._background, regions, rise, hot | darker, self._recent_change_s > 0.0)

    def _changes(self, rise: np.ndarray, fall: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns the blocks' rise, which of them rose above the noise, and which became darker (bool)."""
        least = self._least_change
        return rise, self._background.foreground_blocks(rise, least), fall > least

    def _start(self, picture: AnyPicture, expected: Sequence[Expected]) -> None:
        """Begins a new background; where a spot is expected, the previous one is used, relit."""
        block, before = BLOCK * picture.scale, self._background
        keyframes = [picture.searched.copy()] + ([picture.pixels.copy()] if picture.scale > 1 else [])
        for one in expected:
            rows, columns = blocks_around(before.blocks, one.u, one.v, one.reach + one.max_width, block)
            for size, keyframe in zip((picture.scale, 1), keyframes):
                part = tuple(slice(block // size * side.start, block // size * side.stop) for side in (rows, columns))
                if keyframe[part].size:
                    old = before.moved_part(part, keyframe) if keyframe is keyframes[0] else before.whole[part]
                    keyframe[part] = relight(old, keyframe[part], one.max_width / size)
        self._background = Background(*keyframes)
        self._recent_change_s = np.zeros(
            self._background.blocks, np.float32
        )  # [s] for which each block still counts so
        self._begin()

    def _begin(self) -> None:
        """Makes the last image the background's keyframe."""
        self._motion = np.eye(3)
        if self._registration is not None:
            self._registration.set_keyframe()

    @property
    def _least_change(self) -> float:
        """The difference [grey levels] from which on something has changed."""
        return _MIN_CHANGE * self._background.bright

    def update_background(self, searched: SearchedImage, spots: Sequence[Spot], elapsed: float) -> None:
        """Adds an image to the background, except where it shows these spots.

        Args:
            elapsed: [s] since the last image.
        """
        held = np.zeros_like(searched.changed)
        for spot in spots:
            held[
                blocks_around(held.shape, spot.u, spot.v, 1.25 * spot.diameter + searched.block_px, searched.block_px)
            ] = True
        # nothing is known of what happened between images far apart
        moved = (searched.changed & ~held) | (elapsed >= _UNSEEN)
        self._recent_change_s = np.where(moved, GHOST_TIME, self._recent_change_s - elapsed)
        if self._background.update(searched.picture, searched.rise, searched.changed, held, elapsed):
            self._begin()


def _in_picture(region: Region, picture: AnyPicture) -> Region:
    """Converts a region of the searched pixels to the picture's own; the last blocks include the pixels left over."""
    left, top, right, bottom = (picture.scale * side for side in region)
    width, height = picture.size
    block = BLOCK * picture.scale
    return left, top, width if width - right < block else right, height if height - bottom < block else bottom


def _is_global_change(hot: np.ndarray, darker: np.ndarray) -> bool:
    """Returns whether so much changed that the background no longer holds.

    A person close to the camera darkens much of the image too, and must not become its background.
    """
    return max(np.count_nonzero(hot), 0.5 * np.count_nonzero(darker)) > _MAX_CHANGE * hot.size


# ------------------------------------------------------------------ blocks and regions
def brightest(image: np.ndarray, region: Region) -> float:
    """Returns the brightest sample [grey levels] of a region."""
    left, top, right, bottom = region
    # columns and channels side by side
    return cv2.minMaxLoc(image[top:bottom, left:right].reshape(bottom - top, -1))[1]


def blocks_around(shape: Tuple[int, ...], u: float, v: float, reach: float, block: int = BLOCK) -> Tuple[slice, slice]:
    """Returns the rows and columns of a grid (rows, columns) of blocks, `block` wide, within `reach` of a place [px]."""
    top, bottom = int(max(0.0, v - reach)) // block, int(max(-1.0, v + reach)) // block + 1
    left, right = int(max(0.0, u - reach)) // block, int(max(-1.0, u + reach)) // block + 1
    return slice(top, min(shape[0], bottom)), slice(left, min(shape[1], right))


def find_regions(maxima: np.ndarray, hot: np.ndarray) -> List[Region]:
    """Finds regions [px] of connected hot blocks, those with the highest peaks first.

    A large region is cut down to the parts above 60 % of its peak: a spot beside a person must not be lost in the
    person's region.
    """
    # few blocks are hot, and they are close together: only their surroundings are processed
    x, y, wide, high = cv2.boundingRect(hot.view(np.uint8))
    if not wide:
        return []
    hot, maxima = (np.ascontiguousarray(blocks[y : y + high, x : x + wide]) for blocks in (hot, maxima))
    labels, stats, peaks = _components(hot, maxima)
    large = stats[:, 2:4].max(axis=1) > _LARGE
    large[0] = False
    if large.any():
        labels, stats, peaks = _components(hot & ~(large[labels] & (maxima <= 0.6 * peaks[labels])), maxima)
    result = []
    for label in np.argsort(-peaks[1:], kind="stable") + 1:
        left, top, width, height = ((stats[label, :4] + (x, y, 0, 0)) * BLOCK).tolist()
        result.append((left, top, left + width, top + height))
    return result


def _components(hot: np.ndarray, maxima: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns labels (rows, columns), and OpenCV's statistics and the peak of each connected component."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(hot.view(np.uint8), connectivity=8)
    peaks = np.zeros(len(stats))
    np.maximum.at(peaks, labels[hot], maxima[hot])
    return labels, stats, peaks
