"""Cameras for rostests: rendered images with a spot at a known position, camera_info, depth and transforms."""

import cv2
import numpy as np
import rospy
import tf2_ros
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from spot_scenes import RED, Scene
from vb_core import geometry
from vb_core.camera_model import CameraModel, project_to_floor
from vb_core.ros.images import info_from_camera, message_from_image
from vb_core.ros import messages


class FixedCamera:
    """Looks straight down from 2.95 m. `info` makes the camera_info to be sent from a stamp, or is None to send none."""

    def __init__(self, name, x, y, color, compressed):
        self.name, self.color, self.compressed = name, color, compressed
        self.camera = CameraModel(480, 270, [[300, 0, 239.5], [0, 300, 134.5], [0, 0, 1]], [-0.12, 0.02, 0.001, 0, 0])
        self.T = geometry.make_transform(geometry.rotation_from_rpy(np.pi, 0, 0), (x, y, 2.95))
        self.scene = Scene(480, 270, seed=3)
        self.frame = name + "_optical_frame"
        kind, topic = (CompressedImage, "/image_raw/compressed") if compressed else (Image, "/image_raw")
        self.images = rospy.Publisher("/" + name + topic, kind, queue_size=1)
        self.infos = rospy.Publisher("/" + name + "/camera_info", CameraInfo, queue_size=1)
        self.info = lambda stamp: info_from_camera(self.camera, stamp, self.frame)

    def play(self, stamp, point):
        """Publishes an image with the spot at a point (x, y) of the floor, or None for no spot."""
        points = np.array([[*point, 0.0]] if point is not None else []).reshape(-1, 3)
        spots = self.camera.project(geometry.transform_points(geometry.invert_transform(self.T), points))
        image = self.scene.render(spots, sigma=1.3, color=self.color, bayer=not self.compressed)
        if self.compressed:
            jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
            message = CompressedImage(rospy.Header(stamp=stamp, frame_id=self.frame), "jpeg", jpeg)
        else:
            message = message_from_image(image, "bayer_rggb8", stamp, self.frame)
        self.images.publish(message)
        if self.info is not None:
            self.infos.publish(self.info(stamp))


class RobotCamera:
    """Drives along x and looks at the floor ahead; colour images of 320 x 240 pixels, depth images of 80 x 60.

    `depth_message` makes the message to be sent from a depth image (60, 80) uint16 [mm].
    """

    def __init__(self):
        self.camera = CameraModel.ideal(320, 240, 280.0)
        self.frame = "camera_optical_frame"
        looking_down = geometry.rotation_from_rpy(0, 0.6, 0) @ geometry.optical_rotation()
        self.T_base = geometry.make_transform(looking_down, (0.1, 0.0, 0.6))
        self.scene = Scene(320, 240, seed=5)
        self.images = rospy.Publisher("/camera/rgb/image_raw", Image, queue_size=1)
        self.infos = rospy.Publisher("/camera/rgb/camera_info", CameraInfo, queue_size=1)
        self.depths = rospy.Publisher("/camera/depth_registered/image_raw", Image, queue_size=1)
        self.tf = tf2_ros.TransformBroadcaster()
        self.played = 0
        self.localized = True  # whether its pose is published
        self.pose_late_s = 0.0  # delay of the pose after the image with the same stamp
        self.depth_message = lambda depth: message_from_image(depth, "16UC1", rospy.Time(), self.frame)

    def play(self, stamp, x):
        base = geometry.transform_from_pose2d(x, 1.0, 0.2)
        T = base @ self.T_base
        # the spot moves, since one that rests at one position in the image for long counts as a lamp
        self.played += 1
        point = geometry.transform_points(base, np.array([1.0, 0.1 + 0.15 * np.sin(0.05 * self.played), 0.0]))
        uv = self.camera.project(geometry.transform_points(geometry.invert_transform(T), point)[None])[0]
        image = self.scene.render([uv], sigma=2.5, color=RED)[:, :, ::-1]
        small = self.camera.scaled_to(80, 60)
        grid = np.stack(np.meshgrid(np.arange(80), np.arange(60)), axis=-1).reshape(-1, 2)
        floor = project_to_floor(small, T, grid)
        depth = geometry.transform_points(geometry.invert_transform(T), floor)[:, 2].reshape(60, 80)
        depth = np.where(np.isfinite(depth) & (depth < 6), depth * 1000, 0).astype(np.uint16)
        message = self.depth_message(depth)
        message.header.stamp = stamp
        self.depths.publish(message)
        self.infos.publish(info_from_camera(self.camera, stamp, self.frame))
        if self.pose_late_s == 0.0:
            self._publish_pose(base, stamp)
        self.images.publish(message_from_image(image, "rgb8", stamp, self.frame))
        if self.pose_late_s > 0.0:
            rospy.rostime.wallsleep(self.pose_late_s)
            self._publish_pose(base, stamp)
        return point[:2]

    def _publish_pose(self, base, stamp):
        if self.localized:
            base_pose = messages.message_from_transform(base, "map", "base_link", stamp)
            camera_pose = messages.message_from_transform(self.T_base, "base_link", self.frame, stamp)
            self.tf.sendTransform([base_pose, camera_pose])
