"""One robot's driver: the only publisher of its cmd_vel."""

from __future__ import annotations

import contextlib
import functools
import threading
import time
import traceback
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any, Dict, List, Optional, Tuple

import numpy as np
import rosgraph
import rospy
from actionlib_msgs.msg import GoalID, GoalStatusArray
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist, Vector3
from move_base_msgs.msg import RecoveryStatus
from nav_msgs.msg import Path
from sensor_msgs.msg import LaserScan
from std_srvs.srv import Empty, EmptyRequest

from vb_core import geometry, names
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.interaction_tables import state_by_name
from vb_core.notices import Notice, Severity
from vb_core.parameters import Parameters, param
from vb_core.robot_profile import Contact, RobotProfile
from vb_core.ros import node, parameters, robot_profile
from vb_core.ros.master import find_commanders
from vb_core.ros.messages import NumpyOccupancyGrid, array_from_points, message_from_grid
from vb_core.ros.notices import NoticePublisher
from vb_core.ros.services import call
from vb_core.ros.transforms import TransformLookup
from vb_core.stop_latch import HeldStops, new_id
from vb_msgs.msg import BorderProgress, DriverState, InteractionState, Stop
from vb_robot.driving.arbiter import Arbiter, DriveCommand
from vb_robot.driving.command_gate import NAVIGATION, RATE, STOP, TELEOP
from vb_robot.driving.localization import PoseUncertainty
from vb_robot.driving.scan_clearance import Scan
from vb_robot.driving.workspace import Workspace
from vb_robot.ros.goal_statuses import RUNNING_GOAL_STATUSES
from vb_robot.ros.subscriptions import contact_message_class, subscribe_map, subscribe_spots

STATE_PERIOD = 0.5  # [s] between reports of the source that drives, even if nothing changes
MIN_STOP = 0.5  # [s] shortest stop that is reported as a notice
COMMANDERS_PERIOD = 1.0  # [s] of wall time between searches for other nodes that can command the base
AMCL_UPDATE_PERIOD = 0.3  # [s] of wall time
AMCL = {"who": "AMCL"}  # in sentences
PLANAR = [0, 1, 5]  # indices of x, y and yaw in a pose's covariance
MAX_AMCL_UPDATES = 40  # after so many, AMCL has found its pose, or will not find it
# codes that are reported as notices, unlike everyday ones such as "driving" and "speed_limit"
STOP_CODES = frozenset(
    "stopped state_lost scan_lost pose_lost pose_jumped pose_uncertain no_map clock_stopped "
    "internal_error other_cmd_vel_publisher contact obstacle floor_not_scanned border inside_border bad_command".split()
)
SEVERITIES = {"obstacle": Severity.INFO, "border": Severity.INFO, "other_cmd_vel_publisher": Severity.ERROR}


@dataclass(frozen=True)
class DriverParams(Parameters):
    """The node's parameters. The robot's properties come from its profile."""

    robot: str = param("", doc="the robot's name in borders, notices and frames, and its camera's; empty: the only one")
    mobile_cameras: tuple = param(("robot",), doc="names of all cameras on robots; all others are stationary")
    stop_file: str = param("", doc="file with the stops that the robot holds, also after a restart; empty: none")


