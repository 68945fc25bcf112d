"""One driver per robot: decides who drives it now, and whether it may.

The idea: several want to drive (a person with a joystick, the spot, the path out of a border, navigation), exactly one
does, and every command passes one gate. The gate lets through what it can show to be safe. In doubt the robot
stops, and the driver tells people by a code who drives and why.

Whatever the gate depends on has one age limit: STOP_WITHIN after the last message of any input the robot stops. The
older the oldest input, the slower the robot drives, so that its brakes keep that promise from any speed. A message that
is a little late, on a busy computer, slows the robot for a moment and does not stop it.

Who drives, in order of priority: stop (it holds until resume), teleoperation, following the spot, leaving a border, navigation.
"""
from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from typing import Dict, Iterable, Optional, Tuple

from vb_core.robot_profile import RobotProfile
from vb_robot.driving.border_exit import MAP_MARGIN, BorderExit
from vb_robot.driving.safety import MAX_POSE_JUMP, Clearance, Scan, SpeedLimits, pose_jump, safe_speed, stop_distance
from vb_robot.driving.spot_follower import MAX_SPEED, SpotFollower, VelocityRequest
from vb_robot.spots import DEFAULT, Sighting, Sightings
from vb_robot.driving.turn_finisher import TurnFinisher
from vb_robot.driving.workspace import BorderContact, Workspace
from vb_robot.poses import Pose

RATE = 20.0  # [1/s] how soon late messages are noticed
STOP_WITHIN = 0.5  # [s] after the last scan, state, pose or command the robot stops
BASE_DELAY = 0.02  # [s] from a command to the wheels
MAX_FUTURE_STAMP = 0.5  # [s] a stamp farther ahead comes from another clock, and its age is not known
POSE_JUMP_HOLD = 1.0  # [s] after a jump of the localisation it is not known where the borders are
OTHER_LIMIT = 1.0  # [s] after another node's command nothing is let through: two drivers at one wheel
CANCEL_EACH = 1.0  # [s] how often navigation's goals are cancelled while another one drives
BLIND_SPEED = 0.1  # [m/s] without a scanner, by the map alone, and for a joystick where no beam points
ACCELERATION, TURN_ACCELERATION = 0.4, 2.0  # [m/s^2, rad/s^2] of the driver's own behaviours: gentle beside people

NOBODY, STOP, TELEOP, FOLLOW, LEAVE, NAVIGATION = "nobody", "stop", "teleop", "follow", "leave", "navigation"
CLEARANCES = {
    TELEOP: Clearance(0.05, 0.02, 0.0),
    FOLLOW: Clearance(0.12, 0.04, 0.06),  # from where a person leaves it, navigation must still find a path
    LEAVE: Clearance(0.12, 0.04, MAP_MARGIN),
    NAVIGATION: Clearance(0.04, 0.0, -0.04),  # it keeps its own distance; here is only what must never happen
}


@dataclass(frozen=True)
class Command:
    """The command that goes to the wheels now.

    Attributes:
        v, w: [m/s, rad/s]
        driver: who drives: "nobody", "stop", "teleop", "follow", "leave" or "navigation".
        code: "drives", or what holds the robot.
        publish: whether to publish it: a robot that nobody drives is left alone.
        cancel: whether to cancel navigation's goals.
    """

    v: float = 0.0
    w: float = 0.0
    driver: str = NOBODY
    code: str = "idle"
    publish: bool = False
    cancel: bool = False


