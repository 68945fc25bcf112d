"""Cameras with lens distortion, including fisheyes, as sensor_msgs/CameraInfo describes them.

A lens's polynomial is valid up to the angle at which the image radius stops growing. Beyond it, points have no pixel
and pixels no ray: both are NaN. Within it, `project` and `pixels_to_rays` are exact inverses of each other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Tuple

import cv2
import numpy as np

from vb_core.errors import CodedError

_EXACT_PX = 1e-6  # [px] the largest distance between a pixel and the projection of its ray
_STEPS = 12  # iterations of Newton's method, each of which doubles the number of correct digits
_ORIGIN = np.zeros(3)
FISHEYE_MODELS = ("equidistant", "fisheye")  # names of the fisheye's distortion model
_TAN_90_DEGREES = 1e9  # stands for the tangent of 90 degrees
_CORNER = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])  # [px] a pixel and its neighbours to the right and below
_STENCIL = np.array([(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)])  # a point and its neighbours in x and in y


@dataclass(frozen=True)
class CameraModel:
    """A camera's intrinsic parameters.

    Attributes:
        width, height: image size [px].
        matrix: (3, 3) intrinsic matrix K [px].
        distortion: (4,), (5,), (8,), (12,) or (14,) coefficients in OpenCV's order: plumb_bob, rational_polynomial and its
            extensions; (4,) for a fisheye.
        fisheye: whether the distortion is OpenCV's fisheye model, which ROS calls equidistant. Rays have z = 1, so
            points at 90 degrees or more from the axis are not visible.

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
            raise CodedError("bad_camera_info", f"the image is {self.width} x {self.height}; is the camera running?")
        if not np.isfinite(matrix).all() or matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
            raise CodedError("bad_camera_info", "K has no focal length: calibrate the camera (camera_calibration)")
        if self.fisheye and not self.distortion[4:].any():
            object.__setattr__(self, "distortion", np.concatenate([self.distortion, np.zeros(4)])[:4])
        size = self.distortion.size
        sizes = (4,) if self.fisheye else (4, 5, 8, 12, 14)
        if size not in sizes or not np.isfinite(self.distortion).all():
            expected = f"{', '.join(map(str, sizes))}, all finite"
            raise CodedError("bad_camera_info", f"the distortion D has {size} values; expected {expected}")

    @staticmethod
    def ideal(width: int, height: int, focal_px: float) -> "CameraModel":
        """Makes a camera without distortion whose optical axis meets the image centre. Focal length [px]."""
        matrix = np.array([[focal_px, 0, (width - 1) / 2.0], [0, focal_px, (height - 1) / 2.0], [0, 0, 1.0]])
        return CameraModel(width, height, matrix, np.zeros(5))

    def pixels_to_rays(self, pixels: np.ndarray) -> np.ndarray:
        """Returns the viewing rays of pixels, without undistorting the rest of the image. Inverse of `project`.

        Args:
            pixels: (N, 2) columns and rows [px], the centre of the first pixel is (0, 0).

        Returns:
            (N, 3) in the optical frame, z = 1; NaN beyond the lens model's limit.
        """
        pixels = np.asarray(pixels, dtype=float).reshape(-1, 2)
        result = np.ones((len(pixels), 3))
        if not self.is_distorted:
            focal, center = self._pinhole
            np.multiply(pixels - center, 1.0 / focal, out=result[:, :2])
            return result
        if len(pixels) == 0:
            return result
        # OpenCV is fast, but accurate only near the axis: each result is verified by projecting it again
        if self.fisheye:
            xy = cv2.fisheye.undistortPoints(pixels[:, None], self.matrix, self.distortion)[:, 0]
        else:
            criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-9)
            xy = cv2.undistortPointsIter(pixels[:, None], self.matrix, self.distortion, None, None, criteria)[:, 0]
        inaccurate = self._inaccurate(xy, pixels)
        if inaccurate.any():
            xy[inaccurate] = self._undistort_by_newton(pixels[inaccurate])
            xy[self._inaccurate(xy, pixels)] = np.nan
        result[:, :2] = xy
        return result

    def project(self, points: np.ndarray) -> np.ndarray:
        """Projects points (N, 3) [m] in the optical frame to pixels (N, 2) [px]. Inverse of `pixels_to_rays`.

        Points that are not in front of the camera, or beyond the lens model's limit, give rows of NaN.
        """
        points = np.asarray(points, dtype=float).reshape(-1, 3)
        if len(points) == 0:
            return np.zeros((0, 2))
        if self.is_distorted:
            project = cv2.fisheye.projectPoints if self.fisheye else cv2.projectPoints
            pixels = project(points[:, None], _ORIGIN, _ORIGIN, self.matrix, self.distortion)[0][:, 0]
            depths = points[:, 2]
            axis_distances = np.hypot(points[:, 0], points[:, 1])
            is_visible = (depths > 0) & (axis_distances <= self.max_ray_tangent * depths)
            pixels[~is_visible] = np.nan
            return pixels
        depths = np.where(points[:, 2:] > 0, points[:, 2:], np.nan)
        focal, center = self._pinhole
        return points[:, :2] * (1.0 / depths) * focal + center

    @cached_property
    def is_distorted(self) -> bool:
        """Whether the lens distorts. A fisheye does even with coefficients of 0."""
        return self.fisheye or bool(self.distortion.any())

    @property
    def distortion_model(self) -> str:
        """The distortion model's name in sensor_msgs/CameraInfo."""
        pinhole = "plumb_bob" if self.distortion.size <= 5 else "rational_polynomial"
        return FISHEYE_MODELS[0] if self.fisheye else pinhole

    @cached_property
    def _pinhole(self) -> Tuple[np.ndarray, np.ndarray]:
        """Focal lengths and principal point [px]."""
        return np.array([self.matrix[0, 0], self.matrix[1, 1]]), self.matrix[:2, 2].copy()

    @cached_property
    def max_ray_tangent(self) -> float:
        """Tangent of the angle from the axis at which the model ends: farther out the image would fold back."""
        k = np.concatenate([self.distortion, np.zeros(8)])
        # the radius in the image as a quotient of polynomials in the tangent, or in the angle for a fisheye
        if self.fisheye:
            numerator = np.polynomial.Polynomial([0.0, 1.0, 0.0, k[0], 0.0, k[1], 0.0, k[2], 0.0, k[3]])
            denominator = np.polynomial.Polynomial([1.0])
        else:
            numerator = np.polynomial.Polynomial([0.0, 1.0, 0.0, k[0], 0.0, k[1], 0.0, k[4]])
            denominator = np.polynomial.Polynomial([1.0, 0.0, k[5], 0.0, k[6], 0.0, k[7]])
        # where the radius in the image stops growing, or has no value at all
        slope = numerator.deriv() * denominator - numerator * denominator.deriv()
        roots = np.concatenate([slope.roots(), denominator.roots()])
        is_positive = (np.abs(roots.imag) < 1e-9) & (roots.real > 0)
        limits = roots.real[is_positive].tolist()
        if not self.fisheye:
            return min(limits, default=_TAN_90_DEGREES)
        limit_angle = min(limits, default=math.pi)
        return math.tan(limit_angle) if limit_angle < math.pi / 2 else _TAN_90_DEGREES

    def _inaccurate(self, normalized: np.ndarray, pixels: np.ndarray) -> np.ndarray:
        """Returns, as (N,) bool, which normalised coordinates (N, 2) are not projected back to their pixels (N, 2)."""
        points = np.ones((len(normalized), 3))
        points[:, :2] = normalized
        return ~(np.abs(self.project(points) - pixels).max(axis=1) < _EXACT_PX)

    def _undistort_by_newton(self, pixels: np.ndarray) -> np.ndarray:
        """Undistorts pixels to normalised coordinates (N, 2) by Newton's method, starting within the model's limit."""
        focal, center = self._pinhole
        target = (pixels - center) / focal
        # the start: the undistorted radius, interpolated in a table
        radii = np.tan(np.linspace(0.0, math.atan(self.max_ray_tangent), 2000))
        projected = self.project(np.column_stack([radii, np.zeros(len(radii)), np.ones(len(radii))]))
        finite = np.isfinite(projected[:, 0])
        radius = np.hypot(*target.T)
        image_radii = np.maximum.accumulate((projected[finite, 0] - center[0]) / focal[0])
        initial = np.interp(radius, image_radii, radii[finite])
        xy = target * (initial / np.maximum(radius, 1e-12))[:, None]
        for _ in range(_STEPS):
            stencil = xy[:, None] + 1e-6 * _STENCIL
            rays = np.dstack([stencil, np.ones(stencil.shape[:2])])
            uv = (self.project(rays).reshape(-1, 5, 2) - center) / focal
            # the Jacobian by central differences, and each step by Cramer's rule
            u_x, v_x = (uv[:, 1] - uv[:, 2]).T / 2e-6
            u_y, v_y = (uv[:, 3] - uv[:, 4]).T / 2e-6
            error_u, error_v = (target - uv[:, 0]).T
            determinant = u_x * v_y - u_y * v_x
            with np.errstate(all="ignore"):
                step_x = (v_y * error_u - u_y * error_v) / determinant
                step_y = (u_x * error_v - v_x * error_u) / determinant
                step = np.column_stack([step_x, step_y])
                # close to the limit, a full step may lead beyond it
                room = np.maximum(1e-6, self.max_ray_tangent - np.hypot(*xy.T))
                length = np.maximum(1.0, np.hypot(*step.T) / (0.5 * room))
                xy = xy + step / length[:, None]
        return xy

    def contains(self, pixels: np.ndarray) -> np.ndarray:
        """Returns, as (N,) bool, which pixels (N, 2) are in the image."""
        pixels = np.asarray(pixels, dtype=float).reshape(-1, 2)
        with np.errstate(invalid="ignore"):
            return ((pixels >= -0.5) & (pixels <= (self.width - 0.5, self.height - 0.5))).all(axis=1)

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