class RobotDriverNode:
    """Chooses which source drives a robot, and limits every command. See `Arbiter`.

    Subscribed topics:
        cmd_vel/navigation, cmd_vel/teleop (geometry_msgs/Twist): forward and turning; sideways motion is refused
        /virtual_borders/state (vb_msgs/InteractionState), /virtual_borders/stop (vb_msgs/Stop)
        /virtual_borders/spots (vb_msgs/LaserSpot), /virtual_borders/progress (vb_msgs/BorderProgress)
        /virtual_borders/map, /map (nav_msgs/OccupancyGrid)
        /virtual_borders/speed_limits (nav_msgs/OccupancyGrid): optional
        scan (sensor_msgs/LaserScan): as the profile names it
        <contact> (rospy/AnyMsg): each contact sensor, with the message type that the profile names
        move_base/status (actionlib_msgs/GoalStatusArray)
        move_base/recovery_status (move_base_msgs/RecoveryStatus): a recovery may turn the robot; optional
        move_base/NavfnROS/plan (nav_msgs/Path): or another planner's; the robot first turns towards it; optional
        amcl_pose (geometry_msgs/PoseWithCovarianceStamped): how far off the localisation may be; optional
        initialpose (geometry_msgs/PoseWithCovarianceStamped): somebody has set the robot's pose; optional
        cmd_vel (geometry_msgs/Twist): or the profile's base/topic and base/output; a command of another node is
            answered with a zero
        /tf, /tf_static (tf2_msgs/TFMessage): map -> odom -> base_link, and where the sensors are on the robot
    Published topics:
        cmd_vel (geometry_msgs/Twist): or the profile's base/topic; while the robot is driven, then one zero command;
            zeros while it is stopped, and for some seconds after a subscriber is added
        move_base/cancel (actionlib_msgs/GoalID): while it follows the spot
        /virtual_borders/drivers (vb_msgs/DriverState): which source drives, and why
        /virtual_borders/notices (vb_msgs/NoticeArray)
        robot_driver/keep_out (nav_msgs/OccupancyGrid, latched): /virtual_borders/map with borders inflated by the
            localisation uncertainty: for navigation's costmaps
    Services called:
        request_nomotion_update (std_srvs/Empty): AMCL's, while it is uncertain of a pose that it once knew or was given
    Parameters:
        ~* DriverParams
        robot_profile: in the robot's namespace
    """

    def __init__(self, params: DriverParams, profile: RobotProfile) -> None:
        contacts = [(contact, contact_message_class(contact)) for contact in profile.contacts]
        self._params, self._profile = params, profile
        prefix = f"{params.robot}/" if params.robot else ""
        self._base, self._odom = prefix + profile.frames.base, prefix + profile.frames.odom
        self._stops = HeldStops(FilePath(params.stop_file).expanduser() if params.stop_file else None)
        self._arbiter = Arbiter(profile, params.robot or "robot", params.mobile_cameras, self._stops)
        self._lock = threading.Lock()
        self._maps: Dict[str, GridMap] = {}
        self._uncertainty = PoseUncertainty()
        self._mounts: Dict[str, np.ndarray] = {}
        self._allowed = {rospy.get_name()}  # nodes that may command the base
        self._stopped_since: Dict[str, float] = {}
        self._report: Tuple[Any, ...] = ()  # the newest report's source, code and stops
        self._reported_at = -1.0  # [s]
        self._timer = node.WakeTimer(1.0 / RATE)
        self._transforms = TransformLookup()
        self._notices = NoticePublisher()
        self._cmd_vel = rospy.Publisher(profile.base.topic, Twist, queue_size=1, tcp_nodelay=True)
        self._base_listens = True  # whether any node subscribes to the commands
        self._look_for_commanders()  # before anything can drive
        self._cancel = rospy.Publisher("move_base/cancel", GoalID, queue_size=1)
        self._states = rospy.Publisher(names.DRIVERS, DriverState, queue_size=5)
        self._keep_out = rospy.Publisher("~keep_out", NumpyOccupancyGrid, queue_size=1, latch=True)
        self._amcl_updates_left = 0  # how many updates may still be requested before AMCL knows its pose again
        self._subscribe(profile, contacts)
        self._thread = node.start_thread(self._run)
        self._beats = tuple(node.WakeTimer(period) for period in (COMMANDERS_PERIOD, AMCL_UPDATE_PERIOD))
        node.Worker(self._beats[0], lambda _woken: self._look_for_commanders())
        node.Worker(self._beats[1], lambda _woken: self._request_amcl_update())

    def close(self) -> None:
        """Stops the robot."""
        for timer in (self._timer, *self._beats):
            timer.close()
        self._thread.join(1.0)
        self._cmd_vel.publish(Twist())

    def _subscribe(self, profile: RobotProfile, contacts: List[Tuple[Contact, Any]]) -> None:
        listen = rospy.Subscriber
        planner = str(rospy.get_param("move_base/base_global_planner", "NavfnROS")).split("/")[-1]
        listen("cmd_vel/navigation", Twist, self._on_request, NAVIGATION, queue_size=1, tcp_nodelay=True)
        listen("cmd_vel/teleop", Twist, self._on_request, TELEOP, queue_size=1, tcp_nodelay=True)
        for topic in {profile.base.topic, profile.base.output} - {""}:
            listen(topic, rospy.AnyMsg, self._on_command, queue_size=20, tcp_nodelay=True)
        listen(names.STATE, InteractionState, self._on_state, queue_size=10)
        listen(names.STOP, Stop, self._on_stop, queue_size=10, tcp_nodelay=True)
        subscribe_spots(self._arbiter.add)
        listen(names.PROGRESS, BorderProgress, self._on_progress, queue_size=1)
        subscribe_map(names.MAP_WITH_BORDERS, functools.partial(self._on_map, "borders"))
        subscribe_map(names.PHYSICAL_MAP, functools.partial(self._on_map, "physical"))
        subscribe_map(names.SPEED_LIMITS, self._on_speed_limits)
        listen("amcl_pose", PoseWithCovarianceStamped, self._on_covariance, queue_size=1)
        listen("initialpose", PoseWithCovarianceStamped, self._on_initial_pose, queue_size=1)
        listen("move_base/status", GoalStatusArray, self._on_status, queue_size=1)
        listen(f"move_base/{planner}/plan", Path, self._on_plan, queue_size=1)
        listen("move_base/recovery_status", RecoveryStatus, self._on_recovery, queue_size=5)
        if profile.scanner.present:
            listen(profile.scanner.topic, LaserScan, self._on_scan, queue_size=1)
        for contact, kind in contacts:
            listen(contact.topic, kind, functools.partial(self._on_contact, contact))

    # ------------------------------------------------------------- callbacks
    def _on_request(self, message: Twist, source: str) -> None:
        # sideways motion is never checked, so it makes the command invalid
        forward = message.linear.x if abs(message.linear.y) < 1e-3 else float("nan")
        self._arbiter.request(source, forward, message.angular.z, rospy.get_time())

    def _on_command(self, message: Any) -> None:
        name = message._connection_header.get("callerid", "somebody")
        if name not in self._allowed:
            self._arbiter.gate.other_stamps[name] = rospy.get_time()
            self._cmd_vel.publish(Twist())  # the base obeys the newest command: this zero, until the next step

    def _on_recovery(self, _message: RecoveryStatus) -> None:
        self._arbiter.recover(rospy.get_time())

    def _look_for_commanders(self) -> None:
        """Looks up which other nodes can command the base, whether or not they do."""
        try:
            others, self._allowed, self._base_listens = find_commanders(rospy.get_name(), self._profile.base)
        except (rosgraph.MasterException, OSError):
            return  # without the master, no other node can be connected either
        self._arbiter.gate.other_commanders = tuple(sorted(others))

    def _on_state(self, message: InteractionState) -> None:
        entered, stamp = message.entered.to_sec(), message.header.stamp.to_sec()
        self._arbiter.set_state(state_by_name(message.name), message.interaction_id, entered, stamp)
        self._stops.update_from_latch(message.stopped, message.stops)
        self._stops.store()  # in the callback's thread, so that a slow disk does not delay commands to the wheels

    def _on_stop(self, message: Stop) -> None:
        self._stops.add(message.id or new_id())
        self._stops.store()

    def _on_progress(self, message: BorderProgress) -> None:
        self._arbiter.add_contributors(message.interaction_id, message.cameras)

    def _on_scan(self, message: LaserScan) -> None:
        """Stores a scan with the time of its last beam, from which its age counts. The message has its first beam's."""
        frame = message.header.frame_id.lstrip("/")
        if frame not in self._mounts:
            T = self._lookup(self._base, frame, rospy.Time(0))
            if T is None:
                rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: scans do not count: no transform from '{frame}' yet")
                return
            self._mounts[frame] = T
        scan = Scan(
            ranges=np.asarray(message.ranges),
            angle_min=message.angle_min,
            angle_increment=message.angle_increment,
            range_min=message.range_min,
            range_max=message.range_max,
            mount=self._mounts[frame],
            radius=self._profile.radius,
            no_return=self._profile.scanner.no_return,
        )
        duration = max(message.time_increment, 0.0) * max(len(message.ranges) - 1, 0)
        stamp = message.header.stamp.to_sec()
        age = max(rospy.get_time() - stamp, 0.0)
        self._arbiter.gate.set_scan(scan, stamp + min(duration, age))

    def _on_contact(self, contact: Contact, message: Any) -> None:
        number = int(getattr(message, contact.sensor)) if contact.sensor else 0
        touched = int(getattr(message, contact.field)) != contact.clear
        self._arbiter.gate.set_contact((contact.topic, number), contact.blocks if touched else "")

    def _on_status(self, message: GoalStatusArray) -> None:
        has_goal = any(entry.status in RUNNING_GOAL_STATUSES for entry in message.status_list)
        self._arbiter.set_goal_active(has_goal, rospy.get_time())

    def _on_plan(self, message: Path) -> None:
        if message.header.frame_id.lstrip("/") == names.MAP_FRAME:
            self._arbiter.set_path(array_from_points([entry.pose.position for entry in message.poses]))

    def _on_map(self, layer: str, grid: GridMap) -> None:
        with self._lock:
            self._maps[layer] = grid
            self._use_maps()

    def _on_speed_limits(self, grid: GridMap) -> None:
        self._arbiter.gate.speed_limits = grid

    def _on_covariance(self, message: PoseWithCovarianceStamped) -> None:
        with self._lock:
            covariance = np.reshape(message.pose.covariance, (6, 6))
            changed = self._uncertainty.add(covariance[np.ix_(PLANAR, PLANAR)])
            self._arbiter.gate.pose_uncertain = self._uncertainty.lost
            if not self._uncertainty.lost:
                self._amcl_updates_left = MAX_AMCL_UPDATES
            if changed:
                rospy.loginfo("%s: keeps off borders by %.3f m more", rospy.get_name(), self._uncertainty.meters)
                self._use_maps()

    def _on_initial_pose(self, _message: PoseWithCovarianceStamped) -> None:
        self._amcl_updates_left = MAX_AMCL_UPDATES

    def _request_amcl_update(self) -> None:
        """Makes AMCL compare scans with the map although the robot stands still, if its pose was once known or given.

        On its own, AMCL does so only while the robot moves. But a robot that does not know its pose stands still, so
        that one bad moment would last forever. A pose given in RViz is accurate to half a metre, which is not enough.
        """
        if self._amcl_updates_left and self._arbiter.gate.pose_uncertain:
            self._amcl_updates_left -= 1
            try:
                call("request_nomotion_update", Empty, EmptyRequest(), AMCL, AMCL_UPDATE_PERIOD, AMCL_UPDATE_PERIOD)
            except CodedError as error:
                rospy.logwarn_throttle(10.0, f"{rospy.get_name()}: {error}")

    def _use_maps(self) -> None:
        borders, physical = self._maps.get("borders"), self._maps.get("physical")
        if borders is None or physical is None or not physical.same_geometry(borders):
            self._arbiter.gate.workspace = None  # it is not known which cells are borders
            return
        workspace = Workspace(borders, physical, self._profile.radius, self._uncertainty.meters)
        self._arbiter.gate.workspace = workspace
        self._keep_out.publish(message_from_grid(workspace.keep_out, rospy.Time.now()))

    # ------------------------------------------------------------- driving
    def _run(self) -> None:
        # the robot must stop even if simulated time stands still
        last_stamp = rospy.Time(0)
        clock_moved_at = time.monotonic()
        while self._timer.get() is not None and not rospy.is_shutdown():
            now = rospy.Time.now()
            try:
                if now != last_stamp:
                    last_stamp = now
                    clock_moved_at = time.monotonic()
                self._arbiter.gate.clock_age = time.monotonic() - clock_moved_at
                self._update_pose()
                command = self._arbiter.step(now.to_sec(), self._cmd_vel.get_num_connections())
                self._execute(command, now)
            except Exception:
                if rospy.is_shutdown():
                    return
                rospy.logerr_throttle(5.0, f"{rospy.get_name()}: {traceback.format_exc()}")
                # the last command must not stay in force; zero goes out before the report, which may fail too
                with contextlib.suppress(Exception):
                    self._execute(self._arbiter.halt("internal_error"), now)

    def _update_pose(self) -> None:
        # tf returns the newest transform, however old
        stamp = self._transforms.newest(names.MAP_FRAME, self._base)
        transforms = [self._lookup(frame, self._base, stamp) for frame in (names.MAP_FRAME, self._odom)]
        pose, odometry = (None if T is None else geometry.pose2d_from_transform(T) for T in transforms)
        correction = self._transforms.newest(names.MAP_FRAME, self._odom).to_sec()
        self._arbiter.gate.set_pose(pose, stamp.to_sec(), correction, odometry)

    def _execute(self, command: DriveCommand, now: rospy.Time) -> None:
        if command.publish:
            self._cmd_vel.publish(Twist(linear=Vector3(x=command.v), angular=Vector3(z=command.w)))
        if command.cancel:
            self._cancel.publish(GoalID())
        self._publish_report(command, now.to_sec())

    def _lookup(self, target: str, source: str, stamp: rospy.Time) -> Optional[np.ndarray]:
        try:
            return self._transforms.lookup(target, source, stamp, timeout=0.0)
        except CodedError:
            return None

    # ------------------------------------------------------------- notices
    def _publish_report(self, command: DriveCommand, now: float) -> None:
        """Publishes the notices and which source drives, at once if that changes."""
        previous = self._report
        report = (command.source, command.code, self._stops.persisted_ids)
        if report == previous and 0.0 <= now - self._reported_at < STATE_PERIOD:
            return
        self._report = report
        self._reported_at = now
        message = DriverState(
            robot=self._params.robot,
            source=command.source,
            code=command.code,
            speed=command.v,
            angular_velocity=command.w,
            message=self._notice(_sentence_code(command.code), Severity.INFO).sentence(),
            stops=report[2],
        )
        message.header.stamp = rospy.Time.from_sec(now)
        self._states.publish(message)
        if report[:2] != previous[:2]:
            rospy.loginfo("%s: %s: %s", rospy.get_name(), command.source, command.code)
        self._notices.set(self._list_notices(command, now))

    def _list_notices(self, command: DriveCommand, now: float) -> List[Notice]:
        notices = []
        if command.cancel:
            notices.append(self._notice("goal_cancelled", Severity.INFO))
        self._stopped_since = {command.code: self._stopped_since.get(command.code, now)}
        is_lasting = now - self._stopped_since[command.code] >= MIN_STOP
        if not self._base_listens:
            topic = rospy.resolve_name(self._profile.base.topic)
            notices.append(self._notice("base_not_listening", Severity.WARNING, topic=topic))
        if is_lasting and self._stops.stopped and not self._stops.stored:
            notices.append(self._notice("stop_not_persisted", Severity.WARNING))
        if command.code in STOP_CODES and (is_lasting or command.source == STOP):
            severity = SEVERITIES.get(command.code, Severity.WARNING)
            others = self._arbiter.gate.other_publishers(now)
            notices.append(self._notice(_sentence_code(command.code), severity, others=others))
        return notices

    def _notice(self, code: str, severity: Severity, **values: str) -> Notice:
        return Notice.of_robot(self._params.robot, code, severity, **values)


def _sentence_code(code: str) -> str:
    """Returns the code of the sentence for what stops or slows a robot."""
    return "robot_stopped_inside_border" if code == "inside_border" else f"robot_{code}"


def build() -> RobotDriverNode:
    """Reads the parameters and makes the node."""
    return RobotDriverNode(parameters.read(DriverParams, "~"), robot_profile.read())
