"""The gate that every command passes: it limits each command to what is known to be safe, and says what limited it.

If anything that a command depends on is unknown, the robot stops, with a code that says why. All periodic inputs share
one age limit: INPUT_TIMEOUT (up to MAX_SLACK later for one slower than 10 Hz) after the last message of any of them,
the robot has stopped. The older the oldest input, the slower the robot drives, so that it can brake in time from any
speed. A message that is a little late, as on a busy computer, slows the robot for a moment but does not stop it.

Use it, with or without ROS, to make any source of velocities respect borders and a laser scanner: feed it every input,
and send what `limit` returns to the base.

>>> import numpy as np
>>> from vb_core.grid_map import GridMap
>>> gate, profile = Gate(RobotProfile()), RobotProfile()
>>> wish = VelocityRequest(0.3, 0.0, "driving")                               # [m/s], [rad/s]
>>> gate.limit(10.0, NAVIGATION, wish)                                        # nothing is known yet
(0.0, 0.0, 'no_map')
>>> floor = GridMap(np.zeros((100, 100), np.int8), resolution=0.05)           # 5 m x 5 m ...
>>> borders = floor.with_data(np.tile(np.int8([0] * 60 + [100] * 40), (100, 1)))    # ... restricted from x = 3 m on
>>> gate.workspace = Workspace(borders, floor, profile.radius)
>>> nothing_near = np.full(360, 8.0)                                          # ranges [m], all round
>>> gate.set_scan(Scan(nothing_near, -np.pi, np.radians(1.0), 0.1, 8.0, np.eye(4), profile.radius), stamp=10.0)
>>> gate.record_input("state", 10.0)
>>> gate.set_pose((2.0, 2.5, 0.0), stamp=10.0)
>>> gate.limit(10.0, NAVIGATION, wish), gate.limit(10.6, NAVIGATION, wish)    # at once, and 0.6 s later
((0.3, 0.0, 'driving'), (0.0, 0.0, 'scan_lost'))
"""

from __future__ import annotations

import math
import statistics
import threading
from collections import deque
from typing import Deque, Dict, Optional, Tuple

from vb_core.grid_map import GridMap
from vb_core.geometry import Pose
from vb_core.robot_profile import RobotProfile
from vb_robot.driving.safety import (
    MAX_POSE_JUMP,
    Clearance,
    Fix,
    Scan,
    limit_around,
    pose_jump,
    safe_speed,
    stop_distance,
)
from vb_robot.driving.spot_follower import MAX_SPEED, VelocityRequest
from vb_robot.driving.workspace import Workspace

RATE = 20.0  # [1/s] how often commands are limited, and late messages noticed
INPUT_TIMEOUT = 0.5  # [s] after the last scan, state, pose or command, and its slack, the robot has stopped
BASE_DELAY = 0.02  # [s] from a command to the wheels
MAX_FUTURE_STAMP = 0.5  # [s] a stamp farther ahead comes from another clock, and its age is not known
USUAL_PERIOD, MAX_SLACK = 0.1, 0.15  # [s] an input with a longer period may be older by the excess, up to MAX_SLACK
JUMP_WINDOW = 1.0  # [s] over which the localisation is compared with the odometry
POSE_JUMP_HOLD = 1.0  # [s] for which, after a jump of the localisation, it is not known where the borders are
OTHER_PUBLISHER_HOLD = 1.0  # [s] after another node's command nothing passes: two nodes must not drive one base
BLIND_SPEED = 0.1  # [m/s] without a scanner, by the map alone, and for a joystick where no beam points

OTHER_PUBLISHER = "other_cmd_vel_publisher"  # the code while another node could command the base
NONE, STOP, TELEOP, FOLLOW, ESCAPE, NAVIGATION = "none", "stop", "teleop", "follow", "escape", "navigation"
CLEARANCES = {
    TELEOP: Clearance(0.05, 0.02, 0.0),
    FOLLOW: Clearance(0.12, 0.04, 0.06),  # navigation must find a path from wherever a person leaves the robot
    ESCAPE: Clearance(0.12, 0.04, 0.05),
    NAVIGATION: Clearance(0.04, 0.0, -0.04),  # it keeps its own distance; these only rule out what must never happen
}


