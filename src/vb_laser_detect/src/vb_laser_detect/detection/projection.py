"""Projects pixels to the floor, in the map frame (Sect. 4: ground plane for stationary cameras, depth for mobile ones).

Only the pixel is undistorted, never the image. A ray that meets a robot before the floor shows the robot, not the floor.
Because the robots' poses are known, no rules are needed for their lights, buttons and reflections.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Callable, Dict, List, Optional, Sequence, Tuple

import numpy as np

from vb_core.camera_model import CameraModel, measure_floor, project_to_floor
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.parameters import Parameters, param
from vb_laser_detect.detection.stage_results import Box, FloorPoint, Spot

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
_DEPTH_SHARE = 0.3  # least share of the neighbourhood with readings; below it the plane is used, see the point's source
_MIN_DEPTH, _MAX_DEPTH = 0.3, 6.0  # [m] range of readings; nearer and farther ones count as holes
_BLUR_PX = 3.0  # [px] by which optics and pixels blur every spot, whatever its size


@dataclass(frozen=True)
class ProjectionParams(Parameters):
    """Limits of what counts as a point on the floor."""

    floor_height: float = param(0.0, "m", low=-10.0, high=10.0, doc="z of the floor in the map frame")
    max_range: float = param(12.0, "m", above=0.0, high=100.0, doc="largest distance from the camera to the spot")


class FloorProjection:
    """What counts as a point on the floor that one camera sees. Limits and map may change between images.

    Args:
        params: limits of what counts as a point on the floor.
        floor: the physical map; points outside it are rejected. None: any place is allowed.
    """

    def __init__(self, params: Optional[ProjectionParams] = None, floor: Optional[GridMap] = None) -> None:
        self.params = params or ProjectionParams()
        self.floor = floor

    def reason_against(self, origin: np.ndarray, plane: np.ndarray, point: np.ndarray) -> str:
        """Returns the code of the reason why a pixel's point does not count, or "" if it counts.

        Args:
            origin: (3,) [m] the camera's position.
            plane: (3,) [m] where the pixel's ray meets the floor's plane; NaN: nowhere.
            point: (3,) [m] the pixel's point: `plane` itself, or where a depth image shows it on the ray.
        """
        if origin[2] <= self.params.floor_height or not np.isfinite(plane).all():
            return "no_floor_intersection"
        ray = plane - origin
        distance = float(np.linalg.norm(ray))
        if math.degrees(math.acos(min(1.0, abs(ray[2]) / distance))) > _MAX_INCIDENCE:
            return "grazing_view"
        if distance > self.params.max_range:
            return "too_far"
        if not self._is_on_map(plane):
            return "spot_outside_map"
        if point is plane:
            return ""
        if abs(point[2] - plane[2]) > _MAX_HEIGHT + _HEIGHT_PER_RANGE * float(np.linalg.norm(point - origin)):
            return "not_on_floor"
        return "" if self._is_on_map(point) else "spot_outside_map"

    def _is_on_map(self, point: np.ndarray) -> bool:
        if self.floor is None:
            return True
        return bool(self.floor.contains_cells(self.floor.world_to_cell(point[None, :2]))[0])


def depth_over_plane(
    depth: np.ndarray, pixel: np.ndarray, camera: CameraModel, T_map_camera: np.ndarray, height: float
) -> float:
    """Returns the depth at a pixel as a multiple of the floor plane's depth there, or NaN if there are too few readings.

    Each reading nearby is divided by what the plane would show at its pixel, so that neither the floor's slant nor the
    side on which readings are missing shifts their median.
    """
    if not camera.contains(pixel[None])[0]:
        return math.nan
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
        return math.nan
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
    """Maps the pixels of one image to the floor.

    Pose, depth and robots are looked up once, and only when they are needed: most images show nothing to be located.

    Attributes:
        camera: camera model for the image's size.
        floor_projection: what counts as a point on the floor.
        find_pose: returns T_map_camera (4, 4) at the image's time, or raises CodedError if it is unknown.
        find_depth: returns the depth at that time; None if the floor is a plane.
        find_robots: returns the robots at that time, which hide the floor behind them; by default none.
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

    def max_diameters(self, boxes: Sequence[Box], diameter: float) -> Tuple[Dict[Box, float], Optional[CodedError]]:
        """Returns how large [px] a spot of this diameter [m] is at most in each box, or NaN where no floor is seen.

        Without a pose, all are NaN, and the error says why it is unknown.
        """
        if not boxes:
            return {}, None
        try:
            pose = self._pose
        except CodedError as error:
            return dict.fromkeys(boxes, math.nan), error.without_traceback()
        middles = np.array(boxes).reshape(-1, 2, 2).mean(axis=1)
        _, meters_per_pixel = measure_floor(self.camera, pose, middles, self.floor_projection.params.floor_height)
        diameters = diameter / meters_per_pixel + _BLUR_PX
        return dict(zip(boxes, diameters.tolist())), None

    def locate(self, spots: Sequence[Spot]) -> List[Spot]:
        """Returns spots with their points on the floor. Spots without one are rejected, with the reason.

        Raises:
            CodedError: there is a spot to be located, but no pose.
        """
        accepted = [spot for spot in spots if not spot.rejection]
        if not accepted:
            return list(spots)
        pixels = np.array([(spot.u, spot.v) for spot in accepted])
        depth_ratios = self._depth_ratios(pixels)
        is_inside = self.camera.contains(pixels)
        height = self.floor_projection.params.floor_height
        planes, meters_per_pixel = measure_floor(self.camera, self._pose, pixels, height)
        located = map(self._locate_spot, accepted, is_inside, planes, meters_per_pixel.tolist(), depth_ratios)
        return [spot if spot.rejection else next(located) for spot in spots]

    def _locate_spot(
        self, spot: Spot, is_inside: bool, plane: np.ndarray, meters_per_pixel: float, depth_ratio: float
    ) -> Spot:
        """Returns a spot with its point on the floor, or rejected, given the plane and the depth at its pixel."""
        origin = self._pose[:3, 3]
        source = GROUND_PLANE if self.find_depth is None else GROUND_PLANE_FALLBACK
        point = plane
        if not math.isnan(depth_ratio):
            source = DEPTH
            point = origin + depth_ratio * (plane - origin)
            meters_per_pixel *= depth_ratio
        code = self.floor_projection.reason_against(origin, plane, point) if is_inside else "outside_image"
        if not code and any(robot.occludes(origin, point) for robot in self._robots):
            code = "on_robot"
        if code:
            return replace(spot, rejection=code)
        return replace(spot, floor_point=FloorPoint(point, meters_per_pixel, source))

    def _depth_ratios(self, pixels: np.ndarray) -> List[float]:
        """Returns `depth_over_plane` at each of these pixels (N, 2) of the image; NaN without a depth image."""
        readings, depth_camera = (None, None) if self.find_depth is None else self.find_depth()
        if readings is None or readings.ndim != 2 or not readings.size:
            return [math.nan] * len(pixels)
        # without a camera of its own, the depth image has the colour image's model, scaled to its size
        camera = depth_camera or self.camera.scaled_to(readings.shape[1], readings.shape[0])
        depth_pixels = camera.project(self.camera.pixels_to_rays(pixels))
        height = self.floor_projection.params.floor_height
        return [depth_over_plane(readings, pixel, camera, self._pose, height) for pixel in depth_pixels]
