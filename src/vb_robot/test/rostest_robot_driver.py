#!/usr/bin/env python3
"""Two robots' drivers with spots, tf, scans, maps and commands, in a closed loop: their commands move the robots."""

import os
import signal
import unittest

import numpy as np
import rospy
import rostest
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist, Vector3
from nav_msgs.msg import Path
from std_msgs.msg import UInt8
from std_srvs.srv import Empty, EmptyResponse

from plain_rooms import room, with_border
from robot_inputs import Body, Stimulus
from vb_testing import Newest, process_of, wait_until
from vb_core import names
from vb_core.interaction_tables import DEFAULT, GUIDE
from vb_core.ros.messages import NumpyOccupancyGrid
from vb_msgs.msg import DriverState, NoticeArray, Stop


class DriverTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("test_robot_driver")
        cls.ada = Body((1.0, 4.0, 0.0), "ada")
        cls.stimulus = Stimulus(pose=(1.5, 2.5, 0.0), others=(cls.ada,))
        cls.drivers, cls.notices = {}, {}
        for body in (cls.stimulus, cls.ada):
            cls.listen(body)
        rospy.Subscriber(names.DRIVERS, DriverState, lambda m: cls.drivers.update({m.robot: (m.source, m.code)}))
        rospy.Subscriber(names.NOTICES, NoticeArray, lambda m: cls.notices.update({m.source: m.notices}))
        cls.navigation = rospy.Publisher("cmd_vel/navigation", Twist, queue_size=1)
        cls.stop = rospy.Publisher(names.STOP, Stop, queue_size=1)
        cls.wish = None
        cls.timer = rospy.Timer(rospy.Duration(0.1), cls.on_timer)
        cls.stimulus.set_state(DEFAULT)
        wait_until(lambda: cls.drivers.get("") and cls.drivers.get("ada"), "both drivers")

    @classmethod
    def listen(cls, body):
        body.wheels = rospy.Subscriber(f"{body.prefix}cmd_vel", Twist, cls.on_command, body)

    @classmethod
    def on_command(cls, message, body):
        with body.lock:
            body.velocity = (message.linear.x, message.angular.z)

    @classmethod
    def on_timer(cls, _event):
        if cls.wish is not None:
            v, w = cls.wish
            cls.navigation.publish(Vector3(x=v), Vector3(z=w))

    def setUp(self):
        self.stimulus.spot, self.stimulus.silent = None, False
        type(self).wish = None
        self.stimulus.set_state(DEFAULT)
        wait_until(lambda: self.stimulus.velocity == (0.0, 0.0) == self.ada.velocity, "both robots to stand")
        for body, pose in ((self.stimulus, (1.5, 2.5, 0.0)), (self.ada, (1.0, 4.0, 0.0))):
            with body.lock:
                body.pose = pose
        self.publish_border(False)
        wait_until(self.is_released, lambda: f"the end of all stops; {self.drivers}")

    def is_released(self):
        # repeatedly: a driver that has just started may have reported a stop since
        self.stimulus.latch.resume(self.stimulus.latch.number)
        return self.drivers.get("") == ("none", "idle") and self.drivers["ada"][0] != "stop"

    def is_stopped(self):
        self.stop.publish(Stop())  # repeatedly: a driver that reports may not be connected to this topic yet
        return {drives for drives, _code in self.drivers.values()} == {"stop"}

    def stop_all(self):
        wait_until(self.is_stopped, lambda: f"a stop of both; {self.drivers}")

    def publish_border(self, has_border=True):
        grid = room(6.0)
        borders = with_border(grid, 4.0, 2.0, 5.0, 3.0) if has_border else grid
        self.stimulus.publish_map(borders, physical=grid)
        return int((borders.data == 100).sum())

    def wait_hold(self, code):
        wait_until(
            lambda: self.drivers[""][1] == code and self.stimulus.velocity == (0.0, 0.0),
            lambda: f"a robot that stands because of {code}; {self.drivers}",
        )

    def drive(self):
        type(self).wish = (0.05, 0.2)
        self.wait_driven()

    def wait_driven(self):
        wait_until(lambda: self.stimulus.velocity == (0.05, 0.2), lambda: f"navigation to drive; {self.drivers}")

    def wait_notice(self, code, robot="", expected=True):
        wait_until(lambda: self.has_notice(code, robot) == expected, lambda: f"{code}: {expected}; {self.notices}")

    def has_notice(self, code, robot=""):
        return any((n.code, n.robot) == (code, robot) for notices in self.notices.values() for n in notices)

    def test_follows_the_spot_and_stops_when_the_manager_is_silent(self):
        self.stimulus.set_state(GUIDE)
        self.stimulus.spot = (self.stimulus.pose[0] + 2.2, self.stimulus.pose[1], "robot", True)
        wait_until(lambda: self.stimulus.velocity[0] > 0.1, lambda: f"a robot that drives; {self.drivers}")
        # velocity and report are on different topics, so that either may come first
        wait_until(lambda: self.drivers[""][0] == "follow", lambda: f"the driver to say what drives; {self.drivers}")
        self.stimulus.silent = True
        self.wait_hold("state_lost")
        self.wait_notice("robot_state_lost")
        self.stimulus.silent = False
        wait_until(lambda: self.stimulus.velocity[0] > 0.1, lambda: f"a robot that drives; {self.drivers}")
        self.wait_notice("robot_state_lost", expected=False)

    def test_a_driver_restarted_without_a_manager_stays_stopped(self):
        reports = Newest(names.DRIVERS, DriverState).all
        self.stop_all()
        wait_until(lambda: any(report.robot == "" and report.stops for report in reports), "a driver that holds a stop")
        self.stimulus.silent = True
        old_process = process_of("/robot_driver")
        os.kill(old_process, signal.SIGKILL)
        wait_until(lambda: process_of("/robot_driver") not in (None, old_process), "the driver that starts again")
        reports.clear()
        base = Newest("cmd_vel", Twist)
        wait_until(lambda: base.count > 5 and any(message.robot == "" for message in reports), "what it reports")
        base.subscriber.unregister()
        self.assertEqual({(message.linear.x, message.angular.z) for message in base.all}, {(0.0, 0.0)})
        self.assertEqual({message.code for message in reports if message.robot == ""}, {"stopped"})

    def test_navigation_goes_through_it_and_stop_wins(self):
        self.drive()
        self.stop_all()
        self.wait_hold("stopped")
        self.wait_notice("robot_stopped")
        self.wait_notice("stop_not_persisted", "ada")
        self.assertFalse(self.has_notice("stop_not_persisted"))
        wait_until(lambda: self.is_released() or self.stimulus.velocity == (0.05, 0.2), "navigation to drive again")
        self.stimulus.latch.stop("said to the manager", "test")
        self.wait_hold("stopped")
        self.stimulus.latch.resume(self.stimulus.latch.number)
        self.wait_driven()
        self.assertEqual(self.ada.velocity, (0.0, 0.0))

    def test_maps_of_different_geometry_stop_the_robot(self):
        self.drive()
        self.stimulus.publish_map(room(6.0), physical=room(6.5))
        self.wait_hold("no_map")
        self.publish_border(False)
        self.wait_driven()

    def test_another_node_that_drives_the_base_is_named_and_answered_with_zeros(self):
        speeds = []
        base = rospy.Subscriber("cmd_vel", Twist, lambda message: speeds.append(message.linear.x))
        self.addCleanup(base.unregister)
        other = rospy.Publisher("cmd_vel", Twist, queue_size=1)
        self.addCleanup(other.unregister)
        wait_until(lambda: self.drivers[""][1] == "other_cmd_vel_publisher", "the other one to be found")
        self.wait_notice("robot_other_cmd_vel_publisher")

        def is_answered():
            other.publish(linear=Vector3(x=0.3))
            return 0.3 in speeds and speeds[-1] == 0.0 and 2 * speeds.count(0.0) >= len(speeds) > 40

        wait_until(is_answered, lambda: f"each of its commands to be answered by a zero; {speeds[-10:]}")
        other.unregister()
        wait_until(lambda: self.drivers[""][1] == "idle", "a driver without the other one")

    def test_a_base_that_does_not_listen_is_reported(self):
        # drivers that started before this process subscribed have reported it at first, too
        for robot in ("", "ada"):
            self.wait_notice("base_not_listening", robot, expected=False)
        self.ada.wheels.unregister()
        self.wait_notice("base_not_listening", "ada")
        self.assertFalse(self.has_notice("base_not_listening"), str(self.notices))
        self.listen(self.ada)
        self.wait_notice("base_not_listening", "ada", expected=False)

    def test_a_command_that_goes_sideways_stops_the_robot(self):
        self.drive()
        type(self).wish = None

        def stops():
            self.navigation.publish(linear=Vector3(x=0.05, y=0.1))
            return self.drivers[""][1] == "bad_command" and self.stimulus.velocity == (0.0, 0.0)

        wait_until(stops, lambda: f"the robot to stop; {self.drivers}")

    def test_the_active_source_and_its_code_are_reported_twice_a_second(self):
        self.drive()
        reports = Newest(names.DRIVERS, DriverState).all

        def newest():
            return [report for report in reports if report.robot == ""][-5:]

        # on a busy computer a late input may cause another report in between
        wait_until(
            lambda: [(report.source, report.code) for report in newest()] == 5 * [("navigation", "driving")],
            lambda: f"five reports without a change; {newest()}",
        )
        gaps = np.diff([report.header.stamp.to_sec() for report in newest()])
        self.assertTrue((gaps > 0.4).all(), gaps)  # at most; how much later on a busy computer is irrelevant

    def test_a_lost_localisation_looks_around_if_it_was_ever_located(self):
        certain, uncertain = PoseWithCovarianceStamped(), PoseWithCovarianceStamped()
        uncertain.pose.covariance[0] = uncertain.pose.covariance[7] = 0.25  # as AMCL starts, and as RViz estimates
        poses = rospy.Publisher("ada/amcl_pose", PoseWithCovarianceStamped, queue_size=1, latch=True)
        looks = []

        def look(_request):
            looks.append(0)
            if len(looks) >= 3:
                poses.publish(certain)
            return EmptyResponse()

        self.addCleanup(rospy.Service("ada/request_nomotion_update", Empty, look).shutdown)
        self.addCleanup(poses.publish, certain)
        poses.publish(uncertain)
        reports = Newest(names.DRIVERS, DriverState).all
        wait_until(lambda: len([report for report in reports if report.robot == "ada"]) > 6, "three seconds of reports")
        self.assertEqual(looks, [], "nobody has said where it is")
        rospy.Publisher("ada/initialpose", PoseWithCovarianceStamped, queue_size=1, latch=True).publish(uncertain)
        wait_until(lambda: len(looks) == 3, "three looks")
        poses.publish(uncertain)
        wait_until(lambda: len(looks) == 4, "a look of one that knew a moment ago")

    def test_navigation_gets_borders_inflated_by_the_localisation_uncertainty(self):
        maps = Newest(names.MAP_WITH_MARGIN, NumpyOccupancyGrid)
        localization = PoseWithCovarianceStamped()
        poses = rospy.Publisher("amcl_pose", PoseWithCovarianceStamped, queue_size=1)
        plain = self.publish_border()
        usual = (maps.wait(lambda message: (message.data == 100).sum() > plain, "some margin").data == 100).sum()

        def becomes(variance, condition):
            localization.pose.covariance[0] = localization.pose.covariance[7] = variance
            poses.publish(localization)
            return condition((maps.message.data == 100).sum())

        wait_until(lambda: becomes(0.25, lambda count: count > usual), "a wider margin")
        wait_until(lambda: becomes(0.0001, lambda count: count == usual), "the usual margin")

    def test_the_path_is_that_of_the_planner_that_navigation_has(self):
        planner = rospy.Publisher("ada/move_base/GlobalPlanner/plan", Path, queue_size=1)
        wait_until(lambda: planner.get_num_connections() > 0, "the driver to listen")

    def test_every_value_of_a_contact_but_the_clear_one_counts(self):
        bumper = rospy.Publisher("ada/bumper", UInt8, queue_size=1)
        teleop = rospy.Publisher("ada/cmd_vel/teleop", Twist, queue_size=1)

        def says(value, code):
            bumper.publish(value)
            teleop.publish(angular=Vector3(z=0.2))
            return self.drivers["ada"] == ("teleop", code)

        for value, code in ((0, "driving"), (2, "contact"), (0, "driving"), (4, "contact"), (0, "driving")):
            wait_until(lambda value=value, code=code: says(value, code), lambda: f"{code}; {self.drivers}")


if __name__ == "__main__":
    rostest.rosrun("vb_robot", "robot_driver", DriverTest)
