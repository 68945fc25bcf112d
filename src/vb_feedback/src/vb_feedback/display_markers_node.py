"""Node: draws on the smart display."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, replace
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

import rospy
from nav_msgs.msg import OccupancyGrid
from vb_core import names, sentences
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.capabilities import effective_commands
from vb_core.parameters import Parameters, param
from vb_core.ros import node, parameters, robot_profile
from vb_core.ros.messages import NumpyOccupancyGrid, grid_from_message, message_from_grid
from vb_core.ros.notices import NoticeListener
from vb_core.ros.robot_status import CapabilitiesListener
from visualization_msgs.msg import Marker, MarkerArray

from vb_feedback.display import restriction_overlay, scene
from vb_feedback.display.layout import Rectangle, Layout, fit_view
from vb_feedback.display.text_panel import PanelContent, text_panel_shapes
from vb_feedback.ros import display_messages
from vb_feedback.ros.display_inputs import DisplayInputs, InputListener
from vb_msgs.msg import BorderProgress, VirtualBorder

_REFRESH_PERIOD = 2.0  # [s]
_PERIOD = 0.04  # [s] between two redraws, so that a spot waits no longer than the time of one camera frame
_STRIPE_WIDTH = 0.10  # [m] of the stripes over restricted areas, which are visible from 3 m and finer than a doorway

RESTRICTED_TOPIC = "/virtual_borders/display/restricted"


@dataclass(frozen=True)
class DisplayParams(Parameters):
    """Parameters of display_markers; config/display_markers.yaml explains them."""

    screen_aspect: float = param(16.0 / 9.0, "", low=0.5, high=5.0)
    robots: list = param(["base_link"])
    robot_radius: float = param(0.18, "m", above=0.0, high=2.0)
    language: str = param(sentences.ENGLISH, choices=sentences.languages())


class DisplayMarkersNode:
    """Draws state, text, borders, the drawing and spots as markers, and restricted areas as a grid.

    Subscribed topics:
        /map, /virtual_borders/map (nav_msgs/OccupancyGrid): for the layout, and to see where borders restrict the map.
        /virtual_borders/state (vb_msgs/InteractionState)
        /virtual_borders/progress (vb_msgs/BorderProgress)
        /virtual_borders/preview (vb_msgs/BorderPreview): what saving now would do.
        /virtual_borders/borders (vb_msgs/VirtualBorderArray)
        /virtual_borders/spots (vb_msgs/LaserSpot)
        /virtual_borders/notices (vb_msgs/NoticeArray): notices of all nodes.
        /virtual_borders/robots (vb_msgs/RobotStatusArray): tells which commands have no effect and are not shown
    Published topics:
        /virtual_borders/markers (visualization_msgs/MarkerArray): only the changed markers, at most 25 times a second;
            all markers to a new subscriber.
        /virtual_borders/display/restricted (nav_msgs/OccupancyGrid, latched): stripes where borders restrict the map
            and where saving now would restrict it, in RViz's colour scheme "costmap".
    """

    def __init__(self, params: DisplayParams) -> None:
        self._params = params
        self._radii = {  # [m] of each robot, by its frame
            frame: robot_profile.read_radius(frame.rpartition("/")[0], params.robot_radius)
            for frame in map(str, params.robots)
        }
        self._lock = threading.Lock()
        self._wake = node.WakeTimer(_REFRESH_PERIOD)
        self._newcomers: List[Any] = []  # for each new subscriber, a function that publishes only to it
        self._grids: Dict[str, GridMap] = {}  # by topic
        # used by the worker only
        self._shown: Dict[scene.Key, scene.Shape] = {}
        self._cached_parts: Dict[str, Tuple[Any, List[scene.Shape]]] = {}  # by name: inputs and shapes
        self._overlay_inputs: Tuple[Any, ...] = (None, None, None)
        self._layout: Layout = fit_view(Rectangle(0.0, 0.0, 8.0, 5.0), params.screen_aspect)
        self._inputs = InputListener(self._wake.notify)
        self._notices = NoticeListener(self._wake.notify)
        self._robots = CapabilitiesListener(self._wake.notify)

        self._restricted = rospy.Publisher(RESTRICTED_TOPIC, NumpyOccupancyGrid, queue_size=1, latch=True)
        listener = rospy.SubscribeListener()
        listener.peer_subscribe = self._on_subscriber
        self._markers = rospy.Publisher(names.MARKERS, MarkerArray, listener, queue_size=20)
        self._refreshed = 0.0
        node.Worker(self._wake, lambda _woken: self._redraw())
        for topic in (names.PHYSICAL_MAP, names.MAP_WITH_BORDERS):
            rospy.Subscriber(topic, NumpyOccupancyGrid, self._on_grid, topic, queue_size=1)

    # ------------------------------------------------------------------ inputs
    def _on_subscriber(self, _topic: str, _publish: Any, publish_to_peer: Any) -> None:
        """Records a new subscriber, to which the worker then sends all markers."""
        with self._lock:
            self._newcomers.append(publish_to_peer)
        self._wake.notify()

    def _on_grid(self, message: OccupancyGrid, topic: str) -> None:
        try:
            self._grids[topic] = grid_from_message(message)
        except CodedError as error:
            rospy.logwarn_throttle(5.0, f"display_markers: {error}")
            return
        self._wake.notify()

    # ------------------------------------------------------------------ work
    def _redraw(self) -> None:
        """Draws what has changed, then pauses in wall time, because a screen does not depend on simulated time."""
        started = time.monotonic()
        if started - self._refreshed >= _REFRESH_PERIOD:
            # RViz drops a marker if tf does not know its frame yet, so robots are sent again and again
            self._refreshed = started
            self._shown = {key: shape for key, shape in self._shown.items() if not shape.frame}
        fades = self._draw()
        rospy.rostime.wallsleep(max(0.0, started + _PERIOD - time.monotonic()))
        if fades:
            self._wake.notify()

    def close(self) -> None:
        """Ends the worker."""
        self._wake.close()

    def _draw(self) -> bool:
        """Sends the changed shapes. Returns whether one of them is fading and must be drawn again."""
        with self._lock:
            newcomers = self._newcomers
            self._newcomers = []
        inputs = self._inputs.current()
        physical = self._grids.get(names.PHYSICAL_MAP)
        restricted = self._grids.get(names.MAP_WITH_BORDERS)
        grid = restricted or physical
        if grid is not None:
            self._layout = fit_view(Rectangle.from_points(grid.corners()), self._params.screen_aspect)
        if physical is not None and restricted is not None:
            self._show_restricted(physical, restricted, inputs.region)
        if self._markers.get_num_connections() == 0 and not newcomers:
            return False
        shapes = self._compose(inputs, grid is not None, rospy.get_time())
        changed, removed = scene.find_changes(self._shown, shapes)
        self._shown = {shape.key: shape for shape in shapes}
        message = MarkerArray([Marker(ns=namespace, id=number, action=Marker.DELETE) for namespace, number in removed])
        message.markers += map(display_messages.marker_from_shape, changed)
        if message.markers:
            self._markers.publish(message)
        for publish in newcomers:
            everything = MarkerArray([Marker(action=Marker.DELETEALL)])
            everything.markers += map(display_messages.marker_from_shape, shapes)
            publish(everything)
        # a fading shape is drawn until it has vanished, and then removed
        return any(shape.lifetime for shape in shapes)

    def _show_restricted(self, physical: GridMap, map_with_borders: GridMap, region: Optional[GridMap]) -> None:
        previous = self._overlay_inputs
        self._overlay_inputs = (physical, map_with_borders, region)
        if all(old is new for old, new in zip(previous, self._overlay_inputs)):
            return
        if not physical.same_geometry(map_with_borders):
            rospy.logwarn_throttle(5.0, "display_markers: /map and /virtual_borders/map differ in size or place")
            return
        planned = region.data if region is not None and region.same_geometry(map_with_borders) else None
        stripe = max(1, int(round(_STRIPE_WIDTH / map_with_borders.resolution)))
        cells = restriction_overlay.draw_restrictions(physical.data, map_with_borders.data, stripe, planned)
        self._restricted.publish(message_from_grid(map_with_borders.with_data(cells), rospy.Time.now()))

    def _compose(self, inputs: DisplayInputs, has_map: bool, now: float) -> List[scene.Shape]:
        layout = self._layout
        shapes = list(self._part("text", text_panel_shapes, layout, self._panel_content(inputs, has_map)))
        shapes += self._part("borders", self._border_shapes, layout, inputs.borders)
        if inputs.progress is not None:
            shapes += self._part("drawing", _drawing_shapes, layout, inputs.progress)
        shapes += scene.spot_shapes(layout, inputs.spots, now)
        for number, (frame, radius) in enumerate(self._radii.items()):
            shapes += scene.robot_shapes(frame, number, radius)
        return shapes

    def _part(self, name: str, build_shapes: Callable[..., List[scene.Shape]], *inputs: Any) -> List[scene.Shape]:
        """Builds the shapes of one part of the display, but only if its inputs have changed."""
        if self._cached_parts.get(name, (None,))[0] != inputs:
            self._cached_parts[name] = (inputs, build_shapes(*inputs))
        return self._cached_parts[name][1]

    def _panel_content(self, inputs: DisplayInputs, has_map: bool) -> PanelContent:
        language = self._params.language
        cameras = inputs.progress.cameras_seeing_spot if inputs.progress is not None else ()
        notices = display_messages.select_notices(self._notices.current(), language)
        notices += display_messages.preview_notices(inputs.preview, language)
        content = display_messages.panel_from_state(inputs.state, cameras, notices, has_map, language)
        newest = self._robots.current()
        if newest is None:
            return content
        return replace(content, commands=effective_commands(newest[1], content.commands))

    def _border_shapes(self, layout: Layout, messages: Sequence[VirtualBorder]) -> List[scene.Shape]:
        language = self._params.language
        borders = [display_messages.displayed_border_from_message(message, language) for message in messages]
        return scene.border_shapes(layout, borders, sentences.translate("display_off", {}, language))


def _drawing_shapes(layout: Layout, progress: BorderProgress) -> List[scene.Shape]:
    return scene.drawing_shapes(layout, display_messages.drawing_from_progress(progress))


def build() -> DisplayMarkersNode:
    """Reads the parameters and makes the node."""
    return DisplayMarkersNode(parameters.read(DisplayParams))
