"""Sends a robot to a goal through move_base and records the path that it truly drove."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import List, Tuple

import actionlib
import numpy as np
import rospy
from actionlib_msgs.msg import GoalStatus
from move_base_msgs.msg import MoveBaseAction, MoveBaseGoal

from vb_core import names
from vb_core.geometry import Pose
from vb_core.ros.messages import message_from_pose2d
from vb_core.ros.node import wait_until
from vb_msgs.msg import LabState

GOAL_RADIUS = 0.5  # [m] above navigation's tolerance and localisation error (0.1 each), below a false report's (metres)
WALL_TIMEOUT = 600.0  # [s] of wall time, however slow the simulation
FALSE_REPORTS = 2  # a goal is sent again until navigation has reported falsely this often
OUTCOMES = {
    GoalStatus.SUCCEEDED: "reached",
    GoalStatus.ABORTED: "refused",
    GoalStatus.REJECTED: "refused",
    GoalStatus.PREEMPTED: "cancelled",
    GoalStatus.RECALLED: "cancelled",
}


@dataclass(frozen=True)
class GoalOutcome:
    """The outcome of a goal.

    Attributes:
        outcome: "reached", "refused", "cancelled", "time_is_up", "no_navigation", or "not_there" if navigation kept
            reporting that the goal is reached when it was not.
        text: navigation's own words.
        path: (N, 2) [m] true path of the robot's centre, map frame.
        seconds: simulated time that the drive took.
        false_reports: how often navigation falsely reported the goal as reached, and was sent it again: move_base may
            still hold a plan to its last goal (ros-planning/navigation, issue 949).
    """

    outcome: str
    text: str = ""
    path: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    seconds: float = 0.0
    false_reports: int = 0


class GoalRunner:
    """Sends goals to the simulated lab's only robot, one at a time."""

    def __init__(self) -> None:
        self._path: List[Tuple[float, float]] = []
        self._client = actionlib.SimpleActionClient("/move_base", MoveBaseAction)
        self._subscriber = rospy.Subscriber(names.LAB_STATE, LabState, self._on_lab, queue_size=10)

    def _on_lab(self, message: LabState) -> None:
        path = self._path
        for pose in message.robot_poses[:1]:
            if not path or math.dist(path[-1], (pose.x, pose.y)) > 1e-3:
                path.append((pose.x, pose.y))

    def drive(self, goal: Pose, timeout: float) -> GoalOutcome:
        """Sends the robot to a goal (x, y, yaw) [m, m, rad] and waits for the outcome.

        Args:
            timeout: [s] of simulated time after which the goal is cancelled.
        """
        if not wait_until(lambda: self._client.wait_for_server(rospy.Duration(0.2)), 30.0):
            return GoalOutcome("no_navigation")
        message = MoveBaseGoal()
        message.target_pose.header.frame_id = names.MAP_FRAME
        message.target_pose.header.stamp = rospy.Time.now()
        message.target_pose.pose = message_from_pose2d(*goal)
        self._path = []
        start = rospy.get_time()
        false_reports = 0
        while True:
            self._client.send_goal(message)
            wait_until(lambda: self._client.get_state() in OUTCOMES or rospy.get_time() - start > timeout, WALL_TIMEOUT)
            state = self._client.get_state()
            is_false_report = state == GoalStatus.SUCCEEDED and not wait_until(lambda: self._is_near(goal), 1.0)
            if not is_false_report or false_reports == FALSE_REPORTS:
                break
            false_reports += 1
        outcome = "not_there" if is_false_report else OUTCOMES.get(state, "time_is_up")
        text = self._client.get_goal_status_text()
        seconds = rospy.get_time() - start
        if state not in OUTCOMES:
            self._client.cancel_goal()
        path = np.array(list(self._path), dtype=float).reshape(-1, 2)
        return GoalOutcome(outcome, text, path, seconds, false_reports)

    def _is_near(self, goal: Pose) -> bool:
        return bool(self._path) and math.dist(self._path[-1], goal[:2]) < GOAL_RADIUS
