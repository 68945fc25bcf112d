"""Computes what a camera sees of the floor."""

from __future__ import annotations

from typing import Union

import numpy as np

from vb_core import geometry
from vb_core.camera_model import CameraModel


class FloorView:
    """Projects floor points, given in the frame of a robot's base, into the image of its camera.

    Args:
        camera: the lens, from camera_info.
        T_base_camera: (4, 4) the mount, from tf.
        max_range: [m] farther from the base a spot is too small to be detected.
    """

    def __init__(self, camera: CameraModel, T_base_camera: np.ndarray, max_range: float = 3.0) -> None:
        self.camera = camera
        self.T_base_camera = T_base_camera
        self.max_range = max_range
        self._T_camera_base = geometry.invert(T_base_camera)
        corners = np.array(
            [[0, 0], [camera.width - 1, 0], [camera.width - 1, camera.height - 1], [0, camera.height - 1]]
        )
        # far outside the image the distortion polynomials may map points back into it
        self._widest = 1.05 * float(
            min(camera.limit, np.linalg.norm(camera.rays(corners.astype(float))[:, :2], axis=1).max())
        )

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Projects floor points (N, 2) [m], base frame, to pixels (N, 2) [px]; NaN far outside of the image."""
        points = np.asarray(points, dtype=float).reshape(-1, 2)
        points = geometry.apply(self._T_camera_base, np.column_stack([points, np.zeros(len(points))]))
        ahead = (points[:, 2] > 1e-6) & (np.hypot(points[:, 0], points[:, 1]) <= self._widest * points[:, 2])
        pixels = np.full((len(points), 2), np.nan)
        pixels[ahead] = self.camera.project(points[ahead])
        return pixels

    def sees(self, points: np.ndarray, margin: Union[float, np.ndarray] = 0.0) -> np.ndarray:
        """Returns (N,) bool: which floor points (N, 2) [m], base frame, are in the image and within range.

        Args:
            margin: how far from the image's edges, as a fraction of its width and height, or (2,) of each; 0.5 leaves
                the middle only.
        """
        points = np.asarray(points, dtype=float).reshape(-1, 2)
        width, height = self.camera.width, self.camera.height
        pixels = self.pixels(points)
        edges = margin * np.array([width, height])
        with np.errstate(invalid="ignore"):
            inside = ((pixels >= edges - 0.5) & (pixels <= np.array([width, height]) - 0.5 - edges)).all(axis=1)
        return inside & (np.hypot(points[:, 0], points[:, 1]) <= self.max_range)
