#!/usr/bin/env python3
"""A detector that reads its camera itself: spots, stamps, images for other nodes, and failures of the camera."""

import subprocess
import threading
import time
import unittest
from pathlib import Path
from tempfile import mkdtemp

import cv2
import numpy as np
import rospkg
import rospy
import rostest
import tf2_ros
import yaml
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from sensor_msgs.srv import SetCameraInfo

from mjpeg_server import MjpegServer
from spot_scenes import GREEN, Scene
from vb_testing import TIMEOUT, Process, run_command, wait_until

from vb_core import geometry, names
from vb_core.camera_model import CameraModel, project_to_floor
from vb_core.ros import messages
from vb_core.ros.images import array_from_image
from vb_core.ros.notices import NoticeListener
from vb_laser_detect.camera.lens_and_settings_files import save_lens
from vb_msgs.msg import DetectorStatus, LaserSpot

COMMAND = ("rosrun", "vb_laser_detect", "calibrate_camera")
LATE_S = 0.4  # [s] delay of the camera
WIDTH, HEIGHT = 1440, 1080
PLACE = (675.0, 450.0)
T = geometry.make_transform(geometry.rotation_from_rpy(np.pi, 0, 0), (1.0, 2.0, 2.5))
CAMERA = CameraModel(WIDTH, HEIGHT, [[1125.0, 0, 719.5], [0, 1125.0, 539.5], [0, 0, 1]], [-0.1, 0.01, 0, 0, 0])


def images(width=WIDTH, height=HEIGHT):
    """Returns images of an empty floor, and of one with a trembling spot."""
    scene = Scene(width, height, seed=2)
    jpeg = lambda image: cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 92])[1].tobytes()  # noqa: E731
    empty = [jpeg(scene.render([])) for _ in range(8)]
    u, v = PLACE[0] * width / WIDTH, PLACE[1] * height / HEIGHT
    spot = [jpeg(scene.render([(u + 4 * (i % 3), v)], sigma=3.0, color=GREEN)) for i in range(9)]
    return empty, spot


