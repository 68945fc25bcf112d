"""A robot that is sent to positions from which its camera sees the spot: its view and its goal. Nothing here blocks."""

from __future__ import annotations

from typing import Optional, Set, Tuple

import rospy
from actionlib_msgs.msg import GoalStatus
from sensor_msgs.msg import CameraInfo

from vb_core.errors import CodedError
from vb_core.robot_profile import RobotProfile
from vb_core.ros.cameras import camera_from_info
from vb_core.ros.transforms import TransformLookup
from vb_robot.dispatching.dispatch_policy import DispatchStatus, SentGoalState
from vb_robot.dispatching.viewpoint import Viewpoint
from vb_robot.dispatching.floor_view import FloorView
from vb_robot.monitoring.watched_robot import WatchedRobot
from vb_robot.monitoring.navigation_wiring import within

MARK = "-looks-"  # part of the goals' ids, so that goals of a process that died are recognised
OUTCOMES = {
    GoalStatus.PENDING: SentGoalState.SENT,
    GoalStatus.SUCCEEDED: SentGoalState.REACHED,
    GoalStatus.PREEMPTED: SentGoalState.PREEMPTED,
    GoalStatus.RECALLED: SentGoalState.PREEMPTED,
    GoalStatus.ABORTED: SentGoalState.FAILED,
    GoalStatus.REJECTED: SentGoalState.FAILED,
    GoalStatus.LOST: SentGoalState.FAILED,
}


def follow(state: SentGoalState, status: Optional[int]) -> SentGoalState:
    """Returns a goal's new state, from its status in navigation; None if navigation does not know the goal."""
    if not state.under_way:
        return state
    if status is None:  # the goal has not arrived yet, or navigation was restarted
        return SentGoalState.FAILED if state is SentGoalState.ACTIVE else state
    return OUTCOMES.get(status, SentGoalState.ACTIVE)


class DispatchedRobot:
    """Sends a watched robot to one goal at a time; its navigation may be absent, die and restart.

    Attributes:
        view: its camera's view of the floor; None until it is known.
    """

    def __init__(self, robot: WatchedRobot, profile: RobotProfile, transforms: TransformLookup) -> None:
        self._robot, self._transforms = robot, transforms
        self._max_range = profile.camera.max_range
        self.view: Optional[FloorView] = None
        self._lens: Optional[Tuple[Tuple[float, ...], str]] = None  # of the view: K and frame
        self._goal: Optional[Viewpoint] = None
        self._state = SentGoalState.NONE
        self._sent_ids: Set[str] = set()
        self._goal_id = ""  # of the newest goal
        self._camera = rospy.Subscriber(
            within(robot.name, profile.camera.info), CameraInfo, self._on_info, queue_size=1
        )

    def _on_info(self, message: CameraInfo) -> None:
        lens = tuple(message.K), message.header.frame_id
        if lens == self._lens:
            return
        try:
            T = self._transforms.lookup(self._robot.frame, message.header.frame_id, rospy.Time(0), timeout=0.0)
            self.view, self._lens = FloorView(camera_from_info(message), T, self._max_range), lens
        except CodedError as error:
            camera = f"the camera of {self._robot.frame}"
            rospy.logwarn_throttle(30.0, f"{rospy.get_name()}: the view of {camera} is not known: {error}")

    def set_goal(self, goal: Optional[Viewpoint]) -> None:
        """Sends it to a new goal, which replaces the previous one; None cancels the previous one if it is active."""
        if goal is self._goal:
            return
        self._goal = goal
        if goal is not None:
            self._goal_id, self._state = self._robot.send(goal.pose, MARK), SentGoalState.SENT
            self._sent_ids.add(self._goal_id)
        elif self._state.under_way:
            self._robot.cancel_goals(self._goal_id)
            self._state = SentGoalState.NONE
            rospy.loginfo("%s: the goal of %s is cancelled", rospy.get_name(), self._robot.frame)

    def status(self, wanted: bool) -> DispatchStatus:
        """Returns the robot's status, with its pose only if a robot is wanted. Must be called regularly."""
        goals = self._robot.goals
        self._state = follow(self._state, goals.get(self._goal_id))
        running_states = GoalStatus.PENDING, GoalStatus.ACTIVE
        foreign_goals = {goal_id for goal_id, status in goals.items() if status in running_states} - self._sent_ids
        for goal_id in foreign_goals:
            if goal_id.startswith(rospy.get_name() + MARK):
                # repeated, because a message may be lost while publishers are being connected
                self._robot.cancel_goals(goal_id)
                rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: cancels a goal from before a restart: {goal_id}")
        if wanted:
            self._robot.locate()
        pose = self._robot.pose if wanted else None
        return DispatchStatus(pose, self._robot.is_navigating(), self._state, bool(foreign_goals))
