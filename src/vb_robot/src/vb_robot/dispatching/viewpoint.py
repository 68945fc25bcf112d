"""Poses from which a robot's own camera sees the spot (paper, Sect. 4.2: a robot is sent to the area).

A robot looks a little ahead of the spot, to where the line continues, so that it sees the spot before ceiling cameras
lose it. It avoids the area that the border will probably restrict. One test decides whether the camera sees enough from
a pose, whether that is the robot's own, its goal or a candidate; a candidate needs some more margin. Of the candidates
that pass, the one that costs least, in metres of path, is chosen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Iterable, Optional, Tuple, Union

import cv2
import numpy as np
from shapely.geometry import Polygon

from vb_core import geometry
from vb_core.camera_model import CameraModel
from vb_core.geometry import Pose
from vb_core.grid_map import clearance_grid, sample
from vb_robot.clearance_map import STOP_MARGIN, ClearanceMap

# [m] to the point that the camera looks at; a nearer point leaves the image, a farther spot is too small
MIN_DISTANCE, MAX_DISTANCE = (0.8, 1.5)
BEST_DISTANCE = 1.1  # [m]
DISTANCES, BEARINGS = 4, 36  # how many of each are checked
# minimum distance from the image's edge, as a fraction of the image
IMAGE_MARGIN = 0.15  # of the point that a new pose looks at
SEEN_MARGIN = 0.06  # of the points that any pose must see
LINE_MARGIN = 0.10  # [m] beyond the radius, which a robot keeps from the line being drawn and its extrapolation
# what a pose costs, in metres of path
TURN_COST = 0.4  # for each radian: the time of the turn, at 0.5 m/s
DISTANCE_COST = 0.5  # for each metre off BEST_DISTANCE
UNSEEN_COST = 0.5  # if the robot sees nothing of the extrapolated line
LOCKED_COST = 5.0  # if the path crosses the area that the border will restrict, and again if the pose is on it
STEP = 0.05  # [m] between points of an extrapolated line
# By the time that the robot arrives, a quick hand has moved on. So the robot looks ahead by half of that distance, from
# where it still sees the spot.
REACTION = 1.2  # [s] for which the hand moves on
MIN_LOOKAHEAD, MAX_LOOKAHEAD = 0.3, 0.6  # [m] from the spot to the point that the robot looks at
LINE_AHEAD = 0.8  # [m] length of the extrapolated line, which a robot should see, and on which it does not stand
MIN_LINE = 0.3  # [m] a shorter line encloses nothing yet
NO_POINTS = np.zeros((0, 2))
Circle = Tuple[float, float, float]  # (x, y, radius) [m]


@dataclass(frozen=True)
class DrawingState:
    """The drawing so far, map frame."""

    spot: Optional[np.ndarray] = None  # (2,) [m] the spot's last position; None if it is not known
    chain: np.ndarray = field(default_factory=lambda: NO_POINTS)  # (M, 2) [m] the line drawn so far
    velocity: Optional[np.ndarray] = None  # (2,) [m/s] of the spot, or None
    closed: bool = False  # whether the chain is a polygon
    marks_side: bool = False  # whether the spot marks the side to be restricted, which robots must not enter
    seen_by_stationary: bool = False  # whether a stationary camera sees the spot, so that a robot need not
    seed: Optional[np.ndarray] = None  # (2,) [m] the seed with which the border would be saved now, or None

    def interior_point(self) -> Optional[np.ndarray]:
        """Returns a point (2,) [m] inside a closed line, near its middle, or None if the line is open."""
        if not self.closed or len(self.chain) < 3:
            return None
        return np.array(Polygon(self.chain).representative_point().coords[0])

    def extrapolate_line(self, clearance_map: ClearanceMap) -> np.ndarray:
        """Extrapolates the line from the spot, up to a wall at most: (K, 2) [m]; only the spot if it does not move."""
        if self.velocity is None or self.marks_side:
            return np.array([self.spot])
        wall = clearance_map.ray_end(self.spot, self.velocity)
        room = max(0.0, float(np.linalg.norm(wall - self.spot)) - STEP)
        lengths = np.arange(0.0, min(LINE_AHEAD, room) + 1e-9, STEP)
        return self.spot + lengths[:, None] * self.velocity / np.linalg.norm(self.velocity)

    def target_point(self, ahead: np.ndarray) -> np.ndarray:
        """Returns the point (2,) [m] of the line ahead (K, 2) [m] that a robot should look at."""
        speed = float(np.linalg.norm(self.velocity)) if self.velocity is not None else 0.0
        length = min(max(0.5 * REACTION * speed, MIN_LOOKAHEAD), MAX_LOOKAHEAD)
        index = int(round(length / STEP))
        return ahead[min(index, len(ahead) - 1)]

    def expected_area(self, clearance_map: ClearanceMap) -> np.ndarray:
        """Predicts which cells (H, W) bool the border will restrict. There are none while it is too early to tell.

        While the seed is shown, these are the cells of the seed's side. Before that, they are the cells between the
        drawn line and the straight line that joins its ends, because a half-drawn polygon looks like a curve.
        """
        if self.marks_side:
            return clearance_map.predict_restricted_side(self.spot, self.chain, self.closed)
        canvas = np.zeros(clearance_map.grid.shape, dtype=np.uint8)
        if len(self.chain) > 1 and np.ptp(self.chain, axis=0).max() >= MIN_LINE:
            pixels = np.rint(clearance_map.grid.world_to_grid(self.chain)).astype(np.int32)
            cv2.fillPoly(canvas, [pixels[:, None]], 1)
        return canvas.astype(bool)


class RobotCameraView:
    """Projects floor points, given in the frame of a robot's base, into the image of its camera.

    Args:
        camera: the camera's model, from camera_info.
        T_base_camera: (4, 4) the camera's mount, from tf.
        max_range: [m] distance from the base beyond which a spot is too small to be detected.
    """

    def __init__(self, camera: CameraModel, T_base_camera: np.ndarray, max_range: float = 3.0) -> None:
        self.camera = camera
        self.T_base_camera = T_base_camera
        self.max_range = max_range
        self._T_camera_base = geometry.invert_transform(T_base_camera)
        right, bottom = camera.width - 1.0, camera.height - 1.0
        corners = np.array([[0.0, 0.0], [right, 0.0], [right, bottom], [0.0, bottom]])
        tangents = np.linalg.norm(camera.pixels_to_rays(corners)[:, :2], axis=1)
        # far outside the image the distortion polynomials may map points back into it
        self._widest = 1.05 * float(min(camera.max_ray_tangent, tangents.max()))

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Projects floor points (N, 2) [m], base frame, to pixels (N, 2) [px], or NaN far outside the image."""
        points = np.asarray(points, dtype=float).reshape(-1, 2)
        floor_points = np.column_stack([points, np.zeros(len(points))])
        in_camera = geometry.transform_points(self._T_camera_base, floor_points)
        x, y, depth = in_camera.T
        ahead = (depth > 1e-6) & (np.hypot(x, y) <= self._widest * depth)
        pixels = np.full((len(points), 2), np.nan)
        pixels[ahead] = self.camera.project(in_camera[ahead])
        return pixels

    def sees(self, points: np.ndarray, margin: Union[float, np.ndarray] = 0.0) -> np.ndarray:
        """Returns (N,) bool: which floor points (N, 2) [m], base frame, are in the image and within range.

        Args:
            margin: minimum distance from the image's edges, as a fraction of width and height, or (2,) of each.
        """
        points = np.asarray(points, dtype=float).reshape(-1, 2)
        size = np.array([self.camera.width, self.camera.height])
        edges = margin * size
        pixels = self.pixels(points)
        with np.errstate(invalid="ignore"):
            inside = ((pixels >= edges - 0.5) & (pixels <= size - 0.5 - edges)).all(axis=1)
        in_range = np.hypot(points[:, 0], points[:, 1]) <= self.max_range
        return inside & in_range


