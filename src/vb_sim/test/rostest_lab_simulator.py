#!/usr/bin/env python3
"""The simulated lab over real topics: time, motion, tf, scan, participant, reset, bad worlds."""

import math
import unittest

import numpy as np
import rospy
import rostest
from geometry_msgs.msg import Point, Pose2D, Twist
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from std_srvs.srv import Trigger

from vb_testing import Newest, assert_ends_with_one_line, wait_until

from vb_core import geometry, names
from vb_core.ros.transforms import TransformLookup
from vb_msgs.msg import LabState, ParticipantState

START = (7.6, 0.4, math.radians(150.0))


class LabSimulatorTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("test_lab_simulator")
        cls.clock = Newest("/clock", Clock)
        cls.state = Newest(names.LAB_STATE, LabState)
        cls.odom = Newest("/odom", Odometry)
        cls.transforms = TransformLookup()
        cls.cmd_vel = rospy.Publisher("/cmd_vel", Twist, queue_size=1)
        cls.participant = rospy.Publisher(names.PARTICIPANT, ParticipantState, queue_size=1)
        cls.state.next()
        cls.reset()

    @classmethod
    def reset(cls):
        rospy.wait_for_service("/lab_simulator/reset", 120.0)
        assert rospy.ServiceProxy("/lab_simulator/reset", Trigger)().success

    def pose(self):
        pose = self.state.next().robot_poses[0]
        return np.array([pose.x, pose.y, pose.theta])

    def drive_until(self, condition, speed=0.3, turn_rate=0.0):
        command = Twist()
        command.linear.x, command.angular.z = speed, turn_rate

        def driven():
            self.cmd_vel.publish(command)
            return condition(self.state.message)

        wait_until(driven, "the robot to get there")

    def test_time_goes_on_evenly(self):
        self.clock.next(60)
        stamps = [message.clock.to_nsec() for message in self.clock.all]
        self.assertGreater(min(np.diff(stamps[5:])), 0)
        self.assertEqual(set(np.diff(stamps[-40:])) - {20000000, 40000000, 60000000}, set())

    def test_robot_moves_and_stops_by_itself(self):
        self.reset()
        start = self.pose()
        self.drive_until(
            lambda state: math.hypot(state.robot_poses[0].x - start[0], state.robot_poses[0].y - start[1]) > 0.3
        )
        # nobody commands any longer: it stands soon
        wait_until(lambda: abs(self.odom.next().twist.twist.linear.x) < 1e-6, "the robot to stand")
        heading = math.atan2(*(self.pose()[:2] - start[:2])[::-1])
        self.assertAlmostEqual(geometry.wrap_angle(heading - START[2]), 0.0, delta=0.1)

    def test_tf_is_near_the_truth_at_the_image_time(self):
        self.reset()
        self.drive_until(lambda state: state.robot_poses[0].x < 7.3, 0.3, 0.1)
        state = self.state.next()
        estimate = geometry.pose2d_from_transform(self.transforms.lookup("map", "base_link", state.header.stamp, 2.0))
        true = state.robot_poses[0]
        self.assertLess(math.hypot(estimate[0] - true.x, estimate[1] - true.y), 0.12)
        self.assertNotEqual((estimate[0], estimate[1]), (true.x, true.y))
        mount = self.transforms.lookup("base_link", "base_laser_link", rospy.Time(0), 2.0)
        self.assertAlmostEqual(mount[2, 3], 0.3)

    def test_scan_shows_the_corner(self):
        self.reset()
        scan = Newest("/scan", LaserScan).next()
        self.assertEqual((scan.header.frame_id, len(scan.ranges)), ("base_laser_link", 360))
        # the start is 0.4 m from two walls
        self.assertAlmostEqual(min(scan.ranges), 0.4, delta=0.08)

    def test_the_participant_is_in_the_state_until_silent(self):
        message = ParticipantState(
            laser_on=True,
            laser=Point(1.0, 2.0, 0.0),
            laser_color="green",
            person_present=True,
            person=Pose2D(3.0, 1.0, 0.5),
            doing="draws",
        )

        def shown():
            self.participant.publish(message)
            return self.state.message.laser_on

        wait_until(shown, "the laser in the state")
        state = self.state.message
        self.assertEqual(
            (state.laser.x, state.laser_color, state.person.x, state.participant_doing), (1.0, "green", 3.0, "draws")
        )
        self.state.wait(lambda state: not state.laser_on, "the laser to be off")
        self.assertTrue(self.state.message.person_present)

    def test_bad_parameters_end_with_one_line(self):
        world = f"_world:={rospy.get_param('/lab_simulator/world')}"
        cases = {
            "lab_simulator": [(["_world:=/no/such.yaml"], "no_world"), (["_seed:=2"], "world: must be set")],
            "participant": [
                (["_scenario:=room"], "world: must be set"),
                ([world], "scenario: ''"),
                ([world, "_scenario:=attic"], "attic"),
                ([world, "_scenario:=room", "_method:=magic"], "/method"),
            ],
        }
        for node, bad in cases.items():
            assert_ends_with_one_line("vb_sim", node, bad)


if __name__ == "__main__":
    rostest.rosrun("vb_sim", "lab_simulator", LabSimulatorTest)
