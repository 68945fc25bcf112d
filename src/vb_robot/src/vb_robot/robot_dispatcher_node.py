"""Sends a robot to where its own camera sees the spot (paper, Sect. 4.2, states Border and Seed)."""
from __future__ import annotations

import functools
import threading
from typing import Callable, Dict, Mapping, Tuple

import rospy
from geometry_msgs.msg import PoseStamped

from vb_core import names
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.robot_profile import RobotProfile
from vb_core.ros import node, parameters, robot_profile
from vb_core.ros.messages import OccupancyGridArray, array_from_points, grid_from_message, pose_from_2d
from vb_core.ros.notices import NoticePublisher
from vb_core.ros.transforms import TransformLookup
from vb_msgs.msg import BorderProgress, InteractionState
from vb_robot.dispatching.dispatch import Kind
from vb_robot.dispatching.dispatched_robot import DispatchedRobot
from vb_robot.dispatching.dispatcher import Dispatcher, Progress, WatchParams
from vb_robot.inputs import SpotListener
from vb_robot.spots import BORDER, SEED
from vb_robot.dispatching.viewpoint import Viewpoint

PERIOD = 0.25  # [s] between two decisions: the spot moves 0.1 m at most in that time


class RobotDispatcherNode:
    """Watches spot and state, and sends goals to the navigation of one robot at a time.

    Subscribed topics:
        /virtual_borders/spots (vb_msgs/LaserSpot), /virtual_borders/state (vb_msgs/InteractionState),
        /virtual_borders/progress (vb_msgs/BorderProgress)
        /virtual_borders/map, /map (nav_msgs/OccupancyGrid): where a robot may stand, what hides the spot
        <robot>/virtual_borders/map (nav_msgs/OccupancyGrid): the map of a robot with a name, once it arrives
        [<robot>/]camera_info (sensor_msgs/CameraInfo), tf: what its camera sees of the floor
        /virtual_borders/coverage (nav_msgs/OccupancyGrid): optional; floor that no stationary camera sees
    Published topics:
        ~viewpoint (geometry_msgs/PoseStamped, latched): where a robot was sent last
        /virtual_borders/notices (vb_msgs/NoticeArray): when no camera sees the spot, and what follows
    Actions called:
        [<robot>/]move_base (move_base_msgs/MoveBaseAction)
    Parameters:
        ~* WatchParams; robot_profile in each robot's namespace
    """

    def __init__(self, dispatcher: Dispatcher, profiles: Mapping[str, RobotProfile]) -> None:
        self._dispatcher = dispatcher
        self._goals = threading.Lock()  # held while goals are sent or cancelled with the state
        self._reasons: Dict[str, str] = {}
        transforms = TransformLookup()
        self._viewpoint = rospy.Publisher("~viewpoint", PoseStamped, queue_size=1, latch=True)
        self._notices = NoticePublisher()
        self._robots = [
            DispatchedRobot(name, profiles[name], transforms, dispatcher.set_view) for name in dispatcher.robots
        ]
        grids = [
            (names.MAP_WITH_BORDERS, dispatcher.set_map),
            (names.PHYSICAL_MAP, dispatcher.set_physical_map),
            (names.COVERAGE, dispatcher.set_coverage),
        ]
        for name in filter(None, dispatcher.robots):
            grids.append((f"{name}{names.MAP_WITH_BORDERS}", functools.partial(dispatcher.set_map, robot=name)))
        self._subscribers = [
            *(rospy.Subscriber(topic, OccupancyGridArray, self._on_grid, take, queue_size=1) for topic, take in grids),
            rospy.Subscriber(names.STATE, InteractionState, self._on_state, queue_size=10),
            SpotListener(dispatcher.add),
            rospy.Subscriber(names.PROGRESS, BorderProgress, self._on_progress, queue_size=1),
        ]
        self._beat = node.Beat(PERIOD)
        self._worker = node.Worker(self._beat, lambda _woken: self._decide())

    def close(self) -> None:
        """Cancels every goal: nothing would supervise it any more."""
        self._beat.close()
        self._notices.close()
        for robot in self._robots:
            robot.cancel()

    # ------------------------------------------------------------- callbacks: only store
    def _on_grid(self, message: OccupancyGridArray, take: Callable[[GridMap], None]) -> None:
        try:
            take(grid_from_message(message))
        except CodedError as error:
            rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: map refused: {error}")

    def _on_state(self, message: InteractionState) -> None:
        changed = self._dispatcher.set_state(message.state, message.interaction_id, message.entered.to_sec())
        if not changed:
            return
        rospy.loginfo("%s: state %s", rospy.get_name(), message.name)
        if message.state not in (BORDER, SEED):
            # this cannot wait for the next decision: the robots have to stop
            with self._goals:
                for robot in self._robots:
                    robot.cancel()

    def _on_progress(self, message: BorderProgress) -> None:
        self._dispatcher.set_progress(Progress(
            message.interaction_id, array_from_points(message.chain), bool(message.closed),
            array_from_points(message.points), tuple(message.cameras)))

    # ------------------------------------------------------------- decisions
    def _decide(self) -> None:
        key = self._dispatcher.key
        wanted = self._dispatcher.wanted()
        robots = {robot.name: robot.status(wanted) for robot in self._robots}
        decisions = self._dispatcher.decide(rospy.Time.now().to_sec(), robots)
        for robot in self._robots:
            decision = decisions[robot.name]
            if decision.kind is Kind.CANCEL:
                robot.cancel()
            elif decision.kind is Kind.SEND and decision.viewpoint is not None:
                self._send(robot, decision.viewpoint, key)
            if decision.reason != self._reasons.get(robot.name):
                self._reasons[robot.name] = decision.reason
                rospy.loginfo("%s: %s: %s: %s", rospy.get_name(), robot.who, decision.kind.value, decision.reason)
        self._notices.set([self._dispatcher.notice] if self._dispatcher.notice else [])

    def _send(self, robot: DispatchedRobot, viewpoint: Viewpoint, key: Tuple[str, int]) -> None:
        pose = viewpoint.pose
        with self._goals:
            if self._dispatcher.key != key:
                return  # the state has ended meanwhile
            robot.send(pose)
        message = PoseStamped()
        message.header.stamp = rospy.Time.now()
        message.header.frame_id = names.MAP_FRAME
        message.pose = pose_from_2d(*pose)
        self._viewpoint.publish(message)
        rospy.loginfo("%s: %s is sent to x %.2f m, y %.2f m, yaw %.2f rad", rospy.get_name(), robot.who, *pose)


def build() -> RobotDispatcherNode:
    """Reads the parameters and makes the node."""
    watch = parameters.read(WatchParams, "~")
    profiles = {name: robot_profile.read(name) for name in watch.robots or [""]}
    return RobotDispatcherNode(
        Dispatcher(watch, {name: profile.radius for name, profile in profiles.items()}), profiles)
