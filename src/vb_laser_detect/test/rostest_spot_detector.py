#!/usr/bin/env python3
"""Three real detector nodes before played cameras: fixed with Bayer images, fixed with JPEG, and on a moving robot."""

import os
import sys
import threading
import unittest

import numpy as np
import rospy
import rostest
import tf2_ros
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import Image

from vb_core import geometry, names
from vb_core.grid_map import GridMap
from vb_core.ros.images import array_from_image
from vb_core.ros import messages
from vb_msgs.msg import DetectorStatus, LaserSpot

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from players import FixedCamera, RobotCamera  # noqa: E402
from scenes import GREEN, RED  # noqa: E402

TIMEOUT = 120.0
GUARD = (2.5, 1.5)  # [m] where a robot stands, on the circle that red's laser draws


class SpotDetectorTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("stimulus")
        cls.changed = threading.Condition()
        cls.spots, cls.status, cls.truth, cls.pictures = [], {}, {}, []
        cls.diagnostics = set()
        cls.red = FixedCamera("red", 2.0, 1.5, RED, False)
        cls.blue = FixedCamera("blue", 4.0, 1.5, GREEN, True)
        cls.robot = RobotCamera()
        cls.fixed_tf = tf2_ros.StaticTransformBroadcaster()
        cls.fixed_tf.sendTransform(
            [
                *(messages.message_from_transform(c.T, "map", c.frame, rospy.Time.now()) for c in (cls.red, cls.blue)),
                messages.message_from_transform(
                    geometry.transform(np.eye(3), (*GUARD, 0.0)), "map", "guard/base_link", rospy.Time.now()
                ),
            ]
        )
        cls.map = rospy.Publisher("/map", messages.OccupancyGridArray, queue_size=1, latch=True)
        cls.map.publish(messages.message_from_grid(GridMap(np.zeros((60, 100), np.int8), 0.05), rospy.Time.now()))
        cls.stray = rospy.Publisher("/red/image_raw", Image, queue_size=1)
        rospy.Subscriber(names.SPOTS, LaserSpot, cls.on_spot)
        rospy.Subscriber(names.DETECTORS, DetectorStatus, cls.on_status)
        rospy.Subscriber("/diagnostics", DiagnosticArray, cls.on_diagnostics)
        rospy.Subscriber("/spot_detector_red/debug_image", Image, cls.on_picture)
        cls.running = True
        cls.player = threading.Thread(target=cls.play, daemon=True)
        cls.player.start()

    @classmethod
    def tearDownClass(cls):
        cls.running = False
        cls.player.join()

    @classmethod
    def play(cls):
        rate, step = rospy.Rate(12), 0
        while cls.running and not rospy.is_shutdown():
            stamp = rospy.Time.now()
            angle = 0.1 * step
            for camera in (cls.red, cls.blue):
                center = camera.T[:2, 3]
                point = center + 0.5 * np.array([np.cos(angle), np.sin(angle)])
                cls.truth[camera.name, stamp.to_nsec()] = point
                camera.play(stamp, point)
            with cls.changed:  # a spot may come back before this thread has noted where it was
                cls.truth["robot", stamp.to_nsec()] = cls.robot.play(stamp, 1.0 + 0.01 * (step % 100))
            if step % 10 == 9:
                broken = Image(encoding="bayer_rggb8")
                broken.header.stamp = stamp
                cls.stray.publish(broken)
            step += 1
            rate.sleep()

    @classmethod
    def on_spot(cls, message):
        with cls.changed:
            cls.spots.append(message)
            cls.changed.notify_all()

    @classmethod
    def on_status(cls, message):
        with cls.changed:
            cls.status[message.camera] = message
            cls.changed.notify_all()

    @classmethod
    def on_diagnostics(cls, message):
        with cls.changed:
            cls.diagnostics.update(status.name for status in message.status)
            cls.changed.notify_all()

    @classmethod
    def on_picture(cls, message):
        with cls.changed:
            cls.pictures.append(message)
            cls.changed.notify_all()

    def wait(self, condition, what):
        with self.changed:
            self.assertTrue(self.changed.wait_for(condition, TIMEOUT), f"waited in vain for {what}: {self.status}")

    def check(self, camera, projections, limit):
        self.wait(lambda: sum(spot.camera == camera for spot in self.spots) >= 15, "spots of " + camera)
        with self.changed:
            spots = [spot for spot in self.spots if spot.camera == camera]
        errors = []
        for spot in spots:
            self.assertEqual(spot.header.frame_id, "map")
            self.assertIn(spot.projection, projections)
            # stamped with the image's own time, to the nanosecond
            self.assertIn((camera, spot.header.stamp.to_nsec()), self.truth)
            truth = self.truth[camera, spot.header.stamp.to_nsec()]
            errors.append(np.hypot(spot.position.x - truth[0], spot.position.y - truth[1]))
            self.assertTrue(0.0 < spot.confidence <= 1.0)
            self.assertTrue(0.005 < spot.diameter_m < 0.08, spot.diameter_m)
        # those that are backfilled once a stroke is confirmed come before the one that confirms it
        stamps = [spot.header.stamp.to_nsec() for spot in spots]
        self.assertEqual(stamps, sorted(set(stamps)))
        self.assertLess(np.median(errors), limit)
        self.assertLess(np.max(errors), 5 * limit)

    def test_fixed_camera_with_bayer_images(self):
        self.check("red", [LaserSpot.GROUND_PLANE], 0.01)
        self.assertFalse(any(spot.mobile for spot in self.spots if spot.camera == "red"))

    def test_fixed_camera_with_jpeg_images(self):
        self.check("blue", [LaserSpot.GROUND_PLANE], 0.01)

    def test_moving_camera_with_depth(self):
        self.check("robot", [LaserSpot.DEPTH, LaserSpot.GROUND_PLANE_FALLBACK], 0.02)
        self.assertTrue(any(spot.projection == LaserSpot.DEPTH for spot in self.spots if spot.camera == "robot"))
        self.assertTrue(all(spot.mobile for spot in self.spots if spot.camera == "robot"))

    def test_nothing_on_a_robot_is_a_spot(self):
        def refused(code):
            red = self.status.get("red")
            return dict(zip(red.rejections, red.rejection_counts)).get(code, 0) if red is not None else 0

        self.wait(lambda: refused("on_robot") and refused("robot_without_pose"), "light on a robot")
        # from now on the robot's place is known; the spot comes round to it again
        known, before = self.status["red"].header.stamp, refused("on_robot")
        self.wait(lambda: refused("on_robot") >= before + 5, "more light on the robot")
        self.wait(lambda: any(spot.camera == "red" and spot.header.stamp > known for spot in self.spots), "spots")
        with self.changed:
            later = [spot.position for spot in self.spots if spot.camera == "red" and spot.header.stamp > known]
        self.assertGreater(min(np.hypot(at.x - GUARD[0], at.y - GUARD[1]) for at in later), 0.18)

    def test_status_counts_and_bad_images_do_no_harm(self):
        def counted():
            red = self.status.get("red")
            return red is not None and "bad_image" in red.rejections and red.processed > 20 and red.detected > 10

        self.wait(counted, "the status of red with a bad image")
        red = self.status["red"]
        self.assertGreaterEqual(red.received, red.processed)
        self.assertGreater(red.rate_hz, 0.0)
        self.assertGreater(red.search_ms, 0.0)

    def test_diagnostics(self):
        self.wait(lambda: sum("spot detector of camera" in name for name in self.diagnostics) >= 3, "diagnostics")

    def test_debug_image_when_listened_to(self):
        self.wait(lambda: len(self.pictures) > 0, "a debug image")
        self.assertEqual(array_from_image(self.pictures[-1]).shape, (270, 480, 3))


if __name__ == "__main__":
    rostest.rosrun("vb_laser_detect", "spot_detector", SpotDetectorTest)
