#!/usr/bin/env python3
"""The monitor with maps, borders and a robot that is carried about."""
import os
import sys
import unittest

import rospy
import rostest
from actionlib_msgs.msg import GoalID
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Point, Twist
from move_base_msgs.msg import MoveBaseActionGoal
from std_msgs.msg import String

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from stimulus import Stimulus, room, wait_until  # noqa: E402

from vb_core import names  # noqa: E402
from vb_core.errors import ParameterError  # noqa: E402
from vb_core.ros.messages import pose_from_2d  # noqa: E402
from vb_robot import workspace_monitor_node  # noqa: E402
from vb_msgs.msg import VirtualBorder, VirtualBorderArray  # noqa: E402


class MonitorTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("test_workspace_monitor")
        cls.said, cls.stops, cls.cancelled, cls.levels = [], [], [], []
        rospy.Subscriber("/virtual_borders/workspace", String, lambda m: cls.said.append(m.data))
        rospy.Subscriber("cmd_vel", Twist, lambda m: cls.stops.append(m))
        rospy.Subscriber("move_base/cancel", GoalID, lambda m: cls.cancelled.append(m))
        rospy.Subscriber("/diagnostics", DiagnosticArray,
                         lambda m: cls.levels.extend(s.level for s in m.status if s.name.endswith("workspace")))
        cls.goals = rospy.Publisher("move_base/goal", MoveBaseActionGoal, queue_size=1)
        cls.borders = rospy.Publisher(names.BORDERS, VirtualBorderArray, queue_size=1, latch=True)
        cls.stimulus = Stimulus(pose=(1.0, 1.0, 0.0))
        grid = room()
        data = grid.data.copy()
        data[40:60, 40:60] = 100  # x and y from 2 to 3 m
        cls.stimulus.publish_map(grid.with_data(data), physical=grid)
        border = VirtualBorder(id="1", name="carpet", kind=VirtualBorder.POLYGON, occupancy=1.0, enabled=True)
        border.points = [Point(2, 2, 0), Point(3, 2, 0), Point(3, 3, 0), Point(2, 3, 0)]
        border.seed = Point(2.5, 2.5, 0)
        cls.borders.publish(VirtualBorderArray(borders=[border]))
        assert wait_until(lambda: cls.goals.get_num_connections() > 0), "the monitor did not subscribe"
        assert wait_until(lambda: DiagnosticStatus.OK in cls.levels), "the monitor does not watch"

    def test_entering_is_said_and_stopped_and_leaving_is_said(self):
        self.stimulus.pose = (2.5, 2.5, 0.0)
        self.assertTrue(wait_until(lambda: any("is inside 'carpet'" in s for s in self.said)))
        self.assertTrue(wait_until(lambda: self.cancelled and self.stops))
        self.assertTrue(wait_until(lambda: DiagnosticStatus.ERROR in self.levels))
        self.stimulus.pose = (1.0, 1.0, 0.0)
        self.assertTrue(wait_until(lambda: any("has left 'carpet'" in s for s in self.said)))
        self.stimulus.pose = (1.9, 2.5, 0.0)
        self.assertTrue(wait_until(lambda: any("touches 'carpet'" in s for s in self.said)))

    def test_goal_inside_is_answered_with_the_name(self):
        goal = MoveBaseActionGoal()
        goal.goal.target_pose.header.frame_id = "map"
        goal.goal.target_pose.pose = pose_from_2d(2.4, 2.6, 0.0)
        self.goals.publish(goal)
        self.assertTrue(wait_until(lambda: any("goal" in s and "lies inside 'carpet'" in s for s in self.said)))

    def test_unknown_policy_is_named(self):
        rospy.set_param("~policy", "ignore")
        with self.assertRaises(ParameterError) as caught:
            workspace_monitor_node.build()
        self.assertEqual(caught.exception.key, rospy.get_name() + "/policy")


if __name__ == "__main__":
    rostest.rosrun("vb_robot", "workspace_monitor", MonitorTest)
