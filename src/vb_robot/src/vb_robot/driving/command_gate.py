"""The gate that every command passes: it limits a command to what is known to be safe, and names the reason.

If anything that a command depends on is unknown, the robot stops, with a code that says why. All periodic inputs share
one age limit: if any of them falls silent, the robot has stopped INPUT_TIMEOUT after its last message, or up to
MAX_SLACK later if the input is slower than 10 Hz. The older the oldest input is, the slower the robot drives, so that
it can brake in time from any speed. A message that is a little late, as on a busy computer, slows the robot for a
moment but does not stop it.

With or without ROS, the gate makes any source of velocities respect borders and a laser scanner. Give it every input,
and send the result of `limit` to the base.

>>> import numpy as np
>>> from vb_core.grid_map import GridMap
>>> gate, profile = CommandGate(RobotProfile()), RobotProfile()
>>> request = VelocityRequest(0.3, 0.0, "driving")                            # [m/s], [rad/s]
>>> gate.limit(10.0, NAVIGATION, request)                                     # nothing is known yet
VelocityRequest(v=0.0, w=0.0, code='no_map')
>>> floor = GridMap(np.zeros((100, 100), np.int8), resolution=0.05)           # 5 m x 5 m ...
>>> borders = floor.with_data(np.tile(np.int8([0] * 60 + [100] * 40), (100, 1)))    # ... restricted from x = 3 m on
>>> gate.workspace = Workspace(borders, floor, profile.radius)
>>> ranges = np.full(360, 8.0)                                                # [m] nothing is near
>>> gate.set_scan(Scan(ranges, -np.pi, np.radians(1.0), 0.1, 8.0, np.eye(4), profile.radius), stamp=10.0)
>>> gate.record_input("state", 10.0)
>>> gate.set_pose((2.0, 2.5, 0.0), stamp=10.0)
>>> gate.limit(10.0, NAVIGATION, request), gate.limit(10.6, NAVIGATION, request)    # at once, and 0.6 s later
(VelocityRequest(v=0.3, w=0.0, code='driving'), VelocityRequest(v=0.0, w=0.0, code='scan_lost'))
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
from vb_robot.driving.localization import MAX_POSE_JUMP, Fix, pose_jump
from vb_robot.driving.scan_clearance import RequiredGaps, Scan, safe_speed, stop_distance
from vb_robot.driving.velocity import MAX_SPEED, VelocityRequest
from vb_robot.driving.workspace import Workspace, lowest_speed_limit

RATE = 20.0  # [1/s] how often commands are limited, and late messages noticed
INPUT_TIMEOUT = 0.5  # [s] from an input's last message until the robot has stopped, without slack
BASE_DELAY = 0.02  # [s] from a command to the wheels
MAX_FUTURE_STAMP = 0.5  # [s] a stamp farther in the future comes from another clock, and its age is not known
USUAL_PERIOD = 0.1  # [s] an input with a longer period may be older than others by the excess
MAX_SLACK = 0.15  # [s] by which a slow input may be older at most
JUMP_WINDOW = 1.0  # [s] over which the localisation is compared with the odometry
POSE_JUMP_HOLD = 1.0  # [s] after a jump of the localisation, for which the pose counts as unknown
OTHER_PUBLISHER_HOLD = 1.0  # [s] after another node's command, for which none passes: only one node may drive a base
BLIND_SPEED = 0.1  # [m/s] without a scanner, with the map alone, and with a joystick where no beam points

OTHER_PUBLISHER = "other_cmd_vel_publisher"  # the code while another node can command the base
NONE, STOP, TELEOP, FOLLOW, ESCAPE, NAVIGATION = "none", "stop", "teleop", "follow", "escape", "navigation"
REQUIRED_GAPS = {
    TELEOP: RequiredGaps(0.05, 0.02, 0.0),
    FOLLOW: RequiredGaps(0.12, 0.04, 0.06),  # navigation must find a path from where a person leaves the robot
    ESCAPE: RequiredGaps(0.12, 0.04, 0.05),
    NAVIGATION: RequiredGaps(0.04, 0.0, -0.04),  # navigation keeps its own distance; this is only the last safeguard
}


class CommandGate:
    """Limits one robot's commands by the space ahead and the age of its inputs. All methods are thread safe.

    Attributes:
        workspace: the maps; None while they are not known.
        speed_limits: the map of the slow zones' limits, if there is one.
        contacts: by (topic, sensor), the motion that the contact forbids: "forward", "all", or "" without contact.
        pose_uncertain: whether the localisation reports that the robot may be anywhere.
        other_commanders: other nodes that can command this robot's base now.
        other_stamps: [s] of each other node's last command to this robot's base, by the node's name.
        clock_age: [s] of real time since ROS's clock last moved. While it stands still, stamps do not show their age.
        stamps: [s] of the newest scan, state, pose and spot, and of each source's newest command, by name.
    """

    def __init__(self, profile: RobotProfile) -> None:
        self.profile = profile
        self.workspace: Optional[Workspace] = None
        self.speed_limits: Optional[GridMap] = None
        self.contacts: Dict[Tuple[str, int], str] = {}
        self.pose_uncertain = False
        self.other_commanders: Tuple[str, ...] = ()
        self.clock_age = 0.0
        self.stamps: Dict[str, float] = {}
        self._lock = threading.RLock()
        self._scan: Optional[Scan] = None
        self._recent_fixes: Deque[Fix] = deque(maxlen=64)
        self._periods: Dict[str, Deque[float]] = {}  # [s] between an input's newest messages
        self._corrected_stamp = 0.0  # [s] stamp of the localisation's newest correction
        self._corrected_at = -math.inf  # [s] when it arrived
        self._jump_hold_until = -math.inf
        self.other_stamps: Dict[str, float] = {}
        self._last_limited = -math.inf  # [s] time of the last call of `limit`

    # ------------------------------------------------------------- inputs
    def set_scan(self, scan: Scan, stamp: float) -> None:
        """Stores a scan taken at time `stamp` [s]."""
        with self._lock:
            self._scan = scan
            self.record_input("scan", stamp)

    def set_pose(
        self, pose: Optional[Pose], stamp: float, correction: float = 0.0, odometry: Optional[Pose] = None
    ) -> None:
        """Stores the robot's pose (x, y, yaw) in the map frame at time `stamp` [s], or None if it is not known.

        Args:
            odometry: the pose in the odometry frame, if there is odometry.
            correction: stamp [s] of the localisation's newest correction of the odometry; 0 if none is expected. AMCL
                post-dates its corrections, so a correction's age counts from the moment at which this stamp changed.
        """
        with self._lock:
            if correction != self._corrected_stamp:
                self._corrected_stamp = correction
                self._corrected_at = stamp
            if correction:
                stamp = min(stamp, self._corrected_at)
            if pose is None:
                self.stamps.pop("pose", None)
                return
            fix = Fix(stamp, pose, odometry)
            recent_fixes = self._recent_fixes
            if "pose" not in self.stamps or stamp != recent_fixes[-1].stamp:
                self.record_input("pose", stamp)  # a repeated pose is as old as before
            # the last fix stays at any age, because the pose must agree with the odometry even after a pause
            while len(recent_fixes) > 1 and not stamp - JUMP_WINDOW <= recent_fixes[0].stamp <= stamp:
                recent_fixes.popleft()
            compared_fixes = [recent_fixes[0], recent_fixes[-1]] if recent_fixes else []
            jumps = [pose_jump(earlier, fix) for earlier in compared_fixes if earlier.stamp <= stamp]
            if any(jump > MAX_POSE_JUMP for jump in jumps):
                self._jump_hold_until = stamp + POSE_JUMP_HOLD
                recent_fixes.clear()
            recent_fixes.append(fix)

    def record_input(self, name: str, stamp: float) -> None:
        """Records the stamp [s] of an input's newest message. A stamp slightly in the future counts as now."""
        with self._lock:
            if self._last_limited < stamp < self._last_limited + MAX_FUTURE_STAMP:
                stamp = self._last_limited
            period = stamp - self.stamps.get(name, stamp)
            if 0.0 < period < 1.0:
                self._periods.setdefault(name, deque(maxlen=5)).append(period)
            self.stamps[name] = stamp

    def set_contact(self, sensor: Tuple[str, int], blocks: str) -> None:
        """Stores the motion that a sensor's contact forbids: "forward", "all", or "" without contact."""
        with self._lock:
            self.contacts[sensor] = blocks

    # ------------------------------------------------------------- state
    def other_publishers(self, now: float) -> str:
        """Returns the other nodes that can command the robot, or did in the last second."""
        publishers = list(self.other_stamps.items())
        recent = [name for name, stamp in publishers if 0.0 <= now - stamp <= OTHER_PUBLISHER_HOLD]
        return ", ".join(sorted({*recent, *self.other_commanders}))

    def pose(self, now: float) -> Optional[Pose]:
        """Returns the robot's pose, or None if it is unknown or has just jumped."""
        with self._lock:
            if self.pose_uncertain or self._has_just_jumped(now) or self._age(now, "pose") > INPUT_TIMEOUT:
                return None
            return self._recent_fixes[-1].pose

    def _has_just_jumped(self, now: float) -> bool:
        return now < self._jump_hold_until <= now + POSE_JUMP_HOLD + MAX_FUTURE_STAMP

    # ------------------------------------------------------------- commands
    def limit(self, now: float, source: str, request: VelocityRequest) -> VelocityRequest:
        """Returns a source's request at time `now` [s], limited to what is safe, with a code for what limits it."""
        with self._lock:
            self._last_limited = now
            if self._jump_hold_until > now + POSE_JUMP_HOLD + MAX_FUTURE_STAMP:
                self._jump_hold_until = -math.inf  # time has jumped back
            # two nodes must not drive one base, in any state, even if no source requests motion
            if self.other_publishers(now):
                return VelocityRequest(0.0, 0.0, OTHER_PUBLISHER)
            if source in (NONE, STOP):
                return VelocityRequest(0.0, 0.0, request.code)
            if not (math.isfinite(request.v) and math.isfinite(request.w)):
                return VelocityRequest(0.0, 0.0, "bad_command")
            if "all" in self.contacts.values():
                return VelocityRequest(0.0, 0.0, "contact")
            v, w, code = request
            max_turn_rate = self.profile.limits.max_turn_rate
            w = min(max(w, -max_turn_rate), max_turn_rate)
            if v != 0.0:
                max_speed, reason = self._speed_limit(now, source, v, w)
                if abs(v) > max_speed:
                    code = reason
                    # only the speed is reduced, as this arc has been checked; a round robot can always turn in place
                    scale = max_speed / abs(v)
                    if max_speed >= 0.02:
                        v, w = scale * v, scale * w
                    else:
                        v = 0.0
            scale, missing_code = self._age_factor(now, source, v, w)
            if missing_code:
                return VelocityRequest(0.0, 0.0, missing_code)
            return VelocityRequest(scale * v, scale * w, code)

    def _age_factor(self, now: float, source: str, v: float, w: float) -> Tuple[float, str]:
        """Returns the factor by which to scale a command down so that the robot can brake before an input is too old.

        Also returns the oldest input's code if the factor is 0, else "".
        """
        # a person may be driving with a joystick because all other inputs are lost
        autonomous = source != TELEOP
        limits = self.profile.limits
        unknown = {
            "pose_jumped": autonomous and self._has_just_jumped(now),
            "pose_uncertain": autonomous and self.pose_uncertain,
            "no_map": autonomous and self.workspace is None,
        }
        ages = {code: math.inf for code, is_unknown in unknown.items() if is_unknown}
        required = {"scan": self.profile.scanner.present, "state": autonomous, "pose": autonomous}
        for name, is_required in required.items():
            if is_required:
                ages[f"{name}_lost"] = self._age(now, name)
        if source == FOLLOW:
            ages["spot_lost"] = self._age(now, "spot")
        # a source that has fallen silent drives no more; the arbiter drops it when its command is INPUT_TIMEOUT old
        ages["idle"] = self._age(now, source) if source in self.stamps else 0.0
        ages["clock_stopped"] = self.clock_age
        oldest = max(ages, key=lambda name: ages[name])
        # this step's command is in force until the next step, and the base responds with a delay
        remaining = INPUT_TIMEOUT - 1.0 / RATE - BASE_DELAY - ages[oldest]
        if remaining <= 0.0:
            return 0.0, oldest
        stopping_time = max(abs(v) / limits.deceleration, abs(w) / limits.turn_acceleration, 1e-9)
        return min(1.0, remaining / stopping_time), ""

    def _speed_limit(self, now: float, source: str, v: float, w: float) -> Tuple[float, str]:
        """Returns the highest speed [m/s] on the arc of (v, w), and a code for what limits it."""
        limits, radius = self.profile.limits, self.profile.radius
        gaps = REQUIRED_GAPS[source]
        max_speed = limits.max_speed
        if source in (FOLLOW, ESCAPE):
            max_speed = min(MAX_SPEED, max_speed)
        speeds = [(max_speed, "speed_limit")]
        if v > 0 and any(self.contacts.values()):
            speeds.append((0.0, "contact"))
        scan = self._scan if self.profile.scanner.present else None
        delay = limits.reaction_time
        is_scanned = False
        if scan is not None:
            # the scan's age counts instead of the reaction time if it is longer
            latency = max(delay, now - self.stamps["scan"] + 1.0 / RATE + BASE_DELAY)
            free = scan.free_distance(v, w, radius, gaps)
            speeds.append((safe_speed(free, limits, latency), "obstacle"))
            is_scanned = scan.sees_path(v, w, radius, stop_distance(v, limits, latency))
            if not is_scanned and source != TELEOP:
                speeds.append((0.0, "floor_not_scanned"))
        if not is_scanned:
            speeds.append((BLIND_SPEED, "floor_not_scanned"))
        pose = self.pose(now)
        workspace = self.workspace
        if pose is not None and workspace is not None:
            if source == NAVIGATION and workspace.distance_to_border(pose) <= 0.0:
                speeds.append((0.0, "inside_border"))
            free = workspace.free_distance(pose, v, w, gaps.cells)
            speeds.append((safe_speed(free, limits, delay), "border"))
        if pose is not None and self.speed_limits is not None:
            reach = stop_distance(v, limits, delay)
            speeds.append((lowest_speed_limit(self.speed_limits, pose[:2], reach), "speed_zone"))
        return min(speeds, key=lambda entry: entry[0])

    def _age(self, now: float, name: str) -> float:
        """Returns the age [s] of an input's newest message less its slack; inf without one, or with a future stamp."""
        age = now - self.stamps.get(name, -math.inf)
        if not age >= -MAX_FUTURE_STAMP:  # also for nan
            return math.inf
        period = statistics.median(self._periods.get(name, [0.0]))
        slack = min(max(period - USUAL_PERIOD, 0.0), MAX_SLACK)
        return max(age - slack, min(age, 0.0))
