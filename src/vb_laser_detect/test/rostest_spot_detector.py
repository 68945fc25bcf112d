#!/usr/bin/env python3
"""Three real detector nodes before played cameras: fixed with Bayer images, fixed with JPEG, and on a moving robot."""
import os
import sys
import threading
import unittest

import cv2
import numpy as np
import rospy
import rostest
import tf2_ros
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from vb_core import geometry, names
from vb_core.camera_model import CameraModel
from vb_core.grid_map import GridMap
from vb_core.ros import messages
from vb_msgs.msg import DetectorStatus, LaserSpot

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from scenes import GREEN, RED, Scene  # noqa: E402

PATIENCE = 20.0


class FixedCamera:
    """Looks straight down from 2.95 m."""

    def __init__(self, name, x, y, colour, compressed):
        self.name, self.colour, self.compressed = name, colour, compressed
        self.camera = CameraModel(480, 270, np.array([[300.0, 0, 239.5], [0, 300.0, 134.5], [0, 0, 1]]),
                                  np.array([-0.12, 0.02, 0.001, 0, 0]))
        self.T = geometry.transform(geometry.rotation_from_rpy(np.pi, 0, 0), (x, y, 2.95))
        self.scene = Scene(480, 270, seed=3)
        self.frame = name + "_optical_frame"
        kind, topic = (CompressedImage, "/image_raw/compressed") if compressed else (Image, "/image_raw")
        self.images = rospy.Publisher("/" + name + topic, kind, queue_size=1)
        self.infos = rospy.Publisher("/" + name + "/camera_info", CameraInfo, queue_size=1)

    def play(self, stamp, point):
        uv = self.camera.project(geometry.apply(geometry.invert(self.T), np.array([*point, 0.0]))[None])[0]
        image = self.scene.render([uv], sigma=1.3, colour=self.colour, bayer=not self.compressed)
        if self.compressed:
            message = CompressedImage(format="jpeg")
            message.data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
            message.header.stamp, message.header.frame_id = stamp, self.frame
        else:
            message = messages.image_message(image, "bayer_rggb8", stamp, self.frame)
        self.images.publish(message)
        self.infos.publish(messages.info_from_camera(self.camera, stamp, self.frame))


class RobotCamera:
    """Drives along x and looks down at the floor before it; colour 320 x 240, depth a quarter of it."""

    def __init__(self):
        self.camera = CameraModel.ideal(320, 240, 280.0)
        self.T_base = geometry.transform(
            geometry.rotation_from_rpy(0, 0.6, 0) @ geometry.optical_rotation(), (0.1, 0.0, 0.6))
        self.scene = Scene(320, 240, seed=5)
        self.images = rospy.Publisher("/camera/rgb/image_raw", Image, queue_size=1)
        self.infos = rospy.Publisher("/camera/rgb/camera_info", CameraInfo, queue_size=1)
        self.depths = rospy.Publisher("/camera/depth_registered/image_raw", Image, queue_size=1)
        self.tf = tf2_ros.TransformBroadcaster()

    def play(self, stamp, x):
        base = geometry.pose2d_transform(x, 1.0, 0.2)
        T = base @ self.T_base
        self.tf.sendTransform([
            messages.transform_message(base, "map", "base_link", stamp),
            messages.transform_message(self.T_base, "base_link", "camera_optical_frame", stamp),
        ])
        point = geometry.apply(base, np.array([1.0, 0.1, 0.0]))
        uv = self.camera.project(geometry.apply(geometry.invert(T), point)[None])[0]
        image = self.scene.render([uv], sigma=2.5, colour=RED)[:, :, ::-1]
        small = self.camera.scaled_to(80, 60)
        grid = np.stack(np.meshgrid(np.arange(80), np.arange(60)), axis=-1).reshape(-1, 2)
        floor = geometry.intersect_floor(T[:3, 3], small.rays(grid) @ T[:3, :3].T)
        depth = geometry.apply(geometry.invert(T), floor)[:, 2].reshape(60, 80)
        depth = np.where(np.isfinite(depth) & (depth < 6), depth * 1000, 0).astype(np.uint16)
        self.depths.publish(messages.image_message(depth, "16UC1", stamp, "camera_optical_frame"))
        self.infos.publish(messages.info_from_camera(self.camera, stamp, "camera_optical_frame"))
        self.images.publish(messages.image_message(image, "rgb8", stamp, "camera_optical_frame"))
        return point[:2]


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
        cls.fixed_tf.sendTransform([
            messages.transform_message(c.T, "map", c.frame, rospy.Time.now()) for c in (cls.red, cls.blue)])
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
                centre = camera.T[:2, 3]
                point = centre + 0.5 * np.array([np.cos(angle), np.sin(angle)])
                cls.truth[camera.name, stamp.to_nsec()] = point
                camera.play(stamp, point)
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
            self.assertTrue(self.changed.wait_for(condition, PATIENCE), f"waited in vain for {what}: {self.status}")

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

    def test_status_counts_and_bad_images_do_no_harm(self):
        def counted():
            red = self.status.get("red")
            return red is not None and "bad_image" in red.refusals and red.processed > 20 and red.detected > 10
        self.wait(counted, "the status of red with a bad image")
        red = self.status["red"]
        self.assertGreaterEqual(red.received, red.processed)
        self.assertGreater(red.rate_hz, 0.0)
        self.assertGreater(red.search_ms, 0.0)

    def test_diagnostics(self):
        self.wait(lambda: sum("spot detector of camera" in name for name in self.diagnostics) >= 3, "diagnostics")

    def test_debug_image_when_listened_to(self):
        self.wait(lambda: len(self.pictures) > 0, "a debug image")
        self.assertEqual(messages.image_array(self.pictures[-1]).shape, (270, 480, 3))


if __name__ == "__main__":
    rostest.rosrun("vb_laser_detect", "spot_detector", SpotDetectorTest)
