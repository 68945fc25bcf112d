"""Arbitrates between the sources that request motion of one robot.

At most one source drives at a time, and every command passes one gate, `CommandGate`. In doubt the robot stops, and a
code says why. In order of priority, the sources are: a stop, which is in force until resume; teleoperation; following
the spot; escape from a border or obstacle that is too near; navigation.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from typing import Dict, Iterable, Optional, Tuple

import numpy as np

from vb_core.interaction_tables import DEFAULT, State
from vb_core.robot_profile import RobotProfile
from vb_core.stop_latch import HeldStops
from vb_robot.driving.escape import Escape
from vb_robot.driving.command_gate import ESCAPE, FOLLOW, INPUT_TIMEOUT, NAVIGATION, NONE, STOP, TELEOP, CommandGate
from vb_robot.driving.rotation_shim import RotationShim
from vb_robot.driving.spot_follower import SpotFollower
from vb_robot.driving.velocity import VelocityRequest
from vb_robot.spot_sightings import Sighting, SpotSightings

START_ZEROS = 3.0  # [s] of zero commands to a new subscriber: a base may still execute a crashed driver's command
GOAL_TIMEOUT = 1.0  # [s] without a report of a goal after which it counts as ended; navigation sends five a second
CANCEL_PERIOD = 1.0  # [s] between cancellations of navigation's goals while the robot follows the spot
MAX_STANDING_TURN_RATE = 0.1  # [rad/s] of a robot that counts as standing; navigation's slowest turn is twice as fast


@dataclass(frozen=True)
class DriveCommand:
    """The current command to the wheels.

    It is not always published: while no source drives, only refusals are published, and zeros after the last source and
    for a new subscriber.
    """

    v: float = 0.0  # [m/s]
    w: float = 0.0  # [rad/s]
    source: str = NONE  # "none", "stop", "teleop", "follow", "escape" or "navigation"
    code: str = "idle"  # "driving", or the reason why the robot stops or slows down
    publish: bool = False  # whether to publish it
    cancel: bool = False  # whether to cancel navigation's goals


class Arbiter:
    """Chooses the source that drives a robot, and passes its requests through the gate.

    Several threads may provide inputs; only one may call `step`.

    Args:
        camera: the name of the robot's camera, as in a `Sighting`.
        mobile_cameras: the names of all cameras on robots.
        stops: the stops in force from before this program started.

    Attributes:
        gate: limits every command. It is given the inputs that determine how fast the robot may drive.
        follower: requests the motion that follows the spot.
        stops: the stops in force, during which no other source drives.
    """

    def __init__(
        self,
        profile: RobotProfile,
        camera: str = "robot",
        mobile_cameras: Iterable[str] = (),
        stops: Optional[HeldStops] = None,
    ) -> None:
        self.gate = CommandGate(profile)
        self._lock = threading.Lock()
        self._camera = camera
        self.follower, self._escape = SpotFollower(), Escape(profile.radius)
        self._rotation_shim = RotationShim()
        self._goal_at = -math.inf  # [s] when navigation last reported a goal
        self._zeros_until = -math.inf  # [s] until which new subscribers are sent zero commands
        self._listeners = 0
        self._spots = SpotSightings(mobile_cameras=(*mobile_cameras, camera))
        self.stops = stops or HeldStops()
        self._cancelled_at = -math.inf
        self._commands: Dict[str, VelocityRequest] = {}
        self._last = DriveCommand()

    # ------------------------------------------------------------- inputs
    def set_state(self, state: State, interaction: str, entered: float, stamp: float) -> None:
        """Stores the interaction's state, which was published at time `stamp` [s]."""
        with self._lock:
            self._spots.set_state(state, interaction, entered)
            self.gate.record_input("state", stamp)

    def add(self, sighting: Sighting) -> None:
        """Adds a sighting of any camera."""
        with self._lock:
            counts = self._spots.add(sighting)
            # the robot follows only its own camera's spots, because those of other cameras may arrive in another order
            if counts and sighting.mobile and sighting.camera == self._camera:
                self.follower.spot = sighting.position
                self.gate.stamps["spot"] = sighting.stamp

    def add_contributors(self, interaction: str, cameras: Iterable[str]) -> None:
        """Adds cameras that contributed to an interaction, even before this program started."""
        with self._lock:
            self._spots.add_contributors(interaction, cameras)

    def set_goal_active(self, active: bool, now: float) -> None:
        """Stores whether navigation has a goal, according to its status at time `now` [s]."""
        self._goal_at = now if active else -math.inf

    def recover(self, now: float) -> None:
        """Records that navigation began a recovery."""
        with self._lock:
            self._rotation_shim.recover(now)

    def set_path(self, path: np.ndarray) -> None:
        """Stores navigation's newest path (N, 2) [m], map frame."""
        with self._lock:
            self._rotation_shim.path = path

    def request(self, source: str, v: float, w: float, now: float) -> None:
        """Stores a command of navigation or teleoperation [m/s, rad/s]."""
        self._commands[source] = VelocityRequest(v, w)
        self.gate.stamps[source] = now

    # ------------------------------------------------------------- commands
    def halt(self, code: str) -> DriveCommand:
        """Stops the robot despite any request, because the program has a fault."""
        with self._lock:
            self._last = DriveCommand(0.0, 0.0, self._last.source, code, publish=True)
            return self._last

    def step(self, now: float, listeners: int = 1) -> DriveCommand:
        """Computes the command at time `now` [s] for this number of subscribers. Call it at `command_gate.RATE`."""
        with self._lock:
            if listeners > self._listeners:
                self._zeros_until = now + START_ZEROS
            self._listeners = listeners
            has_goal = 0.0 <= now - self._goal_at <= GOAL_TIMEOUT
            source, request = self._choose(now, has_goal)
            if source in (STOP, TELEOP, FOLLOW):
                self._escape.interrupt(now)
            v, w, code = self.gate.limit(now, source, request)
            was_cancelled = 0.0 <= now - self._cancelled_at < CANCEL_PERIOD
            cancel = has_goal and source == FOLLOW and not was_cancelled
            if cancel:
                self._cancelled_at = now
            if source != NONE:
                self._zeros_until = now
            # one zero command follows when the last source stops driving; while a stop is in force, zeros are repeated
            is_driven = source != NONE or self._last.source != NONE
            is_refusal = code != request.code
            publish = is_driven or is_refusal or now < self._zeros_until
            self._last = DriveCommand(v, w, source, code, publish, cancel)
            return self._last

    def _choose(self, now: float, has_goal: bool) -> Tuple[str, VelocityRequest]:
        """Chooses the source that drives. Returns it and its request."""
        if self.stops.stopped:
            return STOP, VelocityRequest(code="stopped")
        teleop = self._command(TELEOP, now)
        if teleop is not None:
            return TELEOP, teleop
        # if the state is lost while a person guides the robot, this remains the source, and the gate stops the robot
        if self._spots.should_follow(self._camera, now):
            return FOLLOW, self.follower.compute_request(self.gate.pose(now))
        request = self._compute_escape(now, has_goal)
        if request is not None:
            return ESCAPE, request
        navigation = self._command(NAVIGATION, now)
        if navigation is not None:
            return NAVIGATION, self._rotation_shim.align(navigation, self.gate.pose(now), now)
        return NONE, VelocityRequest(code="idle")

    def _command(self, source: str, now: float) -> Optional[VelocityRequest]:
        """Returns the newest command of navigation or teleoperation, or None if it is too old."""
        age = now - self.gate.stamps.get(source, -math.inf)
        return self._commands[source] if -0.1 <= age <= INPUT_TIMEOUT else None

    def _compute_escape(self, now: float, has_goal: bool) -> Optional[VelocityRequest]:
        pose = self.gate.pose(now)
        workspace = self.gate.workspace
        if pose is None or workspace is None:
            return None
        # navigation does not move the robot if the gate stopped its last command at a border or a wall
        last = self._last
        is_standing = last.v == 0.0 and abs(last.w) <= MAX_STANDING_TURN_RATE
        was_stopped = last.source == NAVIGATION and is_standing
        moves = not was_stopped and self._command(NAVIGATION, now) is not None
        has_undisturbed_goal = has_goal and self._spots.state == DEFAULT
        return self._escape.compute_request(now, pose, workspace, has_undisturbed_goal, moves)