# ------------------------------------------------------------------ a camera with a pose
def intersect_floor(T_map_camera: np.ndarray, rays: np.ndarray, height: float = 0.0) -> np.ndarray:
    """Intersects a camera's viewing rays with the floor.

    Args:
        T_map_camera: (4, 4) pose of the camera's optical frame in the map frame.
        rays: (N, 3) in the optical frame, any length.
        height: [m] z of the floor in the map frame.

    Returns:
        (N, 3) [m], map frame; rows of NaN for rays that do not meet the floor in front of the camera.
    """
    origin = T_map_camera[:3, 3]
    directions = rays @ T_map_camera[:3, :3].T
    vertical = directions[:, 2:]
    scales = np.full(vertical.shape, np.nan)
    np.divide(height - origin[2], vertical, out=scales, where=vertical != 0)
    points = origin + scales * directions
    is_in_front = (scales > 0) & (scales < np.inf)
    points[~is_in_front[:, 0]] = np.nan
    return points


def project_to_floor(
    camera: CameraModel, T_map_camera: np.ndarray, pixels: np.ndarray, height: float = 0.0
) -> np.ndarray:
    """Projects pixels (N, 2) to points (N, 3) [m] on the floor, as `intersect_floor` does. Inverse of `project_to_pixels`."""
    return intersect_floor(T_map_camera, camera.pixels_to_rays(pixels), height)


