"""Plays rendered images as the drivers of some cameras would send them; scale.py starts it.

python3 bench/lab/player.py IMAGES.npy CAMERA ...         until it is ended; begins when the parameter /go is set
"""

from __future__ import annotations

import signal
import sys
import time
from pathlib import Path
from typing import List

import numpy as np
import rospy
import tf2_ros
from sensor_msgs.msg import CameraInfo, Image

from bench.detection.rooms import Rooms, lab
from vb_core import names
from vb_core.ros.cameras import info_from_camera
from vb_core.ros.images import message_from_image
from vb_core.ros.messages import message_from_transform

RATE = 25.0  # [1/s] images of each camera
FRAMES = 25  # of each view, played back and forth
LEARN_S = 4.0  # without a laser before, for the background


def play(cameras: List[str], path: Path) -> None:
    """Sends the images of some cameras, evenly spread over the time between two frames, until it is ended."""
    room, rooms = lab(), Rooms(1)
    views = [rooms.view(room, camera.name) for camera in room.cameras]
    pictures = np.load(str(path), mmap_mode="r")
    rospy.init_node("player_" + cameras[0], disable_signals=True)
    signal.signal(signal.SIGTERM, lambda *_: rospy.signal_shutdown("ended"))
    now = rospy.Time.now()
    which = [(int(name[1:]) + 1) % len(views) for name in cameras]
    poses = tf2_ros.StaticTransformBroadcaster()
    frames = [f"{name}_optical_frame" for name in cameras]
    poses.sendTransform(
        [message_from_transform(views[view].pose, names.MAP_FRAME, frame, now) for frame, view in zip(frames, which)]
    )
    sent = [rospy.Publisher(f"/{name}/image_raw", Image, queue_size=1) for name in cameras]
    infos = [rospy.Publisher(f"/{name}/camera_info", CameraInfo, queue_size=1) for name in cameras]
    order = [*range(1, FRAMES + 1), *range(FRAMES, 0, -1)]
    rospy.set_param("/ready", True)
    while not rospy.is_shutdown() and not rospy.get_param("/go", False):
        rospy.rostime.wallsleep(0.1)
    began, number = time.monotonic(), 0
    while not rospy.is_shutdown():
        turn, camera = divmod(number, len(cameras))
        behind = time.monotonic() - began - turn / RATE - camera / RATE / len(cameras)
        if behind < 0.0:
            rospy.rostime.wallsleep(-behind)
        number += 1
        if behind > 1.0 / RATE:
            continue  # a camera does not send later what it could not send in time
        picture = pictures[which[camera], 0 if turn / RATE < LEARN_S else order[turn % len(order)]]
        stamp, encoding = rospy.Time.now(), room.cameras[which[camera]].encoding
        sent[camera].publish(message_from_image(picture, encoding, stamp, frames[camera]))
        infos[camera].publish(info_from_camera(views[which[camera]].model, stamp, frames[camera]))


if __name__ == "__main__":
    play(sys.argv[2:], Path(sys.argv[1]))
