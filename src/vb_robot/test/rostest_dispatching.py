#!/usr/bin/env python3
"""The robot monitor, which sends robots to the spot, with the move_base action servers of two robots, which can die."""

import math
import os
import signal
import threading
import unittest

import actionlib
import numpy as np
import rospy
import rostest

from move_base_msgs.msg import MoveBaseAction, MoveBaseActionGoal
from plain_rooms import VIEW, room, with_border
from robot_inputs import Body, Stimulus
from vb_testing import Newest, process_of, wait_until
from vb_core import names
from vb_core.geometry import map_to_base
from vb_core.interaction_tables import BORDER, DEFAULT, GUIDE
from vb_core.ros.messages import NumpyOccupancyGrid, message_from_grid, message_from_pose2d, pose2d_from_message
from vb_msgs.msg import NoticeArray

SPOT = (2.0, 2.5)


class UnreachingMoveBase:
    """A move_base action server that accepts a robot's goals, none of which is ever reached."""

    def __init__(self, name):
        self.name = name
        self.asked, self.goals = [], []  # time [s] of each goal, and its pose
        self.cancelled = 0  # how often a goal was cancelled or replaced
        self._lock = threading.RLock()
        self.active_goal = self._server = None
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
            self._server = self.active_goal = None
        server.stop()

    def rest(self):
        """Cancels the active goal and forgets all goals."""
        with self._lock:
            self._cancel()
            self.asked, self.goals = [], []
            self.cancelled = 0

    def _on_goal(self, handle):
        with self._lock:
            self.asked.append(rospy.Time.now().to_sec())
            self.goals.append(pose2d_from_message(handle.get_goal().target_pose.pose))
            self._cancel()
            handle.set_accepted()
            self.active_goal = handle

    def _on_cancel(self, handle):
        with self._lock:
            if self.active_goal is not None and handle.get_goal_id().id == self.active_goal.get_goal_id().id:
                self._cancel()

    def _cancel(self):
        if self.active_goal is not None:
            self.active_goal.set_canceled()
            self.active_goal = None
            self.cancelled += 1


class DispatcherTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("test_dispatching")
        cls.ada, cls.bob = Body((5.0, 2.5, 0.0), "ada"), Body((5.4, 0.6, 0.0), "bob")
        cls.stimulus = Stimulus(pose=(0.5, 0.5, 0.0), others=(cls.ada, cls.bob))
        cls.stimulus.set_state(DEFAULT)
        cls.bases = {name: UnreachingMoveBase(name) for name in ("ada", "bob")}
        cls.codes = []
        rospy.Subscriber(names.NOTICES, NoticeArray, lambda message: cls.codes.extend(n.code for n in message.notices))
        cls.maps = {
            name: rospy.Publisher(f"/{name}/virtual_borders/map", NumpyOccupancyGrid, queue_size=1, latch=True)
            for name in cls.bases
        }
        wait_until(lambda: cls.stimulus.spots.get_num_connections() > 0, "the dispatcher to listen")

    def setUp(self):
        self.stop_drawing()
        for base in self.bases.values():
            base.revive()
        self.publish_maps(room(6.0))
        self.ada.pose, self.bob.pose = (5.0, 2.5, 0.0), (5.4, 0.6, 0.0)
        self.stimulus.spot_frame = "map"
        self.codes.clear()

    def publish_maps(self, grid, *robots):
        """Publishes the maps of some robots; without names those of all, the common one and the one without borders."""
        if not robots:
            self.stimulus.publish_map(grid)
        for name in robots or self.maps:
            self.maps[name].publish(message_from_grid(grid, rospy.Time.now()))

    def draw(self, first="ada", spot=SPOT):
        """Draws, repeatedly, until this robot is the first to be sent.

        A drawing may begin before the dispatcher has all that a test has just published, and rightly sends another one.
        """

        def is_first():
            self.draw_once(spot)
            wait_until(lambda: any(base.asked for base in self.bases.values()), "a robot to be asked")
            asked = {name: base.asked[0] for name, base in self.bases.items() if base.asked}
            if asked and min(asked, key=asked.get) == first:
                return True
            self.stop_drawing()
            return False

        wait_until(is_first, lambda: f"{first} to be sent first", 180.0)

    def draw_once(self, spot=SPOT):
        self.stimulus.set_state(BORDER)
        self.stimulus.spot = (*spot, "red", False)

    def stop_drawing(self):
        self.stimulus.spot = None
        self.stimulus.set_state(DEFAULT)
        wait_until(lambda: not any(base.active_goal for base in self.bases.values()), "no goal")
        for base in self.bases.values():
            base.rest()

    def wait_for_goal(self, name):
        return wait_until(lambda: self.bases[name].goals, f"a goal of {name}")[-1]

    def test_waits_for_a_stationary_camera_then_sends_one_once_and_cancels(self):
        self.stimulus.set_state(BORDER)
        self.stimulus.spot = (*SPOT, "ada", True)
        self.hear_spots(20)
        self.stimulus.spot_frame, self.stimulus.spot = "odom", (*SPOT, "red", False)
        self.hear_spots(20)
        goals = [base.goals for base in self.bases.values()]
        self.assertEqual(goals, [[], []], "neither for a robot's own camera alone, nor for a place in another frame")
        self.stimulus.spot_frame = "map"
        pose = self.wait_for_goal("ada")
        self.assertTrue(VIEW.sees(map_to_base(np.array([SPOT]), pose), 0.1)[0], f"{pose} and {SPOT}")
        self.hear_spots(30)
        self.assertEqual([len(base.goals) for base in self.bases.values()], [1, 0], "a spot that stays needs one goal")
        self.stimulus.set_state(GUIDE)
        wait_until(lambda: self.bases["ada"].cancelled, "the goal to be cancelled with the state")
        self.stop_drawing()
        self.draw_once((3.0, 3.5))
        self.wait_for_goal("ada")  # the next interaction is like any other

    def hear_spots(self, count):
        spots = Newest(names.SPOTS, rospy.AnyMsg)
        spots.next(count)
        spots.subscriber.unregister()

    def test_a_goal_of_a_killed_dispatcher_is_cancelled_by_the_next_one(self):
        self.draw()
        self.stimulus.spot = None
        os.kill(process_of("/robot_monitor"), signal.SIGKILL)
        self.stimulus.set_state(DEFAULT)
        wait_until(lambda: self.bases["ada"].cancelled, "a dispatcher that comes back and cancels its goal", 120.0)

    def test_two_never_take_the_same_place(self):
        self.draw()
        best = self.wait_for_goal("ada")
        self.stop_drawing()
        # somebody else has sent bob to exactly that pose
        self.bob.pose = (best[0], best[1], 0.0)
        goal = MoveBaseActionGoal()
        goal.goal_id.id = "somebody"
        goal.goal.target_pose.header.frame_id = "map"
        goal.goal.target_pose.pose = message_from_pose2d(*best)
        self.addCleanup(self.bases["bob"].rest)  # nobody else ends this goal
        somebody = rospy.Publisher("/bob/move_base/goal", MoveBaseActionGoal, queue_size=1)
        wait_until(lambda: somebody.get_num_connections() > 1, "bob to hear of goals, and the monitor")
        somebody.publish(goal)
        wait_until(lambda: self.bases["bob"].active_goal, "bob to set out")
        self.draw_once()
        self.assertGreaterEqual(math.dist(self.wait_for_goal("ada")[:2], best[:2]), 2 * 0.18 + 0.10)
        self.assertEqual(len(self.bases["bob"].goals), 1, "a free robot comes first")

    def test_borders_for_one_robot_do_not_hold_the_other(self):
        self.publish_maps(with_border(room(6.0), 0.5, 0.0, 3.75, 5.0), "bob")  # bob has to keep out of the spot's area
        self.ada.pose, self.bob.pose = (5.0, 4.4, 0.0), (4.2, 2.5, math.pi)
        self.draw("ada", (2.0, 1.2))
        self.wait_for_goal("ada")
        self.assertEqual(self.bases["bob"].goals, [])

    def test_navigation_that_never_comes_and_then_does(self):
        for base in self.bases.values():
            base.die()
        self.draw_once()
        # the interaction goes on; when the spot is lost, people are told that no robot comes
        self.hear_spots(25)
        self.stimulus.spot = None
        wait_until(lambda: "spot_not_seen_no_robot" in self.codes, lambda: f"people to be told; {self.codes}")
        self.stimulus.spot = (*SPOT, "red", False)
        self.bases["bob"].revive()
        self.wait_for_goal("bob")


if __name__ == "__main__":
    rostest.rosrun("vb_robot", "dispatching", DispatcherTest)
