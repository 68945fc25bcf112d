"""Watches whether a robot keeps to the borders, and says so when it does not."""
from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import List, Optional, Tuple

import numpy as np
import rospy
from actionlib_msgs.msg import GoalID
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper, Updater
from geometry_msgs.msg import Twist
from move_base_msgs.msg import MoveBaseActionGoal
from std_msgs.msg import String

from vb_core import geometry, names
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.parameters import Parameters, param
from vb_core.ros import parameters
from vb_core.ros.messages import OccupancyGridArray, array_from_points, grid_from_message, pose_to_2d
from vb_core.ros.transforms import TransformLookup
from vb_msgs.msg import VirtualBorder, VirtualBorderArray
from vb_robot.exit_driver import ExitDriver
from vb_robot.leaving import LeaveParams
from vb_robot.safety import SafetyParams
from vb_robot.workspace import KnownBorder, Standing, Workspace

_GROUPS = ("leave", "safety", "diagnostic_period")

@dataclass(frozen=True)
class MonitorParams(Parameters):
    """The node's parameters."""

    robot: str = param("", doc="the robot's name in the borders' lists; empty for the only one")
    base_frame: str = param("base_link")
    robot_radius: float = param(0.18, "m", above=0.0, high=2.0)
    policy: str = param("report", choices=("report", "stop_and_alert", "allow_exit"))
    rate: float = param(5.0, "1/s", low=0.5, high=20.0)
    stop_s: float = param(1.0, "s", low=0.0, high=10.0, doc="how long stop_and_alert holds the robot")
    exit_rate: float = param(12.0, "1/s", low=5.0, high=30.0, doc="of cmd_vel with allow_exit")
    use_scan: bool = param(True, doc="with allow_exit: without a fresh scan the robot only turns")
    action: str = param("move_base")


