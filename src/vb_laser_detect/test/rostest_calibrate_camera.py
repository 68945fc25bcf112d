#!/usr/bin/env python3
"""The real commands with a scripted person who clicks spots in RViz; and the node that publishes the pose."""

import math
import re
import subprocess
import tempfile
import unittest
from functools import partial

import numpy as np
import rospy
import rostest
from geometry_msgs.msg import Point, PointStamped
from std_msgs.msg import Header

from vb_core import geometry, names
from vb_core.camera_model import project_to_floor
from vb_core.ros.transforms import TransformLookup
from vb_laser_detect.calibration import pose_file

from camera_players import FixedCamera
from spot_scenes import RED
from terminal import Terminal
from vb_testing import TIMEOUT, wait_until


class Player:
    """Plays a camera while it has subscribers, with the spot where `show` puts it."""

    def __init__(self, camera, rate=8):
        self._camera, self._spot = camera, None
        self._latest, self._interval = rospy.Time.now(), rospy.Duration(1.0 / rate)
        self._timer = rospy.Timer(self._interval, self._play)
        self.close = self._timer.shutdown

    def _play(self, _event):
        if self._camera.images.get_num_connections() == 0:
            return
        # the images have their own clock: the same number per second of it even on a busy machine
        now = self._latest + self._interval
        self._camera.play(now, self._spot)
        self._latest = now

    def show(self, spot, seconds):
        """Puts the spot at a point (x, y) of the floor, or nowhere (None), for `seconds` by the images' own clock."""
        self._spot = spot
        since = self._latest
        wait_until(lambda: (self._latest - since).to_sec() > seconds, "the camera's images")


class CalibrateCameraTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("person")
        cls.transforms = TransformLookup()
        cls.clicks = rospy.Publisher("/clicked_point", PointStamped, queue_size=5)

    def click(self, point, frame="map"):
        self.clicks.publish(header=Header(frame_id=frame), point=Point(*point, 0.0))

    def test_spots_clicked_in_rviz(self):
        self.folder = tempfile.TemporaryDirectory()
        self.addCleanup(self.folder.cleanup)
        camera, rng = FixedCamera("red", 2.0, 3.0, RED, compressed=False), np.random.default_rng(2)
        camera.T = geometry.make_transform(geometry.rotation_from_rpy(math.pi + 0.05, -0.03, 1.2), (2.0, 3.0, 2.8))
        red = Player(camera)
        self.addCleanup(red.close)
        # the folder where a running lab looks for calibrations
        rospy.set_param("/camera_poses/calibration_dir", self.folder.name)
        self.addCleanup(rospy.delete_param, "/camera_poses")
        command = Terminal(command=("rosrun", "vb_laser_detect", "calibrate_camera", "spots", "red"))
        self.addCleanup(command.process.kill)
        command.shows("Hold the spot")
        places = [(60.3, 45.6), (427.2, 52.4), (420.8, 225.1), (52.5, 218.9), (240.4, 45.2), (248.7, 225.8)]
        command.press("done\n")
        command.shows("too_few_calibration_points")
        # a click in a frame other than the map's, once the command is connected
        wait_until(lambda: self.clicks.get_num_connections(), "the command to listen to clicks")
        self.click((0, 0), "odom")
        command.shows("set RViz' fixed frame")
        for i, pixel in enumerate(places):
            spot = project_to_floor(camera.camera, camera.T, np.array([pixel]))[0, :2]
            point = spot + rng.normal(0, 0.003, 2)
            if i == 4:
                point = point + (0.5, 0.2)  # a slip of the mouse
            # again after a refusal: a spot that is already in the first image that is seen counts as part of the room
            for _ in range(10):
                red.show(None, 1.0)
                red.show(spot, 2.2)
                length = len(command.text)
                if i == 2:
                    command.press(f"{point[0]:.4f} {point[1]:.4f}\n")
                else:
                    self.click(point)
                pattern = re.compile("^.*(is at|! ).*\n", re.M)
                answer = wait_until(lambda: pattern.search(command.text, length), lambda: command.text).group()
                if "is at" in answer:
                    break
                self.assertTrue("spot_not_seen_by_camera" in answer or "spot_moving" in answer, answer)
            self.assertIn("is at", answer, (i, command.text))
            command.shows(f"{i + 1} place", length)
        command.press("done\n")
        self.assertEqual(command.process.wait(TIMEOUT), 0, command.text)
        command.shows("5 of 6 points used")
        pose = pose_file.read_pose(pose_file.calibration_path(self.folder.name, "red"))
        self.assertEqual((pose.camera, pose.parent, pose.frame), ("red", "map", "red_optical_frame"))
        self.assertLess(np.linalg.norm(pose.T[:3, 3] - camera.T[:3, 3]), 0.05)
        turn = geometry.invert_transform(pose.T) @ camera.T
        self.assertLess(math.degrees(math.acos(min(1.0, (np.trace(turn[:3, :3]) - 1) / 2))), 1.0)
        # camera_poses publishes the file's pose
        rospy.set_param("/camera_poses", {"calibration_dir": self.folder.name, "cameras": "red green"})
        poses = subprocess.Popen(["rosrun", "vb_laser_detect", "camera_poses"])
        self.addCleanup(poses.wait)
        self.addCleanup(poses.terminate)
        self.check_transform("red_optical_frame", pose.T)
        # a camera that is calibrated later is taken over at once
        path = pose_file.calibration_path(self.folder.name, "red")
        path.with_name("green.yaml").write_text(path.read_text().replace("red", "green"))
        self.check_transform("green_optical_frame", pose.T)

    def check_transform(self, frame, truth):
        """Waits until tf has a frame at its true pose."""
        find = partial(self.transforms.lookup, names.MAP_FRAME, frame, rospy.Time(0), TIMEOUT)
        wait_until(lambda: np.abs(find() - truth).max() < 0.02, f"{frame} at its place")


if __name__ == "__main__":
    rostest.rosrun("vb_laser_detect", "calibrate_camera", CalibrateCameraTest)
