#!/usr/bin/env python3
"""The coverage node with two cameras, one of which comes late and is moved."""

import unittest

import numpy as np
import rospy
import rostest
import tf2_ros
from sensor_msgs.msg import CameraInfo

from stimulus import room
from vb_testing import wait_until

from vb_core import geometry, names
from vb_core.camera_model import CameraModel
from vb_core.ros.cameras import info_from_camera
from vb_core.ros.messages import OccupancyGridArray, grid_from_message, message_from_grid, message_from_transform

LENS = CameraModel.ideal(400, 400, 200.0)  # sees 2 m x 2 m from a height of 2 m
DOWN = np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 0, -1.0]])


class CoverageTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("test_camera_coverage")
        cls.grid, cls.count = None, 0
        rospy.Subscriber(names.COVERAGE, OccupancyGridArray, cls.on_grid)
        cls.infos = {
            name: rospy.Publisher(f"/{name}/camera_info", CameraInfo, queue_size=1) for name in ("east", "west")
        }
        cls.silent = {"west"}
        cls.broadcaster = tf2_ros.StaticTransformBroadcaster()
        cls.poses = {}
        cls.place("east", 4.5, 2.5)
        cls.map = rospy.Publisher(names.PHYSICAL_MAP, OccupancyGridArray, queue_size=1, latch=True)
        cls.map.publish(message_from_grid(room(), rospy.Time.now()))
        cls.timer = rospy.Timer(rospy.Duration(0.05), cls.publish)

    @classmethod
    def on_grid(cls, message):
        cls.count += 1  # first: a test that sees the grid takes it for counted
        cls.grid = grid_from_message(message)

    @classmethod
    def place(cls, name, x, y):
        cls.poses[name] = message_from_transform(
            geometry.transform(DOWN, (x, y, 2.0)), "map", f"{name}_optical_frame", rospy.Time.now()
        )
        cls.broadcaster.sendTransform(list(cls.poses.values()))

    @classmethod
    def publish(cls, _event):
        for name, publisher in cls.infos.items():
            if name not in cls.silent:
                publisher.publish(info_from_camera(LENS, rospy.Time.now(), f"{name}_optical_frame"))

    def value(self, x, y):
        return None if self.grid is None else int(self.grid.values_at(np.array([[x, y]]))[0])

    def test_who_sees_what_and_what_changes(self):
        wait_until(lambda: self.value(4.5, 2.5) == 1, "what one camera sees")
        self.assertEqual((self.value(1.5, 2.5), self.value(0.02, 2.5)), (0, -1))
        self.silent.clear()
        self.place("west", 3.0, 2.5)
        wait_until(lambda: self.value(3.75, 2.5) == 2, "a place that both see")
        counted = self.count
        done = rospy.Time.now() + rospy.Duration(1.5)
        wait_until(lambda: rospy.Time.now() > done, "one and a half seconds")
        self.assertEqual(self.count, counted, "nothing has changed, so nothing is published")
        self.place("west", 1.5, 2.5)
        wait_until(lambda: self.value(1.0, 2.5) == 1, "the camera at its new place")
        grid = room()
        data = grid.data.copy()
        data[45:55, 40:44] = 100  # stands before the camera in the west
        self.map.publish(message_from_grid(grid.with_data(data), rospy.Time.now()))
        wait_until(lambda: self.value(2.1, 2.5) == -1 and self.value(2.25, 2.5) == 0, "what stands before the camera")


if __name__ == "__main__":
    rostest.rosrun("vb_robot", "camera_coverage", CoverageTest)
