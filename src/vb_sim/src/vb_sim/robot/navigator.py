"""Plans, replans, follows and aborts as move_base does, without ROS."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Optional

import numpy as np

from vb_core import geometry
from vb_core.errors import CodedError
from vb_core.geometry import Pose, look_ahead, base_to_map
from vb_core.grid_map import GridMap
from vb_core.robot_profile import RobotProfile
from vb_sim.robot.path_planner import Costmap, Planner

# names and values as in move_base if it has the same parameter
_PLANNER_PERIOD = 1.0  # [s] between plans while driving; a new map triggers one at once
_PLANNER_PATIENCE = 3.0  # [s] without any plan before a goal is aborted (move_base: 5 s and recoveries)
_CONTROLLER_PATIENCE = 15.0  # [s] for which the path may be blocked before a goal is aborted
_REPLAN_DISTANCE = 0.3  # [m] from the path at which a new one is planned
_OBSTACLE_RANGE = 2.5  # [m] up to which the scan marks obstacles
_MAP_TOLERANCE = 0.10  # [m] from a mapped obstacle: a point so near is that obstacle, as localisation is a few cm off
# following a path
ACCELERATION, DECELERATION = 0.6, 0.5  # [m/s^2]; deceleration before the goal and obstacles
MAX_TURN_RATE = 1.2  # [rad/s]
_LOOKAHEAD = 0.35  # [m] of pure pursuit
# [rad] heading errors at which the robot turns in place, and at which it drives again
_TURN_IN_PLACE_ABOVE, _DRIVE_AGAIN_BELOW = 0.8, 0.3
_TURN_GAIN = 2.5  # [1/s] turn rate per heading error
# within these, the robot has arrived
GOAL_DISTANCE = 0.06  # [m]
GOAL_ANGLE = 0.08  # [rad]
_BRAKING_RANGE = 1.5  # [m] along the robot's arc, up to which obstacles count
_OBSTACLE_MARGIN = 0.03  # [m] clearance from obstacles that the scanner sees ahead


@dataclass(frozen=True)
class Motion:
    """The command for a step, to send as cmd_vel, and the state of the drive."""

    speed: float = 0.0  # [m/s]
    turn_rate: float = 0.0  # [rad/s]
    arrived: bool = False  # whether the robot is at the goal
    blocked: bool = False  # whether an obstacle is in the way
    off_path: float = 0.0  # [m] distance from the path
    path: Optional[np.ndarray] = None  # (N, 2) [m] the path planned since the last step, or None


class PathFollower:
    """Follows paths to one goal by pure pursuit, and turns in place where a path requires it.

    A new path does not reset its state.

    Args:
        profile: the robot's radius and limits.
        goal: (x, y, yaw) [m, m, rad].
    """

    def __init__(self, profile: RobotProfile, goal: Pose) -> None:
        self._radius = profile.radius
        self._max_speed = profile.limits.max_speed
        self._max_turn_rate = min(profile.limits.max_turn_rate, MAX_TURN_RATE)
        self._goal = goal
        self._path = np.zeros((0, 2))
        self._turning = False
        self._at_goal = False
        self._speed = 0.0

    def set_path(self, path: np.ndarray) -> None:
        """Sets the path (N, 2) [m], N >= 1, from about the robot's position to the goal."""
        self._path = np.asarray(path, dtype=float)

    def halt(self) -> None:
        """Records that the robot was stopped."""
        self._speed = 0.0

    def step(self, pose: Pose, obstacles: np.ndarray, dt: float) -> Motion:
        """Computes the next command.

        Args:
            pose: (x, y, yaw) [m, m, rad], map frame.
            obstacles: (N, 2) [m] points that the scanner sees, robot's frame.
            dt: [s] since the last step.
        """
        if not len(self._path):
            return Motion()
        to_end = math.dist(self._path[-1], pose[:2])
        # hysteresis, because turning in place shifts the estimated position by about a centimetre
        goal_distance = 3.0 * GOAL_DISTANCE if self._at_goal else GOAL_DISTANCE
        self._at_goal = to_end < goal_distance
        if self._at_goal:
            self._speed = 0.0
            error = geometry.wrap_angle(self._goal[2] - pose[2])
            if abs(error) < GOAL_ANGLE:
                return Motion(arrived=True)
            return Motion(0.0, self._turn_rate(error))
        target, off_path, remaining = look_ahead(self._path, pose[:2], _LOOKAHEAD)
        bearing = math.atan2(target[1] - pose[1], target[0] - pose[0])
        error = geometry.wrap_angle(bearing - pose[2])
        largest_error = _DRIVE_AGAIN_BELOW if self._turning else _TURN_IN_PLACE_ABOVE
        self._turning = abs(error) > largest_error
        if self._turning:
            self._speed = 0.0
            return Motion(0.0, self._turn_rate(error), off_path=off_path)
        distance = max(math.dist(target, pose[:2]), 1e-3)
        curvature = 2.0 * math.sin(error) / distance
        braking_speed = math.sqrt(2.0 * DECELERATION * max(remaining, 0.01))
        speed = min(self._max_speed, self._speed + ACCELERATION * dt, braking_speed)
        if abs(curvature) > 1e-6:
            speed = min(speed, self._max_turn_rate / abs(curvature))
        free_distance = self._free_distance(obstacles, curvature)
        safe_speed = math.sqrt(2.0 * DECELERATION * max(free_distance, 0.0))
        if safe_speed < 0.02:
            self._speed = 0.0
            # turning in place is safe for a round robot, and may free the path
            turn_rate = self._turn_rate(error) if abs(error) > 0.1 else 0.0
            return Motion(0.0, turn_rate, blocked=True, off_path=off_path)
        self._speed = max(min(speed, safe_speed), 0.03)
        return Motion(self._speed, self._speed * curvature, off_path=off_path)

    def _turn_rate(self, error: float) -> float:
        rate = max(min(_TURN_GAIN * error, self._max_turn_rate), -self._max_turn_rate)
        # real robots do not turn at lower rates
        return math.copysign(max(abs(rate), 0.15), error)

    def _free_distance(self, obstacles: np.ndarray, curvature: float) -> float:
        """Returns the distance [m] that the robot may drive along the arc before an obstacle; inf without one."""
        half_width = self._radius + _OBSTACLE_MARGIN
        along, across = geometry.arc_coordinates(obstacles, curvature)
        is_in_way = (along > 0.0) & (along < _BRAKING_RANGE) & (np.abs(across) < half_width)
        along = along[is_in_way]
        across = across[is_in_way]
        # the robot's disc, widened by the margin, touches a point before its centre is beside the point
        touching_distances = along - np.sqrt(half_width**2 - across**2)
        return float(touching_distances.min(initial=math.inf))


