"""Cameras with lens distortion, fisheyes among them, as sensor_msgs/CameraInfo describes them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Tuple

import cv2
import numpy as np

from vb_core.errors import CodedError

# from this many points on numpy is faster than OpenCV, whose calls cost less and whose points cost more
_MANY = 64
_ORIGIN = np.zeros(3)


@dataclass(frozen=True)
class CameraModel:
    """A camera's intrinsic parameters.

    Attributes:
        width, height: image size [px].
        matrix: (3, 3) intrinsic matrix K [px].
        distortion: (4,), (5,) or (8,) coefficients of OpenCV's plumb_bob or rational_polynomial model; (4,) for a
            fisheye.
        fisheye: the distortion is OpenCV's fisheye model, which ROS calls equidistant. Rays have z = 1, so nothing is
            seen at 90 degrees from the axis or more.

    Raises:
        CodedError: "bad_camera_info" if no camera can have these values.
    """

    width: int
    height: int
    matrix: np.ndarray
    distortion: np.ndarray
    fisheye: bool = False

    def __post_init__(self) -> None:
        matrix = np.asarray(self.matrix, dtype=float).reshape(3, 3)
        distortion = np.asarray(self.distortion, dtype=float).ravel()
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "distortion", distortion if distortion.size else np.zeros(5))
        if self.width <= 0 or self.height <= 0:
            raise CodedError(
                "bad_camera_info", f"the image size is {self.width} x {self.height}; is the camera running?"
            )
        if not np.isfinite(matrix).all() or matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
            raise CodedError(
                "bad_camera_info", "the camera matrix K has no focal length: calibrate the camera (camera_calibration)"
            )
        if self.fisheye and self.distortion.size != 4:
            if not distortion.size or not self.distortion[4:].any():
                object.__setattr__(self, "distortion", np.concatenate([self.distortion, np.zeros(4)])[:4])
        if (
            self.distortion.size not in ((4,) if self.fisheye else (4, 5, 8, 12, 14))
            or not np.isfinite(self.distortion).all()
        ):
            raise CodedError(
                "bad_camera_info", f"the distortion D has {self.distortion.size} values; expected 4, 5 or 8"
            )

    @staticmethod
    def ideal(width: int, height: int, focal_px: float) -> "CameraModel":
        """Makes a camera without distortion whose axis meets the middle of the image; focal length in pixels."""
        matrix = np.array([[focal_px, 0, (width - 1) / 2.0], [0, focal_px, (height - 1) / 2.0], [0, 0, 1.0]])
        return CameraModel(width, height, matrix, np.zeros(5))

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """Returns the viewing rays of pixels; inverse of `project`.

        Args:
            pixels: (N, 2) columns and rows [px], the centre of the first pixel is (0, 0).

        Returns:
            (N, 3) in the optical frame, z = 1; only these pixels are undistorted.
        """
        pixels = np.asarray(pixels, dtype=float).reshape(-1, 2)
        result = np.ones((len(pixels), 3))
        if not self.distorted:
            focal, middle = self._pinhole
            np.multiply(pixels - middle, 1.0 / focal, out=result[:, :2])
            return result
        if self.fisheye:
            return self._fisheye_rays(pixels)
        # more steps than OpenCV's default of 5, which leaves 0.1 px at the corners of wide lenses
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-9)
        normalized = cv2.undistortPointsIter(pixels[:, None], self.matrix, self.distortion, None, None, criteria)
        result[:, :2] = normalized[:, 0]
        return result

    def project(self, points: np.ndarray) -> np.ndarray:
        """Projects points (N, 3) [m] in the optical frame to pixels (N, 2) [px]; inverse of `rays`.

        Points that are not in front of the camera give rows of NaN.
        """
        points = np.asarray(points, dtype=float).reshape(-1, 3)
        if len(points) == 0:
            return np.zeros((0, 2))
        if self.fisheye:
            pixels = cv2.fisheye.projectPoints(points[:, None], _ORIGIN, _ORIGIN, self.matrix, self.distortion)[0][:, 0]
            pixels[points[:, 2] <= 0] = np.nan
            return pixels
        if self.distorted and (len(points) < _MANY or self.distortion.size > 8):
            pixels = cv2.projectPoints(points, _ORIGIN, _ORIGIN, self.matrix, self.distortion)[0][:, 0]
            pixels[points[:, 2] <= 0] = np.nan
            return pixels
        depths = points[:, 2:]
        if not depths.min() > 0:
            depths = np.where(depths > 0, depths, np.nan)
        # the same operations as in OpenCV, bit for bit
        normalized = points[:, :2] * (1.0 / depths)
        focal, middle = self._pinhole
        return (self._distort(normalized) if self.distorted else normalized) * focal + middle

    @cached_property
    def distorted(self) -> bool:
        """Returns whether the lens distorts; a fisheye does even with coefficients of 0."""
        return self.fisheye or bool(self.distortion.any())

    @cached_property
    def _pinhole(self) -> Tuple[np.ndarray, np.ndarray]:
        """Returns focal lengths and principal point [px]."""
        return np.array([self.matrix[0, 0], self.matrix[1, 1]]), self.matrix[:2, 2].copy()

    def _fisheye_rays(self, pixels: np.ndarray) -> np.ndarray:
        """Returns the rays (N, 3), z = 1, of pixels (N, 2); NaN at 90 degrees from the axis or more."""
        if len(pixels) == 0:
            return np.ones((0, 3))
        normalized = cv2.fisheye.undistortPoints(pixels[:, None], self.matrix, self.distortion)[:, 0]
        result = np.column_stack([normalized, np.ones(len(pixels))])
        # OpenCV marks what it cannot undo with a huge number, and folds what is beyond 90 degrees back to the front
        with np.errstate(invalid="ignore"):
            again = cv2.fisheye.distortPoints(normalized[:, None], self.matrix, self.distortion)[:, 0]
            result[~(np.abs(again - pixels).max(axis=1) < 0.5)] = np.nan
        return result

    def _distort(self, normalized: np.ndarray) -> np.ndarray:
        """Distorts normalised image coordinates (N, 2)."""
        k1, k2, p1, p2, k3, k4, k5, k6 = np.concatenate([self.distortion, np.zeros(4)])[:8]
        x, y = normalized.T
        r2 = x * x + y * y
        r4 = r2 * r2
        r6 = r4 * r2
        radial = 1.0 + k1 * r2 + k2 * r4 + k3 * r6
        rational = 1.0 / (1.0 + k4 * r2 + k5 * r4 + k6 * r6)
        xy = 2.0 * x * y
        bent = np.empty_like(normalized)
        bent[:, 0] = x * radial * rational + p1 * xy + p2 * (r2 + 2.0 * x * x)
        bent[:, 1] = y * radial * rational + p1 * (r2 + 2.0 * y * y) + p2 * xy
        return bent

    def contains(self, pixels: np.ndarray) -> np.ndarray:
        """Returns which of pixels (N, 2) are in the image, (N,) bool."""
        pixels = np.asarray(pixels, dtype=float).reshape(-1, 2)
        with np.errstate(invalid="ignore"):
            return (
                (pixels[:, 0] >= -0.5)
                & (pixels[:, 0] <= self.width - 0.5)
                & (pixels[:, 1] >= -0.5)
                & (pixels[:, 1] <= self.height - 0.5)
            )

    @property
    def focal_px(self) -> float:
        """Mean focal length [px]."""
        return float((self.matrix[0, 0] + self.matrix[1, 1]) / 2.0)

    def scaled_to(self, width: int, height: int) -> "CameraModel":
        """Returns the model of the same camera for an image of another size, for instance a coarser depth image."""
        sx, sy = width / self.width, height / self.height
        # pixel centres are whole numbers: the image's edge is at -0.5 in both sizes
        scale = np.array([[sx, 0, sx / 2 - 0.5], [0, sy, sy / 2 - 0.5], [0, 0, 1]])
        return CameraModel(width, height, scale @ self.matrix, self.distortion, self.fisheye)
