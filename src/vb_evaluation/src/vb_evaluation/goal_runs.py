"""Sends a robot to a goal through move_base and records the path that it truly drove."""
from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import List, Optional, Tuple

import actionlib
import numpy as np
import rospy
from actionlib_msgs.msg import GoalStatus
from move_base_msgs.msg import MoveBaseAction, MoveBaseGoal

from vb_core import names
from vb_core.geometry import chain_length
from vb_core.ros.messages import pose_from_2d
from vb_evaluation.observer import wait_until
from vb_msgs.msg import LabState

OUTCOMES = {GoalStatus.SUCCEEDED: "reached", GoalStatus.ABORTED: "refused", GoalStatus.REJECTED: "refused",
            GoalStatus.PREEMPTED: "cancelled", GoalStatus.RECALLED: "cancelled"}


@dataclass(frozen=True)
class Driven:
    """The outcome of a goal.

    Attributes:
        outcome: "reached", "refused", "cancelled", "time_is_up" or "no_navigation".
        text: navigation's own words.
        path: (N, 2) [m] where the robot's centre truly was, map frame.
        seconds: of simulated time.
    """

    outcome: str
    text: str = ""
    path: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    seconds: float = 0.0

    @property
    def length(self) -> float:
        """[m]"""
        return chain_length(self.path) if len(self.path) > 1 else 0.0


class GoalRunner:
    """Sends goals to one robot of the simulated lab, one at a time.

    Args:
        robot: its namespace; empty for the only one.
        index: of the robot in the world.
    """

    def __init__(self, robot: str = "", index: int = 0) -> None:
        self._index = index
        self._lock = threading.Lock()
        self._path: Optional[List[Tuple[float, float]]] = None
        self._client = actionlib.SimpleActionClient(f"{robot}/move_base" if robot else "/move_base", MoveBaseAction)
        self._subscriber = rospy.Subscriber(names.LAB_STATE, LabState, self._on_lab, queue_size=10)

    def _on_lab(self, message: LabState) -> None:
        if len(message.robot_poses) <= self._index:
            return
        pose = message.robot_poses[self._index]
        with self._lock:
            path = self._path
            if path is not None and (not path or (pose.x - path[-1][0]) ** 2 + (pose.y - path[-1][1]) ** 2 > 1e-6):
                path.append((pose.x, pose.y))

    def drive(self, goal: Tuple[float, float, float], limit_s: float, wall_s: float = 600.0) -> Driven:
        """Sends the robot to a goal (x, y, yaw) [m, m, rad] and waits for the outcome.

        Args:
            limit_s: [s] of simulated time, then the goal is cancelled; wall_s: the same of wall time.
        """
        if not wait_until(lambda: self._client.wait_for_server(rospy.Duration(0.2)), 30.0):
            return Driven("no_navigation")
        message = MoveBaseGoal()
        message.target_pose.header.frame_id = names.MAP_FRAME
        message.target_pose.header.stamp = rospy.Time.now()
        message.target_pose.pose = pose_from_2d(*goal)
        with self._lock:
            self._path = []
        began = rospy.get_time()
        self._client.send_goal(message)
        wait_until(lambda: self._client.get_state() in OUTCOMES or rospy.get_time() - began > limit_s, wall_s, 0.05)
        state, seconds = self._client.get_state(), rospy.get_time() - began
        outcome, text = OUTCOMES.get(state, "time_is_up"), self._client.get_goal_status_text()
        if state not in OUTCOMES:
            self._client.cancel_goal()
        with self._lock:
            path, self._path = np.array(self._path or [], dtype=float).reshape(-1, 2), None
        return Driven(outcome, text, path, seconds)
