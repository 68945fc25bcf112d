"""One robot that is sent to positions from which its camera sees the spot. Its methods do not block."""

from __future__ import annotations

from typing import Optional, Set, Tuple

import rospy
from actionlib_msgs.msg import GoalStatus
from sensor_msgs.msg import CameraInfo

from vb_core.errors import CodedError
from vb_core.robot_profile import RobotProfile
from vb_core.ros.images import camera_from_info
from vb_core.ros.transforms import TransformLookup
from vb_robot.dispatching.dispatch_policy import DispatchStatus, SentGoalState
from vb_robot.dispatching.viewpoint import RobotCameraView, Viewpoint
from vb_robot.monitoring.navigation_connections import resolve_name
from vb_robot.ros.watched_robot import WatchedRobot

GOAL_ID_MARK = "-looks-"  # part of all goals' ids, by which a new process recognises the goals of one that died
OUTCOMES = {
    GoalStatus.PENDING: SentGoalState.SENT,
    GoalStatus.SUCCEEDED: SentGoalState.REACHED,
    GoalStatus.PREEMPTED: SentGoalState.PREEMPTED,
    GoalStatus.RECALLED: SentGoalState.PREEMPTED,
    GoalStatus.ABORTED: SentGoalState.FAILED,
    GoalStatus.REJECTED: SentGoalState.FAILED,
    GoalStatus.LOST: SentGoalState.FAILED,
}


def next_goal_state(state: SentGoalState, status: Optional[int]) -> SentGoalState:
    """Returns a goal's new state, from its status in navigation; None if navigation does not know the goal."""
    if not state.is_running:
        return state
    if status is None:  # the goal has not arrived yet, or navigation was started again
        return SentGoalState.FAILED if state is SentGoalState.ACTIVE else state
    return OUTCOMES.get(status, SentGoalState.ACTIVE)


class DispatchedRobot:
    """Sends a watched robot to one goal at a time. Its navigation may be absent, die and come back.

    Attributes:
        view: its camera's view of the floor; None until it is known.
    """

    def __init__(self, robot: WatchedRobot, profile: RobotProfile, transforms: TransformLookup) -> None:
        self._robot, self._transforms = robot, transforms
        self._max_range = profile.camera.max_range
        self.view: Optional[RobotCameraView] = None
        self._lens: Optional[Tuple[Tuple[float, ...], str]] = None  # K and frame of the view's camera
        self._goal: Optional[Viewpoint] = None
        self._state = SentGoalState.NONE
        self._sent_ids: Set[str] = set()
        self._last_id = ""
        camera_info = resolve_name(robot.name, profile.camera.info)
        self._camera = rospy.Subscriber(camera_info, CameraInfo, self._on_info, queue_size=1)

    def _on_info(self, message: CameraInfo) -> None:
        lens = tuple(message.K), message.header.frame_id
        if lens == self._lens:
            return
        try:
            # the camera's mount is published once, and may arrive after its first image
            T = self._transforms.lookup(self._robot.frame, message.header.frame_id, rospy.Time(0), timeout=2.0)
            self.view = RobotCameraView(camera_from_info(message), T, self._max_range)
            self._lens = lens
        except CodedError as error:
            camera = f"the camera of {self._robot.frame}"
            rospy.logwarn_throttle(30.0, f"{rospy.get_name()}: what {camera} sees is not known: {error}")

    def set_goal(self, goal: Optional[Viewpoint]) -> None:
        """Sends the robot to a new goal instead of the previous one. None cancels the previous one if it still runs."""
        if goal == self._goal:
            return
        self._goal = goal
        if goal is not None:
            self._last_id = self._robot.send_goal(goal.pose, GOAL_ID_MARK)
            self._state = SentGoalState.SENT
            self._sent_ids.add(self._last_id)
        elif self._state.is_running:
            self._robot.cancel_goals(self._last_id)
            self._state = SentGoalState.NONE
            rospy.loginfo("%s: the goal of %s is cancelled", rospy.get_name(), self._robot.frame)

    def status(self, wanted: bool) -> DispatchStatus:
        """Returns the robot's status, with its pose only if a robot is wanted. Call it regularly."""
        statuses = self._robot.goal_statuses
        self._state = next_goal_state(self._state, statuses.get(self._last_id))
        running = GoalStatus.PENDING, GoalStatus.ACTIVE
        running_ids = {goal_id for goal_id, status in statuses.items() if status in running}
        other_ids = running_ids - self._sent_ids
        for goal_id in other_ids:
            if goal_id.startswith(rospy.get_name() + GOAL_ID_MARK):
                # again and again, because a message may be lost while publishers are being connected
                self._robot.cancel_goals(goal_id)
                rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: cancels a goal from before a restart: {goal_id}")
        pose = self._robot.update_pose() if wanted else None
        return DispatchStatus(pose, self._robot.is_navigating(), self._state, is_busy=bool(other_ids))
