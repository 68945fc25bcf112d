#!/usr/bin/env python3
"""The dispatcher against a small move_base action server."""

import math
import os
import signal
import unittest
from xmlrpc.client import ServerProxy

import actionlib
import numpy as np
import rospy
import rostest
from move_base_msgs.msg import MoveBaseAction

from stimulus import Stimulus, assert_bad_parameter_is_named
from vb_testing import wait_until

from vb_core.poses import to_base
from vb_core.ros.messages import pose2d_from_message
from vb_robot import robot_dispatcher_node
from vb_robot.floor_view import FloorView

DEFAULT, BORDER, SEED, GUIDE = range(4)


class MoveBase:
    """Accepts goals and aborts, reaches or holds them, as told."""

    def __init__(self, stimulus):
        self.stimulus = stimulus
        self.goals = []  # (time, pose)
        self.preempted = 0
        self.behavior = "hold"
        self.server = actionlib.SimpleActionServer("move_base", MoveBaseAction, self._execute, auto_start=False)
        self.server.start()

    def _execute(self, goal):
        pose = pose2d_from_message(goal.target_pose.pose)
        self.goals.append((rospy.Time.now().to_sec(), pose))
        while not rospy.is_shutdown():
            if self.server.is_preempt_requested():
                self.preempted += 1
                self.server.set_preempted()
                return
            if self.behavior == "abort":
                self.server.set_aborted()
                return
            if self.behavior == "reach":
                with self.stimulus.lock:
                    self.stimulus.pose = pose
                self.server.set_succeeded()
                return
            rospy.rostime.wallsleep(0.02)


class DispatcherTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("test_robot_dispatcher")
        cls.stimulus = Stimulus(pose=(5.0, 0.7, 0.0))
        cls.stimulus.set_state(DEFAULT)
        cls.navigation = MoveBase(cls.stimulus)
        wait_until(lambda: cls.stimulus.spots.get_num_connections() > 0, "the dispatcher to listen")

    def setUp(self):
        self.stimulus.spot = None
        self.stimulus.spot_frame = "map"
        self.stimulus.set_state(DEFAULT)
        # whatever an earlier test left running is cancelled by the state
        wait_until(lambda: not self.navigation.server.is_active(), "no goal")
        self.stimulus.pose = (5.0, 0.7, 0.0)
        self.navigation.goals.clear()
        self.navigation.preempted = 0

    def assert_sees(self, pose, spot):
        self.assertTrue(FloorView.usual().sees(to_base(np.array([spot]), pose), 0.1)[0], f"{pose} and {spot}")

    def test_waits_for_a_stationary_camera_then_sends_once_and_cancels(self):
        self.navigation.behavior = "hold"
        self.stimulus.set_state(BORDER)
        self.stimulus.spot = (2.0, 2.5, "robot", True)
        count = []
        gather = rospy.Subscriber("/virtual_borders/spots", rospy.AnyMsg, count.append)
        wait_until(lambda: len(count) >= 20, "twenty spots")
        self.assertEqual(self.navigation.goals, [], "a robot's own camera alone sends no robot")
        self.stimulus.spot = (2.0, 2.5, "red", False)
        wait_until(lambda: self.navigation.goals, "a goal")
        self.assert_sees(self.navigation.goals[0][1], (2.0, 2.5))
        seen = len(count)
        wait_until(lambda: len(count) >= seen + 30, "thirty more spots")
        self.assertEqual(len(self.navigation.goals), 1, "a spot that stays needs one goal")
        gather.unregister()
        self.stimulus.set_state(DEFAULT)
        wait_until(lambda: self.navigation.preempted == 1, "the goal to be cancelled with the state")

    def test_aborted_goal_is_followed_by_another_place(self):
        self.navigation.behavior = "abort"
        self.stimulus.set_state(SEED)
        self.stimulus.spot = (2.0, 2.5, "red", False)
        wait_until(lambda: len(self.navigation.goals) >= 2, "a second goal")
        (_, first), (_, second) = self.navigation.goals[:2]
        self.assertGreater(math.dist(first[:2], second[:2]), 0.25)
        self.navigation.behavior = "reach"
        reached = len(self.navigation.goals)
        wait_until(
            lambda: len(self.navigation.goals) > reached or self._robot_sees((2.0, 2.5)),
            "another goal, or a robot that sees the spot",
        )

    def _robot_sees(self, spot):
        return FloorView.usual().sees(to_base(np.array([spot]), self.stimulus.pose), 0.05)[0]

    def test_spot_that_moves_on_is_followed(self):
        self.navigation.behavior = "reach"
        self.stimulus.set_state(BORDER)
        self.stimulus.spot = (2.0, 2.5, "red", False)
        wait_until(lambda: self._robot_sees((2.0, 2.5)), "a robot that sees the spot")
        self.stimulus.spot = (4.6, 4.0, "green", False)
        wait_until(lambda: self._robot_sees((4.6, 4.0)), "a robot that sees the spot at its new place")

    def test_guide_sends_no_robot_and_wrong_frames_do_no_harm(self):
        self.navigation.behavior = "hold"
        self.stimulus.set_state(BORDER)
        self.stimulus.spot_frame = "odom"
        self.stimulus.spot = (2.0, 2.5, "red", False)
        count = []
        gather = rospy.Subscriber("/virtual_borders/spots", rospy.AnyMsg, count.append)
        wait_until(lambda: len(count) >= 15, "fifteen spots")
        self.assertEqual(self.navigation.goals, [])
        self.stimulus.spot_frame = "map"
        wait_until(lambda: self.navigation.goals, "a goal")
        self.stimulus.set_state(GUIDE)
        wait_until(lambda: self.navigation.preempted == 1, "the goal to be cancelled")
        gather.unregister()

    def test_goal_of_a_killed_dispatcher_is_cancelled(self):
        self.navigation.behavior = "hold"
        self.stimulus.set_state(BORDER)
        self.stimulus.spot = (2.0, 2.5, "red", False)
        wait_until(lambda: self.navigation.goals, "a goal")
        self.stimulus.spot = None
        uri = rospy.get_master().lookupNode("/robot_dispatcher")[2]
        pid = ServerProxy(uri).getPid(rospy.get_name())[2]
        os.kill(pid, signal.SIGKILL)
        self.stimulus.set_state(DEFAULT)
        wait_until(lambda: self.navigation.preempted == 1, "a dispatcher that comes back and cancels its goal", 120.0)

    def test_bad_parameter_is_named(self):
        assert_bad_parameter_is_named(self, robot_dispatcher_node.build, "robots", ["ada", "ada"])


if __name__ == "__main__":
    rostest.rosrun("vb_robot", "robot_dispatcher", DispatcherTest)
