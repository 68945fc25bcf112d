"""The node that draws on the smart display."""
from __future__ import annotations

import collections
import threading
import time
from dataclasses import dataclass
from typing import Any, Deque, Dict, List, Optional, Tuple

import numpy as np
import rospy
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from vb_core import names
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.parameters import Parameters, param
from vb_core.ros import node, parameters
from vb_core.ros.messages import OccupancyGridArray, array_from_points, grid_from_message, message_from_grid
from vb_msgs.msg import BorderProgress, InteractionState, LaserSpot, VirtualBorder, VirtualBorderArray
from visualization_msgs.msg import Marker, MarkerArray

from vb_feedback import restricted, scene
from vb_feedback.layout import Box, Layout, fit

_REFRESH_S = 2.0

RESTRICTED = "/virtual_borders/display/restricted"


@dataclass(frozen=True)
class DisplayParams(Parameters):
    """Parameters of display_markers; config/display_markers.yaml says why."""

    screen_aspect: float = param(16.0 / 9.0, "", low=0.5, high=5.0)
    max_rate: float = param(10.0, "1/s", low=1.0, high=30.0)
    fade: float = param(1.5, "s", above=0.0, high=10.0)
    trail: int = param(60, "spots", low=1, high=1000)
    robots: list = param(["base_link"])
    robot_radius: float = param(0.18, "m", above=0.0, high=2.0)
    stripe: float = param(0.10, "m", above=0.0, high=5.0)


_KINDS = {
    scene.LINES: Marker.LINE_LIST,
    scene.POINTS: Marker.POINTS,
    scene.DISC: Marker.CYLINDER,
    scene.PLATE: Marker.CUBE,
    scene.TEXT: Marker.TEXT_VIEW_FACING,
}


def marker_from_shape(shape: scene.Shape) -> Marker:
    """A shape to a marker; its stamp stays zero: "wherever the frame is now"."""
    marker = Marker()
    marker.header.frame_id = shape.frame or names.MAP_FRAME
    marker.frame_locked = bool(shape.frame)
    marker.ns, marker.id = shape.namespace, shape.number
    marker.type, marker.action = _KINDS[shape.kind], Marker.ADD
    marker.pose.orientation.w = 1.0
    marker.lifetime = rospy.Duration.from_sec(shape.lifetime)
    tints = [ColorRGBA(*colour, shape.alpha) for colour in shape.colours]
    marker.color = tints[0]
    scale = marker.scale
    if shape.kind in (scene.LINES, scene.POINTS):
        marker.points = [Point(x, y, shape.z) for x, y in shape.points]
        if len(tints) == len(shape.points) > 1:
            marker.colors = tints
        scale.x = shape.size[0]
        scale.y = shape.size[0] if shape.kind == scene.POINTS else 0.0
        return marker
    marker.pose.position = Point(*shape.points[0], shape.z)
    if shape.kind == scene.TEXT:
        marker.text, scale.z = shape.text, shape.size[0]
    else:
        scale.x, scale.y, scale.z = shape.size[0], shape.size[-1], 0.01
    return marker