class TestCameraSource(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.empty, cls.spot = images()
        cls.server = MjpegServer(cls.empty)
        cls.addClassCleanup(cls.server.close)
        cls.notices = NoticeListener()
        cls.spots, cls.status = [], []
        rospy.Subscriber(names.SPOTS, LaserSpot, lambda m: cls.spots.append((time.time(), m)), queue_size=50)
        rospy.Subscriber(names.DETECTORS, DetectorStatus, cls.status.append, queue_size=50)
        cls.poses = tf2_ros.StaticTransformBroadcaster()
        cls.poses.sendTransform([messages.message_from_transform(T, "map", "hall_optical_frame", rospy.Time.now())])
        lab = Path(mkdtemp())
        (lab / "detectors").mkdir()
        cls.settings = lab / "detectors" / "hall.yaml"
        cls.settings.write_text("{}\n")
        save_lens(lab / "lenses" / "hall.yaml", "hall", CAMERA)
        config = Path(rospkg.RosPack().get_path("vb_laser_detect")) / "config" / "stationary.yaml"
        own = {"camera": "hall", "source": cls.server.address(), "settings": str(cls.settings)}
        rospy.set_param("/spot_detector_hall", {**yaml.safe_load(config.read_text()), **own})
        cls.node = Process("vb_laser_detect", "spot_detector", "__name:=spot_detector_hall")
        cls.addClassCleanup(cls.node.stop)
        wait_until(lambda: cls.status and cls.status[-1].processed > 20, "the first images")

    def codes(self):
        return {notice.code for notice in self.notices.current() if notice.camera == "hall"}

    def test_1_spots_are_where_and_when_they_were(self):
        self.server.rate = 2.0  # so slow that a stamp identifies its image
        self.addCleanup(setattr, self.server, "rate", 25.0)
        self.server.jpegs = self.spot
        wait_until(lambda: len(self.spots) > 12, "spots")
        arrived, message = self.spots[-1]
        truth = project_to_floor(CAMERA, T, np.array([PLACE]))[0]
        self.assertLess(np.hypot(message.position.x - truth[0], message.position.y - truth[1]), 0.025)
        self.assertTrue(PLACE[0] - 1.0 < message.u < PLACE[0] + 9.0 and abs(message.v - PLACE[1]) < 1.0, message)
        age = [came - spot.header.stamp.to_sec() for came, spot in self.spots[5:]]
        self.assertGreaterEqual(min(age), 0.0)
        sent = np.array(self.server.sent)
        late = [np.abs(sent - spot.header.stamp.to_sec()).min() for _, spot in self.spots[5:]]
        self.assertLess(np.median(late), 0.06)

    def test_2_others_get_images_while_they_listen(self):
        kinds = {"image_raw": Image, "image_raw/compressed": CompressedImage, "camera_info": CameraInfo}

        def hear(name):
            return rospy.wait_for_message(f"/hall/{name}", kinds[name], TIMEOUT)

        whole, as_sent, info = map(hear, kinds)
        self.assertEqual(array_from_image(whole).shape, (HEIGHT, WIDTH, 3))
        self.assertEqual(whole.header.frame_id, "hall_optical_frame")
        self.assertIn(as_sent.data, self.spot)
        np.testing.assert_allclose(info.K, CAMERA.matrix.ravel())
        write = rospy.ServiceProxy("/hall/set_camera_info", SetCameraInfo)
        self.assertIn("bad_camera_info", write(CameraInfo()).status_message)
        for focal in (1200.0, CAMERA.focal_px):
            info.K = [focal, *info.K[1:]]
            self.assertTrue(write(info).success)
            wait_until(lambda: hear("camera_info").K == tuple(info.K), "the new lens")

    def test_3_a_camera_that_stalls_or_vanishes_is_named_and_comes_back(self):
        for fault, status, code in (("stalled", 200, "camera_stalled"), ("broken", 401, "camera_password")):
            self.server.status = status
            getattr(self.server, fault).set()
            wait_until(lambda: code in self.codes(), "the sentence")
            getattr(self.server, fault).clear()
            self.server.status = 200
            self.comes_back()

    def test_4_spots_are_dropped_while_the_lens_is_of_another_image_size(self):
        self.server.jpegs = images(320, 240)[1]
        wait_until(lambda: self.refused("no_camera_info") > 0 and "camera_no_lens" in self.codes(), "the refusal")
        self.server.jpegs = self.spot
        self.comes_back()

    def test_5_two_detectors_of_one_camera_or_frame_are_noticed(self):
        other = rospy.Publisher(names.DETECTORS, DetectorStatus, queue_size=1)

        def speak(camera, code):
            other.publish(DetectorStatus(camera=camera, frame_id="hall_optical_frame"))
            return self.refused(code) > 0 and code in self.codes()

        for camera, code in (("hall", "camera_name_twice"), ("other", "shared_frame")):
            wait_until(lambda: speak(camera, code), "the refusal")
            wait_until(lambda: code not in self.codes(), "its end")

    def test_6_the_exposure_of_a_camera_in_the_network_cannot_be_set(self):
        done = run_command(*COMMAND, "exposure", "hall")
        self.assertEqual(done.returncode, 1, done.stdout)
        self.assertIn("control_refused", done.stdout)

    def test_7_the_delay_is_measured_with_the_terminal_s_light(self):
        images = (np.full((HEIGHT, WIDTH, 3), level, np.uint8) for level in (40, 160))
        dark, light = ([cv2.imencode(".jpg", image)[1].tobytes()] for image in images)
        self.server.jpegs = dark
        command = subprocess.Popen([*COMMAND, "delay", "hall"], stdout=subprocess.PIPE)
        output = b""
        for byte in iter(lambda: command.stdout.read(1), b""):
            output += byte
            for code, jpegs in ((b"\x1b[107m", light), (b"\x1b[40m\x1b[2J", dark)):
                if output.endswith(code):  # the camera shows it with its delay
                    threading.Timer(LATE_S, setattr, (self.server, "jpegs", jpegs)).start()
        self.assertEqual(command.wait(TIMEOUT), 0, output)
        delay_ms = yaml.safe_load(self.settings.read_text())["capture"]["delay_ms"]
        self.assertEqual(rospy.get_param("/spot_detector_hall/capture/delay_ms"), delay_ms)
        self.assertLess(abs(delay_ms - 1e3 * LATE_S), 100.0)

    def refused(self, code):
        newest = [message for message in self.status if message.received][-1]
        return dict(zip(newest.rejections, newest.rejection_counts)).get(code, 0)

    def comes_back(self):
        count = len(self.spots)
        wait_until(lambda: len(self.spots) > count + 10, "spots")
        wait_until(lambda: not self.codes(), "the sentence's end")


if __name__ == "__main__":
    rospy.init_node("test_camera_source")
    rostest.rosrun("vb_laser_detect", "camera_source", TestCameraSource)
