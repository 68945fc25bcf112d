#!/usr/bin/env python3
"""Robots with navigation of their own, and borders_only.launch: what the page says is compared with what they do."""

import math
import os
import signal
import subprocess
import threading
import unittest
from pathlib import Path

import rosgraph
import rospy
import rostest
import tf2_ros
from dynamic_reconfigure.msg import Config, DoubleParameter
from dynamic_reconfigure.srv import Reconfigure, ReconfigureResponse
from geometry_msgs.msg import Point, PoseStamped, Twist
from rosgraph_msgs.msg import Log
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Header

from phone import Browser
from vb_testing import is_listening, listen, wait_until
from vb_core import geometry, names, sentences
from vb_core.ros.messages import NumpyOccupancyGrid, grid_from_message, message_from_pose2d, message_from_transform
from vb_core.ros.notices import NoticeListener
from vb_core.child_processes import free_port
from vb_msgs.msg import DriverState, RobotStatusArray, VirtualBorder, VirtualBorderArray
from vb_msgs.srv import AddBorder, RemoveBorder

CARPET = [(3.12, 0.8), (5.12, 0.8), (5.12, 2.05), (3.12, 2.05)]
# what is connected: arguments of borders_only.launch, and changes of its environment
MAP_ONLY = ("robots:=ada bob", "rviz:=true"), {"DISPLAY": "", "WAYLAND_DISPLAY": ""}
OBEYING = ("robots:=ada bob", "rviz:=false", "obey:=true"), {}
DRIVEN = ("robots:=cid", "rviz:=false", "robot_types:=turtlebot2"), {}
START = {"ada": (7.0, 1.5, math.pi), "bob": (7.0, 3.0, math.pi), "cid": (5.8, 2.4, math.pi)}


class Robots:
    """Stands in for the robots' wheels, scanners and localisation: takes velocities, publishes tf and scans."""

    def __init__(self):
        self.poses = dict(START)
        self._velocities = dict.fromkeys(START, (0.0, 0.0))
        self.speeds = dict.fromkeys(START, 0.0)  # the highest speed since it was set to 0
        self.localized = True
        self._lock = threading.Lock()
        self._tf = tf2_ros.TransformBroadcaster()
        self._scans = {name: rospy.Publisher(f"/{name}/scan", LaserScan, queue_size=1) for name in START}
        for name in START:
            rospy.Subscriber(f"/{name}/cmd_vel", Twist, self._on_velocity, name, queue_size=1)
        self._last = rospy.get_time()
        self._timer = rospy.Timer(rospy.Duration(0.05), self._step)

    def put(self, name, pose):
        with self._lock:
            self.poses[name], self._velocities[name] = pose, (0.0, 0.0)

    def rests(self, name):
        with self._lock:
            return self._velocities[name] == (0.0, 0.0)

    def _on_velocity(self, message, name):
        with self._lock:
            self._velocities[name] = (message.linear.x, message.angular.z)
            self.speeds[name] = max(self.speeds[name], abs(message.linear.x))

    def _step(self, _event):
        now = rospy.Time.now()
        seconds = min(0.2, now.to_sec() - self._last)
        self._last = now.to_sec()
        with self._lock:
            for name, (x, y, yaw) in self.poses.items():
                v, w = self._velocities[name]
                self.poses[name] = (x + v * seconds * math.cos(yaw), y + v * seconds * math.sin(yaw), yaw + w * seconds)
            poses = dict(self.poses)
        for name, pose in poses.items():
            scan = LaserScan(angle_min=-3.14, angle_max=3.14, angle_increment=0.02, range_min=0.05, range_max=8.0)
            scan.header = Header(stamp=now, frame_id=f"{name}/base_link")
            scan.ranges = [math.inf] * 315
            self._scans[name].publish(scan)
            if self.localized:
                odom = message_from_transform(geometry.transform_from_pose2d(0, 0, 0), "map", f"{name}/odom", now)
                place = geometry.transform_from_pose2d(*pose)
                self._tf.sendTransform([odom, message_from_transform(place, f"{name}/odom", f"{name}/base_link", now)])