def measure_floor(
    camera: CameraModel, T_map_camera: np.ndarray, pixels: np.ndarray, height: float = 0.0
) -> Tuple[np.ndarray, np.ndarray]:
    """Projects pixels (N, 2) to the floor, as `project_to_floor` does, and measures how much floor each one shows.

    Returns:
        The points (N, 3) [m], and the length of floor (N,) [m/px] that each pixel shows, averaged over all directions.
        Both are NaN where no floor is seen.
    """
    corners = (pixels[:, None] + _CORNER).reshape(-1, 2)
    floor = project_to_floor(camera, T_map_camera, corners, height).reshape(-1, 3, 3)
    right = floor[:, 1] - floor[:, 0]
    down = floor[:, 2] - floor[:, 0]
    areas = np.abs(right[:, 0] * down[:, 1] - right[:, 1] * down[:, 0])
    return floor[:, 0], np.sqrt(np.where(areas > 0.0, areas, np.nan))


def project_to_pixels(camera: CameraModel, T_map_camera: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Projects points (N, 3) [m] in the map frame to pixels (N, 2); inverse of `project_to_floor`. NaN behind the camera."""
    points = np.asarray(points, dtype=float).reshape(-1, 3)
    return camera.project((points - T_map_camera[:3, 3]) @ T_map_camera[:3, :3])