class WorkspaceMonitorNode:
    """Compares the robot's footprint, and goals given to navigation, with the borders.

    Subscribes:
        /virtual_borders/map, /map (nav_msgs/OccupancyGrid), /virtual_borders/borders (vb_msgs/VirtualBorderArray)
        move_base/goal (move_base_msgs/MoveBaseActionGoal)
    Publishes:
        /virtual_borders/workspace (std_msgs/String, latched): a sentence at each change, and for each goal in a border
        /diagnostics: the robot's standing
        move_base/cancel (actionlib_msgs/GoalID), cmd_vel (geometry_msgs/Twist): with stop_and_alert only for a moment
            after the robot came into a border, so that it can be led out; with allow_exit only while the robot
            leaves a border that was put where it stands
    Subscribes, with allow_exit only:
        /virtual_borders/state (vb_msgs/InteractionState), move_base/status (actionlib_msgs/GoalStatusArray),
        scan (sensor_msgs/LaserScan): while it drives
    Parameters:
        ~* MonitorParams, ~leave/* LeaveParams, ~safety/* SafetyParams
    """

    def __init__(
        self, params: MonitorParams, leave: LeaveParams = LeaveParams(), safety: SafetyParams = SafetyParams()
    ) -> None:
        self._params = params
        self._leave = leave
        self._who = f"robot '{params.robot}'" if params.robot else "the robot"
        self._lock = threading.Lock()
        self._map: Optional[GridMap] = None
        self._physical: Optional[GridMap] = None
        self._borders: List[KnownBorder] = []
        self._workspace: Optional[Workspace] = None
        self._standing = Standing.FREE
        self._inside: List[str] = []
        self._localised = False
        self._nameless = 0  # looks in a row at a border whose name is not known
        self._stop_until = rospy.Time(0)
        self._transforms = TransformLookup()
        self._changed = False  # a map has come since the robot was last found free or led out
        self._retry_at = rospy.Time(0)  # when a leaving that was given up is tried again
        self._publisher = rospy.Publisher(names.WORKSPACE, String, queue_size=10, latch=True)
        self._cancel = rospy.Publisher(f"{params.action}/cancel", GoalID, queue_size=1)
        self._cmd_vel: Optional[rospy.Publisher] = None
        if params.policy == "stop_and_alert":
            self._cmd_vel = rospy.Publisher("cmd_vel", Twist, queue_size=1)
        self._exit: Optional[ExitDriver] = None
        if params.policy == "allow_exit":
            self._exit = ExitDriver(params.base_frame, params.robot_radius, params.action, params.exit_rate,
                                    params.use_scan, leave, safety, self._who, self._say, self._transforms)
        self._updater = Updater()
        self._updater.setHardwareID(params.robot or "robot")
        self._updater.add("workspace", self._diagnose)
        self._subscribers = [
            rospy.Subscriber(names.VIRTUAL_MAP, OccupancyGridArray, self._on_map, "_map", queue_size=1),
            rospy.Subscriber(names.PHYSICAL_MAP, OccupancyGridArray, self._on_map, "_physical", queue_size=1),
            rospy.Subscriber(names.BORDERS, VirtualBorderArray, self._on_borders, queue_size=1),
            rospy.Subscriber(f"{params.action}/goal", MoveBaseActionGoal, self._on_goal, queue_size=5),
        ]
        self._timer = rospy.Timer(rospy.Duration(1.0 / params.rate), self._on_timer, reset=True)

    def close(self) -> None:
        """Ends the watch."""
        self._timer.shutdown()
        if self._exit is not None:
            self._exit.close()

    def _on_map(self, message: OccupancyGridArray, where: str) -> None:
        try:
            grid = grid_from_message(message)
        except CodedError as error:
            rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: map refused: {error}")
            return
        with self._lock:
            setattr(self, where, grid)
            self._workspace = None
            self._changed = True

    def _on_borders(self, message: VirtualBorderArray) -> None:
        known = [
            KnownBorder(
                border.name or border.id,
                array_from_points(border.points),
                np.array([border.seed.x, border.seed.y]),
                border.kind == VirtualBorder.POLYGON,
            )
            for border in message.borders
            if border.enabled and len(border.points) and (not border.robots or self._params.robot in border.robots)
        ]
        with self._lock:
            self._borders = known
            self._workspace = None

    def _on_goal(self, message: MoveBaseActionGoal) -> None:
        target = message.goal.target_pose
        if target.header.frame_id.lstrip("/") != names.MAP_FRAME:
            return
        workspace = self._prepared()
        if workspace is None:
            return
        x, y, _ = pose_to_2d(target.pose)
        standing = workspace.standing((x, y))
        if standing is not Standing.FREE and workspace.is_hard((x, y)):
            where = "lies inside" if standing is Standing.INSIDE else "is too close to"
            border = _quoted(workspace.names_at((x, y)))
            self._say(f"the goal of {self._who} at x {x:.2f} m, y {y:.2f} m {where} {border}")

    def _prepared(self) -> Optional[Workspace]:
        with self._lock:
            if self._workspace is None and self._map is not None and self._physical is not None:
                if not self._map.same_geometry(self._physical):
                    rospy.logwarn_throttle(10.0, f"{rospy.get_name()}: the maps with and without borders differ in "
                                                 "size, resolution or origin: nothing is watched")
                    return None
                self._workspace = Workspace(self._map, self._physical, self._borders, self._params.robot_radius)
            return self._workspace

    def _on_timer(self, _event: object) -> None:
        try:
            self._watch()
            self._updater.update()
        except rospy.ROSException:
            if not rospy.is_shutdown():
                raise

    def _watch(self) -> None:
        now = rospy.Time.now()
        workspace = self._prepared()
        if workspace is None:
            return
        try:
            T = self._transforms.lookup(names.MAP_FRAME, self._params.base_frame, rospy.Time(0), timeout_s=0.0)
        except CodedError:
            self._localised = False
            return
        self._localised = True
        x, y, _ = geometry.transform_pose2d(T)
        standing = workspace.standing((x, y))
        found = workspace.names_at((x, y)) if standing is not Standing.FREE else []
        if standing is not Standing.FREE and not found and self._nameless < self._params.rate:
            # the map came before the list of borders: the name is worth a moment
            self._nameless += 1
            return
        self._nameless = 0
        before, self._standing = self._standing, standing
        if standing is not before:
            if standing is Standing.INSIDE:
                self._say(f"{self._who} is inside {_quoted(found)}")
            elif standing is Standing.TOUCHES:
                self._say(f"the edge of {self._who} touches {_quoted(found)}")
            else:
                self._say(f"{self._who} has left {_quoted(self._inside)}")
            entered = standing.value > before.value and workspace.is_hard((x, y))
            if entered and self._cmd_vel is not None:
                self._cancel.publish(GoalID())
                self._stop_until = now + rospy.Duration(self._params.stop_s)
        if standing is not Standing.FREE:
            self._inside = found
        if self._exit is not None:
            self._let_out(workspace, standing, (x, y), now)
        if self._cmd_vel is not None and now < self._stop_until:
            if (self._stop_until - now).to_sec() > self._params.stop_s:
                self._stop_until = now  # time jumped back
            self._cmd_vel.publish(Twist())

    def _let_out(self, workspace: Workspace, standing: Standing, place: Tuple[float, float], now: rospy.Time) -> None:
        """Has the robot driven out if a new map restricts where it stands, and again if that was given up."""
        assert self._exit is not None
        if standing is Standing.FREE:
            self._exit.given_up = False
        if self._exit.active or not self._exit.given_up:
            self._retry_at = now + rospy.Duration(self._leave.retry)
        # time that jumped back must not make it wait for ever
        due_again = self._exit.given_up and not 0.0 < (self._retry_at - now).to_sec() <= self._leave.retry
        if not self._changed and not due_again:
            return
        with self._lock:
            if self._workspace is not workspace or self._map is None or self._physical is None:
                return  # the next look is at a newer map
            self._changed = False
            posterior, physical = self._map, self._physical
        due = standing is not Standing.FREE and workspace.is_hard(place)
        if due or self._exit.active:
            self._exit.set_maps(posterior, physical, workspace.hard_gap)
        if due:
            self._exit.begin(_quoted(self._inside))

    def _say(self, sentence: str) -> None:
        rospy.logwarn("%s: %s", rospy.get_name(), sentence)
        self._publisher.publish(String(sentence))

    def _diagnose(self, status: DiagnosticStatusWrapper) -> DiagnosticStatusWrapper:
        if self._workspace is None:
            status.summary(DiagnosticStatus.WARN, "no maps yet")
        elif not self._localised:
            status.summary(DiagnosticStatus.WARN, "the robot is not localised")
        elif self._standing is Standing.FREE:
            status.summary(DiagnosticStatus.OK, "keeps to the borders")
        elif self._standing is Standing.TOUCHES:
            status.summary(DiagnosticStatus.WARN, f"touches {_quoted(self._inside)}")
        else:
            status.summary(DiagnosticStatus.ERROR, f"is inside {_quoted(self._inside)}")
        status.add("policy", self._params.policy)
        if self._exit is not None:
            status.add("leaves by itself", str(self._exit.active))
            if self._exit.active:
                status.summary(DiagnosticStatus.WARN, f"leaves {_quoted(self._inside)}")
        return status


def _quoted(border_names: List[str]) -> str:
    return " and ".join(f"'{name}'" for name in border_names) if border_names else "a border without a name"


def build() -> WorkspaceMonitorNode:
    """Reads the parameters and makes the node."""
    return WorkspaceMonitorNode(
        parameters.read(MonitorParams, "~", ignore=_GROUPS),
        parameters.read(LeaveParams, "~leave"),
        parameters.read(SafetyParams, "~safety"),
    )
