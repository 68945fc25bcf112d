"""One robot as the dispatcher sees it: where it is, and its move_base action. Nothing here waits."""

from __future__ import annotations

from typing import Optional, Set, Tuple

import actionlib
import rospy
from actionlib_msgs.msg import GoalID, GoalStatus
from move_base_msgs.msg import MoveBaseAction, MoveBaseGoal
from sensor_msgs.msg import CameraInfo

from vb_core import geometry
from vb_core.errors import CodedError
from vb_core.names import MAP_FRAME
from vb_core.poses import Pose
from vb_core.robot_profile import RobotProfile
from vb_core.ros.cameras import camera_from_info
from vb_core.ros.messages import message_from_pose2d
from vb_core.ros.transforms import TransformLookup
from vb_robot.dispatching.dispatch_policy import RobotStatus, SentGoalState
from vb_robot.dispatching.viewpoint import Viewpoint
from vb_robot.floor_view import FloorView

# without a status message for this long navigation counts as gone: it sends five a second
SILENCE = rospy.Duration(2.0)
RUNNING = (GoalStatus.PENDING, GoalStatus.ACTIVE)
OUTCOMES = {
    GoalStatus.PENDING: SentGoalState.SENT,
    GoalStatus.SUCCEEDED: SentGoalState.REACHED,
    GoalStatus.PREEMPTED: SentGoalState.PREEMPTED,
    GoalStatus.RECALLED: SentGoalState.PREEMPTED,
    GoalStatus.ABORTED: SentGoalState.FAILED,
    GoalStatus.REJECTED: SentGoalState.FAILED,
    GoalStatus.LOST: SentGoalState.FAILED,
}


class RobotClient:
    """One robot; its name, if it has one, precedes its frame and its action.

    Sends one goal at a time to an action server that may be absent, die and come back.

    Action client:
        [<name>/]move_base (move_base_msgs/MoveBaseAction)

    Attributes:
        view: what its camera sees of the floor, once that is known.
    """

    def __init__(self, name: str, profile: RobotProfile, transforms: TransformLookup) -> None:
        prefix = f"{name}/" if name else ""
        self.name = name
        self._who = f"robot {name}" if name else "the robot"
        self._base_frame, self._transforms = prefix + profile.frames.base, transforms
        self._max_range = profile.camera.max_range
        self.view: Optional[FloorView] = None
        self._camera = rospy.Subscriber(prefix + profile.camera.info, CameraInfo, self._on_info, queue_size=1)
        self._lens: Optional[Tuple[Tuple[float, ...], str]] = None  # of the view: K and frame
        self._goal: Optional[Viewpoint] = None
        self._sent: Set[str] = set()  # ids of goals
        self._client = actionlib.ActionClient(f"{prefix}move_base", MoveBaseAction)
        self._handle: Optional[actionlib.ClientGoalHandle] = None
        self._status_seen: Optional[object] = None
        self._heard = rospy.Time(0)

    def _on_info(self, message: CameraInfo) -> None:
        lens = tuple(message.K), message.header.frame_id
        if lens == self._lens:
            return
        try:
            T = self._transforms.lookup(self._base_frame, message.header.frame_id, rospy.Time(0), timeout=0.0)
            self.view, self._lens = FloorView(camera_from_info(message), T, self._max_range), lens
        except CodedError as error:
            rospy.logwarn_throttle(30.0, f"{rospy.get_name()}: the view of {self._who}'s camera is not known: {error}")

    def set_goal(self, goal: Optional[Viewpoint]) -> None:
        """Sends it to a new goal, which replaces the one before; without one the last is cancelled if it still runs."""
        if goal is self._goal:
            return
        self._goal = goal
        if goal is not None:
            message = MoveBaseGoal()
            message.target_pose.header.frame_id, message.target_pose.header.stamp = MAP_FRAME, rospy.Time.now()
            message.target_pose.pose = message_from_pose2d(*goal.pose)
            self._handle = self._client.send_goal(message)
            self._sent.add(self._handle.comm_state_machine.action_goal.goal_id.id)
            rospy.loginfo("%s: %s is sent to x %.2f m, y %.2f m, yaw %.2f rad", rospy.get_name(), self._who, *goal.pose)
        elif self._handle is not None and self._goal_status() in (SentGoalState.SENT, SentGoalState.ACTIVE):
            self._handle.cancel()
            self._handle = None
            rospy.loginfo("%s: the goal of %s is cancelled", rospy.get_name(), self._who)

    # ------------------------------------------------------------- how it is
    def status(self, wanted: bool) -> RobotStatus:
        """Returns how the robot is now; its pose only if a robot is wanted. To be called regularly."""
        status = self._client.last_status_msg
        running = {goal.goal_id.id for goal in (status.status_list if status else ()) if goal.status in RUNNING}
        others = running - self._sent
        node = rospy.get_name()
        for goal in others:
            if goal.startswith(f"{node}-"):  # as actionlib begins a node's ids: of a process that died
                # again each time: while publishers are being connected a message may be lost
                self._client.pub_cancel.publish(GoalID(id=goal))
                rospy.logwarn_throttle(5.0, f"{node}: cancels a goal that {self._who} has from before a restart")
        return RobotStatus(self._pose() if wanted else None, self._alive(), self._goal_status(), bool(others))

    def _pose(self) -> Optional[Pose]:
        """Looks up the robot's pose; None if it is not localised."""
        try:
            T = self._transforms.lookup(MAP_FRAME, self._base_frame, rospy.Time(0), timeout=0.0)
        except CodedError as error:
            rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: {self._who} is not localised: {error}")
            return None
        return geometry.pose2d_from_transform(T)

    def _alive(self) -> bool:
        """Returns whether navigation is responding: connected, and heard of lately."""
        now = rospy.Time.now()
        status = self._client.last_status_msg
        if status is not None and status is not self._status_seen:
            self._status_seen, self._heard = status, now
        self._heard = min(self._heard, now)  # time may jump back
        return status is not None and now - self._heard < SILENCE and self._client.pub_goal.get_num_connections() > 0

    def _goal_status(self) -> SentGoalState:
        """Returns the state of the goal that was sent last."""
        if self._handle is None:
            return SentGoalState.NONE
        # known before the result arrives, which may be lost with the server
        return OUTCOMES.get(self._handle.get_goal_status(), SentGoalState.ACTIVE)