class LocalPlanner:
    """Stands in for a local planner's dynamic_reconfigure server: values are set by a service, and published."""

    def __init__(self, name):
        self._values = {"max_vel_trans": 0.5, "max_vel_x": 0.5, "min_vel_trans": 0.1}
        self._updates = rospy.Publisher(f"{name}/parameter_updates", Config, queue_size=5, latch=True)
        rospy.Service(f"{name}/set_parameters", Reconfigure, self._on_request)

    def limit(self):
        return self._values["max_vel_trans"]

    def _on_request(self, request):
        self._values.update({entry.name: entry.value for entry in request.config.doubles})
        config = Config(doubles=[DoubleParameter(name, value) for name, value in self._values.items()])
        self._updates.publish(config)
        return ReconfigureResponse(config)


class OwnRobots(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("own_robots")
        cls.launch = cls.browser = cls.running = None
        cls.addClassCleanup(cls.stop)
        cls.logged = []
        cls.robots = Robots()
        goals = {name: f"/{name}/move_base_simple/goal" for name in START}
        cls.goals = {name: rospy.Publisher(topic, PoseStamped, queue_size=1) for name, topic in goals.items()}
        kinds = {names.ROBOTS: RobotStatusArray, names.BORDERS: VirtualBorderArray, names.DRIVERS: DriverState}
        kinds.update({f"/{name}/virtual_borders/map": NumpyOccupancyGrid for name in ("ada", "bob")})
        cls.heard = listen(kinds)
        cls.listener = NoticeListener()
        rospy.Subscriber("/rosout", Log, lambda entry: cls.logged.append((entry.level, entry.msg)), queue_size=100)

    @classmethod
    def start(cls, lab):
        """Starts borders_only.launch, and the page in a browser, unless this lab runs already."""
        if cls.running == lab:
            return
        cls.stop()
        cls.running, (arguments, environment) = lab, lab
        port = free_port()
        state = Path(rospy.get_param("~state"))
        command = ["roslaunch", "vb_bringup", "borders_only.launch", f"state:={state}", f"page_port:={port}"]
        cls.logged.clear()
        cls.heard.clear()
        cls.launch = subprocess.Popen([*command, *arguments], env={**os.environ, **environment}, start_new_session=True)
        cls.wait(lambda: names.BORDERS in cls.heard and names.ROBOTS in cls.heard, "borders_only to start")
        wait_until(lambda: is_listening(port), "the page to listen")
        cls.browser = Browser(f"http://127.0.0.1:{port}/")
        cls.browser.wait("window.virtualBorders && window.virtualBorders.view.capabilities", what="what is connected")
        cls.browser.run("document.getElementById('health').open = true")

    @classmethod
    def stop(cls):
        if cls.browser is not None:
            cls.browser.close()
        if cls.launch is not None:
            os.killpg(cls.launch.pid, signal.SIGINT)
            cls.launch.wait(60)
        cls.browser = cls.launch = None

    @classmethod
    def wait(cls, arrived, what):
        wait_until(arrived, lambda: f"{what}; there is {cls.notices()}")

    @classmethod
    def notices(cls):
        return {(notice.code, notice.robot) for notice in cls.listener.current()}

    def warnings(self):
        return [text for level, text in self.logged if level >= Log.WARN]

    def status(self, robot):
        return next(status for status in self.heard[names.ROBOTS].robots if status.robot == robot)

    def add(self, name, corners=CARPET, **fields):
        border = VirtualBorder(name=name, kind=VirtualBorder.POLYGON, enabled=True, occupancy=1.0, **fields)
        border.points = [Point(x, y, 0.0) for x, y in corners]
        border.seed = Point(*[sum(axis) / len(corners) for axis in zip(*corners)], 0.0)
        answer = rospy.ServiceProxy(names.ADD_BORDER, AddBorder)(border=border, frame_id="map", source="test")
        self.assertTrue(answer.success, answer.message)
        self.addCleanup(rospy.ServiceProxy(names.REMOVE_BORDER, RemoveBorder), id=answer.id, source="test")
        self.browser.wait_text("#borders", name)
        return answer.id

    def drive(self, robot, x, y):
        header = Header(stamp=rospy.Time.now(), frame_id="map")
        self.goals[robot].publish(PoseStamped(header, message_from_pose2d(x, y, 0.0)))

    def test_a_robot_reports_whether_it_plans_round_borders(self):
        self.start(MAP_ONLY)
        # within a minute this launch file alone prints what is wired and what is not
        expected = [sentences.translate("robot_plans_round_borders", {"who": "ada"}), "bob drives through borders"]
        self.wait(lambda: all(any(part in text for _, text in self.logged) for part in expected), "what is connected")
        self.wait(lambda: ("robot_ignores_borders", "bob") in self.notices(), "the notice about bob")
        self.assertFalse([code for code, robot in self.notices() if robot == "ada"])
        # no node complains about cameras, detectors or a manager, which this launch file does not have
        self.assertFalse([text for text in self.warnings() if "amera" in text or "interaction_manager" in text])
        # no Stop that would stop nothing; the header does not wait for nodes that are not meant to run
        self.browser.wait("document.body.dataset.state == 'robot_unready'", what="the header")
        self.assertEqual(self.browser.boxes("#stop"), [])
        self.assertEqual(self.browser.boxes("#laser"), [])
        self.browser.wait_text("#notices", "bob drives through borders")
        # both robots are on the map
        self.browser.wait("Object.keys(window.virtualBorders.view.robots || {}).sort().join() == 'ada,bob'")
        # without a screen, RViz waits and says so
        self.wait(lambda: any(sentences.translate("no_screen") in text for _, text in self.logged), "RViz to wait")
        self.assertTrue(rosgraph.Master("/test").lookupNode("/rviz"))

    def test_a_border_names_its_robots_and_those_that_ignore_it(self):
        self.start(MAP_ONLY)
        self.add("Rug", robots=["ada"])
        maps = [f"/{name}/virtual_borders/map" for name in ("ada", "bob")]
        restricted = lambda topic: (grid_from_message(self.heard[topic]).data > 50).sum()  # noqa: E731
        self.wait(lambda: set(maps) <= set(self.heard) and restricted(maps[0]) > restricted(maps[1]), "ada's")
        self.browser.wait_text("#borders", "Only ada")
        self.assertNotIn("Not kept", self.browser.text("#borders"))
        self.add("Desk", [(6.0, 3.5), (6.8, 3.5), (6.8, 4.2), (6.0, 4.2)])
        self.browser.wait_text("#borders", "Not kept by bob")
        # a slow zone that nobody enforces is not shown as in force
        self.add("Lane", [(5.3, 3.0), (5.9, 3.0), (5.9, 4.2), (5.3, 4.2)], zone=VirtualBorder.SLOW, max_speed=0.1)
        self.browser.wait_text("#borders", "No speed limit for ada, bob")
        self.browser.wait_text("#borders", "meant: at most 0.1 m/s")
        # such a zone cannot be chosen, but a border's robots can
        self.browser.run("[...document.querySelectorAll('#borders .name')][0].click()")
        self.browser.click("#dialog button", "Edit")
        self.browser.wait("document.querySelector('#review select')", what="the zones")
        zones = "[...document.querySelectorAll('#review select option')].map((one) => one.value)"
        self.assertEqual(self.browser.run(f"return {zones}"), ["keep_out", "avoid"])
        self.browser.click("#review button", "All robots")
        self.browser.click("#review button", "bob")
        self.browser.click("#review button", "Save")
        self.wait(lambda: list(self.heard[names.BORDERS].borders[0].robots) == ["bob"], "the border to be bob's")
        self.assertEqual(self.browser.faults(), [])

    def test_a_goal_is_refused_at_once_with_the_reason(self):
        self.start(MAP_ONLY)
        self.add("Rug")
        self.wait(lambda: self.status("ada").localized, "ada's place")
        self.drive("ada", 4.1, 1.4)
        self.wait(lambda: ("goal_in_border", "ada") in self.notices(), "why ada does not go there")
        self.browser.wait_text("#notices", "'Rug'")
        self.drive("ada", 7.0, 1.5)
        self.wait(lambda: ("goal_in_border", "ada") not in self.notices(), "another goal to count")

    def test_a_robot_caught_inside_is_reported_while_it_lasts(self):
        self.start(MAP_ONLY)
        self.robots.put("ada", (4.1, 1.4, 0.0))
        self.addCleanup(self.robots.put, "ada", START["ada"])
        self.wait(lambda: abs(self.robots.poses["ada"][0] - 4.1) < 0.01, "ada to be put")
        self.add("Rug")
        self.wait(lambda: ("robot_caught_in_border", "ada") in self.notices(), "ada to be caught")
        self.browser.wait_text("#notices", "joystick")
        self.robots.put("ada", START["ada"])
        self.wait(lambda: ("robot_caught_in_border", "ada") not in self.notices(), "ada to be out")

    def test_a_robot_is_sent_to_a_place_by_the_page(self):
        self.start(MAP_ONLY)
        self.add("Rug")
        self.browser.click("#go")
        # bob is not offered, since it would drive through borders
        self.assertNotIn("bob", self.browser.text("#review"))
        self.browser.tap([4.1, 1.4])
        self.browser.wait_text("#toast", "'Rug'")
        self.browser.tap([6.0, 1.5])
        self.browser.wait_text("#goals", "ada is driving to x 6 m, y 1.5 m")
        self.browser.wait("document.querySelector('#world .path')", what="the path on the map")
        self.browser.click("#goals button", "End this drive")
        self.wait(lambda: not self.status("ada").has_goal, "the drive to end")
        self.browser.wait("!document.querySelector('#goals li')", what="the drive to go")
        self.assertEqual(self.browser.faults(), [])

    def test_navigation_alone_stops_a_robot(self):
        self.start(OBEYING)
        self.browser.wait("document.body.dataset.state == 'default'", what="the manager")
        self.wait(lambda: self.status("ada").obeys_stop and self.status("ada").localized, "ada to obey")
        # the stand-in has no local planner whose speed could be set: the page says so
        self.assertFalse(self.status("ada").obeys_speed)
        self.browser.wait_text("#drivers", "It does not obey slow zones")
        self.assertEqual(self.browser.boxes("#laser"), [])
        self.robots.speeds["ada"] = 0.0
        self.drive("ada", 6.0, 1.5)
        self.wait(lambda: self.robots.speeds["ada"] > 0.1, "ada to drive")
        self.browser.click("#stop")
        self.wait(lambda: not self.status("ada").has_goal and self.robots.rests("ada"), "ada to stop")
        self.browser.wait_text("#banners", "stopped")
        self.wait(lambda: self.status("ada").stops, "ada to say that it holds the stop")
        self.drive("ada", 5.0, 3.0)
        self.wait(lambda: ("goal_while_stopped", "ada") in self.notices(), "the goal to be refused")
        self.wait(lambda: not self.status("ada").has_goal and self.robots.rests("ada"), "the goal to be cancelled")
        self.browser.click("#resume")
        self.browser.wait("!document.body.classList.contains('stopped')", what="the end of the stop")
        self.wait(lambda: not self.status("ada").stops, "ada to hold no stop")
        self.drive("ada", 6.5, 1.5)
        self.wait(lambda: self.status("ada").has_goal, "ada to go on")

    def test_navigation_alone_obeys_slow_zones(self):
        """bob has a local planner whose speed can be set; it is in the zone."""
        self.start(OBEYING)
        planner = LocalPlanner("/bob/move_base/DWAPlannerROS")
        self.wait(lambda: self.status("bob").obeys_speed, "bob to obey")
        self.assertEqual(planner.limit(), 0.5)
        self.add("Lane", [(6.5, 2.5), (7.5, 2.5), (7.5, 3.5), (6.5, 3.5)], zone=VirtualBorder.SLOW, max_speed=0.1)
        self.wait(lambda: planner.limit() == 0.1, "bob to be slow")
        # while it is not known to have left the zone, it stays slow
        self.addCleanup(setattr, self.robots, "localized", True)
        self.robots.localized = False
        self.wait(lambda: not self.status("bob").localized, "bob to be lost")
        number = self.heard[names.ROBOTS].header.seq
        self.wait(lambda: self.heard[names.ROBOTS].header.seq > number + 1, "another look")
        self.assertEqual(planner.limit(), 0.1)
        self.robots.put("bob", (5.5, 3.0, math.pi))
        self.addCleanup(self.robots.put, "bob", START["bob"])
        self.robots.localized = True
        self.wait(lambda: planner.limit() == 0.5, "bob's usual speed")

    def test_the_driver_runs_without_cameras(self):
        self.start(DRIVEN)
        self.wait(lambda: names.DRIVERS in self.heard and self.heard[names.DRIVERS].code == "idle", "cid's driver")
        self.browser.wait_text("#drivers", "cid has a driver")
        self.assertEqual(len(self.browser.boxes("#stop")), 1)
        self.assertFalse([text for text in self.warnings() if "state_lost" in text or "amera" in text])
        self.assertEqual(self.browser.boxes("#laser"), [])


if __name__ == "__main__":
    rostest.rosrun("vb_bringup", "own_robots", OwnRobots)
