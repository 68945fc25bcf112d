"""What drives one robot in a run: navigation's goals, or the spot that it follows. The parts are the live nodes'."""
from __future__ import annotations

from collections import deque
from typing import Any, Deque, Mapping, Optional, Tuple

import numpy as np

from vb_core import geometry
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_robot.dispatch import GoalStatus
from vb_robot.dispatcher import RobotStatus
from vb_robot.guiding import Frames, Guiding, GuidingParams
from vb_robot.safety import ForbiddenGround, SafetyParams, free_by_scan
from vb_robot.servoing import Servo, ServoParams
from vb_robot.sightings import Sighting
from vb_robot.view import FloorView, ViewParams
from vb_sim.lab import Lab
from vb_sim.navigator import Navigator
from vb_sim.robot_body import Pose


class PoseHistory:
    """Where odometry and localisation have put a robot lately, as tf remembers it."""

    def __init__(self, span: int = 200) -> None:
        self._entries: Deque[Tuple[float, Pose, Pose]] = deque(maxlen=span)

    def add(self, now: float, odometry: Pose, estimate: Pose) -> None:
        """Takes the newest poses."""
        self._entries.append((now, odometry, estimate))

    def at(self, stamp: float) -> Tuple[Pose, Pose]:
        """(odometry, estimate) at a time [s], interpolated."""
        entries = self._entries
        if stamp >= entries[-1][0]:
            return entries[-1][1], entries[-1][2]
        index = len(entries) - 1
        while index > 0 and entries[index - 1][0] > stamp:
            index -= 1
        later, earlier = entries[index], entries[max(index - 1, 0)]
        span = later[0] - earlier[0]
        share = min(max((stamp - earlier[0]) / span, 0.0), 1.0) if span > 0 else 0.0
        return _between(earlier[1], later[1], share), _between(earlier[2], later[2], share)

    def estimate(self, stamp: float) -> Pose:
        """The pose (x, y, yaw) in the map frame at a time [s]."""
        return self.at(stamp)[1]

    def map_to_odom(self, stamp: float) -> np.ndarray:
        """T_map_odom, 4x4, at a time [s]."""
        odometry, estimate = self.at(stamp)
        return geometry.pose2d_transform(*estimate) @ geometry.invert(geometry.pose2d_transform(*odometry))


def _between(a: Pose, b: Pose, share: float) -> Pose:
    turn = geometry.wrap_angle(b[2] - a[2])
    return a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), geometry.wrap_angle(a[2] + share * turn)


class DrivenRobot:
    """One robot of a run, as its navigation and its robot_guide drive it.

    Args:
        index: of the robot in the world.
        camera: name of its camera in the spots.
        follow: whether it follows the spot while a border is drawn: "auto", "true" or "false".
        settings: robot_guide's parameters.
    """

    def __init__(
        self,
        index: int,
        lab: Lab,
        poses: PoseHistory,
        navigator: Navigator,
        camera: str,
        follow: str,
        grid: GridMap,
        settings: Mapping[str, Any],
    ) -> None:
        self._index, self._lab, self._body = index, lab, lab.robots[index]
        self._poses, self._navigator = poses, navigator
        self._safety = SafetyParams.from_mapping(settings.get("safety"), "safety")
        view = FloorView(ViewParams.from_mapping(settings.get("view"), "view"))
        servo = Servo(ServoParams.from_mapping(settings.get("servo"), "servo"), self._safety, view)
        self._guiding = Guiding(GuidingParams(camera, (camera,), settings["auto_wait"]), follow, servo)
        self._ground = ForbiddenGround(grid, self._safety)
        self._obstacles = np.zeros((0, 2))  # robot's frame, from the newest scan
        self._goal: Optional[Pose] = None
        self._goal_status = GoalStatus.NONE
        self.goals = 0

    def set_map(self, grid: GridMap) -> None:
        """Takes the map with borders."""
        self._navigator.set_map(grid)
        self._ground = ForbiddenGround(grid, self._safety)

    def set_state(self, state: int, interaction_id: str, entered: float) -> None:
        """Takes the interaction's state."""
        self._guiding.set_state(state, interaction_id, entered)

    def add(self, sighting: Sighting) -> None:
        """Takes a spot of any camera."""
        self._guiding.add(sighting)

    def scan(self, now: float) -> None:
        """Looks round, if somebody wants to know."""
        if self.driving or self._guiding.wanted(now):
            angles, ranges = self._lab.scan(self._index)
            hit = np.isfinite(ranges)
            self._obstacles = ranges[hit, None] * np.column_stack([np.cos(angles[hit]), np.sin(angles[hit])])

    # ------------------------------------------------------------- goals
    @property
    def driving(self) -> bool:
        """Whether it is on its way to a goal."""
        return self._goal_status is GoalStatus.ACTIVE

    def status(self, now: float) -> RobotStatus:
        """How the dispatcher sees it."""
        place = self._goal[:2] if self.driving and self._goal is not None else None
        return RobotStatus(self._poses.estimate(now), True, self._goal_status, False, place)

    def send(self, pose: Pose) -> None:
        """Begins a new goal."""
        self._navigator.begin(pose)
        self._goal, self._goal_status = pose, GoalStatus.ACTIVE
        self.goals += 1

    def cancel(self) -> None:
        """Calls the goal off."""
        if self.driving:
            self._end(GoalStatus.NONE)

    def navigate(self, now: float, dt: float) -> None:
        """One step of the controller."""
        if not self.driving:
            return
        try:
            drive = self._navigator.step(now, self._poses.estimate(now), self._obstacles, dt)
        except CodedError:
            self._end(GoalStatus.FAILED)
            return
        if drive.arrived:
            self._end(GoalStatus.REACHED)
            return
        self._body.command(drive.speed, drive.turn_rate, now)

    def _end(self, status: GoalStatus) -> None:
        self._goal_status = status
        self._navigator.halt()
        self._body.command(0.0, 0.0, self._lab.now)

    # ------------------------------------------------------------- following the spot
    def follow(self, now: float, dt: float) -> None:
        """One step of visual servoing, if it is to follow."""
        was = self._guiding.active
        motion = self._guiding.step(now, dt, self._frames(now), self._free_way)
        if self._guiding.active and not was:
            # two drivers at one wheel: the person leads now
            self.cancel()
        if motion is not None:
            self._body.command(motion.v, motion.w, now)

    def _frames(self, now: float) -> Frames:
        odometry = self._poses.at(now)[0]
        return Frames(
            lambda stamp: geometry.invert(self._poses.map_to_odom(stamp)),
            lambda: geometry.invert(geometry.pose2d_transform(*odometry)),
        )

    def _free_way(self, v: float, w: float) -> float:
        pose = self._poses.estimate(self._lab.now)
        return min(self._ground.free_way(pose, v, w), free_by_scan(self._obstacles, v > 0, self._safety))
