"""One robot's driver: the only publisher of its cmd_vel."""

from __future__ import annotations

import functools
import threading
import time
import traceback
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any, Dict, List, Optional

import numpy as np
import rospy
from actionlib_msgs.msg import GoalID, GoalStatus, GoalStatusArray
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from move_base_msgs.msg import MoveBaseActionGoal
from nav_msgs.msg import Path
from roslib.message import get_message_class
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Bool, ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from vb_core import geometry, names, sentences
from vb_core.errors import CodedError, ParameterError
from vb_core.files import write_atomically
from vb_core.grid_map import GridMap
from vb_core.notices import Notice, Severity
from vb_core.parameters import Parameters, param
from vb_core.robot_profile import Contact, RobotProfile
from vb_core.ros import node, parameters, robot_profile
from vb_core.ros.messages import (
    OccupancyGridArray,
    array_from_points,
    grid_from_message,
    message_from_grid,
    pose2d_from_message,
)
from vb_core.ros.notices import NoticePublisher
from vb_core.ros.transforms import TransformLookup
from vb_msgs.msg import BorderProgress, DriverState, InteractionState, VirtualBorder, VirtualBorderArray
from vb_robot.driving.arbiter import Arbiter, Command
from vb_robot.driving.gate import EXIT_BORDER, NAVIGATION, RATE, STOP, TELEOP
from vb_robot.driving.safety import Scan, SpeedLimits
from vb_robot.driving.workspace import BorderContact, PoseUncertainty, KnownBorder, Workspace
from vb_robot.inputs import FloorViewListener, SpotListener

STATE_PERIOD = 0.5  # [s] between reports of who drives, even if nothing changes
MIN_STOP = 0.5  # [s] a shorter stop is not worth a notice
GOAL_NOTICE_LIFETIME = 5.0  # [s] for which a goal in a border is reported
PLAN_LIFETIME = rospy.Duration(5.0)  # a robot on its way plans once a second
RUNNING = (GoalStatus.PENDING, GoalStatus.ACTIVE, GoalStatus.PREEMPTING, GoalStatus.RECALLING)
# what people are told, unlike the usual: "driving", "idle", "spot_in_view", "speed_limit" and so on
STOP_CODES = {
    "stopped",
    "state_lost",
    "scan_lost",
    "pose_lost",
    "pose_jumped",
    "no_map",
    "no_camera",
    "clock_stopped",
    "internal_error",
    "other_cmd_vel_publisher",
    "contact",
    "obstacle",
    "floor_not_scanned",
    "border",
    "inside_border",
    "bad_command",
}


@dataclass(frozen=True)
class DriverParams(Parameters):
    """The node's parameters; what the robot is comes from its profile."""

    robot: str = param(
        "", doc="name of the robot in borders and notices, of its camera, and before its frames; empty: the only one"
    )
    mobile_cameras: tuple = param(("robot",), doc="names of all cameras on robots; all others are stationary")
    exit_borders: bool = param(True, doc="whether to drive out of a border that was added where the robot is")
    stop_file: str = param(
        "", doc="file that exists while the robot is stopped, so that it stays so after a restart; empty: none"
    )


