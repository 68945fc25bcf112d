"""How a camera moved between two images, judged by what is stationary in the room.

Corners of a reference image are followed into the next image (sparse optical flow), and most of them agree on one
motion; what moves by itself, people and the laser spot, does not agree and is left out (RANSAC). While the camera is
stationary a few corners are enough to see that.
"""
from __future__ import annotations

from typing import Optional, Tuple

import cv2
import numpy as np

_WIDTH = 240  # [px] at least, of the images in which corners are followed
_CORNERS, _FEWEST = 48, 12  # looked for; needed to know a motion
_FEW, _MOST_OF_FEW = 24, 0.75  # corners checked first while the camera is stationary; share that must not have moved
_AGREE_PX = 0.7  # [px of the small image] corners that are farther off do not agree
_SHARE = 0.35  # of the corners have to agree
_DIFFERS = 10  # [grey levels] a pixel differs
_STILL_PX = 0.35  # [px] no place of the image moved farther: the camera is stationary
_FLOW_ENDS = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 12, 0.02)
_HALF = np.diag((0.5, 0.5, 1.0))


class Registration:
    """Motion of the images of one camera since a reference image: the last one in which it had moved."""

    def __init__(self) -> None:
        self._reference: Optional[np.ndarray] = None
        self._latest: Optional[np.ndarray] = None
        self._corners: Optional[np.ndarray] = None
        self._followed: Optional[np.ndarray] = None  # where those of the reference are now that agree
        self._wanted = 0
        self._moved = False

    def motion_to(self, image: np.ndarray) -> Optional[np.ndarray]:
        """(3, 3) maps pixels of the reference image to those of this one: np.eye(3) if none moved; None: unknown.

        An image that shows a motion becomes the reference, as does the first one.

        Args:
            image: (H, W) or (H, W, 3) uint8.
        """
        grey, scale = image, 1.0
        while grey.shape[1] >= 2 * _WIDTH:
            # by halves: any other ratio takes ten times as long
            height, width = grey.shape[0] // 2, grey.shape[1] // 2
            grey, scale = cv2.resize(grey[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA), 0.5 * scale
        self._latest, self._followed = grey if grey.ndim == 2 else cv2.cvtColor(grey, cv2.COLOR_BGR2GRAY), None
        if self._reference is None or self._reference.shape != self._latest.shape:
            self.take()
        elif self._moved or not self._stands():
            motion = self._follow(scale)
            if motion is None:
                return None
            self._moved = _farthest(motion, image.shape) >= _STILL_PX
            if self._moved:
                self.take()
                return motion
        return np.eye(3)

    def take(self) -> None:
        """Makes the last image the reference."""
        self._reference, self._corners = self._latest, self._followed
        if self._corners is None or 3 * len(self._corners) < 2 * self._wanted:
            # where exactly a corner is does not matter
            half = cv2.resize(self._latest, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
            found = cv2.goodFeaturesToTrack(half, _CORNERS, 0.01, 4)
            self._corners = None if found is None else 2.0 * found + np.float32(0.5)
            self._wanted = 0 if found is None else len(found)

    def _stands(self) -> bool:
        if self._corners is None or len(self._corners) < _FEWEST:
            return False
        few = np.ascontiguousarray(self._corners[:: max(1, len(self._corners) // _FEW)])
        found, good, _ = cv2.calcOpticalFlowPyrLK(
            self._reference, self._latest, few, None, winSize=(11, 11), maxLevel=0, criteria=_FLOW_ENDS)
        off = np.abs(found - few).max(axis=(1, 2)) + np.where(good.ravel() > 0, 0.0, np.inf)
        return bool(np.mean(off < 0.5 * _STILL_PX) >= _MOST_OF_FEW)

    def _follow(self, scale: float) -> Optional[np.ndarray]:
        if self._corners is None or len(self._corners) < _FEWEST:
            return None
        found, good, _ = cv2.calcOpticalFlowPyrLK(
            self._reference, self._latest, self._corners, None, winSize=(11, 11), maxLevel=2, criteria=_FLOW_ENDS)
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
            plane, of_plane = cv2.findHomography(before, after, cv2.RANSAC, _AGREE_PX, maxIters=200, confidence=0.99)
            if plane is not None and of_plane.sum() > 1.15 * count:
                motion, agree, count = plane, of_plane, int(of_plane.sum())
        if count < max(_FEWEST, _SHARE * len(before)) or not self._explains(motion):
            return None
        self._followed = after[agree.ravel() > 0]
        shrink = np.array([[scale, 0, 0.5 * scale - 0.5], [0, scale, 0.5 * scale - 0.5], [0, 0, 1.0]])
        # numpy's inverse starts threads
        return cv2.invert(shrink)[1] @ motion @ shrink

    def _explains(self, motion: np.ndarray) -> bool:
        """Whether the images differ less after the motion than before: objects that move together do not count."""
        now, before = (cv2.resize(picture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
                       for picture in (self._latest, self._reference))
        moved = cv2.warpPerspective(before, _HALF @ motion @ np.diag((2.0, 2.0, 1.0)), now.shape[::-1],
                                    flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        differ = [cv2.countNonZero(cv2.compare(cv2.absdiff(picture, now), _DIFFERS, cv2.CMP_GT)) for picture in (moved, before)]
        return differ[0] <= differ[1]


def _farthest(motion: np.ndarray, shape: Tuple[int, ...]) -> float:
    """[px] by which a motion moves the corners of an image of this shape, along rows or columns, at most."""
    corners = np.array([[(0, 0), (shape[1], 0), (0, shape[0]), (shape[1], shape[0])]], float)
    return float(np.abs(cv2.perspectiveTransform(corners, motion) - corners).max())
