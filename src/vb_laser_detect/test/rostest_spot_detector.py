#!/usr/bin/env python3
"""Three real detector nodes with simulated cameras: fixed with Bayer images, fixed with JPEG, and on a moving robot.

Spots have the right positions and stamps. Whatever is wrong with its input, a detector logs it once, reports it in its
notices, and goes on.
"""

import unittest
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import rospy
import rostest
import tf2_ros
from dynamic_reconfigure.client import Client
from rosgraph_msgs.msg import Log
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from vb_core import geometry, names
from vb_core.grid_map import GridMap
from vb_core.ros.images import info_from_camera, message_from_image
from vb_core.ros import messages
from vb_msgs.msg import DetectorStatus, LaserSpot, Notice, NoticeArray

from camera_players import FixedCamera, RobotCamera
from spot_scenes import GREEN, RED
from vb_testing import TIMEOUT, wait_until

WARN_EVERY = 10.0
GUARD = (2.5, 1.5)  # [m] position of a robot, on the circle that the spot before camera red draws


class Observer:
    """Keeps what detectors publish, log and report in notices."""

    def __init__(self):
        self.spots, self.logs, self.status, self.truth, self.notices = [], [], {}, {}, {}
        rospy.Subscriber(names.SPOTS, LaserSpot, self.spots.append)
        rospy.Subscriber(names.DETECTORS, DetectorStatus, lambda m: self.status.update({m.camera: m}))
        rospy.Subscriber(names.NOTICES, NoticeArray, lambda m: self.notices.update({m.source: m.notices}))
        rospy.Subscriber("/rosout", Log, self.logs.append)

    def spots_of(self, camera):
        """Returns a camera's spots whose true position is known: a spot may arrive before the player has noted it."""
        spots = [spot for spot in list(self.spots) if spot.camera == camera]
        return [spot for spot in spots if (camera, spot.header.stamp.to_nsec()) in self.truth]

    def errors(self, spots):
        """Returns the distances [m] of spots from their true positions."""
        truth = [self.truth[spot.camera, spot.header.stamp.to_nsec()] for spot in spots]
        return [np.hypot(spot.position.x - x, spot.position.y - y) for spot, (x, y) in zip(spots, truth)]

    def has_notice(self, camera, words, severity=Notice.ERROR):
        """Returns whether the camera's detector has a notice with these words."""
        notices = self.notices.get(f"/spot_detector_{camera}", ())
        return any(notice.severity == severity and words in notice.message for notice in notices)

    def rejections(self, camera, code):
        """Returns how often the camera's detector has rejected something with a code."""
        status = self.status.get(camera)
        return dict(zip(status.rejections, status.rejection_counts)).get(code, 0) if status is not None else 0

    def warnings(self, camera, code):
        """Returns the warnings with a code by the camera's own detector: another one may have the same problem."""
        begin = f"/spot_detector_{camera}: "
        return [log for log in self.logs if log.msg.startswith(begin) and f"[{code}]" in log.msg]


class SpotDetectorTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("stimulus")
        cls.observer = Observer()
        cls.red = FixedCamera("red", 2.0, 1.5, RED, False)
        cls.blue = FixedCamera("blue", 4.0, 1.5, GREEN, True)
        cls.robot = RobotCamera()
        cls.red.info = None
        cls.static = tf2_ros.StaticTransformBroadcaster()
        cls.place(cls.blue.T, cls.blue.frame)
        cls.map = rospy.Publisher("/map", messages.NumpyOccupancyGrid, queue_size=1, latch=True)
        cls.map.publish(messages.message_from_grid(GridMap(np.zeros((60, 100), np.int8), 0.05), rospy.Time.now()))
        cls.step = 0
        cls.player = rospy.Timer(rospy.Duration(1 / 12), cls.play)
        cls.addClassCleanup(cls.player.join)
        cls.addClassCleanup(cls.player.shutdown)  # first

    @classmethod
    def place(cls, T, frame):
        cls.static.sendTransform([messages.message_from_transform(T, "map", frame, rospy.Time.now())])

    @classmethod
    def play(cls, _event):
        stamp = rospy.Time.now()
        cls.step += 1
        for camera in (cls.red, cls.blue):
            point = camera.T[:2, 3] + 0.5 * np.array([np.cos(0.1 * cls.step), np.sin(0.1 * cls.step)])
            cls.observer.truth[camera.name, stamp.to_nsec()] = point
            camera.play(stamp, point)
        cls.observer.truth["robot", stamp.to_nsec()] = cls.robot.play(stamp, 1.0 + 0.01 * (cls.step % 100))

    def wait(self, condition, what):
        wait_until(condition, lambda: f"{what}: {self.observer.status} {self.observer.notices}")

    def wait_for_spots(self, camera, count=3, projection=None):
        """Waits for spots of images taken from now on, and returns them."""
        now = rospy.Time.now()

        def fresh():
            later = [spot for spot in self.observer.spots_of(camera) if spot.header.stamp > now]
            return [spot for spot in later if projection in (None, spot.projection)]

        self.wait(lambda: len(fresh()) >= count, f"spots of {camera}")
        return fresh()

    def check_fault(self, camera, code, words, level, count=10, logged_code=None):
        """Checks that a fault is counted, reported, and logged, but not for each image; the log may have another code."""
        o = self.observer
        before = o.rejections(camera, code)
        self.wait(lambda: o.rejections(camera, code) >= before + count, f"{count} times {code}")
        self.wait(lambda: o.has_notice(camera, words, level), f"the notice of {code}")
        self.wait(lambda: o.warnings(camera, logged_code or code), f"a warning of {code}")
        stamps = sorted(log.header.stamp.to_sec() for log in o.warnings(camera, logged_code or code))
        # a log message is stamped a little after the decision to write it
        self.assertTrue((np.diff(stamps) > WARN_EVERY / 2).all(), stamps)

    def check_spots(self, camera, projections, limit):
        """Checks that a camera's spots so far are accurate, have their images' stamps, and came in order."""
        self.wait_for_spots(camera, 15)
        spots = self.observer.spots_of(camera)
        errors = self.observer.errors(spots)
        self.assertLess(np.median(errors), limit)
        self.assertLess(np.max(errors), 5 * limit)
        # spots published in retrospect, once a stroke is confirmed, come before the one that confirms it
        stamps = [spot.header.stamp.to_nsec() for spot in spots]
        self.assertEqual(stamps, sorted(set(stamps)))
        for spot in spots:
            self.assertEqual((spot.header.frame_id, spot.mobile), ("map", camera == "robot"))
            self.assertIn(spot.projection, projections)
            self.assertTrue(0.0 < spot.confidence <= 1.0 and 0.005 < spot.diameter_m < 0.08, spot)
        o = self.observer
        self.wait(lambda: camera in o.status and o.status[camera].spots > 10, f"the status of {camera}")
        status = o.status[camera]
        self.assertEqual(status.detector, f"/spot_detector_{camera}")
        self.assertGreaterEqual(status.received, status.processed)
        self.assertGreater(min(status.rate_hz, status.search_ms), 0.0)

    def test_all_cameras(self):
        """Tests independent cameras in parallel: most of the time is spent on waiting for what comes once a second."""
        with ThreadPoolExecutor() as pool:
            stories = [pool.submit(self.fixed_camera), pool.submit(self.moving_camera)]
            stories.append(pool.submit(self.check_spots, "blue", [LaserSpot.GROUND_PLANE], 0.01))
            # a camera with a bad parameter does not keep the node from searching the others
            has_notice = partial(self.observer.has_notice, "green", "by_post")
            stories.append(pool.submit(self.wait, has_notice, "green's notice"))
        for story in stories:
            story.result()

    # in this order, as each step needs the one before
    def fixed_camera(self):
        self.camera_info_is_late_wrong_and_then_right()
        self.pose_comes()
        self.check_spots("red", [LaserSpot.GROUND_PLANE], 0.01)
        self.bad_images()
        self.tuning()
        self.debug_image()
        self.nothing_on_a_robot_is_a_spot()

    def camera_info_is_late_wrong_and_then_right(self):
        o, red = self.observer, self.red
        self.wait(lambda: o.has_notice("red", "no camera_info on /red/camera_info"), "the notice that it is missing")
        # the driver of a camera that was never calibrated: K is a matrix of zeros
        red.info = lambda stamp: CameraInfo(header=Header(stamp=stamp, frame_id=red.frame), height=270, width=480)
        self.wait(lambda: o.warnings("red", "bad_camera_info"), "a warning of the zero matrix")
        self.wait(lambda: o.has_notice("red", "no focal length"), "the notice of the zero matrix")
        self.wait(lambda: o.rejections("red", "no_camera_info") >= 3, "spots that were dropped")
        self.assertEqual(len(o.warnings("red", "bad_camera_info")), 1)
        self.assertFalse([spot for spot in o.spots if spot.camera == "red"])
        red.info = lambda stamp: info_from_camera(red.camera, stamp, red.frame)

    def pose_comes(self):
        self.check_fault("red", "no_transform", "no transform", Notice.ERROR, logged_code="camera_no_pose")
        self.assertFalse([spot for spot in self.observer.spots if spot.camera == "red"])
        self.place(self.red.T, self.red.frame)
        self.assertGreater(self.wait_for_spots("red")[-1].track, 0)  # each spot has the number of its track

    def bad_images(self):
        """Sends bad images between good ones."""

        def play(_event):
            bad = message_from_image(np.ones((270, 480), np.float32), "32FC1", rospy.Time.now(), self.red.frame)
            self.red.images.publish(bad)

        timer = rospy.Timer(rospy.Duration(0.15), play)
        self.check_fault("red", "unknown_encoding", "32FC1", Notice.WARNING, count=3)
        self.wait_for_spots("red", 1)
        timer.shutdown()
        self.wait(lambda: not self.observer.notices["/spot_detector_red"], "all well again")

    def tuning(self):
        """Changes the parameters of the detector and of the projection."""
        for part, name, hard, usual, code in (
            ("detector", "max_diameter_mm", 2.0, 80.0, "too_large"),
            ("projection", "max_range", 1.0, 12.0, "too_far"),
        ):
            client = Client(f"/spot_detector_red/{part}", timeout=TIMEOUT)
            self.addCleanup(client.close)
            described = [entry["name"] for entry in client.get_parameter_descriptions(timeout=TIMEOUT)]
            self.assertTrue(name in described and "moving_camera" not in described, described)
            before = self.observer.rejections("red", code)
            self.assertEqual(client.update_configuration({name: hard})[name], hard)
            self.wait(lambda: self.observer.rejections("red", code) > before + 3, f"{code} now")
            self.assertEqual(rospy.get_param(f"/spot_detector_red/{part}/{name}"), hard)
            client.update_configuration({name: usual})
            self.wait_for_spots("red")

    def debug_image(self):
        pictures = []
        rospy.Subscriber("/spot_detector_red/debug_image", Image, pictures.append)
        self.wait(lambda: len(pictures) >= 3, "debug images")
        self.assertEqual((pictures[0].encoding, pictures[0].width), ("bgr8", 480))

    def nothing_on_a_robot_is_a_spot(self):
        o = self.observer
        self.assertTrue(o.rejections("red", "robot_without_pose"))
        self.place(geometry.make_transform(np.eye(3), (*GUARD, 0.0)), "guard/base_link")
        self.wait(lambda: o.rejections("red", "on_robot") >= 1, "light on a robot")
        # from now on the robot's position is known; the spot comes round to it again
        known = o.status["red"].header.stamp
        before = o.rejections("red", "on_robot")
        self.wait(lambda: o.rejections("red", "on_robot") >= before + 5, "more light on the robot")
        self.wait_for_spots("red")
        later = [spot.position for spot in o.spots_of("red") if spot.header.stamp > known]
        self.assertGreater(min(np.hypot(at.x - GUARD[0], at.y - GUARD[1]) for at in later), 0.18)

    # in this order again
    def moving_camera(self):
        self.wait_for_spots("robot", 3, LaserSpot.DEPTH)
        self.check_spots("robot", [LaserSpot.DEPTH, LaserSpot.GROUND_PLANE_FALLBACK], 0.02)
        self.bad_depth(self.robot)
        self.pose_is_late_and_missing(self.robot)

    def bad_depth(self, robot):
        def as_message(encoding, convert, frame=robot.frame):
            return lambda depth: message_from_image(convert(depth), encoding, rospy.Time(), frame)

        meters = as_message("32FC1", lambda depth: np.where(depth > 0, depth / 1000.0, np.nan).astype(np.float32))
        good = robot.depth_message
        for spoilt, code, words in (
            # depth in another frame is not registered to this camera's pixels
            (as_message("16UC1", np.copy, "depth_optical_frame"), "depth_not_registered", "depth_optical_frame"),
            (as_message("32FC1", lambda d: np.full(d.shape, np.nan, np.float32)), "bad_depth", "no reading at all"),
            (as_message("rgb8", lambda d: np.zeros((*d.shape, 3), np.uint8)), "bad_depth", "16UC1 or 32FC1"),
        ):
            robot.depth_message = spoilt
            # the floor plane is used instead, and the spots say so
            spots = self.wait_for_spots("robot", 3, LaserSpot.GROUND_PLANE_FALLBACK)
            self.assertLess(np.median(self.observer.errors(spots)), 0.03)
            self.check_fault("robot", code, words, Notice.WARNING, count=3)
        for message in (meters, good):
            robot.depth_message = message
            self.wait_for_spots("robot", 3, LaserSpot.DEPTH)

    def pose_is_late_and_missing(self, robot):
        # the detector waits for a pose that comes after its image
        robot.pose_late_s = 0.05
        self.assertLess(np.median(self.observer.errors(self.wait_for_spots("robot"))), 0.03)
        robot.pose_late_s = 0.0
        # without a pose at the image's time a spot is dropped and counted, never projected with the last pose
        robot.localized = False
        self.check_fault("robot", "no_transform", "no transform", Notice.ERROR, 5, "camera_robot_lost")
        count, before = len(self.observer.spots_of("robot")), self.observer.rejections("robot", "no_transform")
        self.wait(lambda: self.observer.rejections("robot", "no_transform") >= before + 5, "spots that are dropped")
        self.assertEqual(len(self.observer.spots_of("robot")), count)
        robot.localized = True
        self.assertLess(np.median(self.observer.errors(self.wait_for_spots("robot"))), 0.03)


if __name__ == "__main__":
    rostest.rosrun("vb_laser_detect", "spot_detector", SpotDetectorTest)