class RobotDriverNode:
    """Chooses which source drives a robot, and limits every command. See `Arbiter`.

    Subscribed topics:
        cmd_vel/navigation, cmd_vel/teleop (geometry_msgs/Twist)
        /virtual_borders/state (vb_msgs/InteractionState), /virtual_borders/stop (std_msgs/Bool)
        /virtual_borders/spots (vb_msgs/LaserSpot), /virtual_borders/progress (vb_msgs/BorderProgress)
        /virtual_borders/map, /map (nav_msgs/OccupancyGrid), /virtual_borders/borders (vb_msgs/VirtualBorderArray)
        /virtual_borders/speed_limits (nav_msgs/OccupancyGrid): optional
        scan (sensor_msgs/LaserScan), camera_info (sensor_msgs/CameraInfo): as the profile names them
        <contact> (rospy/AnyMsg): each contact sensor, with the message type that the profile names
        move_base/status (actionlib_msgs/GoalStatusArray), move_base/goal (move_base_msgs/MoveBaseActionGoal)
        move_base/NavfnROS/plan (nav_msgs/Path): the robot turns towards it first; optional
        amcl_pose (geometry_msgs/PoseWithCovarianceStamped): how far off the localisation may be; optional
        cmd_vel (geometry_msgs/Twist): whether another node commands the base
        /tf, /tf_static (tf2_msgs/TFMessage): map -> odom -> base_link, and where the sensors are on the robot
    Published topics:
        cmd_vel (geometry_msgs/Twist): while the robot is driven, then one zero command; zeros while it is stopped
        move_base/cancel (actionlib_msgs/GoalID): while it follows the spot
        /virtual_borders/drivers (vb_msgs/DriverState): which source drives, and why
        /virtual_borders/notices (vb_msgs/NoticeArray)
        robot_driver/keep_out (nav_msgs/OccupancyGrid, latched): /virtual_borders/map with borders inflated by the localisation
            uncertainty: for navigation's costmaps
        /virtual_borders/plans (visualization_msgs/MarkerArray): navigation's path of a robot with a name, for 5 s
            after it was planned; RViz would have to know the robots' names to subscribe to each one's path
    Parameters:
        ~* DriverParams
        robot_profile: in the robot's namespace
    """

    def __init__(self, params: DriverParams, profile: RobotProfile) -> None:
        self._params, self._profile = params, profile
        prefix = f"{params.robot}/" if params.robot else ""
        self._base, self._odom = prefix + profile.frames.base, prefix + profile.frames.odom
        self._stop_file = FilePath(params.stop_file).expanduser() if params.stop_file else None
        self._stop_written = self._stop_file is not None and _is_there(self._stop_file)
        self._writing = threading.Lock()
        self._arbiter = Arbiter(
            profile, params.robot or "robot", params.mobile_cameras, params.exit_borders, self._stop_written
        )
        self._lock = threading.Lock()
        self._maps: Dict[str, GridMap] = {}
        self._borders: List[KnownBorder] = []
        self._uncertainty = PoseUncertainty()
        self._mounts: Dict[str, np.ndarray] = {}
        self._bad_goal: Optional[Notice] = None
        self._bad_goal_until = -1.0
        self._stopped_since: Dict[str, float] = {}
        self._reported = (Command(), -1.0)
        self._timer = node.WakeTimer(1.0 / RATE)
        self._transforms = TransformLookup()
        self._camera = FloorViewListener(
            profile.camera.info,
            self._base,
            profile.camera.max_range,
            self._transforms,
            functools.partial(setattr, self._arbiter.follower, "view"),
        )
        self._notices = NoticePublisher()
        self._cmd_vel = rospy.Publisher("cmd_vel", Twist, queue_size=1, tcp_nodelay=True)
        self._cancel = rospy.Publisher("move_base/cancel", GoalID, queue_size=1)
        self._plans = rospy.Publisher(names.PLANS, MarkerArray, queue_size=5) if params.robot else None
        self._states = rospy.Publisher(names.DRIVERS, DriverState, queue_size=5)
        self._keep_out = rospy.Publisher("~keep_out", OccupancyGridArray, queue_size=1, latch=True)
        self._subscribe(profile)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stops the robot."""
        self._timer.close()
        self._thread.join(1.0)
        self._cmd_vel.publish(Twist())

    def _subscribe(self, profile: RobotProfile) -> None:
        listen = rospy.Subscriber
        self._subscribers = [
            listen("cmd_vel/navigation", Twist, self._on_request, NAVIGATION, queue_size=1, tcp_nodelay=True),
            listen("cmd_vel/teleop", Twist, self._on_request, TELEOP, queue_size=1, tcp_nodelay=True),
            listen("cmd_vel", rospy.AnyMsg, self._on_command, queue_size=20),
            listen(names.STATE, InteractionState, self._on_state, queue_size=10),
            listen(names.STOP, Bool, self._on_stop, queue_size=10),
            SpotListener(self._arbiter.add),
            listen(
                names.PROGRESS,
                BorderProgress,
                lambda message: self._arbiter.add_contributors(message.interaction_id, message.cameras),
                queue_size=1,
            ),
            listen(names.MAP_WITH_BORDERS, OccupancyGridArray, self._on_map, "borders", queue_size=1),
            listen(names.PHYSICAL_MAP, OccupancyGridArray, self._on_map, "physical", queue_size=1),
            listen(names.SPEED_LIMITS, OccupancyGridArray, self._on_map, "speed", queue_size=1),
            listen(names.BORDERS, VirtualBorderArray, self._on_borders, queue_size=1),
            listen("amcl_pose", PoseWithCovarianceStamped, self._on_covariance, queue_size=1),
            listen("move_base/status", GoalStatusArray, self._on_status, queue_size=1),
            listen("move_base/goal", MoveBaseActionGoal, self._on_goal, queue_size=5),
            listen("move_base/NavfnROS/plan", Path, self._on_plan, queue_size=1),
        ]
        if profile.scanner.present:
            self._subscribers.append(listen(profile.scanner.topic, LaserScan, self._on_scan, queue_size=1))
        for contact in profile.contacts:
            kind = get_message_class(contact.type)
            if kind is None:
                # a robot whose bumper cannot be heard must not drive as if it had none
                raise ParameterError("robot_profile/contacts", f"the message type {contact.type} is not installed")
            self._subscribers.append(listen(contact.topic, kind, functools.partial(self._on_contact, contact)))

    # ------------------------------------------------------------- callbacks: only store
    def _on_request(self, message: Twist, source: str) -> None:
        self._arbiter.request(source, message.linear.x, message.angular.z, rospy.get_time())

    def _on_command(self, message: Any) -> None:
        name = message._connection_header.get("callerid", "somebody")
        if name != rospy.get_name():
            self._arbiter.gate.record_other_publisher(name, rospy.get_time())

    def _on_state(self, message: InteractionState) -> None:
        self._arbiter.set_state(
            message.state,
            message.interaction_id,
            message.entered.to_sec(),
            message.header.stamp.to_sec(),
            message.stopped,
        )
        self._write_stop_file()

    def _on_stop(self, message: Bool) -> None:
        self._arbiter.set_stop(message.data, rospy.get_time())
        self._write_stop_file()

    def _write_stop_file(self) -> None:
        """Brings the file up to date; called in the callbacks, so that a slow disk does not keep the wheels waiting."""
        with self._writing:
            stopped = self._arbiter.stopped
            if self._stop_file is None or stopped == self._stop_written:
                return
            try:
                if stopped:
                    write_atomically(self._stop_file, b"")
                else:
                    self._stop_file.unlink(missing_ok=True)
                self._stop_written = stopped
            except (CodedError, OSError) as error:
                rospy.logerr_throttle(5.0, f"{rospy.get_name()}: whether it is stopped is not remembered: {error}")

    def _on_scan(self, message: LaserScan) -> None:
        frame = message.header.frame_id
        if frame not in self._mounts:
            T = self._lookup(self._base, frame, rospy.Time(0))
            if T is None:
                rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: scans do not count: no transform from '{frame}' yet")
                return
            self._mounts[frame] = T
        scan = Scan(
            np.asarray(message.ranges),
            message.angle_min,
            message.angle_increment,
            message.range_min,
            message.range_max,
            self._mounts[frame],
            self._profile.radius,
            self._profile.scanner.zero_means_no_return,
        )
        self._arbiter.gate.set_scan(scan, message.header.stamp.to_sec())

    def _on_contact(self, contact: Contact, message: Any) -> None:
        self._arbiter.gate.contacts[contact.topic] = int(getattr(message, contact.field)) == contact.alarm

    def _on_status(self, message: GoalStatusArray) -> None:
        self._arbiter.goal_active = any(entry.status in RUNNING for entry in message.status_list)

    def _on_plan(self, message: Path) -> None:
        if message.header.frame_id.lstrip("/") == names.MAP_FRAME:
            self._arbiter.set_path(array_from_points([entry.pose.position for entry in message.poses]))
        if self._plans is None:
            return
        marker = Marker(header=message.header, ns=self._params.robot, type=Marker.LINE_STRIP)
        marker.action = Marker.ADD if len(message.poses) > 1 else Marker.DELETE
        marker.pose.orientation.w, marker.pose.position.z, marker.scale.x = 1.0, 0.03, 0.05
        marker.color = ColorRGBA(0.46, 0.31, 0.63, 1.0)  # as the only robot's path in rviz/
        marker.lifetime = PLAN_LIFETIME
        marker.points = [entry.pose.position for entry in message.poses]
        self._plans.publish(MarkerArray(markers=[marker]))

    def _on_map(self, message: OccupancyGridArray, which: str) -> None:
        try:
            grid = grid_from_message(message)
        except CodedError as error:
            rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: map refused: {error}")
            return
        if which == "speed":
            self._arbiter.gate.speed_limits = SpeedLimits(grid)
            return
        with self._lock:
            self._maps[which] = grid
            self._use_maps()

    def _on_covariance(self, message: PoseWithCovarianceStamped) -> None:
        with self._lock:
            if self._uncertainty.add(np.reshape(message.pose.covariance, (6, 6))[:2, :2]):
                rospy.loginfo("%s: keeps off borders by %.3f m more", rospy.get_name(), self._uncertainty.meters)
                self._use_maps()

    def _use_maps(self) -> None:
        if "borders" in self._maps:
            workspace = Workspace(
                self._maps["borders"],
                self._maps.get("physical"),
                self._profile.radius,
                self._borders,
                self._uncertainty.meters,
            )
            self._arbiter.set_maps(workspace)
            self._keep_out.publish(message_from_grid(workspace.keep_out, rospy.Time.now()))

    def _on_borders(self, message: VirtualBorderArray) -> None:
        self._borders = [
            KnownBorder(
                border.name or border.id,
                array_from_points(border.points),
                np.array([border.seed.x, border.seed.y]),
                border.kind == VirtualBorder.POLYGON,
            )
            for border in message.borders
            if border.enabled and len(border.points) and (not border.robots or self._params.robot in border.robots)
        ]
        if self._arbiter.gate.workspace is not None:
            self._arbiter.gate.workspace.known = self._borders

    def _on_goal(self, message: MoveBaseActionGoal) -> None:
        target, workspace = message.goal.target_pose, self._arbiter.gate.workspace
        if target.header.frame_id.lstrip("/") != names.MAP_FRAME or workspace is None:
            return
        x, y, _ = pose2d_from_message(target.pose)
        if workspace.contact_at((x, y)) is not BorderContact.FREE and workspace.is_lethal((x, y)):
            name = _quoted(workspace.name_at((x, y)))
            self._bad_goal = self._notice("goal_in_border", Severity.WARNING, border=name)
            self._bad_goal_until = rospy.get_time() + GOAL_NOTICE_LIFETIME

    # ------------------------------------------------------------- driving
    def _run(self) -> None:
        # a robot must also stop when simulated time does
        last, moved = rospy.Time(0), time.monotonic()
        while self._timer.get() is not None and not rospy.is_shutdown():
            now = rospy.Time.now()
            try:
                if now != last:
                    last, moved = now, time.monotonic()
                self._arbiter.gate.clock_age = time.monotonic() - moved
                self._update_pose()
                self._execute(self._arbiter.step(now.to_sec()), now)
            except rospy.ROSException:
                if not rospy.is_shutdown():
                    raise
            except Exception:
                # whatever fails here, the robot must not keep its last command, and the next step may succeed
                self._execute(self._arbiter.halt("internal_error"), now)
                rospy.logerr_throttle(5.0, f"{rospy.get_name()}: {traceback.format_exc()}")

    def _update_pose(self) -> None:
        # tf returns the newest transform, however old
        stamp = self._transforms.newest(names.MAP_FRAME, self._base)
        T = self._lookup(names.MAP_FRAME, self._base, stamp)
        self._arbiter.gate.set_pose(
            geometry.pose2d_from_transform(T) if T is not None else None,
            stamp.to_sec(),
            self._transforms.newest(names.MAP_FRAME, self._odom).to_sec(),
        )

    def _execute(self, command: Command, now: rospy.Time) -> None:
        if command.publish:
            message = Twist()
            message.linear.x, message.angular.z = command.v, command.w
            self._cmd_vel.publish(message)
        if command.cancel:
            self._cancel.publish(GoalID())
        self._report(command, now.to_sec())

    def _lookup(self, target: str, source: str, stamp: rospy.Time) -> Optional[np.ndarray]:
        try:
            return self._transforms.lookup(target, source, stamp, timeout=0.0)
        except CodedError:
            return None

    # ------------------------------------------------------------- notices
    def _report(self, command: Command, now: float) -> None:
        """Publishes who drives, at once when it changes, and what people should know."""
        before, at = self._reported
        changed = (command.source, command.code) != (before.source, before.code)
        if not changed and 0.0 <= now - at < STATE_PERIOD:
            return
        self._reported = (command, now)
        code = f"robot_{command.code}"
        message = DriverState(
            robot=self._params.robot,
            source=command.source,
            code=command.code,
            speed=command.v,
            angular_velocity=command.w,
            message=sentences.translate(code, {"who": sentences.robot_value(self._params.robot)}),
        )
        message.header.stamp = rospy.Time.from_sec(now)
        self._states.publish(message)
        if changed:
            rospy.loginfo("%s: %s: %s", rospy.get_name(), command.source, command.code)
        self._notices.set(self._list_notices(command, now))

    def _list_notices(self, command: Command, now: float) -> List[Notice]:
        found = []
        contact, name, lethal = self._arbiter.gate.border_contact(now)
        if contact is not BorderContact.FREE:
            inside = contact is BorderContact.INSIDE
            code = "robot_inside_border" if inside else "robot_touches_border"
            severity = Severity.ERROR if inside and lethal else Severity.WARNING
            found.append(self._notice(code, severity, border=_quoted(name)))
            if command.source == EXIT_BORDER:
                found.append(self._notice("robot_exits_border", Severity.INFO, border=_quoted(name)))
            elif self._arbiter.exit.failed:
                reason = f"$robot_{self._arbiter.exit.failed}"
                found.append(self._notice("robot_cannot_exit", Severity.WARNING, border=_quoted(name), reason=reason))
        if command.cancel:
            found.append(self._notice("goal_cancelled", Severity.INFO))
        self._stopped_since = {command.code: self._stopped_since.get(command.code, now)}
        held = now - self._stopped_since[command.code] >= MIN_STOP
        if held and self._arbiter.stopped and not self._stop_written and self._stop_file is not None:
            found.append(self._notice("stop_not_persisted", Severity.WARNING))
        if command.code in STOP_CODES and (held or command.source == STOP):
            severity = Severity.INFO if command.code in ("obstacle", "border") else Severity.WARNING
            code = "robot_stopped_inside_border" if command.code == "inside_border" else f"robot_{command.code}"
            found.append(self._notice(code, severity, others=self._arbiter.gate.other_publishers))
        if self._bad_goal is not None and now < self._bad_goal_until:
            found.append(self._bad_goal)
        return found

    def _notice(self, code: str, severity: Severity, **values: str) -> Notice:
        return Notice(
            code,
            severity,
            robot=self._params.robot,
            values={"who": sentences.robot_value(self._params.robot), **values},
        )


def _is_there(path: FilePath) -> bool:
    try:
        path.lstat()
    except FileNotFoundError:
        return False
    except OSError as error:
        rospy.logwarn("%s: stopped, because %s cannot be read: %s", rospy.get_name(), path, error)
    return True


def _quoted(name: str) -> str:
    return f"'{name}'" if name else "$border_without_name"


def build() -> RobotDriverNode:
    """Reads the parameters and makes the node."""
    return RobotDriverNode(parameters.read(DriverParams, "~"), robot_profile.read())
