"""Finds image regions that are brighter than the background; they are the candidates for a spot.

`ImageRegistration` estimates a single motion from a moving camera's keyframe to each image, so that nothing is resampled
twice and no error accumulates. As it may be off by a pixel, light within a pixel of light in the keyframe counts as old.
"""

from __future__ import annotations

import math
from typing import List, Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_core.image_format import AnyPicture
from vb_laser_detect.detection.background import Background
from vb_laser_detect.detection.stage_results import BLOCK, Box, ChangedRegion, ExpectedSpot, SearchedImage

# lowest level of a spot, as a share of `bright_level`: only 3 of 464 known spots are darker, all in darkened clips
_MIN_LEVEL = 0.86
_HALF_LEVEL = 0.8  # a spot of few pixels keeps at least this share of its level in the halved image
_MAX_REGIONS = 24  # walking people cause fewer, and examining more would take longer than an image period
_LARGE = 14  # [blocks] larger regions are cut down to their brightest parts
_WIDTH = 240  # [px] least width of the images in which corners are tracked
_MAX_CORNERS = 48  # corners looked for
_MIN_CORNERS = 12  # corners needed to estimate a motion
_AGREE_PX = 0.7  # [px of the small image] corners that are farther off do not agree
_MIN_AGREEING = 0.35  # least share of corners that must agree
_MIN_MOTION_PX = 0.35  # [px] if no part of the image has moved this far, the camera is stationary
_FLOW_END = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 12, 0.02)
_FLOW = dict(winSize=(11, 11), maxLevel=2, criteria=_FLOW_END, flags=cv2.OPTFLOW_USE_INITIAL_FLOW)


class ImageRegistration:
    """Estimates one camera's motion since a keyframe: shift, rotation and scale, which suffice over a few images.

    Corners of the keyframe are tracked into each image (sparse optical flow), and enough of them agree on one motion.
    Those on people and the laser spot, which move on their own, do not agree and are left out (RANSAC).

    Attributes:
        motion: (3, 3) from the keyframe's pixels to the last image's; None if the camera has not moved. While it cannot
            be estimated, the last one stays.
    """

    def __init__(self) -> None:
        self._keyframe: Optional[np.ndarray] = None
        self.motion: Optional[np.ndarray] = None

    def follow(self, image: np.ndarray) -> Optional[np.ndarray]:
        """Estimates the motion (3, 3) from the last image's pixels to this one's, or None if it is not known.

        The first image, (H, W) or (H, W, 3) uint8, becomes the keyframe.
        """
        gray, scale = image, 1.0
        while gray.shape[1] >= 2 * _WIDTH:
            height, width = (number // 2 for number in gray.shape[:2])
            gray = cv2.resize(gray[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)
            scale *= 0.5
        self._latest = gray if gray.ndim == 2 else cv2.cvtColor(gray, cv2.COLOR_BGR2GRAY)
        if self._keyframe is None:
            self.set_keyframe()
        motion_before = self.motion
        motion = self._track_corners()
        if motion is None:
            return None
        shrink = np.array([[scale, 0, 0.5 * scale - 0.5], [0, scale, 0.5 * scale - 0.5], [0, 0, 1.0]])
        # numpy's inverse starts threads
        motion = cv2.invert(shrink)[1] @ motion @ shrink
        height, width = image.shape[:2]
        corners = np.array([[(0, 0), (width, 0), (0, height), (width, height)]], float)
        is_still = np.abs(cv2.perspectiveTransform(corners, motion) - corners).max() < _MIN_MOTION_PX
        self.motion = None if is_still else motion
        motion = np.eye(3) if is_still else motion
        return motion if motion_before is None else motion @ cv2.invert(motion_before)[1]

    def set_keyframe(self) -> None:
        """Makes the last image the keyframe."""
        self._keyframe = self._latest
        # the exact position of a corner does not matter
        half = cv2.resize(self._latest, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        corners = cv2.goodFeaturesToTrack(half, _MAX_CORNERS, 0.01, 4)
        self._corners = np.zeros((0, 1, 2), np.float32) if corners is None else 2.0 * corners + np.float32(0.5)
        self.motion = None
        self._small_motion = np.eye(3)  # `motion` in pixels of the small images

    def _track_corners(self) -> Optional[np.ndarray]:
        """Finds the motion since the keyframe on which the most corners agree, or None if too few do."""
        if len(self._corners) < _MIN_CORNERS:
            return None
        guess = cv2.perspectiveTransform(self._corners, self._small_motion)
        points, good, _ = cv2.calcOpticalFlowPyrLK(self._keyframe, self._latest, self._corners, guess, **_FLOW)
        good = good.ravel() > 0
        if good.sum() < _MIN_CORNERS:
            return None
        # RANSAC, by default
        motion, agree = cv2.estimateAffinePartial2D(self._corners[good], points[good], ransacReprojThreshold=_AGREE_PX)
        if motion is None or agree.sum() < max(_MIN_CORNERS, _MIN_AGREEING * good.sum()):
            return None
        self._small_motion = np.vstack([motion, (0.0, 0.0, 1.0)])
        return self._small_motion


class RegionProposer:
    """Finds regions in one camera's images that are new in its background. Estimates its motion if it may move."""

    def __init__(self, background: Background, moving_camera: bool) -> None:
        self._background = background
        self._registration = ImageRegistration() if moving_camera else None

    def propose(self, picture: AnyPicture, expected: Sequence[ExpectedSpot]) -> SearchedImage:
        """Compares a picture with the background. The spots are `expected` there if the camera has not moved."""
        image = picture.search_pixels
        background = self._background
        motion = shift = None
        if self._registration is not None:
            if background.is_keyframe:
                self._registration.set_keyframe()
            motion = self._registration.follow(image)
            shift = self._registration.motion
        if motion is not None:
            expected = [move_spot(spot, motion) for spot in expected]
        changes = background.compare(picture, shift, expected)
        min_level = _MIN_LEVEL * background.bright_level
        # the brightest first: a spot is white on any floor, but on a bright floor a person next to it rises more
        boxes = sorted(find_regions(changes.rise, changes.brighter), key=lambda box: -_max_in_box(image, box))
        regions = [_region(picture, box, min_level, expected) for box in boxes[:_MAX_REGIONS]]
        return SearchedImage(
            picture,
            diagonal=math.hypot(*picture.size),
            bright_level=background.bright_level,
            min_level=min_level,
            regions=regions,
            reference=background.reference,
            motion=motion,
            shifted=background.motion is not None,
            changed=changes.brighter | changes.darker,
            ghost_s=background.ghost_s,
        )


def move_spot(spot: ExpectedSpot, motion: np.ndarray) -> ExpectedSpot:
    """Returns the spot expected after the camera's motion (3, 3) has moved the image."""
    return spot._replace(last=cv2.perspectiveTransform(np.array([[spot.last]]), motion)[0, 0].tolist())


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
        part = part_within_reach(spot, box)
        if part is not None:
            return ChangedRegion(box, [box, part] if level >= min_level else [], spot)
    return ChangedRegion(box, [box] if level >= min_level else [], None)


def part_within_reach(spot: ExpectedSpot, box: Box) -> Optional[Box]:
    """Returns the part of a box that is within an expected spot's reach, or None if no part is."""
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


def find_regions(maxima: np.ndarray, hot: np.ndarray) -> List[Box]:
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