class Driver:
    """Drives one robot. Several threads may feed it; one calls `step`.

    Args:
        camera: name of the robot's camera in the spots; mobile_cameras: names of all cameras on robots.
        leaves: whether it leaves a border that was saved where it is.
        stopped: whether it was stopped when this program ended last; holds until released, as a stop of the topic.

    Attributes:
        follower, exit: the behaviours that are the driver's own.
        workspace: the maps; None before there are any. speed_limits: where there are slow zones.
        contacts: by bumper or cliff sensor whether it is touched.
        goal_runs: whether navigation has a goal.
        clock_age: [s] of real time for which the clock has stood still: messages age without it.
    """

    def __init__(
        self, profile: RobotProfile, camera: str = "robot", mobile_cameras: Iterable[str] = (), leaves: bool = True,
        stopped: bool = False,
    ) -> None:
        self.profile, self._camera = profile, camera
        self.follower, self.exit = SpotFollower(), BorderExit(profile.radius, leaves)
        self._turn_finisher = TurnFinisher()
        self.workspace: Optional[Workspace] = None
        self.speed_limits: Optional[SpeedLimits] = None
        self.contacts: Dict[str, bool] = {}
        self.goal_runs = False
        self._lock = threading.RLock()
        self._spots = Sightings(mobile_cameras=(*mobile_cameras, camera))
        self._stamps: Dict[str, float] = {}  # [s] of the newest scan, state, pose and command
        self.clock_age = 0.0
        self._stopped = {"state": False, "topic": stopped}
        self._stopped_at = -math.inf  # [s] when the topic stopped it last
        self._scan: Optional[Scan] = None
        self._pose: Optional[Tuple[float, Pose]] = None
        self._correction = 0.0, -math.inf  # its date, and when that was new [s]
        self._jump_hold_until = self._cancelled_at = -math.inf
        self._other_publishers: Dict[str, float] = {}  # who else commanded this robot, and when
        self._commands: Dict[str, VelocityRequest] = {}
        self._last = Command()
        self._stepped_at: Optional[float] = None

    # ------------------------------------------------------------- inputs
    def set_state(self, state: int, interaction: str, entered: float, stamp: float, stopped: bool = False) -> None:
        """Takes the interaction's state, said at a time [s]."""
        with self._lock:
            if self._spots.set_state(state, interaction, entered):
                self.follower.clear()
            self._note("state", stamp)
            # `resume` releases both, but not a stop that is newer than it: the two topics have no common order
            if self._stopped["state"] and not stopped and stamp >= self._stopped_at:
                self._stopped["topic"] = False
            self._stopped["state"] = stopped

    def set_stop(self, stopped: bool, now: float) -> None:
        """Takes a message of the stop topic that comes at a time [s].

        A stop holds until this topic releases it, or a later state that is not stopped after one that was. An
        interaction manager that starts again and knows of no stop releases none.
        """
        with self._lock:
            self._stopped["topic"] = stopped
            if stopped:
                self._stopped_at = now

    @property
    def stopped(self) -> bool:
        """Whether a stop holds."""
        return any(self._stopped.values())

    def add(self, sighting: Sighting) -> None:
        """Takes a spot of any camera."""
        with self._lock:
            self._spots.add(sighting)
            if sighting.mobile and sighting.camera == self._camera and self._spots.newest() is sighting:
                self.follower.add(sighting)

    def add_contributors(self, interaction: str, cameras: Iterable[str]) -> None:
        """Learns which cameras contributed to an interaction, for instance before this program started."""
        with self._lock:
            if interaction == self._spots.key[0]:
                self._spots.add_contributors(cameras)

    def set_scan(self, scan: Scan, stamp: float) -> None:
        """Takes a scan of a time [s]."""
        with self._lock:
            self._scan = scan
            self._note("scan", stamp)

    def set_pose(self, pose: Optional[Pose], stamp: float, correction: float = 0.0) -> None:
        """Takes where the robot was (x, y, yaw), map frame, at a time [s]; None: it is not known.

        Args:
            correction: date [s] of the newest correction that localisation has made to odometry; 0: there is none to be
                expected. AMCL dates its corrections ahead, so that what counts is when the date changes.
        """
        with self._lock:
            if correction != self._correction[0]:
                self._correction = correction, stamp
            stamp = min(stamp, self._correction[1]) if correction else stamp
            before = self._pose
            self._pose = (stamp, pose) if pose is not None else None
            if pose is None:
                self._stamps.pop("pose", None)
            elif before is None or stamp != before[0]:
                self._note("pose", stamp)  # the same one again is as old as before
            if pose is None or before is None:
                return
            seconds = stamp - before[0]
            # after a pause a robot may be anywhere
            if 0.0 <= seconds < 1.0 and pose_jump(before[1], pose, seconds) > MAX_POSE_JUMP:
                self._jump_hold_until = stamp + POSE_JUMP_HOLD

    def set_maps(self, workspace: Workspace) -> None:
        """Takes new maps."""
        with self._lock:
            self.workspace = workspace
            self.exit.set_maps(workspace)

    def request(self, driver: str, v: float, w: float, now: float) -> None:
        """Takes a command of navigation or teleoperation [m/s, rad/s]."""
        self._commands[driver], self._stamps[driver] = VelocityRequest(v, w), now

    def note_other_publisher(self, name: str, now: float) -> None:
        """Notes that another node has commanded this robot's base."""
        self._other_publishers[name] = now

    # ------------------------------------------------------------- outputs
    @property
    def other_publishers(self) -> str:
        """Who else commanded the robot lately."""
        return ", ".join(sorted(self._other_publishers))

    def pose(self, now: float) -> Optional[Pose]:
        """Returns the robot's pose; None if it is unknown, or has just jumped."""
        if self._jump_hold_until > now + POSE_JUMP_HOLD:
            self._jump_hold_until = -math.inf  # time has jumped back
        if self._pose is None or self._age(now, "pose") > STOP_WITHIN or now < self._jump_hold_until:
            return None
        return self._pose[1]

    def halt(self, code: str) -> Command:
        """Stops the robot, whatever is requested: the program has a fault."""
        with self._lock:
            self._last = Command(0.0, 0.0, self._last.driver, code, True)
            return self._last

    def step(self, now: float) -> Command:
        """Decides the command for a time [s]; called once in 1 / RATE."""
        with self._lock:
            dt = 0.0 if self._stepped_at is None else min(max(now - self._stepped_at, 0.0), 0.2)
            self._stepped_at = now
            driver, request = self._choose(now, dt)
            if driver not in (LEAVE, NOBODY):
                self.exit.pause()
            if driver != FOLLOW:
                self.follower.stop()
            v, w, code = self._gate(now, driver, request)
            cancel = self.goal_runs and driver == FOLLOW and not 0.0 <= now - self._cancelled_at < CANCEL_EACH
            if cancel:
                self._cancelled_at = now
            # a robot that nobody drives any more is told once to stop, and one that stops on command all the time
            publish = driver != NOBODY or self._last.driver != NOBODY
            self._last = Command(v, w, driver, code, publish, cancel)
            return self._last

    def _choose(self, now: float, dt: float) -> Tuple[str, VelocityRequest]:
        """Chooses who drives; returns that one and its request."""
        if self.stopped:
            return STOP, VelocityRequest(0.0, 0.0, "stopped")
        teleop = self._command(TELEOP, now)
        if teleop is not None:
            return TELEOP, teleop
        # a robot that a person guides stays theirs when the state is lost: the gate then stops it
        if self._spots.follows(self._camera, now):
            return FOLLOW, self._ramped(dt, self.follower.compute_request(self.pose(now)))
        request = self._leave(now)
        if request is not None:
            return LEAVE, self._ramped(dt, request)
        navigation = self._command(NAVIGATION, now)
        if navigation is not None:
            return NAVIGATION, self._turn_finisher.finish(now, navigation, self.pose(now))
        return NOBODY, VelocityRequest(0.0, 0.0, "idle")

    def _command(self, driver: str, now: float) -> Optional[VelocityRequest]:
        return self._commands[driver] if -0.1 <= now - self._stamps.get(driver, -math.inf) <= STOP_WITHIN else None

    def _leave(self, now: float) -> Optional[VelocityRequest]:
        pose = self.pose(now)
        if pose is None:
            return None
        last = self._command(NAVIGATION, now)
        # a request that ends at a border moves nothing either, whatever navigation believes
        blocked = self._last.driver == NAVIGATION and self._last.code == "border" and self._last.v == 0.0
        moves = last is not None and (last.v != 0.0 or last.w != 0.0) and not blocked
        held = self._last.code if self._last.driver == LEAVE and self._last.code != "drives" else ""
        return self.exit.compute_request(now, pose, self._spots.state == DEFAULT, self.goal_runs, moves, held)

    def _ramped(self, dt: float, request: VelocityRequest) -> VelocityRequest:
        """Bounds the accelerations of a request; slowing down is bounded by the brake only."""
        brake = self.profile.limits.brake
        speed = ACCELERATION if abs(request.v) > abs(self._last.v) and request.v * self._last.v >= 0 else brake
        v = _towards(self._last.v, request.v, speed * dt)
        turn = TURN_ACCELERATION if abs(request.w) > abs(self._last.w) else 4.0 * TURN_ACCELERATION
        return VelocityRequest(v, _towards(self._last.w, request.w, turn * dt), request.code)

    # ------------------------------------------------------------- the gate
    def _gate(self, now: float, driver: str, request: VelocityRequest) -> Tuple[float, float, str]:
        """Returns what of a request is safe: (v, w, code)."""
        if driver in (NOBODY, STOP):
            return 0.0, 0.0, request.code
        if not (math.isfinite(request.v) and math.isfinite(request.w)):
            return 0.0, 0.0, "bad_command"
        v, w, code = self._slowed_by_floor(now, driver, request)
        share, late = self._slowed_by_age(now, driver, v, w)
        held = self._held(now, driver) or late
        return (0.0, 0.0, held) if held else (share * v, share * w, code)

    def _slowed_by_floor(self, now: float, driver: str, request: VelocityRequest) -> Tuple[float, float, str]:
        """Slows a request to what the floor ahead allows: (v, w, code)."""
        w = min(max(request.w, -self.profile.limits.max_turn), self.profile.limits.max_turn)
        if request.v == 0.0:
            return 0.0, w, request.code
        allowed, code = self._allowed(now, driver, request.v, w)
        if abs(request.v) <= allowed:
            return request.v, w, request.code
        if allowed < 0.02:
            # turning enters no new floor: the robot is round
            return 0.0, w, code
        # the same arc, more slowly: it is the one that was checked
        share = allowed / abs(request.v)
        return share * request.v, share * w, code

    def _slowed_by_age(self, now: float, driver: str, v: float, w: float) -> Tuple[float, str]:
        """Which part of a command the brakes can end before the oldest of its inputs is too old.

        Returns what was lost, as a code, if that is nothing; else "".
        """
        # a person with a joystick beside the robot may have come because all else is lost
        needs = ["scan"] if self.profile.scanner.present else []
        if driver != TELEOP:
            needs += ["state", "pose"]
        ages = {f"{what}_lost": self._age(now, what) for what in needs}
        if driver == FOLLOW and math.isfinite(self.follower.seen):
            self._stamps["spot"] = self.follower.seen
            ages["spot_gone"] = self._age(now, "spot")
        ages["drives"] = self._age(now, driver) if driver in self._commands else 0.0
        ages["clock_stopped"] = self.clock_age
        oldest = max(ages, key=lambda what: ages[what])
        # the command of this step holds until the next one, and the base takes a moment
        left = STOP_WITHIN - 1.0 / RATE - BASE_DELAY - ages[oldest]
        if left <= 0.0:
            return 0.0, oldest
        limits = self.profile.limits
        return min(1.0, left / max(abs(v) / limits.brake, abs(w) / limits.turn_acceleration, 1e-9)), ""

    def _note(self, what: str, stamp: float) -> None:
        """Notes that something has come that is dated so [s]; a date a little ahead makes it no younger than it is."""
        ahead = self._stepped_at is not None and self._stepped_at < stamp < self._stepped_at + MAX_FUTURE_STAMP
        self._stamps[what] = self._stepped_at if ahead and self._stepped_at is not None else stamp

    def _age(self, now: float, what: str) -> float:
        """Returns how old [s] the newest of something is; inf if it never came, or comes from another clock."""
        age = now - self._stamps.get(what, -math.inf)
        return age if age >= -MAX_FUTURE_STAMP else math.inf

    def _held(self, now: float, driver: str) -> str:
        """Why nothing may move, apart from what is too old, as a code; else empty."""
        self._other_publishers = {name: at for name, at in list(self._other_publishers.items()) if 0.0 <= now - at <= OTHER_LIMIT}
        if self._other_publishers:
            return "other_cmd_vel_publisher"
        if driver != TELEOP and now < self._jump_hold_until:
            return "pose_jumped"
        if driver != TELEOP and self.workspace is None:
            return "no_map"
        return ""

    def _allowed(self, now: float, driver: str, v: float, w: float) -> Tuple[float, str]:
        """The highest speed [m/s] on the arc of (v, w), and what limits it."""
        limits, clearance, radius = self.profile.limits, CLEARANCES[driver], self.profile.radius
        found = [(MAX_SPEED if driver in (FOLLOW, LEAVE) else limits.max_speed, "speed_limit")]
        if v > 0 and any(self.contacts.values()):
            found.append((0.0, "contact"))
        blind = self._scan is None or not self.profile.scanner.present
        if not blind:
            assert self._scan is not None
            found.append((safe_speed(self._scan.free_distance(v, w, radius, clearance), limits), "obstacle"))
            blind = not self._scan.sees_path(v, w, radius, stop_distance(v, limits))
            if blind and driver != TELEOP:
                found.append((0.0, "floor_not_scanned"))
        if blind:
            found.append((BLIND_SPEED, "floor_not_scanned"))
        pose, workspace = self.pose(now), self.workspace
        if pose is not None and workspace is not None:
            if driver == NAVIGATION and workspace.distance_to_keep_out(pose) <= 0.0:
                found.append((0.0, "inside_border"))
            free = workspace.free_distance(pose, v, w, clearance.cells, leaving=driver == LEAVE)
            found.append((safe_speed(free, limits), "border"))
        if pose is not None and self.speed_limits is not None:
            found.append((self.speed_limits.at(pose, v, w, stop_distance(v, limits)), "speed_zone"))
        return min(found, key=lambda entry: entry[0])

    # ------------------------------------------------------------- for people
    def border_contact(self, now: float) -> Tuple[BorderContact, str, bool]:
        """Returns whether the robot touches a border, the border's name, and whether it may not be entered at all."""
        pose, workspace = self.pose(now), self.workspace
        if pose is None or workspace is None:
            return BorderContact.FREE, "", False
        return workspace.contact_at(pose), workspace.name_at(pose[:2]), workspace.is_lethal(pose[:2])


def _towards(value: float, target: float, step: float) -> float:
    return min(max(target, value - step), value + step)
