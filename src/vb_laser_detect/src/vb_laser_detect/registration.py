"""How a camera moved between two images: what stands still in the room tells it.

Corners of a reference image are followed into the next image (sparse optical flow), and most of them agree on one
motion; what moves by itself, people and the laser spot, does not agree and is left out (RANSAC).
"""
from __future__ import annotations

from typing import Optional, Tuple

import cv2
import numpy as np

_WIDTH = 320  # [px] of the images in which corners are followed
_CORNERS, _FEWEST = 120, 12  # looked for; needed to know a motion
_AGREE_PX = 0.7  # [px of the small image] corners that are farther off do not agree
_SHARE = 0.35  # of the corners have to agree
_DIFFERS = 10  # [grey levels] a pixel of the small image differs
_STILL_PX = 0.35  # [px] no place of the image moved farther: the camera stands still


class Registration:
    """Motion of the images of one camera against a reference image, the last one that was taken as such."""

    def __init__(self) -> None:
        self._reference: Optional[np.ndarray] = None
        self._latest: Optional[np.ndarray] = None
        self._corners: Optional[np.ndarray] = None
        self._scale = (1.0, 1.0)

    def motion_to(self, image: np.ndarray) -> Optional[np.ndarray]:
        """(3, 3) maps pixels of the reference image to those of this one; None if it cannot be told.

        Args:
            image: (H, W) or (H, W, 3) uint8. The first one becomes the reference.
        """
        height, width = image.shape[:2]
        small = (min(width, _WIDTH), max(1, round(height * min(width, _WIDTH) / width)))
        # the mean over an area makes a grey image of a Bayer mosaic too
        grey = cv2.resize(image, small, interpolation=cv2.INTER_AREA)
        self._latest = grey if grey.ndim == 2 else cv2.cvtColor(grey, cv2.COLOR_BGR2GRAY)
        if self._reference is None or self._reference.shape != self._latest.shape:
            self.take()
            return np.eye(3)
        self._scale = (small[0] / width, small[1] / height)
        return self._follow()

    def take(self) -> None:
        """The image that was looked at last becomes the reference."""
        self._reference = self._latest
        self._corners = cv2.goodFeaturesToTrack(self._reference, _CORNERS, 0.01, 7)

    def stands(self, motion: np.ndarray, shape: Tuple[int, ...]) -> bool:
        """Whether a motion leaves every pixel of an image of this shape where it was."""
        corners = np.array([[(0, 0), (shape[1], 0), (0, shape[0]), (shape[1], shape[0])]], float)
        moved = cv2.perspectiveTransform(corners, motion)
        return float(np.abs(moved - corners).max()) < _STILL_PX

    def _follow(self) -> Optional[np.ndarray]:
        if self._corners is None or len(self._corners) < _FEWEST:
            return None
        found, good, _ = cv2.calcOpticalFlowPyrLK(
            self._reference, self._latest, self._corners, None, winSize=(15, 15), maxLevel=3,
            criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 12, 0.02), minEigThreshold=1e-3)
        good = good.ravel() > 0
        before, after = self._corners[good], found[good]
        if len(before) < _FEWEST:
            return None
        motion, agree = cv2.estimateAffinePartial2D(
            before, after, method=cv2.RANSAC, ransacReprojThreshold=_AGREE_PX, maxIters=200, confidence=0.99)
        if motion is None:
            return None
        motion, count = np.vstack([motion, (0, 0, 1)]), int(agree.sum())
        if count < 0.85 * len(before) and len(before) >= 2 * _FEWEST:
            # a floor seen at a slant: where the camera drives, near places move farther than far ones
            plane, agree = cv2.findHomography(before, after, cv2.RANSAC, _AGREE_PX, maxIters=200, confidence=0.99)
            if plane is not None and agree.sum() > 1.15 * count:
                motion, count = plane, int(agree.sum())
        if count < max(_FEWEST, _SHARE * len(before)) or not self._explains(motion):
            return None
        (sx, sy) = self._scale
        shrink = np.array([[sx, 0, 0.5 * sx - 0.5], [0, sy, 0.5 * sy - 0.5], [0, 0, 1.0]])
        # numpy's inverse starts threads
        return cv2.invert(shrink)[1] @ motion @ shrink

    def _explains(self, motion: np.ndarray) -> bool:
        """Whether the images differ less after the motion than before: things that move together are no camera."""
        size = self._latest.shape[::-1]
        moved = cv2.warpPerspective(self._reference, motion, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        after, before = (cv2.countNonZero(cv2.compare(cv2.absdiff(picture, self._latest), _DIFFERS, cv2.CMP_GT))
                         for picture in (moved, self._reference))
        return after <= before
