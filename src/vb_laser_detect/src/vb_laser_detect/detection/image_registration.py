"""Estimates how a camera moved since a keyframe, from what is stationary in the room.

Corners of the keyframe are followed into each image (sparse optical flow), and most of them agree on one motion; what
moves by itself, people and the laser spot, does not agree and is left out (RANSAC).
"""

from __future__ import annotations

from typing import Optional

import cv2
import numpy as np

from vb_laser_detect.detection.blocks import halve

_WIDTH = 240  # [px] at least, of the images in which corners are followed
_CORNERS, _FEWEST = 48, 12  # looked for; needed to know a motion
_AGREE_PX = 0.7  # [px of the small image] corners that are farther off do not agree
_SHARE = 0.35  # of the corners have to agree
_MORE = 1.15  # times as many must agree on a homography: with twice the freedom it explains some by chance
_STILL_PX = 0.35  # [px] no place of the image moved farther: the camera is stationary
_FLOW = dict(
    winSize=(11, 11),
    maxLevel=2,
    criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 12, 0.02),
    flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
)


class ImageRegistration:
    """Motion of one camera's images since a keyframe."""

    def __init__(self) -> None:
        self._keyframe: Optional[np.ndarray] = None
        self._latest: Optional[np.ndarray] = None
        self._corners: Optional[np.ndarray] = None
        self._motion = self._step = np.eye(3)  # since the keyframe, and since the image before the last

    def motion_to(self, image: np.ndarray, half: np.ndarray) -> Optional[np.ndarray]:
        """Estimates the motion (3, 3) from pixels of the keyframe to those of this image; None if it is not known.

        The first image is a keyframe.

        Args:
            image: (H, W) or (H, W, 3) uint8.
            half: the same at half size.
        """
        gray, scale = (half, 0.5) if half.shape[1] >= _WIDTH else (image, 1.0)
        while gray.shape[1] >= 2 * _WIDTH:
            gray, scale = halve(gray), 0.5 * scale
        self._latest = gray if gray.ndim == 2 else cv2.cvtColor(gray, cv2.COLOR_BGR2GRAY)
        if self._keyframe is None or self._keyframe.shape != self._latest.shape:
            self.set_keyframe()
            return np.eye(3)
        motion = self._follow()
        if motion is None:
            return None
        shrink = np.array([[scale, 0, 0.5 * scale - 0.5], [0, scale, 0.5 * scale - 0.5], [0, 0, 1.0]])
        # numpy's inverse starts threads
        return cv2.invert(shrink)[1] @ motion @ shrink

    def set_keyframe(self) -> None:
        """Makes the last image the keyframe."""
        self._keyframe = self._latest
        # where exactly a corner is does not matter
        half = cv2.resize(self._latest, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        found = cv2.goodFeaturesToTrack(half, _CORNERS, 0.01, 4)
        self._corners = np.zeros((0, 1, 2), np.float32) if found is None else 2.0 * found + np.float32(0.5)
        self._motion = np.eye(3)

    def _follow(self) -> Optional[np.ndarray]:
        """Finds the motion since the keyframe, first where it leads on as before."""
        if len(self._corners) < _FEWEST:
            return None
        ahead = cv2.perspectiveTransform(self._corners, self._step @ self._motion)
        found, good, _ = cv2.calcOpticalFlowPyrLK(self._keyframe, self._latest, self._corners, ahead, **_FLOW)
        good = good.ravel() > 0
        before, after = self._corners[good], found[good]
        motion = _agreed_motion(before, after) if len(before) >= _FEWEST else None
        if motion is None:
            self._step = np.eye(3)
            return None
        self._step, self._motion = motion @ cv2.invert(self._motion)[1], motion
        return motion


def _agreed_motion(before: np.ndarray, after: np.ndarray) -> Optional[np.ndarray]:
    """Returns the motion (3, 3) that most corners (N, 1, 2) agree on; None if too few do."""
    motion, agree = cv2.estimateAffinePartial2D(
        before, after, method=cv2.RANSAC, ransacReprojThreshold=_AGREE_PX, maxIters=200, confidence=0.99
    )
    if motion is None:
        return None
    motion, count = np.vstack([motion, (0, 0, 1)]), int(agree.sum())
    if _MORE * count < len(before) and len(before) >= 2 * _FEWEST:
        # a floor seen at a slant: where the camera drives, near places move farther than far ones
        plane, of_plane = cv2.findHomography(before, after, cv2.RANSAC, _AGREE_PX, maxIters=200, confidence=0.99)
        if plane is not None and of_plane.sum() > _MORE * count:
            motion, count = plane, int(of_plane.sum())
    return motion if count >= max(_FEWEST, _SHARE * len(before)) else None


def is_still(motion: np.ndarray, shape: tuple) -> bool:
    """Returns whether a motion moves no place of an image of this shape."""
    corners = np.array([[(0, 0), (shape[1], 0), (0, shape[0]), (shape[1], shape[0])]], float)
    return bool(np.abs(cv2.perspectiveTransform(corners, motion) - corners).max() < _STILL_PX)
