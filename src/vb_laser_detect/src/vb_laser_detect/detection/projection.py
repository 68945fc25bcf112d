"""Projects pixels to the floor, in the map frame (Sect. 4: ground plane for stationary cameras, depth for mobile ones).

Only the pixel is undistorted, never the image. A ray that meets a robot before the floor shows the robot, and nothing
on it is a spot on the floor. As the robots' poses are known, no rules are needed for their lights, buttons and reflections.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Callable, List, Optional, Sequence, Tuple

import numpy as np

from vb_core.camera_model import CameraModel, project_to_floor
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.parameters import Parameters, param
from vb_laser_detect.detection.stage_results import FloorPoint, Spot

# a depth image (h, w) and its camera, if that is known; both are None if no depth image is near the image's time
Depth = Tuple[Optional[np.ndarray], Optional[CameraModel]]

# vb_msgs/LaserSpot's constants in lower case
GROUND_PLANE = "ground_plane"
DEPTH = "depth"
GROUND_PLANE_FALLBACK = "ground_plane_fallback"
# [deg] largest angle between a ray and the floor's normal; there an error of one pixel is an error of centimetres
_MAX_INCIDENCE = 85.0
_MAX_HEIGHT = 0.08  # [m] a depth point farther from the floor is on an object
_HEIGHT_PER_RANGE = 0.03  # [m/m] by which that limit grows with the distance, as the depth's noise does
_DEPTH_RADIUS = 2  # [px of the depth image] neighbourhood of the median: a spot's size at a metre
_DEPTH_SHARE = 0.3  # least share of the neighbourhood with readings; below it the plane is used, and the point says so
_MIN_DEPTH, _MAX_DEPTH = 0.3, 6.0  # [m] nearer and farther readings count as holes, for every camera of this kind
_CORNER = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])  # [px] a pixel and its neighbours to the right and below


@dataclass(frozen=True)
class ProjectionParams(Parameters):
    """Limits of what counts as a point on the floor."""

    floor_height: float = param(0.0, "m", low=-10.0, high=10.0, doc="z of the floor in the map frame")
    max_range: float = param(12.0, "m", above=0.0, high=100.0, doc="largest distance from the camera to the spot")


def _scales(corners: np.ndarray) -> np.ndarray:
    """Computes the floor length (N,) [m/px] of pixels, the mean over directions, from their corners (N, 3, 3) [m]."""
    right, down = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas = np.abs(right[:, 0] * down[:, 1] - right[:, 1] * down[:, 0])
    return np.sqrt(np.where(areas > 0.0, areas, np.nan))


class FloorProjection:
    """Projects the spots of one camera.

    Args:
        params: limits of what counts as a point on the floor.
        floor: the physical map; points outside it are rejected. None: any place is allowed.
    """

    def __init__(self, params: Optional[ProjectionParams] = None, floor: Optional[GridMap] = None) -> None:
        self.params = params or ProjectionParams()
        self.floor = floor

    def project_to_plane(self, camera: CameraModel, T_map_camera: np.ndarray, u: float, v: float) -> FloorPoint:
        """Projects a pixel [px] to the floor plane.

        Raises:
            CodedError: "outside_image", "no_floor_intersection", "grazing_view", "too_far", "spot_outside_map".
        """
        p = self.params
        if not (math.isfinite(u) and math.isfinite(v)) or not camera.contains(np.array([[u, v]]))[0]:
            raise CodedError("outside_image", size=f"{camera.width} x {camera.height}")
        corner = project_to_floor(camera, T_map_camera, (u, v) + _CORNER, p.floor_height)
        point, origin = corner[0], T_map_camera[:3, 3]
        if origin[2] <= p.floor_height or not np.isfinite(point).all():
            raise CodedError("no_floor_intersection", "the ray does not meet the floor in front of the camera")
        ray = point - origin
        distance = float(np.linalg.norm(ray))
        incidence = math.degrees(math.acos(min(1.0, abs(ray[2]) / distance)))
        if incidence > _MAX_INCIDENCE:
            raise CodedError("grazing_view", f"the floor is seen at {incidence:.0f} degrees from its normal")
        if distance > p.max_range:
            raise CodedError("too_far", f"the point is {distance:.1f} m away")
        self._check_map(point)
        return FloorPoint(point, float(_scales(corner[None])[0]), GROUND_PLANE, distance)

    def project_with_depth(
        self, camera: CameraModel, T_map_camera: np.ndarray, u: float, v: float, depth: Depth
    ) -> FloorPoint:
        """Projects a colour pixel [px] to the point that the depth image shows there.

        Args:
            depth: image (h, w) float [m] or uint16 [mm], registered to the colour image and of any size; 0 and NaN are
                holes. None, or too few readings round the pixel: the floor plane is used, and `source` says so. Without
                a camera, the depth image has the colour image's model, scaled to its size.

        Raises:
            CodedError: as `project_to_plane`, and "not_on_floor" for a point above or below the floor.
        """
        plane = self.project_to_plane(camera, T_map_camera, u, v)
        readings, depth_camera = depth
        ratio = None
        if readings is not None and readings.ndim == 2 and readings.size:
            model = depth_camera or camera.scaled_to(readings.shape[1], readings.shape[0])
            pixel = model.project(camera.pixels_to_rays(np.array([[u, v]])))[0]
            ratio = depth_over_plane(readings, pixel, model, T_map_camera, self.params.floor_height)
        if ratio is None:
            return replace(plane, source=GROUND_PLANE_FALLBACK)
        origin = T_map_camera[:3, 3]
        point = origin + ratio * (plane.position - origin)
        distance = ratio * plane.range
        height_error = float(point[2] - plane.position[2])
        if abs(height_error) > _MAX_HEIGHT + _HEIGHT_PER_RANGE * distance:
            raise CodedError("not_on_floor", f"the spot lies {height_error:+.2f} m off the floor")
        self._check_map(point)
        return FloorPoint(point, ratio * plane.meters_per_pixel, DEPTH, distance)

    def _check_map(self, point: np.ndarray) -> None:
        if self.floor is None:
            return
        cells = self.floor.world_to_cell(point[None, :2])
        if not self.floor.contains_cells(cells)[0]:
            raise CodedError("spot_outside_map", f"({point[0]:.2f}, {point[1]:.2f}) lies outside the map")


def depth_over_plane(
    depth: np.ndarray, pixel: np.ndarray, camera: CameraModel, T_map_camera: np.ndarray, height: float
) -> Optional[float]:
    """Returns the depth at a pixel as a multiple of the floor plane's depth there, or None if there are too few readings.

    Each reading nearby is divided by what the plane would show at its pixel, so that neither the floor's slant nor the
    side on which readings are missing shifts their median.
    """
    if not camera.contains(pixel[None])[0]:
        return None
    middle = np.round(pixel).astype(int)
    left, top = np.maximum(middle - _DEPTH_RADIUS, 0)
    right, bottom = middle + _DEPTH_RADIUS + 1
    units_per_meter = 1000.0 if depth.dtype.kind in "ui" else 1.0
    part = np.nan_to_num(depth[top:bottom, left:right].astype(float)) / units_per_meter
    rows, columns = np.nonzero((part >= _MIN_DEPTH) & (part <= _MAX_DEPTH))
    floor = project_to_floor(camera, T_map_camera, np.column_stack([columns + left, rows + top]), height)
    plane_depths = (floor - T_map_camera[:3, 3]) @ T_map_camera[:3, 2]
    ratios = part[rows, columns] / plane_depths
    ratios = ratios[np.isfinite(ratios)]
    if len(ratios) < max(1.0, _DEPTH_SHARE * part.size):
        return None
    return float(np.median(ratios))


# ------------------------------------------------------------------ one image
@dataclass(frozen=True)
class RobotCylinder:
    """An upright cylinder on the floor, in metres, whose axis is at (x, y) in the map frame."""

    x: float
    y: float
    radius: float
    height: float

    def occludes(self, origin: np.ndarray, floor: np.ndarray) -> bool:
        """Returns whether a ray from the camera `origin` (3,) [m] to a point `floor` (3,) [m] passes through it."""
        # seen from above: the distance from the axis to the part of the ray that is not higher than the cylinder
        share = min(1.0, self.height / (origin[2] - floor[2]))
        ray = share * (origin - floor)[:2]
        axis = np.array([self.x, self.y]) - floor[:2]
        squared_length = max(float(ray @ ray), 1e-12)
        nearest = min(1.0, max(0.0, float(axis @ ray) / squared_length))  # as a share of the ray
        offset = axis - nearest * ray
        return float(np.hypot(*offset)) <= self.radius


@dataclass(eq=False)
class ImageGeometry:
    """Locates the pixels of one image on the floor: first `meters_per_pixel`, then `locate`.

    Most images show nothing to be located, so pose, depth and robots are looked up only if they are needed.

    Attributes:
        camera: camera model for the image's size.
        floor_projection: projection of this camera's spots.
        find_pose: returns T_map_camera (4, 4) at the image's time, or raises CodedError if it is unknown.
        find_depth: returns the depth at that time; None: the floor is a plane.
        find_robots: returns where robots hide the floor at that time; by default nowhere.
    """

    camera: CameraModel
    floor_projection: FloorProjection
    find_pose: Callable[[], np.ndarray]
    find_depth: Optional[Callable[[], Depth]] = None
    find_robots: Callable[[], Sequence[RobotCylinder]] = tuple

    @cached_property
    def _pose(self) -> np.ndarray:
        return self.find_pose()

    @cached_property
    def _robots(self) -> Sequence[RobotCylinder]:
        return self.find_robots()

    def meters_per_pixel(self, pixels: np.ndarray) -> np.ndarray:
        """Returns the floor length (N,) [m/px] of pixels (N, 2), NaN where no floor is seen. Raises CodedError without a pose."""
        corners = (pixels[:, None] + _CORNER).reshape(-1, 2)
        floor = project_to_floor(self.camera, self._pose, corners, self.floor_projection.params.floor_height)
        return _scales(floor.reshape(-1, 3, 3))

    def locate(self, spots: Sequence[Spot]) -> List[Spot]:
        """Returns spots with their points on the floor. Spots without one are rejected, with the reason."""
        located = []
        for spot in spots:
            try:
                located.append(spot if spot.rejection else replace(spot, floor_point=self.floor_point(spot.u, spot.v)))
            except CodedError as error:
                located.append(replace(spot, rejection=error.code))
        return located

    def floor_point(self, u: float, v: float) -> FloorPoint:
        """Projects a pixel to the floor.

        Raises:
            CodedError: where there is no floor point, or without a pose; "on_robot" if a robot hides it.
        """
        if self.find_depth is None:
            point = self.floor_projection.project_to_plane(self.camera, self._pose, u, v)
        else:
            point = self.floor_projection.project_with_depth(self.camera, self._pose, u, v, self.find_depth())
        if any(robot.occludes(self._pose[:3, 3], point.position) for robot in self._robots):
            raise CodedError("on_robot")
        return point
