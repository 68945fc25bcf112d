"""One image's geometry: where its pixels are on the floor, computed only where a candidate needs it.

A ray that meets a robot before it meets the floor shows the robot, and nothing on it is a spot on the floor, whatever it
looks like. Where robots are is known, so no rule about their lights, buttons and reflections is needed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Callable, Dict, Optional, Sequence, Tuple

import numpy as np

from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError
from vb_laser_detect.detection import projection
from vb_laser_detect.detection.projection import FloorPoint, FloorProjection

# a depth image (h, w), and its camera if that is known; (None, None) where there is none near the image's time
DepthAt = Callable[[], Tuple[Optional[np.ndarray], Optional[CameraModel]]]


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


class ImageGeometry:
    """Places the pixels of one image on the floor. Most images hold no candidate and cost nothing here.

    Attributes:
        unplaced: why the requested pose is not known; None while all is well.

    Args:
        camera: of the image.
        pose: returns (4, 4) T_map_camera at the image's time; asked at most once. CodedError "no_transform" if unknown.
        projector: the camera's.
        depth: returns the depth image of that time; None: the floor is a plane.
        cylinders: returns what stood on the floor at that time; asked at most once, and only for a candidate.
    """

    def __init__(
        self,
        camera: CameraModel,
        pose: Callable[[], np.ndarray],
        projector: FloorProjection,
        depth: Optional[DepthAt] = None,
        cylinders: Callable[[], Sequence[RobotCylinder]] = tuple,
    ) -> None:
        self.unplaced: Optional[CodedError] = None
        self._camera, self._projector = camera, projector
        self._ask_pose, self._depth, self._ask_cylinders = pose, depth, cylinders
        self._points: Dict[Tuple[float, float], FloorPoint] = {}

    @cached_property
    def pose(self) -> np.ndarray:
        """Returns T_map_camera (4, 4)."""
        return self._ask_pose()

    @cached_property
    def cylinders(self) -> Sequence[RobotCylinder]:
        """Cylinders that may hide the floor."""
        return self._ask_cylinders()

    def to_floor(self, pixels: np.ndarray) -> np.ndarray:
        """Projects pixels (N, 2) to the floor (N, 3) [m]; NaN without a pose, see `unplaced`."""
        if self.unplaced is None:
            try:
                return projection.floor_points(self._camera, self.pose, pixels, self._projector.params.floor_height)
            except CodedError as error:
                if error.code not in ("no_transform", "bad_transform"):
                    raise
                self.unplaced = error.without_traceback()
        return np.full((len(pixels), 3), np.nan)

    def point(self, u: float, v: float) -> FloorPoint:
        """Projects a pixel to the floor, once.

        Raises:
            CodedError: where there is no floor point; "on_robot" if a body hides it.
        """
        if (u, v) not in self._points:
            where, at = (self._camera, self.pose, u, v), self._projector
            point = at.on_plane(*where) if self._depth is None else at.with_depth(*where, *self._depth())
            if any(robot.occludes(self.pose[:3, 3], point.position) for robot in self.cylinders):
                raise CodedError("on_robot")
            self._points[u, v] = point
        return self._points[u, v]
