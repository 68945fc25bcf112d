#!/usr/bin/env python3
"""The simulated lab over real topics, and the stand-ins for map_server and move_base with its robot."""

import math
import unittest

import actionlib
import numpy as np
import rospy
import rostest
from actionlib_msgs.msg import GoalStatus
from geometry_msgs.msg import Point, Pose2D, PoseStamped, Twist
from move_base_msgs.msg import MoveBaseAction, MoveBaseGoal
from nav_msgs.msg import Odometry, Path
from nav_msgs.srv import GetMap, GetPlan
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Header

from vb_testing import Newest, assert_ends_with_one_line, assert_fields, wait_until
from vb_core import geometry, names
from vb_core.ros import node
from vb_core.ros.messages import NumpyOccupancyGrid, grid_from_message, message_from_grid, message_from_pose2d
from vb_core.ros.transforms import TransformLookup
from vb_msgs.msg import LabState, ParticipantState


def pose(x, y, yaw=0.0):
    return PoseStamped(Header(frame_id="map"), message_from_pose2d(x, y, yaw))


class LabSimulatorTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("test_lab_simulator")
        node.wait_for_clock()
        cls.clock = Newest("/clock", Clock)
        cls.state = Newest(names.LAB_STATE, LabState)
        cls.odom = Newest("/odom", Odometry)
        cls.transforms = TransformLookup()
        cls.drive = rospy.Publisher("/cmd_vel", Twist, queue_size=1)
        cls.participant = rospy.Publisher(names.PARTICIPANT, ParticipantState, queue_size=1)
        cls.map = Newest("/map", NumpyOccupancyGrid)
        cls.cmd_vel = Newest("/cmd_vel", Twist)
        cls.costmap = Newest("/move_base/global_costmap/costmap", NumpyOccupancyGrid)
        cls.plan = Newest("/move_base/NavfnROS/plan", Path)
        cls.maps = rospy.Publisher(names.MAP_WITH_BORDERS, NumpyOccupancyGrid, queue_size=1, latch=True)
        cls.client = actionlib.SimpleActionClient("move_base", MoveBaseAction)
        assert cls.client.wait_for_server(rospy.Duration(60.0))
        cls.make_plan = rospy.ServiceProxy("/move_base/make_plan", GetPlan)
        cls.make_plan.wait_for_service(60.0)
        cls.grid = grid_from_message(cls.map.message)
        cls.first_scan = Newest("/scan", LaserScan).message  # before the robot drives
        goal = MoveBaseGoal(target_pose=pose(7.0, 1.0))  # before navigation has a map
        cls.first_goal = cls.client.send_goal_and_wait(goal, rospy.Duration(60.0)), cls.client.get_goal_status_text()

    def publish(self, blocked=None):
        """Publishes the map with a box (x0, y0, x1, y1) [m] blocked, and waits until the costmap has it."""
        data = self.grid.data.copy()
        if blocked is not None:
            low, high = self.grid.world_to_cell(np.array(blocked).reshape(2, 2))
            data[low[0] : high[0], low[1] : high[1]] = 100
        count = self.costmap.count
        wait_until(lambda: self.maps.get_num_connections() > 0, "navigation to listen")
        self.maps.publish(message_from_grid(self.grid.with_data(data), rospy.Time.now()))
        wait_until(lambda: self.costmap.count > count, "the costmap with it")

    def path(self, start, goal, tolerance=0.0):
        reply = self.make_plan(pose(*start), pose(*goal), tolerance)
        return np.array([(p.pose.position.x, p.pose.position.y) for p in reply.plan.poses]).reshape(-1, 2)

    def may_plan(self):
        try:
            self.path((7.0, 0.6), (7.0, 0.7))
            return True
        except rospy.ServiceException:
            return False

    # ------------------------------------------------------------- navigation
    def test_without_a_map_goals_are_aborted(self):
        state, text = self.first_goal
        self.assertEqual(state, GoalStatus.ABORTED)
        self.assertIn("no_map", text)

    def test_the_map_server_serves_the_map_that_is_published(self):
        plain = rospy.ServiceProxy("/static_map", GetMap)().map
        self.assertTrue(np.array_equal(np.array(plain.data, np.int8).reshape(self.grid.shape), self.grid.data))
        self.assertEqual(self.map.message.header.frame_id, "map")

    def test_a_new_border_is_in_costmap_and_plans(self):
        self.publish((3.12, 0.3, 5.12, 2.05))
        start = (7.6, 0.4)
        occupancy = np.array(self.costmap.message.data).reshape(self.grid.shape)
        row, column = self.grid.world_to_cell([(4.0, 1.0)])[0]
        self.assertEqual(occupancy[row, column], 100)
        # a goal inside the border: no plan, and with a tolerance a plan to its rim
        self.assertEqual(len(self.path(start, (4.0, 1.0))), 0)
        self.assertGreater(len(self.path(start, (5.0, 1.0), 0.5)), 0)

    def test_a_goal_is_reached_round_a_new_border(self):
        self.publish()
        self.client.send_goal(MoveBaseGoal(target_pose=pose(5.2, 1.0, 1.5)))
        wait_until(lambda: self.client.get_state() == GoalStatus.ACTIVE, "the goal to be taken")
        # like the real move_base: no plans for others while a goal is active
        self.assertFalse(self.may_plan())
        self.state.wait(lambda state: state.robot_poses[0].x < 7.3, "the robot to set out")
        border = (6.0, 0.4, 6.4, 1.3)
        self.publish(border)
        states_before = len(self.state.all)
        self.assertTrue(self.client.wait_for_result(rospy.Duration(90.0)))
        self.assertEqual(self.client.get_state(), GoalStatus.SUCCEEDED)
        wait_until(self.may_plan, "plans for others again")
        # result and velocity are on different topics, so that either may come first
        wait_until(lambda: all(last == Twist() for last in self.cmd_vel.all[-1:]), "the command to stand")
        true = self.state.next().robot_poses[0]
        self.assertLess(math.hypot(true.x - 5.2, true.y - 1.0), 0.2)
        self.assertLess(abs(geometry.wrap_angle(true.theta - 1.5)), 0.25)
        self.assertEqual(self.plan.message.header.frame_id, "map")
        poses = [state.robot_poses[0] for state in self.state.all[states_before:]]
        self.assertFalse([p for p in poses if border[0] < p.x < border[2] and border[1] < p.y < border[3]])

    # ------------------------------------------------------------- the lab
    def test_time_goes_on_evenly(self):
        self.clock.next(60)
        # rospy's own subscription to /clock, which this one shares, keeps the newest message only: some are missing
        steps = np.diff([message.clock.to_nsec() for message in self.clock.all[5:]])
        self.assertEqual(min(steps), 20_000_000)
        self.assertEqual(set(steps % 20_000_000), {0})

    def test_the_robot_is_where_tf_says_and_stops_by_itself(self):
        start = self.state.next().robot_poses[0]
        command = Twist()
        command.linear.x, command.angular.z = 0.3, 0.1

        def driven():
            self.drive.publish(command)
            pose = self.state.message.robot_poses[0]
            return math.hypot(pose.x - start.x, pose.y - start.y) > 0.3

        wait_until(driven, "the robot to get there")
        state = self.state.next()
        estimate = geometry.pose2d_from_transform(self.transforms.lookup("map", "base_link", state.header.stamp, 2.0))
        true = state.robot_poses[0]
        self.assertLess(math.hypot(estimate[0] - true.x, estimate[1] - true.y), 0.12)
        self.assertNotEqual((estimate[0], estimate[1]), (true.x, true.y))
        mount = self.transforms.lookup("base_link", "base_laser_link", rospy.Time(0), 2.0)
        self.assertAlmostEqual(mount[2, 3], 0.3)
        # nobody sends commands any longer
        wait_until(lambda: abs(self.odom.next().twist.twist.linear.x) < 1e-6, "the robot to stand")

    def test_the_first_scan_shows_the_corner_of_the_start(self):
        scan = self.first_scan
        self.assertEqual(scan.header.frame_id, "base_laser_link")
        self.assertEqual(len(scan.ranges), 360)
        # the start is 0.4 m from two walls
        self.assertAlmostEqual(min(scan.ranges), 0.4, delta=0.08)

    def test_the_participant_is_in_the_state_until_silent(self):
        message = ParticipantState(laser_on=True, laser=Point(1.0, 2.0, 0.0), laser_color="green", doing="draws")
        message.person_present = True
        message.person = Pose2D(3.0, 1.0, 0.5)

        def shown():
            self.participant.publish(message)
            return self.state.message.laser_on

        wait_until(shown, "the laser in the state")
        state = self.state.message
        assert_fields(state, laser_color="green", participant_doing="draws")
        self.assertEqual((state.laser.x, state.person.x), (1.0, 3.0))
        self.state.wait(lambda state: not state.laser_on, "the laser to be off")
        self.assertTrue(self.state.message.person_present)

    def test_bad_parameters_end_with_one_line(self):
        world = f"_world:={rospy.get_param('/lab_simulator/world')}"
        cases = {
            "lab_simulator": [(["_world:=/no/such.yaml"], "no_world"), (["_seed:=2"], "world: must be set")],
            "participant": [
                (["_scenario:=room"], "world: must be set"),
                ([world, "_scenario:=attic"], "attic"),
                ([world, "_scenario:=room", "_method:=magic"], "/method"),
            ],
        }
        for executable, bad in cases.items():
            assert_ends_with_one_line("vb_sim", executable, bad)


if __name__ == "__main__":
    rostest.rosrun("vb_sim", "lab_simulator", LabSimulatorTest)
