"""Node: draws on the floor with a projector."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import List, Optional, Tuple

import numpy as np
import rospy
from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import Image
from vb_core import names
from vb_core.errors import CodedError, ParameterError
from vb_core.parameters import Parameters, param
from vb_core.ros.images import message_from_image
from vb_core.ros import node, parameters

from vb_feedback.display.scene import Drawing, TrailPoint
from vb_feedback.projector import projector_calibration
from vb_feedback.projector.floor_image import FloorContent, FloorImage, draw_calibration_image
from vb_feedback.projector.projector_calibration import MARKER_COUNT, ProjectorCalibration
from vb_feedback.projector.projector_window import ProjectorWindow
from vb_feedback.ros.display_inputs import InputListener
from vb_feedback.ros.display_messages import displayed_border_from_message, drawing_from_progress

FRAME = "projector"
MIN_PERIOD = 0.2  # [s] between two images; border_fusion sends a new chain about as often
_SPOT_LIFETIME = 0.5  # [s] after which a spot that no camera sees any more counts as gone
# [m] by which the spot must move before the image is drawn again; less than the radius that stays dark around it
_SPOT_STEP = 0.1


@dataclass(frozen=True)
class ProjectorParams(Parameters):
    """Parameters of floor_projector; config/floor_projector.yaml explains them."""

    calibration: str = param("")
    width: int = param(1280, "px", low=16, high=16384)
    height: int = param(800, "px", low=16, high=16384)
    brightness: float = param(1.0, "", low=0.05, high=1.0)
    window: bool = param(False)
    window_x: int = param(0, "px", low=-32768, high=32767)
    window_y: int = param(0, "px", low=-32768, high=32767)

    @property
    def path(self) -> Path:
        """The calibration file."""
        return Path(self.calibration).expanduser()


class FloorProjectorNode:
    """Projects borders, the drawing, the area that saving would restrict and the state onto the floor.

    Without a calibration, the node first shows four markers, one after another, and expects a click on each.

    Subscribed topics:
        /virtual_borders/state (vb_msgs/InteractionState), /virtual_borders/progress (vb_msgs/BorderProgress)
        /virtual_borders/preview (vb_msgs/BorderPreview), /virtual_borders/borders (vb_msgs/VirtualBorderArray)
        /virtual_borders/spots (vb_msgs/LaserSpot)
        /clicked_point (geometry_msgs/PointStamped): RViz's tool "Publish Point", in the map frame, clicked where the
            bright marker is on the floor; only while there is no calibration.
    Published topics:
        /virtual_borders/projector (sensor_msgs/Image, rgb8, latched): the projector's image, only when it changes,
            at most 5 times a second.

    Args:
        calibration: None if it is to be computed from four clicks.
        window: shows the image too. None if it is only published.
    """

    def __init__(
        self,
        params: ProjectorParams,
        calibration: Optional[ProjectorCalibration],
        window: Optional[ProjectorWindow] = None,
    ) -> None:
        self._params = params
        self._floor_image = FloorImage(calibration, params.brightness) if calibration is not None else None
        self._clicked: List[Tuple[float, float]] = []
        self._window = window
        # a period, because no message reports that the spot is gone
        self._wake = node.WakeTimer(1.0)
        self._inputs = InputListener(self._wake.notify)
        self._spot_shown: Optional[Tuple[float, float]] = None
        self._shown: Optional[FloorContent] = None
        self._publisher = rospy.Publisher(names.PROJECTOR, Image, queue_size=1, latch=True)
        if self._floor_image is None:
            self._ask_for_click()
            rospy.Subscriber("/clicked_point", PointStamped, self._on_click, queue_size=5)
        node.Worker(self._wake, lambda _woken: self._redraw())
        self._wake.notify()

    def close(self) -> None:
        """Ends the worker, and closes the window."""
        self._wake.close()
        if self._window is not None:
            self._window.close()

    # ------------------------------------------------------------- calibration
    def _ask_for_click(self) -> None:
        number = len(self._clicked)
        self._project(draw_calibration_image(self._params.width, self._params.height, number))
        marker = f"marker {number + 1} of {MARKER_COUNT}"
        rospy.loginfo("floor_projector: click in RViz ('Publish Point') where %s shines brightly on the floor", marker)

    def _on_click(self, message: PointStamped) -> None:
        """Stores a click. rospy calls this from only one thread."""
        if self._floor_image is not None:
            return
        point = (message.point.x, message.point.y)
        if message.header.frame_id.lstrip("/") != names.MAP_FRAME or not np.isfinite(point).all():
            rospy.logwarn("floor_projector: that click is not in the frame map, click again")
            return
        self._clicked.append(point)
        if len(self._clicked) == MARKER_COUNT:
            try:
                self._calibrate()
                return
            except CodedError as error:
                self._clicked.clear()
                rospy.logwarn("floor_projector: %s; once more from the first marker", error)
        self._ask_for_click()

    def _calibrate(self) -> None:
        calibration = projector_calibration.calibrate(self._params.width, self._params.height, self._clicked)
        path = self._params.path
        projector_calibration.write_calibration(calibration, path)
        rospy.loginfo("floor_projector: wrote %s; draw a border to see whether it fits", path)
        self._floor_image = FloorImage(calibration, self._params.brightness)
        self._wake.notify()

    # ------------------------------------------------------------- projection
    def _redraw(self) -> None:
        if self._floor_image is None:
            return
        started = time.monotonic()
        self._show(self._floor_image, self._content(rospy.get_time()))
        rospy.rostime.wallsleep(max(0.0, started + MIN_PERIOD - time.monotonic()))

    def _content(self, now: float) -> FloorContent:
        """Returns what to show at a time [s]."""
        inputs = self._inputs.current()
        borders = tuple(map(displayed_border_from_message, inputs.borders))
        if inputs.state is None or not inputs.state.interaction_id:
            return FloorContent(borders=borders)
        drawing = Drawing()
        if inputs.progress is not None:
            # without the points, which are not projected: if only they change, the image stays the same
            drawing = replace(drawing_from_progress(inputs.progress), points=(), point_cameras=())
        region = inputs.region if inputs.preview is not None and inputs.preview.success else None
        return FloorContent(inputs.state.name, borders, drawing, self._steady_spot(inputs.spots, now), region)

    def _steady_spot(self, spots: Tuple[TrailPoint, ...], now: float) -> Optional[Tuple[float, float]]:
        """Returns the position of the newest spot, which changes only in steps, so that few images are drawn."""
        if not spots or not abs(now - spots[-1].stamp) <= _SPOT_LIFETIME:
            self._spot_shown = None
            return None
        position = (spots[-1].x, spots[-1].y)
        if self._spot_shown is None or math.dist(position, self._spot_shown) > _SPOT_STEP:
            self._spot_shown = position
        return self._spot_shown

    def _show(self, floor_image: FloorImage, content: FloorContent) -> None:
        if self._shown != content or self._shown.region is not content.region:
            self._shown = content
            self._project(floor_image.render(content))

    def _project(self, image: np.ndarray) -> None:
        self._publisher.publish(message_from_image(image, "rgb8", rospy.Time.now(), FRAME))
        if self._window is not None:
            self._window.show(image)


def build() -> FloorProjectorNode:
    """Reads the parameters and makes the node."""
    params = parameters.read(ProjectorParams)
    if not params.calibration:
        raise ParameterError("~calibration", "must name the calibration's file, which is created if it does not exist")
    calibration = projector_calibration.read_calibration(params.path) if params.path.exists() else None
    screen = calibration or params  # both have the size of the projector's image
    window = None
    if params.window:
        window = ProjectorWindow(params.window_x, params.window_y, screen.width, screen.height, node.start_thread)
    return FloorProjectorNode(params, calibration, window)
