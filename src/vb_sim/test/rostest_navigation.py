#!/usr/bin/env python3
"""The stand-ins for map_server and move_base, with the simulated robot."""

import math
import unittest

import actionlib
import numpy as np
import rospy
import rostest
from actionlib_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped, Twist
from move_base_msgs.msg import MoveBaseAction, MoveBaseGoal
from nav_msgs.msg import Path
from nav_msgs.srv import GetMap, GetPlan
from std_srvs.srv import Trigger

from vb_testing import Newest, wait_until

from vb_core import geometry, names
from vb_core.ros import node
from vb_core.ros.messages import OccupancyGridArray, grid_from_message, message_from_grid, message_from_pose2d
from vb_msgs.msg import LabState


def pose(x, y, yaw=0.0):
    stamped = PoseStamped()
    stamped.header.frame_id = "map"
    stamped.pose = message_from_pose2d(x, y, yaw)
    return stamped


class NavigationTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("test_navigation")
        node.wait_for_clock()
        cls.state = Newest(names.LAB_STATE, LabState)
        cls.map = Newest("/map", OccupancyGridArray)
        cls.cmd_vel = Newest("/cmd_vel", Twist)
        cls.costmap = Newest("/move_base/global_costmap/costmap", OccupancyGridArray)
        cls.plan = Newest("/move_base/NavfnROS/plan", Path)
        cls.maps = rospy.Publisher(names.MAP_WITH_BORDERS, OccupancyGridArray, queue_size=1, latch=True)
        cls.client = actionlib.SimpleActionClient("move_base", MoveBaseAction)
        assert cls.client.wait_for_server(rospy.Duration(60.0))
        cls.make_plan = rospy.ServiceProxy("/move_base/make_plan", GetPlan)
        cls.make_plan.wait_for_service(60.0)
        cls.grid = grid_from_message(cls.map.message)

    def setUp(self):
        rospy.wait_for_service("/lab_simulator/reset", 120.0)
        rospy.ServiceProxy("/lab_simulator/reset", Trigger)()

    def publish(self, blocked=None):
        """The map with a box (x0, y0, x1, y1) [m] blocked; waits until the costmap has it."""
        data = self.grid.data.copy()
        if blocked is not None:
            low, high = self.grid.world_to_cell(np.array(blocked).reshape(2, 2))
            data[low[0] : high[0], low[1] : high[1]] = 100
        before = self.costmap.count
        wait_until(lambda: self.maps.get_num_connections() > 0, "navigation to listen")
        self.maps.publish(message_from_grid(self.grid.with_data(data), rospy.Time.now()))
        wait_until(lambda: self.costmap.count > before, "the costmap with it")

    def path(self, start, goal, tolerance=0.0):
        reply = self.make_plan(pose(*start), pose(*goal), tolerance)
        return np.array([(p.pose.position.x, p.pose.position.y) for p in reply.plan.poses]).reshape(-1, 2)

    def send(self, *goal):
        self.client.send_goal(MoveBaseGoal(target_pose=pose(*goal)))

    def finish(self, limit=90.0):
        wait_until(
            lambda: self.client.get_state() not in (GoalStatus.PENDING, GoalStatus.ACTIVE), "the goal's end", limit
        )
        wait_until(self.may_plan, "plans for others again")
        for last in self.cmd_vel.all[-1:]:
            self.assertEqual((last.linear.x, last.angular.z), (0.0, 0.0))
        return self.client.get_state(), self.client.get_goal_status_text()

    def may_plan(self):
        try:
            self.path((7.0, 0.6), (7.0, 0.7))
            return True
        except rospy.ServiceException:
            return False

    def test_0_without_a_map_goals_are_aborted(self):
        self.send(7.0, 1.0)
        state, text = self.finish()
        self.assertEqual(state, GoalStatus.ABORTED)
        self.assertIn("no_map", text)

    def test_1_map_server(self):
        plain = rospy.ServiceProxy("/static_map", GetMap)().map
        self.assertTrue(np.array_equal(np.array(plain.data, np.int8).reshape(self.grid.shape), self.grid.data))
        self.assertEqual(self.map.message.header.frame_id, "map")

    def test_2_a_new_border_is_in_costmap_and_plans(self):
        self.publish((3.12, 0.3, 5.12, 2.05))
        start = (7.6, 0.4)
        occupancy = np.array(self.costmap.message.data).reshape(self.grid.shape)
        row, column = self.grid.world_to_cell([(4.0, 1.0)])[0]
        self.assertEqual(occupancy[row, column], 100)
        # a goal inside it: no plan, and with a tolerance its rim
        self.assertEqual(len(self.path(start, (4.0, 1.0))), 0)
        self.assertGreater(len(self.path(start, (5.0, 1.0), 0.5)), 0)

    def test_3_goal_is_reached(self):
        self.publish()
        first = len(self.cmd_vel.all)
        self.send(6.6, 1.0, 1.5)
        wait_until(lambda: self.client.get_state() == GoalStatus.ACTIVE, "the goal to be taken")
        # as the real one: no plans for others while a goal is active
        self.assertFalse(self.may_plan())
        self.assertEqual(self.finish()[0], GoalStatus.SUCCEEDED)
        true = self.state.next().robot_poses[0]
        self.assertLess(math.hypot(true.x - 6.6, true.y - 1.0), 0.2)
        self.assertLess(abs(geometry.wrap_angle(true.theta - 1.5)), 0.25)
        self.assertLessEqual(max(message.linear.x for message in self.cmd_vel.all[first:]), 0.5)
        self.assertEqual(self.plan.message.header.frame_id, "map")

    def test_4_a_border_published_while_driving_is_respected(self):
        self.publish()
        self.send(5.2, 1.0, math.pi)
        self.state.wait(lambda state: state.robot_poses[0].x < 7.3, "the robot to set out")
        border = (6.0, 0.4, 6.4, 1.3)
        self.publish(border)
        first = len(self.state.all)
        self.assertEqual(self.finish()[0], GoalStatus.SUCCEEDED)
        poses = [state.robot_poses[0] for state in self.state.all[first:]]
        self.assertFalse([at for at in poses if border[0] < at.x < border[2] and border[1] < at.y < border[3]])


if __name__ == "__main__":
    rostest.rosrun("vb_sim", "navigation", NavigationTest)
