"""What drives one robot in a run: navigation's goals, or the spot that it follows. The parts are the live nodes'."""
from __future__ import annotations

from collections import deque
from typing import Deque, Optional, Tuple

import numpy as np

from vb_core import geometry
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_robot import sightings
from vb_robot.dispatch import GoalStatus
from vb_robot.safety import ForbiddenGround, SafetyParams, free_by_scan
from vb_robot.servoing import Servo, ServoParams
from vb_robot.sightings import Sighting, Sightings
from vb_robot.view import FloorView, ViewParams
from vb_sim.navigator import Navigator
from vb_sim.robot_body import Pose, RobotBody

AUTO_WAIT = 1.0  # [s] robot_guide.yaml, auto_wait


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


class NavigatedRobot:
    """A robot and its stand-in for move_base: one goal at a time."""

    def __init__(self, body: RobotBody, poses: PoseHistory, navigator: Navigator) -> None:
        self._body, self._poses, self._navigator = body, poses, navigator
        self.status = GoalStatus.NONE
        self.goals = 0

    def send(self, pose: Pose) -> None:
        """Begins a new goal."""
        self._navigator.begin(pose)
        self.status = GoalStatus.ACTIVE
        self.goals += 1

    def cancel(self) -> None:
        """Calls the goal off."""
        if self.status is GoalStatus.ACTIVE:
            self._end(GoalStatus.NONE, None)

    @property
    def driving(self) -> bool:
        return self.status is GoalStatus.ACTIVE

    def _end(self, status: GoalStatus, now: Optional[float]) -> None:
        self.status = status
        self._navigator.halt()
        if now is not None:
            self._body.command(0.0, 0.0, now)

    def step(self, now: float, obstacles: np.ndarray, dt: float) -> None:
        """One step of the controller; obstacles (N, 2) [m] in the robot's frame."""
        if not self.driving:
            return
        try:
            drive = self._navigator.step(now, self._poses.estimate(now), obstacles, dt)
        except CodedError:
            self._end(GoalStatus.FAILED, now)
            return
        if drive.arrived:
            self._end(GoalStatus.REACHED, now)
            return
        self._body.command(drive.speed, drive.turn_rate, now)


class FollowingRobot:
    """A robot that follows the spot that its own camera sees, as robot_guide lets it."""

    def __init__(self, body: RobotBody, poses: PoseHistory, camera: str, follow: str, grid: GridMap) -> None:
        self._body, self._poses, self._camera, self._follow = body, poses, camera, follow
        safety = SafetyParams()
        self._servo = Servo(ServoParams(), safety, FloorView(ViewParams()))
        self._safety = safety
        self._ground = ForbiddenGround(grid, safety)
        self._sightings = Sightings(mobile_cameras=(camera,))
        self._spot: Optional[Tuple[float, np.ndarray]] = None  # stamp [s], (2,) [m] in the odom frame
        self.active = False

    def set_state(self, state: int, interaction_id: str, entered: float) -> None:
        """Takes the interaction's state."""
        if self._sightings.set_state(state, interaction_id, entered):
            self._spot = None

    def add(self, sighting: Sighting) -> None:
        """Takes a spot of any camera."""
        self._sightings.add(sighting)
        if sighting.camera == self._camera:
            to_odom = geometry.invert(self._poses.map_to_odom(sighting.stamp))
            self._spot = (sighting.stamp, geometry.apply(to_odom, np.array([*sighting.position, 0.0]))[:2])

    def wanted(self, now: float) -> bool:
        """Whether it is to follow now."""
        known = self._sightings
        if known.state == sightings.GUIDE:
            return True
        if known.state not in (sightings.BORDER, sightings.SEED) or self._follow == "false":
            return False
        if self._follow == "true":
            return True
        if known.stationary_seen or known.first_mobile is None:
            return False
        return now - known.first_mobile >= AUTO_WAIT

    def step(self, now: float, obstacles: np.ndarray, dt: float) -> bool:
        """One step; obstacles (N, 2) [m] in the robot's frame. Says whether it has just begun."""
        wanted = self.wanted(now)
        begun = wanted and not self.active
        if begun or (self.active and not wanted):
            self.active = wanted
            self._servo.reset()
            self._body.command(0.0, 0.0, now)
        if not self.active:
            return False
        pose = self._poses.estimate(now)
        spot, age = None, 0.0
        if self._spot is not None:
            stamp, place = self._spot
            base = geometry.pose2d_transform(*self._poses.at(now)[0])
            spot, age = geometry.apply(geometry.invert(base), np.array([*place, 0.0]))[:2], now - stamp

        def free_way(v: float, w: float) -> float:
            return min(self._ground.free_way(pose, v, w), free_by_scan(obstacles, v > 0, self._safety))

        motion = self._servo.step(dt, spot, age, free_way)
        self._body.command(motion.v, motion.w, now)
        return begun
