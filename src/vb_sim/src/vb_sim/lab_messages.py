"""Messages that the camera nodes read and send."""

from __future__ import annotations

import math
import struct
import sys
from typing import List

import numpy as np
import rospy
from sensor_msgs.msg import Image

from vb_msgs.msg import LabState
from vb_sim.lab_history import Snapshot


class ArrayImage(Image):
    """An Image whose pixels are a numpy array and are copied only once, into the outgoing buffer.

    sensor_msgs/Image copies them three times on the way, which at 150 MB/s is a fifth of a core. Only
    for publishing; the array may be changed as soon as `publish` has returned.
    """

    __slots__: List[str] = []

    def serialize(self, buff) -> None:
        """Writes what sensor_msgs/Image would write."""
        header = self.header
        frame_id, encoding = header.frame_id.encode("utf-8"), self.encoding.encode("utf-8")
        pixels = np.ascontiguousarray(self.data)
        buff.write(struct.pack("<3I", header.seq, header.stamp.secs, header.stamp.nsecs))
        buff.write(struct.pack("<I", len(frame_id)) + frame_id)
        buff.write(struct.pack("<2I", self.height, self.width))
        buff.write(struct.pack("<I", len(encoding)) + encoding)
        buff.write(struct.pack("<BII", self.is_bigendian, self.step, pixels.nbytes))
        buff.write(pixels.data.cast("B"))


def array_image(image: np.ndarray, encoding: str, stamp: rospy.Time, frame_id: str) -> ArrayImage:
    """Pixels (H, W) or (H, W, C) to a message, without a copy if they are contiguous."""
    image = np.ascontiguousarray(image)
    message = ArrayImage()
    message.header.stamp = stamp
    message.header.frame_id = frame_id
    message.height, message.width = image.shape[:2]
    message.encoding = encoding
    message.is_bigendian = int(sys.byteorder == "big" and image.itemsize > 1)
    message.step = image.strides[0]
    message.data = image
    return message


def snapshot_from_message(message: LabState) -> Snapshot:
    """Reads a Snapshot from a LabState, without what is not finite."""
    robots = {
        name.strip("/"): (pose.x, pose.y, pose.theta)
        for name, pose in zip(message.robots, message.robot_poses)
        if _finite(pose.x, pose.y, pose.theta)
    }
    laser, person = None, None
    if message.laser_on and _finite(message.laser.x, message.laser.y):
        laser = (message.laser.x, message.laser.y)
    if message.person_present and _finite(message.person.x, message.person.y, message.person.theta):
        person = (message.person.x, message.person.y, message.person.theta)
    return Snapshot(message.header.stamp.to_sec(), robots, laser, message.laser_color or "red", (0.0, 0.0), person)


def _finite(*values: float) -> bool:
    return all(math.isfinite(value) for value in values)
