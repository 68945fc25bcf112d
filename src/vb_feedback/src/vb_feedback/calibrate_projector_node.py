"""Calibrates a projector over the floor: shows four markers in turn and takes a click on each."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from pathlib import Path
from typing import List, Optional, Tuple

import numpy as np
import rospy
import yaml
from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import Image
from vb_core import names
from vb_core.errors import CodedError, ParameterError
from vb_core.files import write_atomically
from vb_core.parameters import Parameters, param
from vb_core.ros.images import message_from_image
from vb_core.ros import node, parameters

from vb_feedback.projector import floor_image
from vb_feedback.floor_projector_node import FRAME
from vb_feedback.projector.projector_calibration import calibrate
from vb_feedback.projector.projector_window import ProjectorWindow

_MARKERS = 4


@dataclass(frozen=True)
class CalibrationParams(Parameters):
    """Parameters of calibrate_projector; config/calibrate_projector.yaml says why."""

    file: str = param("")
    width: int = param(1280, "px", low=16, high=16384)
    height: int = param(800, "px", low=16, high=16384)
    window: bool = param(True)
    window_x: int = param(0, "px", low=-32768, high=32767)
    window_y: int = param(0, "px", low=-32768, high=32767)


class CalibrateProjectorNode:
    """Calibrates a floor projector from four clicks, and ends.

    Subscribed topics:
        /clicked_point (geometry_msgs/PointStamped): RViz's tool "Publish Point", in the map frame, on the map where the
            bright marker is seen on the floor.

    Published topics:
        /virtual_borders/projector (sensor_msgs/Image, rgb8, latched): the markers.

    Args:
        params: see config/calibrate_projector.yaml.
        window: shows; None: only the topic.
    """

    def __init__(self, params: CalibrationParams, window: Optional[ProjectorWindow] = None) -> None:
        self._params = params
        self._window = window
        self._lock = threading.Lock()
        self._clicked: List[Tuple[float, float]] = []
        self._publisher = rospy.Publisher(names.PROJECTOR, Image, queue_size=1, latch=True)
        self._ask()
        rospy.Subscriber("/clicked_point", PointStamped, self._on_click, queue_size=5)

    def close(self) -> None:
        """Closes the window."""
        if self._window is not None:
            self._window.close()

    def _ask(self) -> None:
        number = len(self._clicked)
        self._show(floor_image.draw_calibration_image(self._params.width, self._params.height, number))
        rospy.loginfo(
            "calibrate_projector: click in RViz ('Publish Point') where marker %d of %d shines brightly on the floor",
            number + 1,
            _MARKERS,
        )

    def _show(self, image: np.ndarray) -> None:
        self._publisher.publish(message_from_image(image, "rgb8", rospy.Time.now(), FRAME))
        if self._window is not None:
            self._window.show(image)

    def _on_click(self, message: PointStamped) -> None:
        point = (message.point.x, message.point.y)
        with self._lock:
            if len(self._clicked) == _MARKERS:
                return
            if message.header.frame_id.lstrip("/") != names.MAP_FRAME or not np.isfinite(point).all():
                rospy.logwarn("calibrate_projector: that click is not in the frame map, click again")
                return
            self._clicked.append(point)
            if len(self._clicked) < _MARKERS:
                self._ask()
                return
            try:
                self._finish()
            except CodedError as error:
                self._clicked.clear()
                rospy.logwarn("calibrate_projector: %s; once more from the first marker", error)
                self._ask()

    def _finish(self) -> None:
        params = self._params
        calibration = calibrate(params.width, params.height, self._clicked)
        path = Path(params.file).expanduser()
        content = yaml.safe_dump(calibration.to_mapping(), sort_keys=False)
        head = "# Written by vb_feedback/calibrate_projector: map coordinates [m] to pixels of the projector.\n"
        write_atomically(path, (head + content).encode("utf-8"))
        rospy.loginfo("calibrate_projector: wrote %s; draw a border to see whether it fits", path)
        rospy.signal_shutdown("calibrated")


def build() -> CalibrateProjectorNode:
    """Reads the parameters and makes the node."""
    params = parameters.read(CalibrationParams)
    if not params.file:
        raise ParameterError(
            "~file", "must name the file to be written, for instance ~/.ros/virtual_borders/projector.yaml"
        )
    window = (
        ProjectorWindow(params.window_x, params.window_y, params.width, params.height, node.start_thread)
        if params.window
        else None
    )
    return CalibrateProjectorNode(params, window)