@dataclass(frozen=True)
class Viewpoint:
    """A pose to which a robot may be sent."""

    pose: Pose  # (x, y, yaw) [m, m, rad], map frame
    cost: float  # [m] of path
    sees_spot: bool = True  # False for a pose at which the robot only leaves the side to be restricted
    number: int = 0  # counts the goals that were sent, so that the same pose sent again is another goal


class ViewpointPlanner:
    """Computes what one robot can see of a drawing, from its pose and from the poses that it can reach.

    Args:
        others: (K, 2) [m] positions of other robots.
    """

    def __init__(
        self, clearance_map: ClearanceMap, view: RobotCameraView, drawing: DrawingState, others: Iterable = ()
    ) -> None:
        self.clearance_map, self.view, self.drawing = clearance_map, view, drawing
        self._others = np.asarray(list(others), dtype=float).reshape(-1, 2)
        self._ahead = drawing.extrapolate_line(clearance_map)
        self.target_point = drawing.target_point(self._ahead)
        area = drawing.expected_area(clearance_map)
        # the robot stands and drives clear of the future border's area, so that the border does not lock it in
        area_distance = clearance_grid(area, clearance_map.grid.resolution)
        self._outside = area_distance >= clearance_map.radius + STOP_MARGIN
        self._touching = area_distance < clearance_map.radius
        drawn = drawing.chain
        if len(drawn) > 1:
            drawn = geometry.resample_chain(drawn, 0.1, drawing.closed)
        self._line = np.vstack([self._ahead, drawn])

    def is_suitable(self, pose: Pose) -> bool:
        """Returns whether a robot at a pose would see its target well enough and not be in the border's way."""
        return bool(self._are_suitable(np.array([pose[:2]]), np.array([pose[2]]))[0])

    def has_room_at(self, pose: Pose) -> bool:
        """Returns whether there is still room for the robot at a goal."""
        return bool(self.clearance_map.has_room_at(np.array([pose[:2]]))[0])

    def best_viewpoint(self, robot: Pose, avoid: Iterable[Circle] = ()) -> Optional[Viewpoint]:
        """Finds the cheapest reachable suitable pose, or None if there is none.

        The pose keeps the radius and a margin from obstacles and borders. It is not on the drawn line, its
        extrapolation or the seed's side. If possible, pose and path avoid the area that the border will probably
        restrict. The robot's own position, at which it only turns, is a candidate too. If there is no such pose while
        the robot is on the seed's side, returns the nearest pose off that side.

        Args:
            avoid: circles around positions that failed.
        """
        positions, yaws, distances = self._candidates(robot, avoid)
        costs = self._costs(robot, positions, yaws, distances)
        if not np.isfinite(costs).any():
            return self._retreat(robot)
        best = int(np.argmin(costs))
        yaw = geometry.wrap_angle(float(yaws[best]))
        return Viewpoint((*positions[best].tolist(), yaw), float(costs[best]))

    def _candidates(self, robot: Pose, avoid: Iterable[Circle]) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns the suitable poses that have room: positions (N, 2) [m], yaws (N,) [rad], distances (N,) [m]."""
        positions, yaws, distances = _poses_around(self.target_point, robot)
        keep = self.view.sees(np.column_stack([distances, np.zeros_like(distances)]), IMAGE_MARGIN)
        keep &= self.clearance_map.has_room_at(positions)
        min_gap = 2.0 * self.clearance_map.radius + STOP_MARGIN
        robot_circles = [(x, y, min_gap) for x, y in self._others]
        for x, y, radius in [*robot_circles, *avoid]:
            keep &= np.hypot(positions[:, 0] - x, positions[:, 1] - y) >= radius
        keep[keep] = self._are_suitable(positions[keep], yaws[keep])
        return positions[keep], yaws[keep], distances[keep]

    def _costs(self, robot: Pose, positions: np.ndarray, yaws: np.ndarray, distances: np.ndarray) -> np.ndarray:
        """Returns what each candidate costs, (N,) [m] of path; inf if the robot must not drive there."""
        offsets = positions - robot[:2]
        moves = np.hypot(*offsets.T)
        lengths = self.clearance_map.path_lengths(robot[:2], positions, self._others)
        crossing = self._cross_area(robot, positions, lengths)
        lengths[moves < 1e-6] = 0.0
        # the robot first turns towards the position, and there to the yaw; if it is there already, only to the yaw
        heading = np.where(moves < 0.1, robot[2], np.arctan2(offsets[:, 1], offsets[:, 0]))
        turns = np.array([heading - robot[2], yaws - heading])
        turns = np.abs(np.arctan2(np.sin(turns), np.cos(turns)))
        turn_costs = TURN_COST * turns.sum(axis=0)
        distance_costs = DISTANCE_COST * np.abs(distances - BEST_DISTANCE)
        unseen_costs = UNSEEN_COST * (1.0 - self._seen(self._ahead, positions, yaws).mean(axis=1))
        # while the seed is shown, the border may be saved at any moment; so a robot waits if it is not needed
        waits = self.drawing.marks_side and self.drawing.seen_by_stationary
        crossing_cost = np.inf if waits else LOCKED_COST
        crossing_costs = np.where(crossing, crossing_cost, 0.0)
        locked_costs = LOCKED_COST * ~self._is_outside(positions)
        return lengths + turn_costs + distance_costs + unseen_costs + (crossing_costs + locked_costs)

    def _cross_area(self, robot: Pose, positions: np.ndarray, lengths: np.ndarray) -> np.ndarray:
        """Returns (N,) bool: whether the shortest path to each position, of length (N,) [m], crosses the expected area.

        Navigation does not know the border before it is saved. A robot that is on the area must leave it in any case.
        """
        is_touching = sample(self.clearance_map.grid, self._touching, np.array([robot[:2]]))[0]
        if is_touching or not self._touching.any():
            return np.zeros(len(positions), dtype=bool)
        detours = self.clearance_map.path_lengths(robot[:2], positions, self._others, self._touching)
        return detours > lengths + 1e-6

    # ------------------------------------------------------------- one test for all poses
    def _are_suitable(self, positions: np.ndarray, yaws: np.ndarray) -> np.ndarray:
        """Returns (N,) bool: which poses see all they must, and are neither on the line nor on the seed's side."""
        drawing = self.drawing
        required = [self.target_point] if drawing.seen_by_stationary else [self.target_point, drawing.spot]
        keep = self._seen(np.array(required), positions, yaws, SEEN_MARGIN).all(axis=1)
        gaps = np.linalg.norm(positions[:, None, :] - self._line[None, :, :], axis=2).min(axis=1)
        keep &= gaps >= self.clearance_map.radius + LINE_MARGIN
        if drawing.marks_side:
            keep &= self._is_outside(positions)
        keep[keep] = self.clearance_map.has_line_of_sight(positions[keep], self.target_point)
        return keep

    def _is_outside(self, positions: np.ndarray) -> np.ndarray:
        """Returns (N,) bool: which positions (N, 2) [m] are probably outside the area that the border will restrict."""
        return sample(self.clearance_map.grid, self._outside, positions, outside=1.0) > 0

    def _seen(self, points: np.ndarray, positions: np.ndarray, yaws: np.ndarray, margin: float = 0.0) -> np.ndarray:
        """Returns (N, K) bool: which points (K, 2) [m] are in the image from each pose."""
        x, y = (points[:, None] - positions).T  # (N, K) each, from a pose to a point, map frame
        cosines = np.cos(yaws)[:, None]
        sines = np.sin(yaws)[:, None]
        ahead = x * cosines + y * sines
        left = y * cosines - x * sines
        in_base = np.column_stack([ahead.ravel(), left.ravel()])
        return self.view.sees(in_base, margin).reshape(ahead.shape)

    def _retreat(self, robot: Pose) -> Optional[Viewpoint]:
        """Returns the nearest pose off the side that the seed marks, if the robot is on it."""
        clearance_map, spot = self.clearance_map, self.drawing.spot
        if not self.drawing.marks_side or self._is_outside(np.array([robot[:2]]))[0]:
            return None
        has_room = clearance_map.clearance >= clearance_map.radius + STOP_MARGIN
        cells = np.argwhere(self._outside & has_room)
        positions = clearance_map.grid.cell_to_world(cells)
        lengths = clearance_map.path_lengths(robot[:2], positions, self._others)
        if not np.isfinite(lengths).any():
            return None
        best = int(np.argmin(lengths))
        x, y = spot - positions[best]
        yaw = math.atan2(y, x)
        return Viewpoint((*positions[best].tolist(), yaw), float(lengths[best]), sees_spot=False)


def _poses_around(target_point: np.ndarray, robot: Pose) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns positions (N, 2) [m], yaws (N,) [rad], distances (N,) [m] of poses facing a point, even the robot's."""
    x, y = target_point - robot[:2]
    robot_distance = float(np.hypot(x, y))
    robot_yaw = math.atan2(y, x)
    # the bearings start at the robot's own, so that a robot that only has to come nearer does not drive round the point
    bearings = np.arange(BEARINGS) * (2.0 * math.pi / BEARINGS) + robot_yaw
    distance = np.tile(np.linspace(MIN_DISTANCE, MAX_DISTANCE, DISTANCES), BEARINGS)
    yaw = np.repeat(bearings, DISTANCES)
    if 0.8 * MIN_DISTANCE <= robot_distance <= 1.3 * MAX_DISTANCE:
        # turning is quicker than driving to a slightly better position
        distance = np.append(distance, robot_distance)
        yaw = np.append(yaw, robot_yaw)
    directions = np.column_stack([np.cos(yaw), np.sin(yaw)])
    return target_point - distance[:, None] * directions, yaw, distance
