"""Drives to a goal as move_base does, without ROS: plan, follow, plan again, give up."""

from __future__ import annotations

from dataclasses import replace
from typing import Optional

import numpy as np

from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.geometry import Pose, to_map
from vb_core.robot_profile import RobotProfile
from vb_sim.robot.costmap import Costmap
from vb_sim.robot.path_follower import Follower, Motion
from vb_sim.robot.path_planner import Planner

# names and figures are move_base's where it has them
_PLANNER_PERIOD = 1.0  # [s] after which the plan is renewed while driving; a new map renews it at once
_PLANNER_PATIENCE = 3.0  # [s] without any plan before a goal is aborted (move_base: 5 s and recoveries)
_CONTROLLER_PATIENCE = 15.0  # [s] for which the path may be blocked before a goal is aborted
_REPLAN_DISTANCE = 0.3  # [m] off the path at which a new one is planned
_OBSTACLE_RANGE = 2.5  # [m] up to which the scan marks obstacles
_MAP_TOLERANCE = 0.10  # [m] a scan point this near to a mapped obstacle is that obstacle: localisation is a few cm off


class Navigator:
    """Plans on the map with the virtual borders and follows the plan. Maps may be set from another thread."""

    def __init__(self, profile: RobotProfile) -> None:
        radius, limits = profile.radius, profile.limits
        self._radius = radius
        self._follower = Follower(radius, limits.max_speed, limits.max_turn_rate)
        self._planner: Optional[Planner] = None  # on the static map
        self._goal: Pose = (0.0, 0.0, 0.0)
        self._forget()

    def _forget(self) -> None:
        self._planned_at: Optional[float] = None
        self._last_plan_at: Optional[float] = None  # when there last was a plan
        self._last_moved_at: Optional[float] = None
        self._planned_on: Optional[Planner] = None
        self._failed = False

    # ------------------------------------------------------------ maps
    def set_map(self, grid: GridMap) -> Costmap:
        """Sets the static map, and returns its costs."""
        costmap = Costmap(grid, self._radius)
        self._planner = Planner(costmap)
        return costmap

    def static(self) -> Planner:
        """Returns the planner on the map alone; raises CodedError "no_map"."""
        if self._planner is None:
            raise CodedError("no_map")
        return self._planner

    def _with_obstacles(self, static: Planner, pose: Pose, seen: np.ndarray) -> Planner:
        """Makes the planner on map and scan; returns that on the map alone if the scan shows nothing new."""
        grid, distance = static.costmap.grid, static.costmap.distance
        seen = seen[np.hypot(seen[:, 0], seen[:, 1]) < _OBSTACLE_RANGE]
        cells = grid.world_to_cell(to_map(seen, pose))
        cells = cells[grid.contains_cells(cells)]
        # a wall seen slightly off its position is not a new obstacle
        cells = cells[distance[tuple(cells.T)] > _MAP_TOLERANCE]
        if not len(cells):
            return static
        mask = np.zeros(grid.shape, bool)
        mask[tuple(cells.T)] = True
        return Planner(Costmap(grid, self._radius, mask))

    # ------------------------------------------------------------ driving
    def begin(self, goal: Pose) -> None:
        """Sets a new goal (x, y, yaw) [m, m, rad], map frame; raises CodedError "no_map"."""
        self.static()  # checked before the robot's pose is asked for, which may be unknown too
        self._goal = goal
        self._follower.set_goal(goal)
        self._forget()

    def halt(self) -> None:
        """Records that another node stopped the robot."""
        self._follower.halt()

    def step(self, now: float, pose: Pose, obstacles: np.ndarray, dt: float) -> Motion:
        """Decides how to drive now.

        Args:
            now: [s]
            pose: (x, y, yaw) [m, m, rad], map frame.
            obstacles: (N, 2) [m] points that the scanner sees, robot's frame.
            dt: [s] since the last step.

        Raises:
            CodedError: why the goal cannot be reached.
        """
        static, path = self.static(), None
        due = self._planned_at is None or not 0.0 <= now - self._planned_at < _PLANNER_PERIOD
        if due or static is not self._planned_on:
            self._planned_at, self._planned_on = now, static
            path = self._replan(static, pose, obstacles, now)
        if self._failed:
            # do not drive on along a path that the map no longer allows
            self._follower.halt()
            return Motion()
        motion = self._follower.step(pose, obstacles, dt)
        if motion.arrived:
            return replace(motion, path=path)
        self._last_moved_at = now if self._last_moved_at is None or not motion.blocked else self._last_moved_at
        if now - self._last_moved_at >= _CONTROLLER_PATIENCE:
            raise CodedError("blocked", "something has been standing in the way for too long")
        if motion.off_path > _REPLAN_DISTANCE:
            self._planned_at = None
        return replace(motion, path=path)

    def _replan(self, static: Planner, pose: Pose, obstacles: np.ndarray, now: float) -> Optional[np.ndarray]:
        """Sets the follower's new path; raises CodedError if there has been none for too long."""
        start, end = np.array(pose[:2]), np.array(self._goal[:2])
        try:
            try:
                path = self._with_obstacles(static, pose, obstacles).plan(start, end)
            except CodedError:
                # perhaps a person is at the goal or beside the robot: plan on the map; the follower stops before them
                path = static.plan(start, end)
        except CodedError:
            self._failed = True
            self._last_plan_at = now if self._last_plan_at is None else self._last_plan_at
            if now - self._last_plan_at >= _PLANNER_PATIENCE:
                raise
            return None
        self._failed, self._last_plan_at = False, now
        self._follower.set_path(path)
        return path
