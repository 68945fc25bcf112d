"""The transform from one map's frame to another's."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np


class Transform(NamedTuple):
    """A rigid motion in the plane: q = R(yaw) p + (x, y).

    Attributes:
        x, y, yaw: [m], [m], [rad].

    >>> Transform(1.0, 0.0, math.pi / 2).apply([(2.0, 0.0)]).round(3).tolist()
    [[1.0, 2.0]]
    """

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Moves points (N, 2) [m]; the identity returns the same numbers."""
        points = np.asarray(points, dtype=float).reshape(-1, 2)
        if not any(self):
            return points
        return points @ self.rotation.T + (self.x, self.y)

    @property
    def rotation(self) -> np.ndarray:
        """The rotation matrix (2, 2)."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return np.array([[c, -s], [s, c]])

    @property
    def inverse(self) -> "Transform":
        """The motion back."""
        if not any(self):
            return self
        x, y = -self.rotation.T @ (self.x, self.y)
        return Transform(float(x), float(y), -self.yaw)

    def after(self, first: "Transform") -> "Transform":
        """Returns this motion after another one."""
        x, y = self.rotation @ (first.x, first.y) + (self.x, self.y)
        return Transform(float(x), float(y), math.remainder(self.yaw + first.yaw, 2.0 * math.pi))

    @classmethod
    def rotation_about(cls, center: np.ndarray, destination: np.ndarray, yaw: float) -> "Transform":
        """Returns the motion that turns about a centre (2,) [m] by a yaw [rad], and takes it to a destination (2,) [m]."""
        x, y = destination - cls(yaw=yaw).apply(center)[0]
        return cls(float(x), float(y), math.remainder(yaw, 2.0 * math.pi))
