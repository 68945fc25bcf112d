"""The move_base action as the dispatcher uses it: nothing here waits."""
from __future__ import annotations

from collections import deque
from typing import Deque, List, Optional, Tuple

import actionlib
import rospy
from actionlib import CommState
from actionlib_msgs.msg import GoalID, GoalStatus as StatusMessage
from move_base_msgs.msg import MoveBaseAction, MoveBaseActionGoal, MoveBaseGoal

from vb_core.names import MAP_FRAME
from vb_core.ros.messages import pose_from_2d, pose_to_2d
from vb_robot.dispatching.dispatch import GoalStatus
from vb_robot.dispatching.viewpoint import Pose

_FAILED = (StatusMessage.ABORTED, StatusMessage.REJECTED, StatusMessage.LOST)
_CALLED_OFF = (StatusMessage.PREEMPTED, StatusMessage.RECALLED)


class NavigationClient:
    """Sends one goal at a time to an action server that may be absent, die and come back.

    Args:
        name: of the action, relative to the node's namespace.
        silence_s: [s] without a status message after which the server counts as gone.
    """

    def __init__(self, name: str = "move_base", silence_s: float = 2.0) -> None:
        self._client = actionlib.ActionClient(name, MoveBaseAction)
        self._silence = rospy.Duration(silence_s)
        self._handle: Optional[actionlib.ClientGoalHandle] = None
        self._cancelled = False
        self._status_seen: Optional[object] = None
        self._heard = rospy.Time(0)
        self._known: Deque[str] = deque(maxlen=100)  # ids of goals that are this client's own
        self._newest_goal: Optional[MoveBaseActionGoal] = None
        self._goals = rospy.Subscriber(f"{name}/goal", MoveBaseActionGoal, self._on_goal, queue_size=5)

    def _on_goal(self, message: MoveBaseActionGoal) -> None:
        self._newest_goal = message

    def alive(self) -> bool:
        """Whether the server is there: connected, and heard of lately. To be asked regularly."""
        now = rospy.Time.now()
        status = self._client.last_status_msg
        if status is not None and status is not self._status_seen:
            self._status_seen, self._heard = status, now
        if self._heard > now:  # time jumped back
            self._heard = now
        fresh = status is not None and now - self._heard < self._silence
        return fresh and self._client.pub_goal.get_num_connections() > 0

    def send(self, pose: Pose) -> None:
        """Sends the robot to a pose (x, y, yaw), map frame; a goal that still runs is replaced by it."""
        goal = MoveBaseGoal()
        goal.target_pose.header.frame_id = MAP_FRAME
        goal.target_pose.header.stamp = rospy.Time.now()
        goal.target_pose.pose = pose_from_2d(*pose)
        self._cancelled = False
        self._handle = self._client.send_goal(goal)
        self._known.append(self._goal_id(self._handle))

    def cancel(self) -> None:
        """Calls the goal off, if there is one."""
        if self._handle is not None and self.status() in (GoalStatus.SENT, GoalStatus.ACTIVE):
            self._cancelled = True
            self._handle.cancel()

    def cancel_leftovers(self) -> int:
        """Cancels goals that an earlier process of this node sent before it died; gives how many."""
        left = [goal for goal in self._running() if goal not in self._known and goal.startswith(f"{rospy.get_name()}-")]
        for goal in left:
            self._known.append(goal)
            self._client.pub_cancel.publish(GoalID(id=goal))
        return len(left)

    def _running(self) -> List[str]:
        """The ids of the goals that the server works on, no matter who gave them."""
        status = self._client.last_status_msg
        entries = status.status_list if status is not None else []
        running = (StatusMessage.PENDING, StatusMessage.ACTIVE)
        return [entry.goal_id.id for entry in entries if entry.status in running]

    def busy(self) -> bool:
        """Whether it drives to a goal that somebody else gave."""
        return any(goal not in self._known for goal in self._running())

    def goal_place(self) -> Optional[Tuple[float, float]]:
        """(x, y) [m], map frame, where it drives to, no matter who gave the goal; None if nowhere that is known."""
        goal = self._newest_goal
        if goal is None or goal.goal_id.id not in self._running():
            return None
        target = goal.goal.target_pose
        return pose_to_2d(target.pose)[:2] if target.header.frame_id.lstrip("/") == MAP_FRAME else None

    def status(self) -> GoalStatus:
        """What became of the goal that was sent last."""
        if self._handle is None or self._cancelled:
            return GoalStatus.NONE
        state = self._handle.get_comm_state()
        if state == CommState.WAITING_FOR_GOAL_ACK:
            return GoalStatus.SENT
        # the terminal status is known before the result arrives, and the result may be lost with the server
        code = self._handle.get_terminal_state() if state == CommState.DONE else self._handle.get_goal_status()
        if code == StatusMessage.SUCCEEDED:
            return GoalStatus.REACHED
        if code in _FAILED:
            return GoalStatus.FAILED
        if code in _CALLED_OFF:
            return GoalStatus.TAKEN
        return GoalStatus.ACTIVE

    @staticmethod
    def _goal_id(handle: actionlib.ClientGoalHandle) -> str:
        return handle.comm_state_machine.action_goal.goal_id.id
