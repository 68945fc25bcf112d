#!/usr/bin/env python3
"""The real commands, guided by a scripted person: spots clicked in RViz; and what publishes the pose."""

import math
import subprocess
import tempfile
import threading
import unittest

import numpy as np
import rospy
import rostest
import tf2_ros
from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import CameraInfo, Image

from vb_core import geometry, names
from vb_core.camera_model import CameraModel
from vb_core.ros.cameras import info_from_camera
from vb_core.ros.images import message_from_image
from vb_core.ros import messages
from vb_laser_detect.calibration import calibration_file
from vb_laser_detect.detection.projection import floor_points

from scenes import Scene
from vb_testing import TIMEOUT, wait_until

SMALL = CameraModel(640, 360, np.array([[400.0, 0, 319], [0, 400.0, 181], [0, 0, 1]]), np.array([-0.1, 0.02, 0, 0, 0]))


class Command:
    """A process with a terminal's lines."""

    def __init__(self, *arguments):
        self.lines = []
        self._process = subprocess.Popen(
            ["rosrun", "vb_laser_detect", "calibrate_camera", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            universal_newlines=True,
            bufsize=1,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self):
        for line in self._process.stdout:
            self.lines.append(line.rstrip())

    def type(self, line):
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def wait_for(self, *words, after=0):
        """The first line from number `after` on that has one of the words."""
        return wait_until(
            lambda: next((line for line in self.lines[after:] if any(word in line for word in words)), None),
            lambda: f"{words} after line {after} of:\n" + "\n".join(self.lines),
        )

    def status(self):
        status = self._process.wait(TIMEOUT)
        self._reader.join(TIMEOUT)
        return status

    def end(self):
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        self._process.stdin.close()


class Player:
    """The camera red, which shows what it is told to."""

    def __init__(self, render, rate=8):
        self._render, self._shown = render, None
        self._latest, self._interval = rospy.Time.now(), rospy.Duration(1.0 / rate)
        self._images = rospy.Publisher("/red/image_raw", Image, queue_size=1)
        self._infos = rospy.Publisher("/red/camera_info", CameraInfo, queue_size=1)
        self._timer = rospy.Timer(self._interval, self._play)
        self.close = self._timer.shutdown

    def _play(self, _event):
        if self._images.get_num_connections() == 0:
            return
        # the images' own time: as many within a second of it on a busy machine as on any
        frame, now = "red_optical_frame", self._latest + self._interval
        self._infos.publish(info_from_camera(SMALL, now, frame))
        self._images.publish(message_from_image(self._render(self._shown), "mono8", now, frame))
        self._latest = now

    def show(self, what, seconds):
        """Shows something else, and waits until it was shown for so long, by the images' own time."""
        self._shown, since = what, self._latest
        wait_until(lambda: (self._latest - since).to_sec() > seconds, "the camera's images")


class CalibrateCameraTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("person")
        cls.buffer = tf2_ros.Buffer()
        cls.listener = tf2_ros.TransformListener(cls.buffer)
        cls.clicks = rospy.Publisher("/clicked_point", PointStamped, queue_size=5)
        # takes its time without the person: it runs while the others are guided
        cls.unattended = Command("spots", "nobody")

    @classmethod
    def tearDownClass(cls):
        cls.unattended.end()

    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.addCleanup(self.folder.cleanup)

    def click(self, point, frame="map"):
        message = PointStamped()
        message.header.frame_id = frame
        message.point.x, message.point.y = point
        self.clicks.publish(message)

    def check_pose(self, camera, truth, meters, degrees):
        pose = calibration_file.load(calibration_file.calibration_path(self.folder.name, camera))
        self.assertEqual((pose.camera, pose.parent, pose.frame), (camera, "map", camera + "_optical_frame"))
        self.assertLess(np.linalg.norm(pose.T[:3, 3] - truth[:3, 3]), meters)
        turn = geometry.invert(pose.T) @ truth
        self.assertLess(math.degrees(math.acos(min(1.0, (np.trace(turn[:3, :3]) - 1) / 2))), degrees)
        return pose

    def test_spots_clicked_in_rviz(self):
        truth = geometry.transform(geometry.rotation_from_rpy(math.pi + 0.05, -0.03, 1.2), (2.0, 3.0, 2.8))
        scene, rng = Scene(640, 360, seed=4), np.random.default_rng(2)
        base = np.clip(np.median([scene.render() for _ in range(3)], axis=0).max(axis=2), 0, 200).astype(np.uint8)
        rows, columns = np.mgrid[:360, :640]

        def render(spot):
            picture = base + rng.normal(0, 2, base.shape)
            if spot is not None:
                u, v = spot
                picture = picture + 400 * np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / (2 * 1.6**2))
            return np.clip(picture, 0, 255).astype(np.uint8)

        red = Player(render)
        self.addCleanup(red.close)
        # where the running lab looks for calibrations
        rospy.set_param("/camera_poses/calibration_dir", self.folder.name)
        self.addCleanup(rospy.delete_param, "/camera_poses")
        command = Command("spots", "red")
        self.addCleanup(command.end)
        command.wait_for("Hold the spot")
        places = [(80.3, 60.6), (570.2, 70.4), (560.8, 300.1), (70.5, 290.9), (320.4, 60.2), (330.7, 300.8)]
        command.type("done")
        command.wait_for("too_few_calibration_points")
        # a click that is not in the map's frame, as long as it takes to connect with the command
        wait_until(lambda: self.clicks.get_num_connections(), "the command to listen to clicks")
        self.click((0, 0), "odom")
        command.wait_for("set RViz' fixed frame")
        for i, pixel in enumerate(places):
            point = floor_points(SMALL, truth, np.array([pixel]))[0, :2] + rng.normal(0, 0.003, 2)
            if i == 4:
                point = point + (0.5, 0.2)  # a slip of the mouse
            # as the refusal says: what is there in the first image that a busy computer sees belongs to the room
            for _ in range(10):
                red.show(None, 1.0)
                red.show(pixel, 2.2)
                before = len(command.lines)
                if i == 2:
                    command.type(f"{point[0]:.4f} {point[1]:.4f}")
                else:
                    self.click(point)
                answer = command.wait_for("is at", "! ", after=before)
                if "is at" in answer:
                    break
                self.assertTrue("spot_not_seen_by_camera" in answer or "spot_moving" in answer, answer)
            self.assertIn("is at", answer, (i, command.lines))
            command.wait_for(f"{i + 1} place", after=before)
        command.type("done")
        self.assertEqual(command.status(), 0, command.lines)
        text = "\n".join(command.lines)
        self.assertIn("5 of 6 points used", text)
        pose = self.check_pose("red", truth, 0.05, 1.0)
        self.check_camera_poses(pose.T)

    def check_camera_poses(self, pose):
        """The pose that the file holds is what launch/parts/perception.launch publishes, and what replaces it later."""
        rospy.set_param("/camera_poses", {"calibration_dir": self.folder.name, "cameras": "red green"})
        poses = subprocess.Popen(["rosrun", "vb_laser_detect", "camera_poses"])
        self.addCleanup(poses.wait)
        self.addCleanup(poses.terminate)
        self.check_transform("red_optical_frame", pose)
        # a camera that is calibrated later, or again, is taken at once
        path = calibration_file.calibration_path(self.folder.name, "red")
        later = path.with_name("green.yaml")
        later.write_text(path.read_text().replace("red", "green"))
        self.check_transform("green_optical_frame", pose)

    def check_transform(self, frame, truth):
        """Waits until tf has a frame at its true pose."""

        def is_there():
            found = self.buffer.lookup_transform(names.MAP_FRAME, frame, rospy.Time(0), rospy.Duration(TIMEOUT))
            return np.abs(messages.transform_from_message(found.transform) - truth).max() < 0.02

        wait_until(is_there, f"{frame} at its place")

    def test_nothing_comes_from_the_camera(self):
        command = self.unattended
        self.assertEqual(command.status(), 1)
        command.wait_for("no_images")


if __name__ == "__main__":
    rostest.rosrun("vb_laser_detect", "calibrate_camera", CalibrateCameraTest)