class Navigator:
    """Plans paths on the map with the virtual borders, and begins drives. Another thread may set maps."""

    def __init__(self, profile: RobotProfile) -> None:
        self._profile = profile
        self._planner: Optional[Planner] = None  # on the static map

    # ------------------------------------------------------------ maps
    def set_map(self, grid: GridMap) -> Costmap:
        """Sets the static map and returns its costs."""
        costmap = Costmap(grid, self._profile.radius)
        self._planner = Planner(costmap)
        return costmap

    def planner_on_map(self) -> Planner:
        """Returns the planner on the map alone. Raises CodedError "no_map"."""
        if self._planner is None:
            raise CodedError("no_map")
        return self._planner

    def add_obstacles(self, map_planner: Planner, pose: Pose, points: np.ndarray) -> Planner:
        """Creates a planner on the map and a scan's points (N, 2) [m], robot's frame; returns the map's if none is new."""
        grid, distance = map_planner.costmap.grid, map_planner.costmap.distance
        points = points[np.hypot(points[:, 0], points[:, 1]) < _OBSTACLE_RANGE]
        cells = grid.world_to_cell(base_to_map(points, pose))
        cells = cells[grid.contains_cells(cells)]
        # a wall seen slightly off its position is not a new obstacle
        cells = cells[distance[tuple(cells.T)] > _MAP_TOLERANCE]
        if not len(cells):
            return map_planner
        new_obstacles = np.zeros(grid.shape, bool)
        new_obstacles[tuple(cells.T)] = True
        return Planner(Costmap(grid, self._profile.radius, new_obstacles))

    def begin(self, goal: Pose) -> Drive:
        """Begins a drive to a goal (x, y, yaw) [m, m, rad], map frame. Raises CodedError "no_map"."""
        self.planner_on_map()  # checks for a map before the robot's pose is looked up, which may fail too
        return Drive(self, PathFollower(self._profile, goal), goal)


class Drive:
    """A drive to one goal (x, y, yaw) [m, m, rad], map frame, on the navigator's newest maps."""

    def __init__(self, navigator: Navigator, follower: PathFollower, goal: Pose) -> None:
        self._navigator = navigator
        self._follower = follower
        self._goal = np.array(goal[:2])
        self._planned_at: Optional[float] = None
        self._last_plan_at: Optional[float] = None  # when planning last succeeded
        self._last_free_at: Optional[float] = None  # when no obstacle was last in the way
        self._planned_on: Optional[Planner] = None
        self._failed = False

    def step(self, now: float, pose: Pose, obstacles: np.ndarray, dt: float) -> Motion:
        """Plans if due, and computes the next command.

        Args:
            now: [s]
            pose: (x, y, yaw) [m, m, rad], map frame.
            obstacles: (N, 2) [m] points that the scanner sees, robot's frame.
            dt: [s] since the last step.

        Raises:
            CodedError: says why the goal cannot be reached.
        """
        map_planner = self._navigator.planner_on_map()
        path = None
        is_due = self._planned_at is None or not 0.0 <= now - self._planned_at < _PLANNER_PERIOD
        if is_due or map_planner is not self._planned_on:
            self._planned_at = now
            self._planned_on = map_planner
            path = self._replan(map_planner, pose, obstacles, now)
        if self._failed:
            # stops, as the map may no longer permit the last path
            self._follower.halt()
            return Motion()
        motion = self._follower.step(pose, obstacles, dt)
        if self._last_free_at is None or not motion.blocked:
            self._last_free_at = now
        if now - self._last_free_at >= _CONTROLLER_PATIENCE:
            raise CodedError("blocked", "something has been standing in the way for too long")
        if motion.off_path > _REPLAN_DISTANCE:
            self._planned_at = None
        return replace(motion, path=path)

    def _replan(self, map_planner: Planner, pose: Pose, obstacles: np.ndarray, now: float) -> Optional[np.ndarray]:
        """Plans the follower's new path. Raises CodedError if planning has failed for too long."""
        start = np.array(pose[:2])
        try:
            try:
                path = self._navigator.add_obstacles(map_planner, pose, obstacles).plan(start, self._goal)
            except CodedError:
                # a person may be at the goal or beside the robot; plans without them, as the follower stops before them
                path = map_planner.plan(start, self._goal)
        except CodedError:
            self._failed = True
            self._last_plan_at = now if self._last_plan_at is None else self._last_plan_at
            if now - self._last_plan_at >= _PLANNER_PATIENCE:
                raise
            return None
        self._failed = False
        self._last_plan_at = now
        self._follower.set_path(path)
        return path
