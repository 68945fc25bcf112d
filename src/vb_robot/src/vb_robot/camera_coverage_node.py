"""Shows which floor the stationary cameras see, and which none does."""
from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any, Dict, List, Optional, Tuple

import numpy as np
import rospy
from geometry_msgs.msg import Point
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from vb_core import names
from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError, ParameterError
from vb_core.grid_map import GridMap
from vb_core.parameters import Parameters, param
from vb_core.ros.cameras import camera_from_info
from vb_core.ros import node, parameters
from vb_core.ros.messages import OccupancyGridArray, grid_from_message, message_from_grid
from vb_core.ros.transforms import TransformLookup
from vb_robot.coverage import CoverageParams, combined, floor_seen, obstacle_heights, outlines

_GROUPS = ("coverage",)
_START_S = 10.0
# cameras named after a colour get it; all others take the next of these
_COLOURS = {"red": (0.8, 0.2, 0.1), "green": (0.0, 0.6, 0.4), "blue": (0.1, 0.4, 0.9)}
_OTHER_COLOURS = ((0.8, 0.5, 0.7), (0.9, 0.6, 0.0), (0.3, 0.7, 0.9), (0.9, 0.9, 0.3))


@dataclass(frozen=True)
class CameraCoverageParams(Parameters):
    """The node's own parameters."""

    cameras: list = param([], doc="names of the stationary cameras")
    refresh: float = param(30.0, "s", low=1.0, high=3600.0, doc="between two looks whether a camera was moved")
    patience: float = param(2.0, "s", above=0.0, high=60.0, doc="between two looks for a camera that is missing")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not all(isinstance(name, str) and name for name in self.cameras):
            raise ParameterError("cameras", f"expected names of cameras, got {self.cameras!r}")


class CameraCoverageNode:
    """Computes camera coverage, and only when the map, a camera's calibration or its pose changes.

    Subscribed topics:
        /map (nav_msgs/OccupancyGrid): where floor is, and what is on it
        <camera>/camera_info (sensor_msgs/CameraInfo): for one message now and then
        tf: <camera's optical frame> to map
    Published topics, latched, in the geometry of /map:
        /virtual_borders/coverage (nav_msgs/OccupancyGrid): how many cameras see each cell; 0: none; -1: no free floor
        /virtual_borders/coverage/outlines (visualization_msgs/MarkerArray): the edge of each camera's area, its name
    Parameters:
        ~* CameraCoverageParams, ~coverage/* CoverageParams

    A camera that is missing counts as seeing nothing until it comes.
    """

    def __init__(self, params: CameraCoverageParams, coverage: CoverageParams) -> None:
        self._params = params
        self._coverage = coverage
        self._lock = threading.Lock()
        self._map: Optional[GridMap] = None
        self._infos: Dict[str, CameraInfo] = {}
        self._seen: Dict[str, Tuple[Any, np.ndarray]] = {}  # by camera: what it was computed from, (H, W) bool
        self._published: Any = None
        self._asking: Dict[str, rospy.Subscriber] = {}
        self._asked_at = rospy.Time(0)
        self._started = rospy.Time.now()
        self._transforms = TransformLookup()
        self._publisher = rospy.Publisher(names.COVERAGE, OccupancyGridArray, queue_size=1, latch=True)
        self._markers = rospy.Publisher(f"{names.COVERAGE}/outlines", MarkerArray, queue_size=1, latch=True)
        self._maps: node.Mailbox = node.Mailbox()
        self._worker = node.Worker(self._maps, self._take_map)
        self._subscriber = rospy.Subscriber(names.PHYSICAL_MAP, OccupancyGridArray, self._maps.put, queue_size=1)
        self._timer = rospy.Timer(rospy.Duration(params.patience), self._on_timer, reset=True)

    def close(self) -> None:
        """Ends timer and worker."""
        self._timer.shutdown()
        self._maps.close()

    # ------------------------------------------------------------- inputs
    def _take_map(self, message: Any) -> None:
        if message is not _LOOK:
            grid = grid_from_message(message)
            if self._map is None or not self._map.same_geometry(grid) or not np.array_equal(self._map.data, grid.data):
                self._map = grid
                self._seen.clear()
        self._work_out()

    def _on_timer(self, _event: object) -> None:
        now = rospy.Time.now()
        missing = [name for name in self._params.cameras if name not in self._seen]
        due = not 0.0 <= (now - self._asked_at).to_sec() < self._params.refresh
        if not missing and not due:
            return
        if due:
            self._asked_at = now
        self._ask(self._params.cameras if due else [name for name in missing if name not in self._infos])
        self._maps.put(_LOOK)

    def _ask(self, cameras: List[str]) -> None:
        """Listens for one camera_info of each: at image rate they would cost time for nothing."""
        with self._lock:
            for name in cameras:
                if name not in self._asking:
                    topic = f"{name}/camera_info"
                    self._asking[name] = rospy.Subscriber(topic, CameraInfo, self._on_info, name, queue_size=1)

    def _on_info(self, message: CameraInfo, name: str) -> None:
        with self._lock:
            subscriber = self._asking.pop(name, None)
            self._infos[name] = message
        if subscriber is not None:
            subscriber.unregister()
            self._maps.put(_LOOK)

    # ------------------------------------------------------------- outputs
    def _work_out(self) -> None:
        grid = self._map
        if grid is None:
            return
        with self._lock:
            infos = dict(self._infos)
        heights: Optional[np.ndarray] = None
        for name, info in infos.items():
            try:
                camera = camera_from_info(info)
                frame = info.header.frame_id or f"{name}_optical_frame"
                pose = self._transforms.lookup(names.MAP_FRAME, frame, rospy.Time(0), 0.0)
                made_of = (_numbers(camera), tuple(np.round(pose, 4).ravel()))
                if name in self._seen and self._seen[name][0] == made_of:
                    continue
                heights = obstacle_heights(grid, self._coverage) if heights is None else heights
                self._seen[name] = (made_of, floor_seen(grid, heights, camera, pose, self._coverage))
            except CodedError as error:
                # during start-up a transform may be missing for a moment
                if rospy.Time.now() - self._started > rospy.Duration(_START_S):
                    rospy.logwarn_throttle(30.0, f"{rospy.get_name()}: camera '{name}': {error}")
        key = (id(grid), tuple(sorted((name, entry[0]) for name, entry in self._seen.items())))
        if key != self._published:
            self._published = key
            self._publish(grid, {name: entry[1] for name, entry in self._seen.items()})

    def _publish(self, grid: GridMap, seen: Dict[str, np.ndarray]) -> None:
        now = rospy.Time.now()
        values = combined(grid, seen)
        self._publisher.publish(message_from_grid(grid.with_data(values), now))
        markers = MarkerArray([Marker(action=Marker.DELETEALL)])
        for number, (name, mask) in enumerate(sorted(seen.items())):
            markers.markers += _outline_markers(grid, number, name, mask)
        self._markers.publish(markers)
        floor = values >= 0
        share = float((values[floor] > 0).mean()) if floor.any() else 0.0
        cameras = " and ".join(sorted(seen)) or "no camera"
        rospy.loginfo("%s: seen by %s: %.0f %% of the floor", rospy.get_name(), cameras, 100.0 * share)


