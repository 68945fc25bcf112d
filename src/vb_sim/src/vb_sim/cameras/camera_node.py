"""The node of simulated cameras: receives the lab's state, and renders the images that are due."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import Any, Callable, List, Optional, Sequence

import cv2
import numpy as np
import rospy
import tf2_ros
from geometry_msgs.msg import TransformStamped
from sensor_msgs.msg import CameraInfo, Image

from vb_core import names
from vb_core.camera_model import CameraModel
from vb_core.ros import node, parameters
from vb_core.ros.images import info_from_camera, message_from_image
from vb_msgs.msg import LabState
from vb_sim.rendering.camera_view import CameraView
from vb_sim.cameras.frame_clock import FrameSchedule, SmoothClock
from vb_sim.lab_history import LabHistory, Snapshot, snapshot_from_message

Render = Callable[[Snapshot], np.ndarray]
_REPORT_PERIOD = 60.0  # [s]


class ImageStream:
    """One stream of a camera's images, rendered only while it has subscribers.

    Args:
        topic: the namespace of image_raw and camera_info.
        frame: name of the images' frame.
        every: n if the stream has only every n-th image of the camera.
    """

    def __init__(
        self, topic: str, frame: str, camera: CameraModel, encoding: str, render: Render, every: int = 1
    ) -> None:
        self._frame = frame
        self._encoding = encoding
        self._render = render
        self._every = every
        self._image = rospy.Publisher(f"{topic}/image_raw", Image, queue_size=2)
        self._info = rospy.Publisher(f"{topic}/camera_info", CameraInfo, queue_size=2)
        self._message = info_from_camera(camera, rospy.Time(), frame)

    def publish(self, number: int, stamp: rospy.Time, snapshot: Optional[Snapshot]) -> None:
        """Publishes the camera_info of image `number`, counted from 0, and the image unless `snapshot` is None."""
        if number % self._every == 0:
            if self._info.get_num_connections() > 0:
                self._message.header.stamp = stamp
                self._info.publish(self._message)
            if snapshot is not None and self._image.get_num_connections() > 0:
                self._image.publish(message_from_image(self._render(snapshot), self._encoding, stamp, self._frame))


@dataclass
class SimulatedCamera:
    """A camera with its image streams."""

    name: str
    rate: float  # [1/s]
    view: CameraView
    streams: List[ImageStream]
    mount: TransformStamped
    taken: int = 0  # number of images taken


class CameraNode:
    """Publishes the cameras' images when they are due. The nodes' modules list the topics.

    Args:
        latency_ms: [ms] from an image's stamp to its delivery.
    """

    def __init__(self, cameras: Sequence[SimulatedCamera], latency_ms: float) -> None:
        self._cameras = cameras
        self._history = LabHistory()
        self._schedule = FrameSchedule([camera.rate for camera in cameras], latency_ms * 1e-3)
        self._clock = SmoothClock(rospy.get_time, time.monotonic)
        self._broadcaster = tf2_ros.StaticTransformBroadcaster()
        self._broadcaster.sendTransform([camera.mount for camera in cameras])
        rospy.Subscriber(names.LAB_STATE, LabState, self._on_state, queue_size=10, tcp_nodelay=True)
        threading.Thread(target=self._run, daemon=True).start()

    def _on_state(self, message: LabState) -> None:
        self._history.add(snapshot_from_message(message))

    def _publish(self, camera: SimulatedCamera, stamp_s: float) -> None:
        snapshot = self._history.at(stamp_s)
        rendered = snapshot if self._is_wanted(camera, snapshot) else None
        for stream in camera.streams:
            stream.publish(camera.taken, rospy.Time.from_sec(stamp_s), rendered)
        camera.taken += 1

    def _is_wanted(self, _camera: SimulatedCamera, _snapshot: Snapshot) -> bool:
        """Returns whether to publish the image of a scene."""
        return True

    def _run(self) -> None:
        node.wait_for_clock()
        reported = 0
        while not rospy.is_shutdown():
            try:
                for index, stamp in self._schedule.due(self._clock.now()):
                    self._publish(self._cameras[index], stamp)
                if self._schedule.skipped > reported:
                    reported = self._schedule.skipped
                    warning = f"{rospy.get_name()}: {reported} images left out so far: this computer is too slow"
                    rospy.logwarn_throttle(_REPORT_PERIOD, warning)
            except rospy.ROSException:
                # the topics close during shutdown
                return
            # checks again after at most 20 ms, as simulated time may run faster or slower than wall time
            time.sleep(min(max(self._schedule.time_to_next(self._clock.now()), 0.001), 0.02))


def configure_and_read(params_class: Any) -> Any:
    """Configures a camera node's process, and reads its parameters."""
    cv2.setNumThreads(1)
    node.disable_heap_trimming()
    return parameters.read(params_class)
