"""A move_base action server that dies and comes back on request."""

import threading

import actionlib
import rospy
from move_base_msgs.msg import MoveBaseAction

from vb_core.ros.messages import pose2d_from_message


class FaultyMoveBase:
    """Accepts a robot's goals, none of which is ever reached.

    Attributes:
        asked, goals: time [s] of each goal, and its pose.
        cancelled: how often a goal was cancelled or replaced.
    """

    def __init__(self, name):
        self.name = name
        self.asked, self.goals, self.cancelled = [], [], 0
        self._lock = threading.RLock()
        self._handle = self._server = None
        self.revive()

    def revive(self):
        """Starts the server if it is dead, as a new process would."""
        if self._server is not None:
            return
        name = f"{self.name}/move_base"
        self._server = actionlib.ActionServer(name, MoveBaseAction, self._on_goal, self._on_cancel, auto_start=False)
        # one common lock: the server holds its own during callbacks, and needs it when a goal is answered
        self._server.lock = self._lock
        self._server.start()

    def die(self):
        """Leaves the graph without a word, as a killed process does."""
        with self._lock:
            server = self._server
            self._server = self._handle = None
        server.stop()

    def rest(self):
        """Cancels the active goal and forgets all goals."""
        with self._lock:
            self._cancel()
            self.asked.clear()
            self.goals.clear()
            self.cancelled = 0

    @property
    def active(self):
        """Whether a goal is active."""
        return self._handle is not None

    def _on_goal(self, handle):
        with self._lock:
            self.asked.append(rospy.Time.now().to_sec())
            self.goals.append(pose2d_from_message(handle.get_goal().target_pose.pose))
            self._cancel()
            handle.set_accepted()
            self._handle = handle

    def _on_cancel(self, handle):
        with self._lock:
            if self._handle is not None and handle.get_goal_id().id == self._handle.get_goal_id().id:
                self._cancel()

    def _cancel(self):
        if self._handle is not None:
            self._handle.set_canceled()
            self._handle = None
            self.cancelled += 1
