"""Finds which robots hide the floor from a camera.

One idea: a ray that meets a robot before it meets the floor shows the robot, and nothing on it is a spot on the floor,
whatever it looks like. Where robots are is known, so no rule about their lights, buttons and reflections is needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class RobotCylinder:
    """An upright cylinder on the floor.

    Attributes:
        x, y: [m] its axis, map frame.
        radius, height: [m]
    """

    x: float
    y: float
    radius: float
    height: float

    def occludes(self, origin: np.ndarray, floor: np.ndarray) -> bool:
        """Returns whether a ray passes through it.

        Args:
            origin: (3,) [m] of the camera, above the floor.
            floor: (3,) [m] where the ray meets the floor.
        """
        # seen from above, the part of the ray that is not higher than the cylinder: how near it comes to the axis
        share = min(1.0, self.height / (origin[2] - floor[2]))
        along, axis = share * (origin - floor)[:2], np.array([self.x, self.y]) - floor[:2]
        nearest = min(1.0, max(0.0, float(axis @ along) / max(float(along @ along), 1e-12)))
        return float(np.hypot(*(axis - nearest * along))) <= self.radius
