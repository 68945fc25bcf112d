"""Replaces move_base: the same action, services, and topics of costmap and plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, Optional

import actionlib
import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped, Twist
from move_base_msgs.msg import MoveBaseAction, MoveBaseActionGoal, MoveBaseGoal, MoveBaseResult
from nav_msgs.msg import Path
from nav_msgs.srv import GetPlan, GetPlanResponse
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Header
from std_srvs.srv import Empty, EmptyResponse

from vb_core import geometry, names
from vb_core.errors import CodedError
from vb_core.geometry import Pose
from vb_core.parameters import Parameters, param
from vb_core.robot_profile import RobotProfile
from vb_core.ros import messages, node, parameters, robot_profile
from vb_core.ros.transforms import TransformLookup
from vb_sim.robot.navigator import Navigator

MAPS = (names.MAP_WITH_BORDERS, names.MAP_WITH_MARGIN)
_PERIOD = 0.1  # [s] between commands; a shorter period uses more processor time, but drives no better at 0.5 m/s


@dataclass(frozen=True)
class NavigationParams(Parameters):
    """The node's own parameters."""

    prefix: str = param("")


class NavigationNode:
    """Plans paths on the map with the virtual borders, and drives along them.

    Subscribed topics:
        /virtual_borders/map (nav_msgs/OccupancyGrid): the static map of both costmaps
        robot_driver/keep_out (nav_msgs/OccupancyGrid): the map with borders inflated by the localisation uncertainty;
            optional
        scan (sensor_msgs/LaserScan): only while driving
        move_base_simple/goal (geometry_msgs/PoseStamped)
        /tf, /tf_static (tf2_msgs/TFMessage): map -> base_link
    Actions:
        move_base (move_base_msgs/MoveBaseAction)
    Services:
        move_base/make_plan (nav_msgs/GetPlan): refused while a goal is active; the plan is empty if there is no path
        move_base/clear_costmaps (std_srvs/Empty): removes the scanner's obstacles, but not the map or borders
    Published topics:
        cmd_vel (geometry_msgs/Twist): only while a goal is active, and a zero command at its end
        move_base/NavfnROS/plan (nav_msgs/Path)
        move_base/global_costmap/costmap (nav_msgs/OccupancyGrid, latched)
        move_base/goal (move_base_msgs/MoveBaseActionGoal): goals received on move_base_simple/goal
    Parameters:
        ~prefix: of the names of the robot's frames
        robot_profile: in the robot's namespace
    """

    def __init__(self, profile: RobotProfile, prefix: str) -> None:
        self._base_frame = prefix + profile.frames.base
        self._navigator = Navigator(profile)
        self._obstacles = np.zeros((0, 2))  # (N, 2) [m] of the newest scan, robot's frame; replaced as a whole
        self._mount: Optional[np.ndarray] = None  # T_base_laser
        self._driving = False
        self._transforms = TransformLookup()
        self._cmd_vel = rospy.Publisher("cmd_vel", Twist, queue_size=1)
        self._plan = rospy.Publisher("~NavfnROS/plan", Path, queue_size=1, latch=True)
        self._global = rospy.Publisher("~global_costmap/costmap", messages.NumpyOccupancyGrid, queue_size=1, latch=True)
        self._goals = rospy.Publisher("move_base/goal", MoveBaseActionGoal, queue_size=1)
        self._static: Dict[str, messages.NumpyOccupancyGrid] = {}  # by topic
        self._maps: node.Mailbox = node.Mailbox()  # topics of the maps that have arrived
        self._worker = node.Worker(self._maps, self._update_costmap)
        for topic in MAPS:
            rospy.Subscriber(topic, messages.NumpyOccupancyGrid, self._on_map, topic, queue_size=1, buff_size=2**24)
        rospy.Service("~make_plan", GetPlan, self._on_make_plan)
        rospy.Service("~clear_costmaps", Empty, self._on_clear)
        self._server = actionlib.SimpleActionServer("move_base", MoveBaseAction, self._execute, auto_start=False)
        self._server.start()
        rospy.Subscriber("move_base_simple/goal", PoseStamped, self._on_simple_goal, queue_size=1)

    def close(self) -> None:
        """Stops the robot."""
        if self._driving:
            self._cmd_vel.publish(Twist())
        self._maps.close()

    # ------------------------------------------------------------ maps
    def _on_map(self, message: messages.NumpyOccupancyGrid, topic: str) -> None:
        self._static[topic] = message
        self._maps.put(topic)

    def _update_costmap(self, _topic: str) -> None:
        borders, keep_out = (self._static.get(topic) for topic in MAPS)
        if borders is None:
            return
        grid = messages.grid_from_message(borders)
        with_margin = messages.grid_from_message(keep_out) if keep_out is not None else grid
        if with_margin.same_geometry(grid):
            grid = grid.with_data(np.maximum(grid.data, with_margin.data))  # as static_layer with use_maximum
        occupancy = grid.with_data(self._navigator.set_map(grid).occupancy())
        self._global.publish(messages.message_from_grid(occupancy, rospy.Time.now()))

    # ------------------------------------------------------------ scan and pose
    def _on_scan(self, message: LaserScan) -> None:
        if self._mount is None:
            try:
                self._mount = self._transforms.lookup(self._base_frame, message.header.frame_id, rospy.Time(0))
            except CodedError as error:
                rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: scan ignored: {error}")
                return
        ranges = np.asarray(message.ranges, dtype=float)
        angles = message.angle_min + message.angle_increment * np.arange(len(ranges))
        valid = np.isfinite(ranges) & (ranges >= message.range_min) & (ranges <= message.range_max)
        ranges = ranges[valid]
        angles = angles[valid]
        x, y = ranges * np.cos(angles), ranges * np.sin(angles)
        points = np.column_stack([x, y, np.zeros(len(ranges))])
        self._obstacles = geometry.transform_points(self._mount, points)[:, :2]

    def _pose(self) -> Pose:
        T = self._transforms.lookup(names.MAP_FRAME, self._base_frame, rospy.Time(0), 0.5)
        return geometry.pose2d_from_transform(T)

    def _to_map_frame(self, pose: PoseStamped) -> Pose:
        """Returns a pose in the map frame. Raises CodedError "bad_goal" or "no_transform"."""
        pose2d = messages.pose2d_from_message(pose.pose)
        if not np.isfinite(pose2d).all():
            raise CodedError("bad_goal", "the goal's pose is not finite")
        frame = pose.header.frame_id.lstrip("/")
        if frame == names.MAP_FRAME:
            return pose2d
        T = self._transforms.lookup(names.MAP_FRAME, frame, rospy.Time(0))
        return geometry.pose2d_from_transform(T @ geometry.transform_from_pose2d(*pose2d))

    # ------------------------------------------------------------ services and the simple topic
    def _on_make_plan(self, request: GetPlan) -> GetPlanResponse:
        if self._driving:
            raise rospy.ServiceException("move_base must be in an inactive state to make a plan for an external user")
        response = GetPlanResponse()
        try:
            start = self._to_map_frame(request.start) if request.start.header.frame_id else self._pose()
            goal = self._to_map_frame(request.goal)
            planner = self._navigator.planner_on_map()
            start_point, goal_point = np.array(start[:2]), np.array(goal[:2])
            path = planner.plan(start_point, goal_point, max(request.tolerance, 0.0))
            response.plan = path_message(path, goal[2])
        except CodedError as error:
            rospy.loginfo("%s: make_plan: %s", rospy.get_name(), error)
        return response

    def _on_clear(self, _request: Empty) -> EmptyResponse:
        self._obstacles = np.zeros((0, 2))
        return EmptyResponse()

    def _on_simple_goal(self, pose: PoseStamped) -> None:
        goal = MoveBaseActionGoal(goal=MoveBaseGoal(target_pose=pose))
        goal.header.stamp = rospy.Time.now()
        self._goals.publish(goal)

    # ------------------------------------------------------------ driving
    def _execute(self, goal: MoveBaseGoal) -> None:
        self._driving = True
        scan = rospy.Subscriber("scan", LaserScan, self._on_scan, queue_size=1, tcp_nodelay=True)
        try:
            self._drive(self._to_map_frame(goal.target_pose))
        except CodedError as error:
            rospy.logwarn("%s: goal aborted: %s", rospy.get_name(), error)
            self._server.set_aborted(MoveBaseResult(), str(error))
        except rospy.ROSException:
            if not rospy.is_shutdown():
                raise
        finally:
            scan.unregister()
            self._obstacles = np.zeros((0, 2))
            self._driving = False
            if not rospy.is_shutdown():
                self._cmd_vel.publish(Twist())

    def _drive(self, goal: Pose) -> None:
        """Drives to a goal until it is reached or preempted. Raises CodedError that says why it cannot be reached."""
        drive = self._navigator.begin(goal)
        while not rospy.is_shutdown():
            if self._server.is_preempt_requested():
                self._server.set_preempted(MoveBaseResult(), "the goal was cancelled or replaced")
                return
            now = rospy.Time.now().to_sec()
            motion = drive.step(now, self._pose(), self._obstacles, _PERIOD)
            if motion.path is not None:
                self._plan.publish(path_message(motion.path, goal[2]))
            if motion.arrived:
                self._server.set_succeeded(MoveBaseResult(), "the goal is reached")
                return
            command = Twist()
            command.linear.x, command.angular.z = motion.speed, motion.turn_rate
            self._cmd_vel.publish(command)
            rospy.sleep(_PERIOD)


def path_message(path: np.ndarray, goal_yaw: float) -> Path:
    """Converts a path (N, 2) [m] to a message. Poses face along the path, the last one in the goal's direction."""
    header = Header(0, rospy.Time.now(), names.MAP_FRAME)
    dx, dy = np.diff(path, axis=0).T
    yaws = np.append(np.arctan2(dy, dx), goal_yaw)
    message = Path(header=header)
    for (x, y), yaw in zip(path, yaws):
        message.poses.append(PoseStamped(header, messages.message_from_pose2d(x, y, yaw)))
    return message


def build() -> NavigationNode:
    """Reads the parameters and constructs the node."""
    return NavigationNode(robot_profile.read(), parameters.read(NavigationParams).prefix)
