"""The one gate that every command passes: it lets through what can be shown to be safe, and says what limited the rest.

Whatever it depends on has one age limit: INPUT_TIMEOUT after the last message of any input the robot stops. The older
the oldest input, the slower the robot, so that its brakes keep that promise from any speed. A message that is a little
late, on a busy computer, slows the robot for a moment and does not stop it.

Use it to put borders and a laser scanner between any source of velocities and a robot's base, with or without ROS:
feed it whatever comes, and send what `limit` returns.

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
import threading
from typing import Dict, Optional, Tuple

from vb_core.robot_profile import RobotProfile
from vb_robot.driving.border_exit import MAP_MARGIN
from vb_robot.driving.safety import MAX_POSE_JUMP, Clearance, Scan, SpeedLimits, pose_jump, safe_speed, stop_distance
from vb_robot.driving.spot_follower import MAX_SPEED, VelocityRequest
from vb_robot.driving.workspace import BorderContact, Workspace
from vb_robot.poses import Pose

RATE = 20.0  # [1/s] how soon late messages are noticed
INPUT_TIMEOUT = 0.5  # [s] after the last scan, state, pose or command the robot stops
BASE_DELAY = 0.02  # [s] from a command to the wheels
MAX_FUTURE_STAMP = 0.5  # [s] a stamp farther ahead comes from another clock, and its age is not known
POSE_JUMP_HOLD = 1.0  # [s] after a jump of the localisation it is not known where the borders are
OTHER_PUBLISHER_HOLD = 1.0  # [s] after another node's command nothing is let through: two nodes at one wheel
BLIND_SPEED = 0.1  # [m/s] without a scanner, by the map alone, and for a joystick where no beam points

NONE, STOP, TELEOP, FOLLOW, EXIT_BORDER, NAVIGATION = "none", "stop", "teleop", "follow", "exit_border", "navigation"
CLEARANCES = {
    TELEOP: Clearance(0.05, 0.02, 0.0),
    FOLLOW: Clearance(0.12, 0.04, 0.06),  # from where a person leaves it, navigation must still find a path
    EXIT_BORDER: Clearance(0.12, 0.04, MAP_MARGIN),
    NAVIGATION: Clearance(0.04, 0.0, -0.04),  # it keeps its own distance; here is only what must never happen
}


class Gate:
    """Limits one robot's commands by what is ahead of it and by the age of its inputs. Several threads may feed it.

    Attributes:
        workspace: the maps; None before there are any.
        speed_limits: where there are slow zones.
        contacts: by bumper or cliff sensor whether it is touched.
        clock_age: [s] of real time since ROS's clock last moved; while it stands still, stamps do not show their age.
        stamps: [s] of the newest scan, state, pose and spot, and of each source's newest command, by name.
    """

    def __init__(self, profile: RobotProfile) -> None:
        self.profile = profile
        self.workspace: Optional[Workspace] = None
        self.speed_limits: Optional[SpeedLimits] = None
        self.contacts: Dict[str, bool] = {}
        self.clock_age = 0.0
        self.stamps: Dict[str, float] = {}
        self._lock = threading.Lock()
        self._scan: Optional[Scan] = None
        self._pose: Optional[Tuple[float, Pose]] = None
        self._correction = 0.0, -math.inf  # its stamp, and when that was new [s]
        self._jump_hold_until = -math.inf
        self._other_publishers: Dict[str, float] = {}  # who else commanded this robot, and when
        self._limited_at: Optional[float] = None  # [s] the time of the last command

    # ------------------------------------------------------------- inputs
    def set_scan(self, scan: Scan, stamp: float) -> None:
        """Stores a scan taken at a time [s]."""
        with self._lock:
            self._scan = scan
            self.record_input("scan", stamp)

    def set_pose(self, pose: Optional[Pose], stamp: float, correction: float = 0.0) -> None:
        """Stores the robot's pose (x, y, yaw), map frame, at a time [s]; None: it is not known.

        Args:
            correction: stamp [s] of the newest correction that localisation has made to odometry; 0: none is to be
                expected. AMCL stamps its corrections ahead, so that what counts is when the stamp changes.
        """
        with self._lock:
            if correction != self._correction[0]:
                self._correction = correction, stamp
            stamp = min(stamp, self._correction[1]) if correction else stamp
            before = self._pose
            self._pose = (stamp, pose) if pose is not None else None
            if pose is None:
                self.stamps.pop("pose", None)
            elif before is None or stamp != before[0]:
                self.record_input("pose", stamp)  # the same one again is as old as before
            if pose is None or before is None:
                return
            seconds = stamp - before[0]
            # after a pause a robot may be anywhere
            if 0.0 <= seconds < 1.0 and pose_jump(before[1], pose, seconds) > MAX_POSE_JUMP:
                self._jump_hold_until = stamp + POSE_JUMP_HOLD

    def record_input(self, what: str, stamp: float) -> None:
        """Records the stamp [s] of an input's newest message; a stamp slightly in the future counts as now."""
        ahead = self._limited_at is not None and self._limited_at < stamp < self._limited_at + MAX_FUTURE_STAMP
        self.stamps[what] = self._limited_at if ahead and self._limited_at is not None else stamp

    def record_other_publisher(self, name: str, now: float) -> None:
        """Records that another node has commanded this robot's base."""
        self._other_publishers[name] = now

    # ------------------------------------------------------------- what is known
    @property
    def other_publishers(self) -> str:
        """Returns the other nodes that have recently commanded the robot."""
        return ", ".join(sorted(self._other_publishers))

    def pose(self, now: float) -> Optional[Pose]:
        """Returns the robot's pose; None if it is unknown, or has just jumped."""
        if self._jump_hold_until > now + POSE_JUMP_HOLD:
            self._jump_hold_until = -math.inf  # time has jumped back
        if self._pose is None or self._age(now, "pose") > INPUT_TIMEOUT or now < self._jump_hold_until:
            return None
        return self._pose[1]

    def border_contact(self, now: float) -> Tuple[BorderContact, str, bool]:
        """Returns whether and how the robot touches a border, its name, and whether it may not be entered at all."""
        pose, workspace = self.pose(now), self.workspace
        if pose is None or workspace is None:
            return BorderContact.FREE, "", False
        return workspace.contact_at(pose), workspace.name_at(pose[:2]), workspace.is_lethal(pose[:2])

    # ------------------------------------------------------------- what it lets through
    def limit(self, now: float, source: str, request: VelocityRequest) -> Tuple[float, float, str]:
        """Limits a source's request at a time [s] to what is safe; returns (v [m/s], w [rad/s], code)."""
        with self._lock:
            self._limited_at = now
            if source in (NONE, STOP):
                return 0.0, 0.0, request.code
            if not (math.isfinite(request.v) and math.isfinite(request.w)):
                return 0.0, 0.0, "bad_command"
            limits = self.profile.limits
            v, w, code = request.v, min(max(request.w, -limits.max_turn_rate), limits.max_turn_rate), request.code
            allowed, reason = self._speed_limit(now, source, v, w) if v != 0.0 else (math.inf, "")
            if abs(v) > allowed:
                # the same arc, more slowly: it is the one that was checked; turning enters no new floor: the robot is
                # round
                share = allowed / abs(v)
                v, w, code = (share * v, share * w, reason) if allowed >= 0.02 else (0.0, w, reason)
            share, missing = self._age_factor(now, source, v, w)
            return (0.0, 0.0, missing) if missing else (share * v, share * w, code)

    def _age_factor(self, now: float, source: str, v: float, w: float) -> Tuple[float, str]:
        """Returns which part of a command the brakes can end before the oldest of its inputs is too old.

        If that is nothing, it returns what is missing as a code; else "".
        """
        self._other_publishers = {
            name: at for name, at in list(self._other_publishers.items()) if 0.0 <= now - at <= OTHER_PUBLISHER_HOLD
        }
        # a person with a joystick beside the robot may have come because all else is lost
        alone = source != TELEOP
        missing = {
            "other_cmd_vel_publisher": bool(self._other_publishers),
            "pose_jumped": alone and now < self._jump_hold_until,
            "no_map": alone and self.workspace is None,
        }
        ages = {code: math.inf for code, holds in missing.items() if holds}
        needs = {"scan": self.profile.scanner.present, "state": alone, "pose": alone}
        ages.update({f"{what}_lost": self._age(now, what) for what, needed in needs.items() if needed})
        if source == FOLLOW and "spot" in self.stamps:
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
        found = [(MAX_SPEED if source in (FOLLOW, EXIT_BORDER) else limits.max_speed, "speed_limit")]
        if v > 0 and any(self.contacts.values()):
            found.append((0.0, "contact"))
        blind = self._scan is None or not self.profile.scanner.present
        if not blind:
            assert self._scan is not None
            found.append((safe_speed(self._scan.free_distance(v, w, radius, clearance), limits), "obstacle"))
            blind = not self._scan.sees_path(v, w, radius, stop_distance(v, limits))
            if blind and source != TELEOP:
                found.append((0.0, "floor_not_scanned"))
        if blind:
            found.append((BLIND_SPEED, "floor_not_scanned"))
        pose, workspace = self.pose(now), self.workspace
        if pose is not None and workspace is not None:
            if source == NAVIGATION and workspace.distance_to_keep_out(pose) <= 0.0:
                found.append((0.0, "inside_border"))
            free = workspace.free_distance(pose, v, w, clearance.cells, exiting=source == EXIT_BORDER)
            found.append((safe_speed(free, limits), "border"))
        if pose is not None and self.speed_limits is not None:
            found.append((self.speed_limits.at(pose, v, w, stop_distance(v, limits)), "speed_zone"))
        return min(found, key=lambda entry: entry[0])

    def _age(self, now: float, what: str) -> float:
        """Returns how old [s] the newest of something is; inf if it never came, or comes from another clock."""
        age = now - self.stamps.get(what, -math.inf)
        return age if age >= -MAX_FUTURE_STAMP else math.inf
