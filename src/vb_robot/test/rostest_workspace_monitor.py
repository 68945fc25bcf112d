#!/usr/bin/env python3
"""The monitor with maps, borders and a robot that is carried about."""
import os
import sys
import unittest

import rospy
import rostest
from actionlib_msgs.msg import GoalID, GoalStatus, GoalStatusArray
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Point, Twist
from move_base_msgs.msg import MoveBaseActionGoal
from std_msgs.msg import String

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from stimulus import Stimulus, assert_bad_parameter_is_named, room, wait_until  # noqa: E402

from vb_core import names  # noqa: E402
from vb_core.ros.messages import OccupancyGridArray, message_from_grid, pose_from_2d  # noqa: E402
from vb_robot import workspace_monitor_node  # noqa: E402
from vb_msgs.msg import VirtualBorder, VirtualBorderArray  # noqa: E402


class MonitorTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("test_workspace_monitor")
        cls.said, cls.stops, cls.cancelled, cls.levels = [], [], [], []
        rospy.Subscriber(names.WORKSPACE, String, lambda m: cls.said.append(m.data))
        rospy.Subscriber("cmd_vel", Twist, lambda m: cls.stops.append(m))
        rospy.Subscriber("move_base/cancel", GoalID, lambda m: cls.cancelled.append(m))
        rospy.Subscriber("/diagnostics", DiagnosticArray,
                         lambda m: cls.levels.extend(s.level for s in m.status if s.name.endswith("workspace")))
        cls.exit_map = rospy.Publisher("/exit/virtual_map", OccupancyGridArray, queue_size=1, latch=True)
        cls.exit_map.publish(message_from_grid(room(), rospy.Time.now()))
        cls.exit_said = []
        rospy.Subscriber("/exit/workspace", String, lambda m: cls.exit_said.append(m.data))
        cls.drives, cls.called_off, cls.goal_runs = [], 0, False
        rospy.Subscriber("exit/cmd_vel", Twist, cls.on_drive)
        rospy.Subscriber("exit/move_base/cancel", GoalID, cls.on_call_off)
        cls.status = rospy.Publisher("exit/move_base/status", GoalStatusArray, queue_size=1)
        rospy.Timer(rospy.Duration(0.1), cls.publish_status)
        cls.goals = rospy.Publisher("move_base/goal", MoveBaseActionGoal, queue_size=1)
        cls.borders = rospy.Publisher(names.BORDERS, VirtualBorderArray, queue_size=1, latch=True)
        cls.stimulus = Stimulus(pose=(1.0, 1.0, 0.0))
        cls.stimulus.scan_range = 7.0
        grid = room()
        data = grid.data.copy()
        data[40:60, 40:60] = 100  # x and y from 2 to 3 m
        cls.carpet = grid.with_data(data)
        cls.stimulus.publish_map(cls.carpet, physical=grid)
        border = VirtualBorder(id="1", name="carpet", kind=VirtualBorder.POLYGON, occupancy=1.0, enabled=True)
        border.points = [Point(2, 2, 0), Point(3, 2, 0), Point(3, 3, 0), Point(2, 3, 0)]
        border.seed = Point(2.5, 2.5, 0)
        cls.borders.publish(VirtualBorderArray(borders=[border]))
        assert wait_until(lambda: cls.goals.get_num_connections() > 0), "the monitor did not subscribe"
        assert wait_until(lambda: cls.levels.count(DiagnosticStatus.OK) > 2), "the monitors do not watch"

    @classmethod
    def on_drive(cls, message):
        cls.drives.append((message.linear.x, message.angular.z))
        assert not cls.goal_runs or cls.drives[-1] == (0.0, 0.0)
        cls.stimulus.velocity = cls.drives[-1]

    @classmethod
    def on_call_off(cls, _message):
        cls.called_off += 1
        cls.goal_runs = False

    @classmethod
    def publish_status(cls, _event):
        status = GoalStatus(status=GoalStatus.ACTIVE if cls.goal_runs else GoalStatus.PREEMPTED)
        cls.status.publish(GoalStatusArray(status_list=[status]))

    def setUp(self):
        self.stimulus.scan_range = 7.0

    def swallow(self, pose):
        """A border is put where the robot stands; gives the sentences that follow."""
        self.exit_map.publish(message_from_grid(room(), rospy.Time.now()))
        self.assertTrue(wait_until(lambda: not self.exit_said or "has left" in self.exit_said[-1], 25.0))
        # it may still have been making its margin wider
        self.assertTrue(wait_until(lambda: not self.drives or self.drives[-1] == (0.0, 0.0)))
        self.exit_said.clear()
        self.drives.clear()
        with self.stimulus.lock:
            self.stimulus.pose, self.stimulus.velocity = pose, (0.0, 0.0)
        self.exit_map.publish(message_from_grid(self.carpet, rospy.Time.now()))

    def was_said(self, part):
        return wait_until(lambda: any(part in sentence for sentence in self.exit_said), 25.0)

    def test_leaves_by_itself_after_the_drawing_and_after_navigation(self):
        self.stimulus.set_state(2)
        type(self).goal_runs = True
        before = self.called_off
        self.swallow((2.2, 2.5, 3.0))
        self.assertTrue(self.was_said("is inside 'carpet'"))
        self.assertFalse(self.drives, "while somebody draws it waits")
        self.assertEqual(self.called_off, before)
        self.stimulus.set_state(0)
        self.assertTrue(self.was_said("goal is called off"))
        self.assertTrue(self.was_said("leaves 'carpet' by itself"))
        self.assertTrue(self.was_said("has left 'carpet'"))
        self.assertTrue(wait_until(lambda: self.drives[-1] == (0.0, 0.0)))
        self.assertGreater(self.called_off, before)
        self.assertLess(self.stimulus.pose[0], 2.0 - 0.18 - 0.05)
        self.assertTrue(all(abs(v) <= 0.2 and abs(w) <= 0.8 for v, w in self.drives))

    def test_gives_up_with_the_reason_and_tries_again(self):
        self.stimulus.set_state(0)
        self.stimulus.scan_range = 0.25
        self.swallow((2.2, 2.5, 3.0))
        self.assertTrue(self.was_said("gives up leaving 'carpet': something is in the way"))
        self.assertTrue(all(v == 0.0 for v, _ in self.drives))
        # whoever stood there goes; no new map comes
        self.stimulus.scan_range = 7.0
        self.assertTrue(self.was_said("has left 'carpet'"))

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
        assert_bad_parameter_is_named(self, workspace_monitor_node.build, "policy", "ignore")


if __name__ == "__main__":
    rostest.rosrun("vb_robot", "workspace_monitor", MonitorTest)
