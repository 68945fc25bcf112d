#!/usr/bin/env python3
"""The guide with spots, tf, scans and a map; the commanded velocity moves the robot."""
import math
import os
import sys
import unittest

import rospy
import rostest
from geometry_msgs.msg import Twist

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from stimulus import Stimulus, assert_bad_parameter_is_named, room, wait_until  # noqa: E402

from vb_robot import robot_guide_node  # noqa: E402

DEFAULT, BORDER, SEED, GUIDE = range(4)


class GuideTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("test_robot_guide")
        cls.stimulus = Stimulus()
        cls.commands = []
        cls.nearest = math.inf  # [m] the smallest distance between the robot's middle and x = 3.5 m
        rospy.Subscriber("cmd_vel", Twist, cls.on_command)
        cls.seen = 0
        rospy.Subscriber("/virtual_borders/spots", rospy.AnyMsg, cls.on_spot)
        assert wait_until(lambda: cls.stimulus.spots.get_num_connections() > 1), "the guide did not subscribe"

    @classmethod
    def on_command(cls, message):
        cls.commands.append((message.linear.x, message.angular.z))
        with cls.stimulus.lock:
            cls.stimulus.velocity = cls.commands[-1]
            cls.nearest = min(cls.nearest, 3.5 - cls.stimulus.pose[0])

    @classmethod
    def on_spot(cls, _message):
        cls.seen += 1

    def setUp(self):
        self.stimulus.spot = None
        self.stimulus.set_state(DEFAULT)
        self.assertTrue(wait_until(lambda: self.stimulus.velocity == (0.0, 0.0)))
        self.stimulus.publish_map(room())
        self.stimulus.scan_range = 7.0
        self.stimulus.pose, self.stimulus.offset = (1.5, 2.5, 0.0), (0.0, 0.0)
        self.commands.clear()

    def spots(self, count):
        until = self.seen + count
        self.assertTrue(wait_until(lambda: self.seen >= until))

    def tearDown(self):
        for v, w in self.commands:
            self.assertLessEqual(abs(v), 0.2 + 1e-9)
            self.assertLessEqual(abs(w), 0.8 + 1e-9)

    def distance(self, spot):
        return math.dist(self.stimulus.pose[:2], spot)

    def test_guide_follows_and_stops_when_the_spot_is_gone(self):
        self.stimulus.set_state(GUIDE)
        self.stimulus.spot = (2.95, 2.7, "robot", True)
        self.assertTrue(wait_until(lambda: self.distance((2.95, 2.7)) < 1.4))
        self.stimulus.spot = None
        self.assertTrue(wait_until(lambda: self.stimulus.velocity == (0.0, 0.0)))
        spot = (self.stimulus.pose[0] + 1.32, 2.7)
        self.stimulus.spot = (*spot, "robot", True)
        self.assertTrue(wait_until(lambda: self.distance(spot) < 1.1 and self.stimulus.velocity == (0.0, 0.0)))
        self.stimulus.spot = (spot[0] + 0.6, 2.7, "robot", True)
        self.assertTrue(wait_until(lambda: self.stimulus.velocity[0] > 0.1))
        self.stimulus.set_state(DEFAULT)
        self.assertTrue(wait_until(lambda: self.commands[-1] == (0.0, 0.0)))
        said = len(self.commands)
        self.spots(15)
        self.assertEqual(len(self.commands), said, "it keeps silent when it is not wanted")

    def test_border_belongs_to_the_dispatcher_once_a_stationary_camera_saw_the_spot(self):
        self.stimulus.set_state(BORDER)
        self.stimulus.spot = (3.2, 2.8, "red", False)
        self.spots(5)
        self.stimulus.spot = (3.2, 2.8, "robot", True)
        self.spots(25)
        self.assertEqual(self.commands, [])

    def test_border_without_stationary_cameras_is_followed(self):
        self.stimulus.set_state(BORDER)
        self.stimulus.spot = (3.2, 2.2, "robot", True)
        self.assertTrue(wait_until(lambda: self.stimulus.velocity[0] > 0.05))
        self.stimulus.spot = (3.2, 2.2, "red", False)
        self.assertTrue(wait_until(lambda: self.commands[-1] == (0.0, 0.0)))

    def assert_only_turns(self, scan_range, spots):
        """With such a scan; the one of the free room must be replaced or out of date first, after so many spots."""
        self.stimulus.scan_range = scan_range
        self.stimulus.spot = (3.0, 3.1, "other", True)
        self.spots(spots)
        self.stimulus.set_state(GUIDE)
        self.stimulus.spot = (3.0, 3.1, "robot", True)
        self.assertTrue(wait_until(lambda: self.stimulus.pose[2] > 0.2))
        self.assertEqual(max(v for v, _ in self.commands), 0.0)

    def test_obstacle_in_the_scan_stops_it_but_it_turns(self):
        self.assert_only_turns(0.28, spots=12)

    def test_missing_scan_lets_it_only_turn(self):
        self.assert_only_turns(None, spots=20)

    def test_never_enters_a_border(self):
        grid = room()
        data = grid.data.copy()
        data[:, 70:80] = 100  # x = 3.5 m ... 4.0 m
        self.stimulus.publish_map(grid.with_data(data), physical=grid)
        self.stimulus.spot = (3.0, 3.1, "other", True)
        self.spots(12)
        self.stimulus.pose = (3.12, 2.5, 0.0)
        type(self).nearest = math.inf
        self.stimulus.set_state(GUIDE)
        self.stimulus.spot = (4.6, 2.5, "robot", True)
        self.assertTrue(wait_until(lambda: self.stimulus.pose[0] > 3.15))
        self.assertTrue(wait_until(lambda: self.stimulus.velocity[0] < 0.01))
        self.spots(10)
        self.assertGreaterEqual(self.nearest, 0.18)

    def test_localisation_that_leaps_half_a_metre_stops_it_for_a_moment(self):
        self.stimulus.set_state(GUIDE)
        self.stimulus.spot = (3.0, 2.5, "robot", True)
        self.assertTrue(wait_until(lambda: self.stimulus.velocity[0] > 0.1))
        leapt = rospy.Time.now()
        self.stimulus.offset = (0.35, 0.35)
        # the camera's places on the floor leap with it
        self.stimulus.spot = (self.stimulus.pose[0] + 1.7, 2.85, "robot", True)
        self.assertTrue(wait_until(lambda: self.stimulus.velocity[0] == 0.0))
        print(f"leap to stop: {1e3 * (rospy.Time.now() - leapt).to_sec():.0f} ms")
        self.assertTrue(wait_until(lambda: self.stimulus.velocity[0] > 0.1), "and it goes on")

    def test_bad_parameter_is_named(self):
        assert_bad_parameter_is_named(self, robot_guide_node.build, "follow_in_border", "sometimes")


if __name__ == "__main__":
    rostest.rosrun("vb_robot", "robot_guide", GuideTest)