class DisplayMarkers:
    """Draws state, words, borders, drawing and spots as markers, and restricted areas as a grid.

    Subscribes to:
        /map, /virtual_borders/map (nav_msgs/OccupancyGrid): the layout, and where borders restrict.
        /virtual_borders/state (vb_msgs/InteractionState)
        /virtual_borders/progress (vb_msgs/BorderProgress)
        /virtual_borders/borders (vb_msgs/VirtualBorderArray)
        /virtual_borders/spots (vb_msgs/LaserSpot)

    Publishes:
        /virtual_borders/markers (visualization_msgs/MarkerArray): only what changed, at most ~max_rate
            times a second; everything to a subscriber that has just come.
        /virtual_borders/display/restricted (nav_msgs/OccupancyGrid, latched): stripes where borders
            restrict the map, for RViz's colour scheme "costmap".

    Args:
        params: see config/display_markers.yaml.
    """

    def __init__(self, params: DisplayParams) -> None:
        self._params = params
        self._lock = threading.Lock()
        self._dirty = threading.Event()
        self._shown: Dict[Tuple[str, int], scene.Shape] = {}
        self._newcomers: List[Any] = []
        self._physical: Optional[GridMap] = None
        self._posterior: Optional[GridMap] = None
        self._maps_changed = False
        self._layout: Layout = fit(Box(0.0, 0.0, 8.0, 5.0), params.screen_aspect)
        self._has_map = False
        self._state: Optional[InteractionState] = None
        self._progress: Optional[BorderProgress] = None
        self._borders: List[VirtualBorder] = []
        self._spots: Deque[scene.Spot] = collections.deque(maxlen=params.trail)

        self._restricted = rospy.Publisher(RESTRICTED, OccupancyGridArray, queue_size=1, latch=True)
        self._markers = rospy.Publisher(names.MARKERS, MarkerArray, self._on_subscriber(), queue_size=20)
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()
        self._dirty.set()
        rospy.Subscriber(names.PHYSICAL_MAP, OccupancyGridArray, self._on_physical, queue_size=1)
        rospy.Subscriber(names.VIRTUAL_MAP, OccupancyGridArray, self._on_posterior, queue_size=1)
        rospy.Subscriber(names.STATE, InteractionState, self._on_state, queue_size=5)
        rospy.Subscriber(names.PROGRESS, BorderProgress, self._on_progress, queue_size=1)
        rospy.Subscriber(names.BORDERS, VirtualBorderArray, self._on_borders, queue_size=1)
        rospy.Subscriber(names.SPOTS, LaserSpot, self._on_spot, queue_size=50)

    # ------------------------------------------------------------------ inputs
    def _on_subscriber(self) -> rospy.SubscribeListener:
        owner = self

        class Listener(rospy.SubscribeListener):
            """Notes who came, so that the worker sends them everything."""

            def peer_subscribe(self, _topic: str, _publish: Any, peer_publish: Any) -> None:
                with owner._lock:
                    owner._newcomers.append(peer_publish)
                owner._dirty.set()

        return Listener()

    def _on_physical(self, message: OccupancyGridArray) -> None:
        self._take_map("_physical", message)

    def _on_posterior(self, message: OccupancyGridArray) -> None:
        self._take_map("_posterior", message)

    def _take_map(self, which: str, message: OccupancyGridArray) -> None:
        try:
            grid = grid_from_message(message)
        except CodedError as error:
            rospy.logwarn_throttle(5.0, f"display_markers: {error}")
            return
        with self._lock:
            setattr(self, which, grid)
            self._maps_changed = True
        self._dirty.set()

    def _on_state(self, message: InteractionState) -> None:
        with self._lock:
            self._state = message
        self._dirty.set()

    def _on_progress(self, message: BorderProgress) -> None:
        with self._lock:
            self._progress = message
        self._dirty.set()

    def _on_borders(self, message: VirtualBorderArray) -> None:
        with self._lock:
            self._borders = list(message.borders)
        self._dirty.set()

    def _on_spot(self, message: LaserSpot) -> None:
        x, y = message.position.x, message.position.y
        if not (np.isfinite(x) and np.isfinite(y)):
            rospy.logwarn_throttle(5.0, f"display_markers: a spot of camera '{message.camera}' has no position")
            return
        with self._lock:
            self._spots.append(scene.Spot(message.camera, x, y, message.header.stamp.to_sec()))
        self._dirty.set()

    # ------------------------------------------------------------------ work
    def _work(self) -> None:
        """Draws on change. The pause is wall time: what a screen can show does not depend on simulated time."""
        period, refreshed = 1.0 / self._params.max_rate, 0.0
        while not rospy.is_shutdown():
            self._dirty.wait(_REFRESH_S)
            self._dirty.clear()
            started = time.monotonic()
            if started - refreshed >= _REFRESH_S:
                # RViz drops markers in a frame that tf does not know yet: robots are sent again and again
                refreshed = started
                self._shown = {key: shape for key, shape in self._shown.items() if not shape.frame}
            try:
                fading = self._draw()
            except rospy.ROSException:
                if rospy.is_shutdown():
                    return
                raise
            rospy.rostime.wallsleep(max(0.0, period - (time.monotonic() - started)))
            if fading:
                self._dirty.set()

    def _draw(self) -> bool:
        """Sends what changed; gives whether spots are still fading."""
        with self._lock:
            if self._maps_changed:
                maps = (self._physical, self._posterior)
                self._maps_changed = False
            else:
                maps = None
            state, progress, borders, spots = self._state, self._progress, self._borders, list(self._spots)
            newcomers, self._newcomers = self._newcomers, []
        if maps is not None:
            self._take_geometry(*maps)
            self._show_restricted(*maps)
        if self._markers.get_num_connections() == 0 and not newcomers:
            return False
        now = rospy.get_time()
        shapes = self._compose(state, progress, borders, spots, now)
        changed, gone = scene.changes(self._shown, shapes)
        self._shown = {shape.key: shape for shape in shapes}
        message = MarkerArray([self._removal(namespace, number) for namespace, number in gone])
        message.markers += [marker_from_shape(shape) for shape in changed]
        if message.markers:
            self._markers.publish(message)
        for publish in newcomers:
            everything = MarkerArray([Marker(action=Marker.DELETEALL)])
            everything.markers += [marker_from_shape(shape) for shape in shapes]
            publish(everything)
        return any(abs(now - spot.stamp) <= self._params.fade for spot in spots)

    def _take_geometry(self, physical: Optional[GridMap], posterior: Optional[GridMap]) -> None:
        grid = posterior if posterior is not None else physical
        if grid is not None:
            self._has_map = True
            self._layout = fit(Box.around(grid.corners()), self._params.screen_aspect)

    def _show_restricted(self, physical: Optional[GridMap], posterior: Optional[GridMap]) -> None:
        if physical is None or posterior is None:
            return
        if not physical.same_geometry(posterior):
            rospy.logwarn_throttle(5.0, "display_markers: /map and /virtual_borders/map differ in size or place")
            return
        stripe = max(1, int(round(self._params.stripe / posterior.resolution)))
        cells = restricted.overlay(physical.data, posterior.data, stripe)
        self._restricted.publish(message_from_grid(posterior.with_data(cells), rospy.Time.now()))

    def _compose(
        self,
        state: Optional[InteractionState],
        progress: Optional[BorderProgress],
        borders: List[VirtualBorder],
        spots: List[scene.Spot],
        now: float,
    ) -> List[scene.Shape]:
        layout, params = self._layout, self._params
        seeing: List[str] = []
        drawn = scene.Drawing()
        # what belongs to an interaction that has ended is not shown any more
        if progress is not None and state is not None and state.interaction_id:
            if progress.interaction_id == state.interaction_id:
                drawn = drawing_from_progress(progress)
                seeing = list(progress.seeing)
        shapes = scene.words(layout, talk_from_state(state, seeing, self._has_map))
        shapes += scene.borders(layout, [border_from_message(border) for border in borders])
        shapes += scene.drawing(layout, drawn)
        shapes += scene.spots(layout, spots, now, params.fade, 2.0 * params.fade)
        for number, frame in enumerate(params.robots):
            shapes += scene.robot(str(frame), number, params.robot_radius)
        return shapes

    @staticmethod
    def _removal(namespace: str, number: int) -> Marker:
        marker = Marker(ns=namespace, id=number, action=Marker.DELETE)
        marker.header.frame_id = names.MAP_FRAME
        marker.pose.orientation.w = 1.0
        return marker