class Gate:
    """Limits one robot's commands by what is ahead of it and by the age of its inputs. Several threads may feed it.

    Attributes:
        workspace: the maps; None while they are not known.
        speed_limits: the map of the slow zones' limits, if there is one.
        contacts: for each (topic, sensor), which motion its contact forbids: "forward" or "all".
        pose_uncertain: whether the localisation itself says that the robot may be anywhere.
        registered: other nodes that could command this robot's base now.
        clock_age: [s] of real time since ROS's clock last moved; while it stands still, stamps do not show their age.
        stamps: [s] of the newest scan, state, pose and spot, and of each source's newest command, by name.
    """

    def __init__(self, profile: RobotProfile) -> None:
        self.profile = profile
        self.workspace: Optional[Workspace] = None
        self.speed_limits: Optional[GridMap] = None
        self.contacts: Dict[Tuple[str, int], str] = {}
        self.pose_uncertain = False
        self.registered: Tuple[str, ...] = ()
        self.clock_age = 0.0
        self.stamps: Dict[str, float] = {}
        self._lock = threading.RLock()
        self._scan: Optional[Scan] = None
        self._fixes: Deque[Fix] = deque(maxlen=64)
        self._pose_known = False  # whether the newest fix still holds
        self._periods: Dict[str, Deque[float]] = {}  # [s] between an input's newest messages
        self._correction = 0.0, -math.inf  # the newest one's stamp, and when that was new [s]
        self._jump_hold_until = -math.inf
        self._other_publishers: Dict[str, float] = {}  # other nodes that commanded this robot, and when [s]
        self._limited_at = -math.inf  # [s] the time of the last command

    # ------------------------------------------------------------- inputs
    def set_scan(self, scan: Scan, stamp: float) -> None:
        """Stores a scan taken at a time [s]."""
        with self._lock:
            self._scan = scan
            self.record_input("scan", stamp)

    def set_pose(
        self, pose: Optional[Pose], stamp: float, correction: float = 0.0, odometry: Optional[Pose] = None
    ) -> None:
        """Stores the robot's pose (x, y, yaw), map frame, at a time [s]; None: it is not known.

        Args:
            odometry: the pose in the odometry frame, if there is odometry.
            correction: stamp [s] of the newest correction that localisation has made to odometry; 0: none is to be
                expected. AMCL post-dates its corrections, so the time counts at which the stamp changes.
        """
        with self._lock:
            if correction != self._correction[0]:
                self._correction = correction, stamp
            stamp = min(stamp, self._correction[1]) if correction else stamp
            was_located, self._pose_known = self._pose_known, pose is not None
            if pose is None:
                self.stamps.pop("pose", None)
                return
            fixes, fix = self._fixes, Fix(stamp, pose, odometry)
            if not was_located or not fixes or stamp != fixes[-1].stamp:
                self.record_input("pose", stamp)  # a repeated pose is as old as before
            # the last fix stays, however old: even after a pause, the pose must agree with the odometry
            while len(fixes) > 1 and not stamp - JUMP_WINDOW <= fixes[0].stamp <= stamp:
                fixes.popleft()
            compared = {fixes[0], fixes[-1]} if fixes else ()
            if any(before.stamp <= stamp and pose_jump(before, fix) > MAX_POSE_JUMP for before in compared):
                self._jump_hold_until = stamp + POSE_JUMP_HOLD
                fixes.clear()
            fixes.append(fix)

    def record_input(self, what: str, stamp: float) -> None:
        """Records the stamp [s] of an input's newest message; a stamp slightly in the future counts as now."""
        with self._lock:
            if self._limited_at < stamp < self._limited_at + MAX_FUTURE_STAMP:
                stamp = self._limited_at
            if 0.0 < stamp - self.stamps.get(what, stamp) < 1.0:
                self._periods.setdefault(what, deque(maxlen=5)).append(stamp - self.stamps[what])
            self.stamps[what] = stamp

    def set_contact(self, sensor: Tuple[str, int], blocks: str) -> None:
        """Stores which motion the contact of one sensor of a topic forbids: "forward" or "all"; "": no contact."""
        with self._lock:
            self.contacts.pop(sensor, None)
            if blocks:
                self.contacts[sensor] = blocks

    def record_other_publisher(self, name: str, now: float) -> None:
        """Records that another node has commanded this robot's base."""
        self._other_publishers[name] = now

    # ------------------------------------------------------------- what is known
    def other_publishers(self, now: float) -> str:
        """Returns the other nodes that can command the robot, or did in the last second."""
        heard = [name for name, at in list(self._other_publishers.items()) if 0.0 <= now - at <= OTHER_PUBLISHER_HOLD]
        return ", ".join(sorted({*heard, *self.registered}))

    def pose(self, now: float) -> Optional[Pose]:
        """Returns the robot's pose; None if it is unknown, or has just jumped."""
        if self._jump_hold_until > now + POSE_JUMP_HOLD + MAX_FUTURE_STAMP:
            self._jump_hold_until = -math.inf  # time has jumped back
        unknown = not self._pose_known or self.pose_uncertain or now < self._jump_hold_until
        return None if unknown or self._age(now, "pose") > INPUT_TIMEOUT else self._fixes[-1].pose

    # ------------------------------------------------------------- what it lets through
    def limit(self, now: float, source: str, request: VelocityRequest) -> Tuple[float, float, str]:
        """Limits a source's request at a time [s] to what is safe; returns (v [m/s], w [rad/s], code)."""
        with self._lock:
            self._limited_at = now
            # two nodes must not drive one base, in any state, even if no source requests motion
            if self.other_publishers(now):
                return 0.0, 0.0, OTHER_PUBLISHER
            if source in (NONE, STOP):
                return 0.0, 0.0, request.code
            if not (math.isfinite(request.v) and math.isfinite(request.w)):
                return 0.0, 0.0, "bad_command"
            if "all" in self.contacts.values():
                return 0.0, 0.0, "contact"
            limits = self.profile.limits
            v, w, code = request.v, min(max(request.w, -limits.max_turn_rate), limits.max_turn_rate), request.code
            allowed, reason = self._speed_limit(now, source, v, w) if v != 0.0 else (math.inf, "")
            if abs(v) > allowed:
                # the same arc, which was checked, but more slowly; turning enters no new floor, as the robot is round
                share = allowed / abs(v)
                v, w, code = (share * v, share * w, reason) if allowed >= 0.02 else (0.0, w, reason)
            share, missing = self._age_factor(now, source, v, w)
            return (0.0, 0.0, missing) if missing else (share * v, share * w, code)

    def _age_factor(self, now: float, source: str, v: float, w: float) -> Tuple[float, str]:
        """Returns the fraction of a command from which the robot can stop before the oldest input is too old.

        If that is 0, it also returns the code of what is missing; else "".
        """
        # a person with a joystick beside the robot may have come because all other inputs are lost
        alone = source != TELEOP
        missing = {
            "pose_jumped": alone and now < self._jump_hold_until,
            "pose_uncertain": alone and self.pose_uncertain,
            "no_map": alone and self.workspace is None,
        }
        ages = {code: math.inf for code, holds in missing.items() if holds}
        needs = {"scan": self.profile.scanner.present, "state": alone, "pose": alone}
        ages.update({f"{what}_lost": self._age(now, what) for what, needed in needs.items() if needed})
        if source == FOLLOW:
            ages["spot_lost"] = self._age(now, "spot")
        ages["driving"] = self._age(now, source) if source in self.stamps else 0.0
        ages["clock_stopped"] = self.clock_age
        oldest = max(ages, key=lambda what: ages[what])
        # the command of this step holds until the next one, and the base takes a moment
        left = INPUT_TIMEOUT - 1.0 / RATE - BASE_DELAY - ages[oldest]
        if left <= 0.0:
            return 0.0, oldest
        limits = self.profile.limits
        return min(1.0, left / max(abs(v) / limits.deceleration, abs(w) / limits.turn_acceleration, 1e-9)), ""

    def _speed_limit(self, now: float, source: str, v: float, w: float) -> Tuple[float, str]:
        """Returns the highest speed [m/s] on the arc of (v, w), and what limits it."""
        limits, clearance, radius = self.profile.limits, CLEARANCES[source], self.profile.radius
        led = source in (FOLLOW, ESCAPE)
        speeds = [(min(MAX_SPEED, limits.max_speed) if led else limits.max_speed, "speed_limit")]
        if v > 0 and self.contacts:
            speeds.append((0.0, "contact"))
        blind, delay = self._scan is None or not self.profile.scanner.present, limits.reaction_time
        if not blind:
            assert self._scan is not None
            # the delay since the scan counts too, if it is longer
            late = max(delay, now - self.stamps["scan"] + 1.0 / RATE + BASE_DELAY)
            speeds.append((safe_speed(self._scan.free_distance(v, w, radius, clearance), limits, late), "obstacle"))
            blind = not self._scan.sees_path(v, w, radius, stop_distance(v, limits, late))
            if blind and source != TELEOP:
                speeds.append((0.0, "floor_not_scanned"))
        if blind:
            speeds.append((BLIND_SPEED, "floor_not_scanned"))
        pose, workspace = self.pose(now), self.workspace
        if pose is not None and workspace is not None:
            if source == NAVIGATION and workspace.distance_to_border(pose) <= 0.0:
                speeds.append((0.0, "inside_border"))
            speeds.append((safe_speed(workspace.free_distance(pose, v, w, clearance.cells), limits, delay), "border"))
        if pose is not None and self.speed_limits is not None:
            speeds.append((limit_around(self.speed_limits, pose[:2], stop_distance(v, limits, delay)), "speed_zone"))
        return min(speeds, key=lambda entry: entry[0])

    def _age(self, now: float, what: str) -> float:
        """Returns the age [s] of an input's newest message, less the slack that its period allows.

        Returns inf if none has come, or its stamp is from another clock.
        """
        age = now - self.stamps.get(what, -math.inf)
        period = statistics.median(self._periods[what]) if what in self._periods else 0.0
        slack = min(max(period - USUAL_PERIOD, 0.0), MAX_SLACK)
        return max(age - slack, min(age, 0.0)) if age >= -MAX_FUTURE_STAMP else math.inf
