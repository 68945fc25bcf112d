"""Inputs that this package's rostests share: a room, a robot whose pose is published to tf, spots and states."""

import math
import threading

import numpy as np
import rospy
import tf2_ros
from geometry_msgs.msg import Point
from sensor_msgs.msg import CameraInfo, LaserScan

from plain_rooms import VIEW, room
from vb_core import geometry, names
from vb_core.interaction_tables import DEFAULT
from vb_core.ros.images import info_from_camera
from vb_core.ros.messages import NumpyOccupancyGrid, message_from_grid, message_from_transform
from vb_core.stop_latch import StopLatch, new_id
from vb_msgs.msg import DriverState, InteractionState, LaserSpot
from vb_sim.robot.robot_body import advance


class Body:
    """A robot: its pose (x, y, yaw) in the map frame, moved by `velocity` (v, w), and published to tf."""

    def __init__(self, pose, name=""):
        self.lock = threading.Lock()
        self.name = name
        self.prefix = f"{name}/" if name else ""
        self.pose, self.velocity = pose, (0.0, 0.0)
        self.view = VIEW
        self.info = rospy.Publisher(f"{self.prefix}camera/rgb/camera_info", CameraInfo, queue_size=1)
        self._time = None

    def step(self, now):
        """Moves the robot on and returns its transforms."""
        with self.lock:
            if self._time is not None and now > self._time:
                dt = min(0.2, (now - self._time).to_sec())
                self.pose = advance(self.pose, self.velocity[0] * dt, self.velocity[1] * dt)
            self._time = now
            place = geometry.transform_from_pose2d(*self.pose)
        return [
            message_from_transform(np.eye(4), "map", self.prefix + "odom", now),
            message_from_transform(place, self.prefix + "odom", self.prefix + "base_link", now),
            message_from_transform(self.view.T_base_camera, self.prefix + "base_link", self.prefix + "optical", now),
        ]


class Stimulus(Body):
    """Publishes map, tf, state and spots. The robot's pose is (x, y, yaw) in the map frame; odom equals map."""

    def __init__(self, pose, others=()):
        super().__init__(pose)
        self.others = others  # Bodies
        self.spot = None  # (x, y, camera, mobile), published at 20 Hz while set
        self.spot_frame = "map"
        self._broadcaster = tf2_ros.TransformBroadcaster()
        self._map = rospy.Publisher(names.MAP_WITH_BORDERS, NumpyOccupancyGrid, queue_size=1, latch=True)
        self._physical = rospy.Publisher(names.PHYSICAL_MAP, NumpyOccupancyGrid, queue_size=1, latch=True)
        self._state = rospy.Publisher(names.STATE, InteractionState, queue_size=1, latch=True)
        self.spots = rospy.Publisher(names.SPOTS, LaserSpot, queue_size=10)
        self._scans = rospy.Publisher("scan", LaserScan, queue_size=1)
        self.silent = False  # whether the interaction manager is
        self._state_message, self._ticks = None, 0
        self._interaction = ""
        self.publish_map(room(6.0))
        self.latch = StopLatch()  # the interaction manager's
        self._reports = rospy.Subscriber(names.DRIVERS, DriverState, self._on_driver)
        self._timer = rospy.Timer(rospy.Duration(0.05), self._tick)

    def publish_map(self, grid, physical=None):
        self._map.publish(message_from_grid(grid, rospy.Time.now()))
        self._physical.publish(message_from_grid(physical or grid, rospy.Time.now()))

    def _on_driver(self, message):
        for identity in message.stops:
            self.latch.stop(identity, message.robot)

    def set_state(self, state):
        now = rospy.Time.now()
        self._interaction = "" if state == DEFAULT else self._interaction or new_id()
        self._state_message = InteractionState(name=state.name, interaction_id=self._interaction, entered=now)
        self._publish_state(now)

    def _publish_state(self, now):
        message = self._state_message
        message.header.stamp = now
        message.stopped, message.stopped_by, message.stop_number, message.stops = self.latch.snapshot()
        self._state.publish(message)

    def _tick(self, _event):
        now = rospy.Time.now()
        self._ticks += 1
        if self._state_message is not None and not self.silent and self._ticks % 2 == 0:
            self._publish_state(now)
        if self._ticks % 5 == 1:
            for body in (self, *self.others):
                body.info.publish(info_from_camera(body.view.camera, now, body.prefix + "optical"))
        transforms = [transform for body in (self, *self.others) for transform in body.step(now)]
        with self.lock:
            spot, frame = self.spot, self.spot_frame
        # a scanner at the robot's centre with nothing in range, its frame_id with a slash as in tf1
        scan = LaserScan(ranges=[math.inf] * 361, range_min=0.1, range_max=8.0, time_increment=0.4 / 360)
        scan.angle_min, scan.angle_max, scan.angle_increment = -math.pi, math.pi, math.pi / 180.0
        # the stamp is that of the first beam, and the scanner turns slowly. Its scan counts as new nevertheless
        scan.header.stamp = now - rospy.Duration(0.4)
        scan.header.frame_id = "/base_laser_link"
        self._scans.publish(scan)
        transforms.append(message_from_transform(np.eye(4), "base_link", "base_laser_link", now))
        self._broadcaster.sendTransform(transforms)
        if spot is not None:
            x, y, camera, mobile = spot
            message = LaserSpot(camera=camera, mobile=mobile, confidence=1.0, position=Point(x, y, 0.0))
            message.header.stamp, message.header.frame_id = now, frame
            self.spots.publish(message)
