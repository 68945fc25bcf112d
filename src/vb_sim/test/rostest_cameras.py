#!/usr/bin/env python3
"""Both camera nodes: images, camera_info, stamps, tf; a lab that falls silent."""

import unittest

import numpy as np
import rospy
import rostest
from geometry_msgs.msg import Point, Pose2D
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from vb_testing import Newest, wait_until
from vb_core import geometry
from vb_core.camera_model import project_to_pixels
from vb_core.ros.images import array_from_image, camera_from_info
from vb_core.ros.transforms import TransformLookup
from vb_msgs.msg import LabState

TOPICS = {
    "north": ("/north", "bayer_rggb8", (480, 640)),
    "color": ("/tb/camera/rgb", "rgb8", (480, 640, 3)),
    "depth": ("/tb/camera/depth_registered", "16UC1", (120, 160)),
}
SPOT = (1.4, 1.0)


def is_lit(image):
    return array_from_image(image).max() > 250


class CamerasTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("rostest_cameras")
        cls.images = {key: Newest(topic + "/image_raw", Image, 60) for key, (topic, _, _) in TOPICS.items()}
        cls.infos = {key: Newest(topic + "/camera_info", CameraInfo, 60) for key, (topic, _, _) in TOPICS.items()}
        cls.transforms = TransformLookup()
        cls.lab = rospy.Publisher("/sim/lab_state", LabState, queue_size=5)
        cls.is_running = True
        cls.timer = rospy.Timer(rospy.Duration(0.02), cls.play)

    @classmethod
    def play(cls, _event):
        """Publishes the lab's state while it is running."""
        if cls.is_running:
            message = LabState(robots=["tb"], robot_poses=[Pose2D(0.4, 1.0, 0.0)], laser_on=True, laser_color="green")
            message.header = Header(stamp=rospy.Time.now(), frame_id="map")
            message.laser = Point(*SPOT, 0.0)
            cls.lab.publish(message)

    def of_one_time(self, *topics):
        """Waits for messages of several topics with a common stamp, and returns the newest ones."""

        def newest_common():
            messages_by_stamp = [{message.header.stamp: message for message in list(topic.all)} for topic in topics]
            stamps = set.intersection(*map(set, messages_by_stamp))
            return [messages[max(stamps)] for messages in messages_by_stamp] if stamps else None

        return wait_until(newest_common, f"a common stamp of {[topic.topic for topic in topics]}")

    def test_images_and_their_camera_info(self):
        for key, (_, encoding, shape) in TOPICS.items():
            image, info = self.of_one_time(self.images[key], self.infos[key])
            frame = "north_optical_frame" if key == "north" else "tb/camera_optical_frame"
            self.assertEqual(image.encoding, encoding)
            self.assertEqual({image.header.frame_id, info.header.frame_id}, {frame})
            self.assertEqual(array_from_image(image).shape, shape)
            self.assertEqual((info.height, info.width), shape[:2])
            camera_from_info(info)

    def test_spot_lies_where_tf_and_camera_info_say(self):
        # the calibrated pose is off by some millimetres
        for key, parent, inverse, limit in (
            ("north", "map", np.eye(4), 8.0),
            ("color", "tb/base_link", geometry.transform_from_pose2d(0.4, 1.0, 0.0), 1.5),
        ):
            image = self.images[key].wait(is_lit, f"the spot in {key}")
            mount = self.transforms.lookup(parent, image.header.frame_id, rospy.Time(0), 10.0)
            camera = camera_from_info(self.infos[key].message)
            u, v = project_to_pixels(camera, inverse @ mount, np.array([[*SPOT, 0.0]]))[0]
            bright = array_from_image(image).astype(float)
            bright = bright if bright.ndim == 2 else bright.max(axis=2)
            rows, columns = np.nonzero(bright > 240)
            self.assertLess(np.hypot(columns.mean() - u, rows.mean() - v), limit)

    def test_depth_has_a_colour_image_of_the_same_time(self):
        depth, _ = self.of_one_time(self.images["depth"], self.images["color"])
        self.assertGreater((array_from_image(depth)[60:] > 400).mean(), 0.9)
        self.assertNotIn("/south/image_raw", [name for name, _ in rospy.get_published_topics()])  # not among ~cameras

    def test_survives_a_silent_lab(self):
        north = self.images["north"]
        north.wait(is_lit, "the spot")
        CamerasTest.is_running = False
        try:
            north.wait(lambda image: not is_lit(image), "the empty lab")
        finally:
            CamerasTest.is_running = True
        north.wait(is_lit, "the spot again")


if __name__ == "__main__":
    rostest.rosrun("vb_sim", "rostest_cameras", CamerasTest)