_LOOK = object()  # in the mailbox: no new map, but perhaps a new camera


def _numbers(camera: CameraModel) -> Tuple[float, ...]:
    return (camera.width, camera.height, *camera.matrix.ravel(), *camera.distortion)


def _outline_markers(grid: GridMap, number: int, name: str, mask: np.ndarray) -> List[Marker]:
    colour = ColorRGBA(*_COLOURS.get(name, _OTHER_COLOURS[number % len(_OTHER_COLOURS)]), 0.9)
    line = Marker(ns="coverage", id=2 * number, type=Marker.LINE_LIST, action=Marker.ADD, color=colour)
    for outline in outlines(grid, mask):
        for start, end in zip(outline, np.roll(outline, -1, axis=0)):
            line.points += [Point(float(start[0]), float(start[1]), 0.03), Point(float(end[0]), float(end[1]), 0.03)]
    line.scale.x = 0.03
    text = Marker(ns="coverage", id=2 * number + 1, type=Marker.TEXT_VIEW_FACING, action=Marker.ADD, color=colour)
    text.text = name
    text.scale.z = 0.2
    middle = grid.cell_to_world(np.argwhere(mask)).mean(axis=0) if mask.any() else np.zeros(2)
    text.pose.position = Point(float(middle[0]), float(middle[1]), 0.3)
    for marker in (line, text):
        marker.header.frame_id = names.MAP_FRAME
        marker.pose.orientation.w = 1.0
    # RViz complains about a line without points
    return [line, text] if line.points else []


def build() -> CameraCoverageNode:
    """Reads the parameters and makes the node."""
    return CameraCoverageNode(
        parameters.read(CameraCoverageParams, "~", ignore=_GROUPS), parameters.read(CoverageParams, "~coverage")
    )
