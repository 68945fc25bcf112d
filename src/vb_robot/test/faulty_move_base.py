"""A move_base action server that has the faults it is told to have."""

import math
import threading

import actionlib
import rospy
from actionlib_msgs.msg import GoalStatus
from move_base_msgs.msg import MoveBaseAction

from vb_core.ros.messages import pose2d_from_message

SPEED = 1.5  # [m/s] faster than in life: tests wait for robots that arrive


class _Server(actionlib.ActionServer):
    asked = None  # a list: when [s] a goal came

    def internal_goal_callback(self, goal):
        self.asked.append(rospy.Time.now().to_sec())
        super().internal_goal_callback(goal)


class FaultyMoveBase:
    """Drives a stimulus.Body straight to its goal, or does what `behavior` says.

    Attributes:
        behavior: "drive"; "hold": accepts the goal and stands; "abort".
        asked: when [s] each goal came, before it was answered.
        goals: (time [s], pose) of every goal.
        stopped: when [s] the robot was stopped by a cancel or a new goal.
    """

    def __init__(self, body):
        self.body = body
        self.behavior = "drive"
        self.asked, self.goals, self.stopped = [], [], []
        self._lock = threading.RLock()
        self._handle = self._target = self._server = None
        self.revive()
        self._timer = rospy.Timer(rospy.Duration(0.05), self._drive)

    def revive(self):
        """Starts the server, as a new process would."""
        self._server = _Server(
            self.body.prefix + "move_base", MoveBaseAction, self._on_goal, self._on_cancel, auto_start=False
        )
        # one lock: the server holds its own while it calls back, and wants it when a goal is answered
        self._server.lock, self._server.asked = self._lock, self.asked
        self._server.start()

    def die(self):
        """Leaves the graph without a word, as a killed process does; the base stops by its own timeout."""
        with self._lock:
            server, self._server, self._handle = self._server, None, None
            self.body.velocity = (0.0, 0.0)
        server.stop()

    def rest(self):
        """Ends what runs and forgets every goal."""
        with self._lock:
            if self._handle is not None:
                self._handle.set_canceled()
            self._handle = None
            self.body.velocity = (0.0, 0.0)
            for remembered in (self.asked, self.goals, self.stopped):
                remembered.clear()

    def recover(self):
        """Has no fault any more, for the next test."""
        if self._server is None:
            self.revive()
        self.behavior = "drive"

    @property
    def active(self):
        """Whether a goal runs."""
        return self._handle is not None

    def _on_goal(self, handle):
        with self._lock:
            pose = pose2d_from_message(handle.get_goal().target_pose.pose)
            self.goals.append((rospy.Time.now().to_sec(), pose))
            if self._handle is not None:
                self._handle.set_canceled()
                self._stop()
            handle.set_accepted()
            if self.behavior == "abort":
                handle.set_aborted()
                return
            self._handle, self._target = handle, pose

    def _on_cancel(self, handle):
        with self._lock:
            if self._handle is not None and handle.get_goal_id().id == self._handle.get_goal_id().id:
                self._handle.set_canceled()
                self._handle = None
                self._stop()

    def _stop(self):
        self.body.velocity = (0.0, 0.0)
        self.stopped.append(rospy.Time.now().to_sec())

    def _drive(self, _event):
        with self._lock:
            if self._handle is None or self.behavior != "drive":
                return
            if self._handle.get_goal_status().status != GoalStatus.ACTIVE:
                return
            with self.body.lock:
                x, y, _ = self.body.pose
                distance = math.hypot(self._target[0] - x, self._target[1] - y)
                if distance < 0.05:
                    self.body.velocity = (0.0, 0.0)
                    self.body.pose = (*self.body.pose[:2], self._target[2])
                    self._handle.set_succeeded()
                    self._handle = None
                    return
                heading = math.atan2(self._target[1] - y, self._target[0] - x)
                self.body.pose = (*self.body.pose[:2], heading)
                self.body.velocity = (min(SPEED, distance / 0.1), 0.0)
