"""Estimates how a camera moved since a keyframe, from what is stationary in the room.

Corners of the keyframe are followed into each image (sparse optical flow), and most of them agree on one motion; what
moves by itself, people and the laser spot, does not agree and is left out (RANSAC).
"""

from __future__ import annotations

from typing import Optional

import cv2
import numpy as np

_WIDTH = 240  # [px] at least, of the images in which corners are followed
_CORNERS, _FEWEST = 48, 12  # looked for; needed to know a motion
_AGREE_PX = 0.7  # [px of the small image] corners that are farther off do not agree
_SHARE = 0.35  # of the corners have to agree
_STILL_PX = 0.35  # [px] no place of the image moved farther: the camera is stationary
_FLOW = dict(
    winSize=(11, 11),
    maxLevel=2,
    criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 12, 0.02),
    flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
)


class ImageRegistration:
    """Motion of one camera's images since a keyframe: shift, turn and scale, which for some images describe any."""

    def __init__(self) -> None:
        self._keyframe: Optional[np.ndarray] = None
        self._latest: Optional[np.ndarray] = None
        self._corners: Optional[np.ndarray] = None
        self._motion = np.eye(3)  # since the keyframe

    def motion_to(self, image: np.ndarray) -> Optional[np.ndarray]:
        """Estimates the motion (3, 3) from pixels of the keyframe to those of this image; None if it is not known.

        The first image is a keyframe.

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
        still = np.abs(cv2.perspectiveTransform(corners, motion) - corners).max() < _STILL_PX
        return np.eye(3) if still else motion

    def set_keyframe(self) -> None:
        """Makes the last image the keyframe."""
        self._keyframe = self._latest
        # where exactly a corner is does not matter
        half = cv2.resize(self._latest, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        found = cv2.goodFeaturesToTrack(half, _CORNERS, 0.01, 4)
        self._corners = np.zeros((0, 1, 2), np.float32) if found is None else 2.0 * found + np.float32(0.5)
        self._motion = np.eye(3)

    def _follow(self) -> Optional[np.ndarray]:
        """Finds the motion since the keyframe on which most corners agree; None if too few do."""
        if len(self._corners) < _FEWEST:
            return None
        ahead = cv2.perspectiveTransform(self._corners, self._motion)
        found, good, _ = cv2.calcOpticalFlowPyrLK(self._keyframe, self._latest, self._corners, ahead, **_FLOW)
        good = good.ravel() > 0
        if good.sum() < _FEWEST:
            return None
        # RANSAC, by default
        motion, agree = cv2.estimateAffinePartial2D(self._corners[good], found[good], ransacReprojThreshold=_AGREE_PX)
        if motion is None or agree.sum() < max(_FEWEST, _SHARE * good.sum()):
            return None
        self._motion = np.vstack([motion, (0.0, 0.0, 1.0)])
        return self._motion
