"""A test rig for the robot's driver: the pure parts of driver and navigation without nodes, whose inputs can be taken away."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Optional, Set

import numpy as np
import yaml

from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.robot_profile import RobotProfile
from vb_robot.dispatching.dispatch_policy import SentGoalState
from vb_robot.dispatching.dispatcher import RobotStatus
from vb_robot.driving.arbiter import Arbiter, Command
from vb_robot.driving.gate import NAVIGATION
from vb_robot.driving.safety import Scan
from vb_robot.driving.workspace import Workspace
from vb_robot.floor_view import FloorView
from vb_robot.spots import Sighting
from vb_sim.lab import Lab
from vb_sim.robot.costmap import CostmapParams
from vb_sim.robot.follower import FollowerParams
from vb_sim.robot.navigator import Navigator, NavigatorParams, params_for_robot
from vb_sim.robot.planner import PlannerParams
from vb_sim.robot.robot_body import Pose

NAVIGATION_HZ, SCAN_HZ = 10.0, 10.0
STATE_PERIOD = 0.1  # [s] the interaction manager repeats the state that often


class Every:
    """Says when something that happens at a rate is due."""

    def __init__(self, rate: float) -> None:
        self.period = 1.0 / rate
        self._next: Optional[float] = None

    def due(self, now: float) -> bool:
        if self._next is None:
            self._next = now
        if now < self._next - 1e-9:
            return False
        while self._next <= now + 1e-9:
            self._next += self.period
        return True


def standin_navigator(grid: GridMap, profile: RobotProfile) -> Navigator:
    """Makes what vb_sim's navigation node drives with."""
    path = Path(__file__).resolve().parents[2] / "src" / "vb_sim" / "config" / "navigation.yaml"
    settings = yaml.safe_load(path.read_text(encoding="utf-8"))
    costmap, follower = params_for_robot(
        profile,
        CostmapParams.from_mapping(settings.get("costmap"), "costmap"),
        FollowerParams.from_mapping(settings.get("follower"), "follower"),
    )
    planner = PlannerParams.from_mapping(settings.get("planner"), "planner")
    navigator = Navigator(NavigatorParams(), costmap, planner, follower)
    navigator.set_map(grid)
    return navigator


class DrivenRobot:
    """One robot of a run, as its navigation and its driver drive it.

    Args:
        index: of the robot in the world.
        camera: name of its camera in the spots.

    Attributes:
        lost: what has broken: "state" (the interaction manager is silent), "scan", "pose", "spots" (the detector),
            "driver" (its process), "network" (all that comes over it).
    """

    def __init__(
        self,
        index: int,
        lab: Lab,
        navigator: Navigator,
        camera: str,
        grid: GridMap,
        profile: RobotProfile,
        exit_borders: bool = False,
    ) -> None:
        self._index, self._lab, self._body = index, lab, lab.robots[index]
        self._navigator, self._profile = navigator, profile
        self._state = (0, "", 0.0)
        self._said_at = -math.inf
        self.arbiter = Arbiter(profile, camera, (camera,), exit_borders)
        robot = lab.world.robots[index]
        self.arbiter.follower.view = FloorView(robot.color_model(), robot.camera_mount(), profile.camera.max_range)
        self.arbiter.set_maps(Workspace(grid, None, profile.radius))
        self.lost: Set[str] = set()
        self.command = Command()
        self._obstacles = np.zeros((0, 2))  # robot's frame, from the newest scan
        self._goal: Optional[Pose] = None
        self._goal_status = SentGoalState.NONE
        self.goals = 0

    def set_map(self, grid: GridMap) -> None:
        """Takes the map with borders."""
        self._navigator.set_map(grid)
        self.arbiter.set_maps(Workspace(grid, None, self._profile.radius))

    def set_state(self, state: int, interaction_id: str, entered: float) -> None:
        """Takes the interaction's state."""
        self._state = (state, interaction_id, entered)
        self._said_at = -math.inf  # a change is said at once

    def add(self, sighting: Sighting) -> None:
        """Takes a spot of any camera."""
        if not self.lost & {"spots", "network"}:
            self.arbiter.add(sighting)

    def scan(self, now: float) -> None:
        """Looks round."""
        if "scan" in self.lost:
            return
        angles, ranges = self._lab.scan(self._index)
        hit = np.isfinite(ranges)
        self._obstacles = ranges[hit, None] * np.column_stack([np.cos(angles[hit]), np.sin(angles[hit])])
        model = self._lab.scan_model
        self.arbiter.gate.set_scan(
            Scan(
                ranges,
                angles[0],
                angles[1] - angles[0],
                self._lab.range_min(self._index),
                model.range_max,
                np.eye(4),
                self._profile.radius,
            ),
            now,
        )

    # ------------------------------------------------------------- goals
    @property
    def driving(self) -> bool:
        """Whether it is on its way to a goal."""
        return self._goal_status is SentGoalState.ACTIVE

    def status(self, now: float) -> RobotStatus:
        """Returns how the dispatcher sees it."""
        place = self._goal[:2] if self.driving and self._goal is not None else None
        return RobotStatus(self._body.estimate(), True, self._goal_status, False, place)

    def send(self, pose: Pose) -> None:
        """Begins a new goal."""
        self._navigator.begin(pose)
        self._goal, self._goal_status = pose, SentGoalState.ACTIVE
        self.goals += 1

    def cancel(self) -> None:
        """Cancels the goal."""
        if self.driving:
            self._end(SentGoalState.NONE)

    def navigate(self, now: float, dt: float) -> None:
        """Performs one step of the controller."""
        if not self.driving:
            return
        try:
            drive = self._navigator.step(now, self._body.estimate(), self._obstacles, dt)
        except CodedError:
            self._end(SentGoalState.FAILED)
            return
        if drive.arrived:
            self._end(SentGoalState.REACHED)
            return
        self.arbiter.request(NAVIGATION, drive.speed, drive.turn_rate, now)

    def _end(self, status: SentGoalState) -> None:
        self._goal_status = status
        self._navigator.halt()
        self.arbiter.request(NAVIGATION, 0.0, 0.0, self._lab.now)

    # ------------------------------------------------------------- who drives
    def drive(self, now: float) -> None:
        """Performs one step of the driver, which alone commands the base."""
        if "driver" in self.lost:
            return
        state, interaction_id, entered = self._state
        if not self.lost & {"state", "network"} and not 0.0 <= now - self._said_at < STATE_PERIOD - 1e-9:
            self._said_at = now
            self.arbiter.set_state(state, interaction_id, entered, now)
        if "pose" not in self.lost:
            self.arbiter.gate.set_pose(self._body.estimate(), now)
        self.arbiter.goal_active = self.driving
        self.command = command = self.arbiter.step(now)
        if command.cancel:
            self.cancel()
        if command.publish:
            self._body.command(command.v, command.w, now)
