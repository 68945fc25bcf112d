"""Estimates how a moving camera has moved between images.

A single motion leads from the keyframe to each image, so that nothing is resampled twice and no error accumulates. As it
may be off by a pixel, light within a pixel of light in the keyframe counts as old.
"""

from __future__ import annotations

from typing import Optional

import cv2
import numpy as np

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