def talk_from_state(state: Optional[InteractionState], seeing: List[str], has_map: bool) -> scene.Talk:
    """The words' contents; without a map nothing else matters."""
    if not has_map:
        return scene.Talk(message="Waiting for the map of the room.")
    if state is None:
        return scene.Talk()
    return scene.Talk(
        state.name,
        # whole seconds, as they are shown: less is no change
        float(int(state.guide_s + state.border_s + state.seed_s)),
        tuple(state.commands),
        state.last_success,
        state.last_message,
        tuple(seeing),
    )


def drawing_from_progress(progress: BorderProgress) -> scene.Drawing:
    """Progress message to plain values; points whose camera is unknown get the name ""."""
    cameras = list(progress.cameras)
    indices = bytes(progress.point_cameras)
    names_of_points = [
        cameras[indices[number]] if number < len(indices) and indices[number] < len(cameras) else ""
        for number in range(len(progress.points))
    ]
    return scene.Drawing(
        tuple(map(tuple, array_from_points(progress.points).tolist())),
        tuple(names_of_points),
        tuple(map(tuple, array_from_points(progress.chain).tolist())),
        progress.closed,
        (progress.seed.x, progress.seed.y) if progress.has_seed else None,
    )


def border_from_message(border: VirtualBorder) -> scene.Border:
    """Border message to plain values."""
    return scene.Border(
        border.name or border.id,
        tuple(map(tuple, array_from_points(border.points).tolist())),
        border.kind == VirtualBorder.POLYGON,
        (border.seed.x, border.seed.y),
        border.occupancy,
        border.enabled,
        border.area_m2,
    )


def main() -> None:
    """Runs the node."""
    node.run("display_markers", lambda: DisplayMarkers(parameters.read(DisplayParams)))
