#!/usr/bin/env python3
"""Two robots' drivers with spots, tf, scans, maps and commands; what they command moves the robots."""

import os
import signal
import sys
import unittest
from xmlrpc.client import ServerProxy

import rosgraph
import rospy
import rostest
from geometry_msgs.msg import Point, PoseStamped, PoseWithCovarianceStamped, Twist
from move_base_msgs.msg import MoveBaseActionGoal
from nav_msgs.msg import Path
from std_msgs.msg import Bool
from visualization_msgs.msg import MarkerArray

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from stimulus import Body, Stimulus, assert_bad_parameter_is_named, room, wait_until  # noqa: E402

from vb_core import names  # noqa: E402
from vb_core.ros.messages import OccupancyGridArray, message_from_pose2d  # noqa: E402
from vb_msgs.msg import DriverState, NoticeArray, VirtualBorder, VirtualBorderArray  # noqa: E402
from vb_robot import robot_driver_node  # noqa: E402

DEFAULT, BORDER, SEED, GUIDE = range(4)


def process_of(node):
    """The id of a node's process; None while there is none."""
    try:
        return ServerProxy(rosgraph.Master("/test").lookupNode(node)).getPid("/test")[2]
    except (OSError, rosgraph.MasterException):
        return None


class DriverTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("test_robot_driver")
        cls.ada = Body((1.0, 4.0, 0.0), "ada")
        cls.stimulus = Stimulus(pose=(1.5, 2.5, 0.0), others=(cls.ada,))
        cls.drivers, cls.notices = {}, {}
        for body in (cls.stimulus, cls.ada):
            rospy.Subscriber(f"{body.prefix}cmd_vel", Twist, cls.on_command, body)
        rospy.Subscriber(names.DRIVERS, DriverState, lambda m: cls.drivers.update({m.robot: (m.source, m.code)}))
        rospy.Subscriber(names.NOTICES, NoticeArray, cls.on_notices)
        cls.navigation = rospy.Publisher("cmd_vel/navigation", Twist, queue_size=1)
        cls.stop = rospy.Publisher(names.STOP, Bool, queue_size=1)
        cls.goals = rospy.Publisher("move_base/goal", MoveBaseActionGoal, queue_size=1)
        cls.borders = rospy.Publisher(names.BORDERS, VirtualBorderArray, queue_size=1, latch=True)
        cls.wish = None
        cls.timer = rospy.Timer(rospy.Duration(0.1), cls.on_timer)
        border = VirtualBorder(id="1", name="carpet", kind=VirtualBorder.POLYGON, occupancy=1.0, enabled=True)
        border.points = [Point(*p, 0.0) for p in ((4, 2), (5, 2), (5, 3), (4, 3))]
        border.seed = Point(4.5, 2.5, 0.0)
        cls.borders.publish(VirtualBorderArray(borders=[border]))
        cls.stimulus.scan_range = 7.0
        cls.stimulus.set_state(DEFAULT)
        assert wait_until(lambda: cls.drivers.get("") and cls.drivers.get("ada")), "the drivers did not come up"

    @classmethod
    def on_command(cls, message, body):
        with body.lock:
            body.velocity = (message.linear.x, message.angular.z)

    @classmethod
    def on_notices(cls, message):
        cls.notices[message.source] = {(notice.code, notice.robot) for notice in message.notices}

    @classmethod
    def on_timer(cls, _event):
        if cls.wish is not None:
            message = Twist()
            message.linear.x, message.angular.z = cls.wish
            cls.navigation.publish(message)

    def setUp(self):
        self.stimulus.spot, self.stimulus.silent, self.stimulus.confidence = None, False, 1.0
        type(self).wish = None
        self.stimulus.set_state(DEFAULT)
        self.assertTrue(wait_until(lambda: self.stimulus.velocity == (0.0, 0.0) == self.ada.velocity))
        self.put(self.stimulus, (1.5, 2.5, 0.0))
        self.put(self.ada, (1.0, 4.0, 0.0))
        self.publish_border(False)
        self.assertTrue(wait_until(self.is_released), str(self.drivers))

    def is_released(self):
        self.stop.publish(Bool(False))  # again: a driver that has just started may not have heard the first one
        return self.drivers.get("") == ("none", "idle") and self.drivers["ada"][0] != "stop"

    def is_stopped(self):
        self.stop.publish(Bool(True))  # again: a driver that reports need not be connected to this topic yet
        return {drives for drives, _code in self.drivers.values()} == {"stop"}

    def put(self, body, pose):
        with body.lock:
            body.pose = pose

    def publish_border(self, there=True):
        grid = room()
        data = grid.data.copy()
        data[40:60, 80:100] = 100  # x 4 to 5 m, y 2 to 3 m
        self.stimulus.publish_map(grid.with_data(data) if there else grid, physical=grid)
        return int((data == 100).sum())

    def guided(self):
        self.stimulus.set_state(GUIDE)
        self.stimulus.spot = (self.stimulus.pose[0] + 2.2, self.stimulus.pose[1], "robot", True)
        self.assertTrue(wait_until(lambda: self.stimulus.velocity[0] > 0.1), str(self.drivers))

    def holds(self, code):
        return wait_until(lambda: self.drivers.get("", ("", ""))[1] == code and self.stimulus.velocity == (0.0, 0.0))

    def has_notice(self, code, robot=""):
        return any((code, robot) in codes for codes in self.notices.values())

    def test_follows_the_spot_and_stops_when_the_manager_is_silent(self):
        self.guided()
        self.assertEqual(self.drivers[""][0], "follow")
        self.stimulus.silent = True
        self.assertTrue(self.holds("state_lost"), str(self.drivers))
        self.assertTrue(wait_until(lambda: self.has_notice("robot_state_lost")))
        self.stimulus.silent = False
        self.assertTrue(wait_until(lambda: self.stimulus.velocity[0] > 0.1))
        self.assertTrue(wait_until(lambda: not self.has_notice("robot_state_lost")))

    def test_a_driver_that_starts_again_while_the_manager_is_away_stays_stopped(self):
        self.assertTrue(wait_until(self.is_stopped), str(self.drivers))
        self.assertTrue(wait_until(lambda: os.path.exists(rospy.get_param("/robot_driver/stop_file"))))
        self.stimulus.silent = True
        said = []
        listener = rospy.Subscriber(names.DRIVERS, DriverState, said.append)
        before = process_of("/robot_driver")
        os.kill(before, signal.SIGKILL)
        self.assertTrue(wait_until(lambda: process_of("/robot_driver") not in (None, before)))
        said.clear()
        self.assertTrue(wait_until(lambda: any(message.robot == "" for message in said)))
        listener.unregister()
        self.assertEqual({message.code for message in said if message.robot == ""}, {"stopped"})

    def test_navigation_goes_through_it_and_stop_wins(self):
        type(self).wish = (0.05, 0.2)
        self.assertTrue(wait_until(lambda: self.stimulus.velocity == (0.05, 0.2)))
        self.assertTrue(wait_until(self.is_stopped), str(self.drivers))
        self.assertTrue(self.holds("stopped"))
        self.assertTrue(wait_until(lambda: self.has_notice("robot_stopped")))
        self.assertTrue(wait_until(lambda: self.has_notice("stop_not_persisted", "ada")))
        self.assertFalse(self.has_notice("stop_not_persisted"))
        self.stop.publish(Bool(False))
        self.assertTrue(wait_until(lambda: self.stimulus.velocity == (0.05, 0.2)))
        self.assertTrue(wait_until(lambda: not os.path.exists(rospy.get_param("/robot_driver/stop_file"))))
        self.stimulus.set_state(DEFAULT, stopped=True)
        self.assertTrue(self.holds("stopped"))
        self.stimulus.set_state(DEFAULT)
        self.assertTrue(wait_until(lambda: self.stimulus.velocity == (0.05, 0.2)))
        self.assertEqual(self.ada.velocity, (0.0, 0.0))

    def test_without_a_scan_it_stops(self):
        type(self).wish = (0.05, 0.2)
        self.assertTrue(wait_until(lambda: self.stimulus.velocity == (0.05, 0.2)))
        self.stimulus.scan_range = None
        self.assertTrue(self.holds("scan_lost"))
        self.stimulus.scan_range = 7.0
        self.assertTrue(wait_until(lambda: self.stimulus.velocity == (0.05, 0.2)))

    def test_commands_past_the_driver_stop_it(self):
        other = rospy.Publisher("cmd_vel", Twist, queue_size=1)
        type(self).wish = (0.05, 0.2)
        self.assertTrue(wait_until(lambda: self.stimulus.velocity == (0.05, 0.2)))

        def disturbed():
            other.publish(Twist())
            return self.drivers[""][1] == "other_cmd_vel_publisher"

        self.assertTrue(wait_until(disturbed))
        other.unregister()
        self.assertTrue(wait_until(lambda: self.stimulus.velocity == (0.05, 0.2)))

    def test_notices_are_cleared_by_code_and_robot(self):
        self.stimulus.set_state(SEED)  # nobody leaves while somebody draws
        self.publish_border()
        self.put(self.stimulus, (4.5, 2.5, 0.0))
        self.put(self.ada, (4.4, 2.4, 0.0))
        for robot in ("", "ada"):
            self.assertTrue(wait_until(lambda: self.has_notice("robot_inside_border", robot)), robot)
        self.put(self.ada, (1.0, 4.0, 0.0))
        self.assertTrue(wait_until(lambda: not self.has_notice("robot_inside_border", "ada")))
        self.assertTrue(self.has_notice("robot_inside_border", ""), "that the other has left clears nothing")

    def test_leaves_by_itself_after_the_drawing(self):
        self.stimulus.set_state(SEED)
        self.put(self.ada, (4.15, 2.5, 3.1))
        self.publish_border()
        self.assertTrue(wait_until(lambda: self.has_notice("robot_inside_border", "ada")))
        self.assertEqual(self.ada.velocity, (0.0, 0.0))
        # only a border that comes while the robot is there is left: until now the driver may have seen the map
        # before it saw where the robot had been put, which is a robot that somebody took into a border
        self.publish_border()
        self.stimulus.set_state(DEFAULT)
        self.assertTrue(wait_until(lambda: self.has_notice("robot_exits_border", "ada")))
        self.assertTrue(wait_until(lambda: self.ada.pose[0] < 4.0 - 0.18 and self.ada.velocity == (0.0, 0.0)))
        self.assertTrue(wait_until(lambda: not self.has_notice("robot_inside_border", "ada")))

    def test_navigation_gets_borders_inflated_by_the_localisation_uncertainty(self):
        cells, localization = [], PoseWithCovarianceStamped()
        listener = rospy.Subscriber(
            names.KEEP_OUT, OccupancyGridArray, lambda message: cells.append(int((message.data == 100).sum()))
        )
        poses = rospy.Publisher("amcl_pose", PoseWithCovarianceStamped, queue_size=1)
        plain = self.publish_border()
        self.assertTrue(wait_until(lambda: cells and cells[-1] > plain), "by something in any case")
        usual = cells[-1]

        def becomes(variance, condition):
            localization.pose.covariance[0] = localization.pose.covariance[7] = variance
            poses.publish(localization)
            return condition(cells[-1])

        self.assertTrue(wait_until(lambda: becomes(0.25, lambda count: count > usual)))
        self.assertTrue(wait_until(lambda: becomes(0.0001, lambda count: count == usual)))
        listener.unregister()

    def test_a_goal_inside_is_answered(self):
        self.publish_border()
        goal = MoveBaseActionGoal()
        goal.goal.target_pose.header.frame_id = "map"
        goal.goal.target_pose.pose = message_from_pose2d(4.4, 2.6, 0.0)

        def answered():
            self.goals.publish(goal)
            return self.has_notice("goal_in_border")

        self.assertTrue(wait_until(answered))

    def test_the_path_of_a_robot_with_a_name_is_on_the_topic_of_all(self):
        shown = {}
        rospy.Subscriber(names.PLANS, MarkerArray, lambda m: shown.update({k.ns: len(k.points) for k in m.markers}))
        path = Path(poses=[PoseStamped(), PoseStamped()])
        path.header.frame_id = "map"
        planner = rospy.Publisher("ada/move_base/NavfnROS/plan", Path, queue_size=1, latch=True)

        def is_shown():
            planner.publish(path)
            return shown == {"ada": 2}

        self.assertTrue(wait_until(is_shown))

    def test_a_contact_that_cannot_be_heard_is_refused(self):
        contact = {"topic": "bumper", "type": "no_such_msgs/Bumper"}
        rospy.set_param("robot_profile", {"contacts": [contact]})
        try:
            with self.assertRaisesRegex(Exception, "no_such_msgs/Bumper"):
                robot_driver_node.build()
        finally:
            rospy.delete_param("robot_profile")

    def test_bad_parameter_is_named(self):
        assert_bad_parameter_is_named(self, robot_driver_node.build, "exit_borders", "sometimes")


if __name__ == "__main__":
    rostest.rosrun("vb_robot", "robot_driver", DriverTest)
