"""Shows which floor the stationary cameras see, and which none does."""
from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, Dict, List, Optional, Tuple

import numpy as np
import rospy
from geometry_msgs.msg import Point
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from vb_core import names
from vb_core.errors import CodedError, ParameterError
from vb_core.grid_map import GridMap
from vb_core.parameters import Parameters, param
from vb_core.ros.cameras import camera_from_info
from vb_core.ros import node, parameters
from vb_core.ros.messages import OccupancyGridArray, grid_from_message, message_from_grid
from vb_core.ros.transforms import TransformLookup
from vb_robot.coverage import CoverageParams, combined, floor_seen, obstacle_heights, outlines

_GROUPS = ("coverage",)
START = rospy.Duration(10.0)
LOOK_EACH = 2.0  # [s] between two looks whether a camera has come or was moved: one costs a millisecond
# cameras named after a colour get it; all others take the next of these
_COLOURS = {"red": (0.8, 0.2, 0.1), "green": (0.0, 0.6, 0.4), "blue": (0.1, 0.4, 0.9)}
_OTHER_COLOURS = ((0.8, 0.5, 0.7), (0.9, 0.6, 0.0), (0.3, 0.7, 0.9), (0.9, 0.9, 0.3))


@dataclass(frozen=True)
class CameraCoverageParams(Parameters):
    """The node's own parameters."""

    cameras: list = param([], doc="names of the stationary cameras")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not all(isinstance(name, str) and name for name in self.cameras):
            raise ParameterError("cameras", f"expected names of cameras, got {self.cameras!r}")


class CameraCoverageNode:
    """Computes camera coverage, and only when the map, a camera's calibration or its pose changes.

    Subscribed topics:
        /map (nav_msgs/OccupancyGrid): where floor is, and what is on it
        <camera>/camera_info (sensor_msgs/CameraInfo)
        tf: <camera's optical frame> to map
    Published topics, latched, in the geometry of /map:
        /virtual_borders/coverage (nav_msgs/OccupancyGrid): how many cameras see each cell; 0: none; -1: no free floor
        /virtual_borders/coverage/outlines (visualization_msgs/MarkerArray): the edge of each camera's area, its name
    Parameters:
        ~* CameraCoverageParams, ~coverage/* CoverageParams

    A camera that is missing counts as seeing nothing until it comes.
    """

    def __init__(self, params: CameraCoverageParams, coverage: CoverageParams) -> None:
        self._coverage = coverage
        self._map_message: Any = None
        self._map_taken: Any = None
        self._map: Optional[GridMap] = None
        self._infos: Dict[str, Any] = {}  # as they came: at image rate unpacking them would cost time for nothing
        self._seen: Dict[str, Tuple[Any, np.ndarray]] = {}  # by camera: what it was computed from, (H, W) bool
        self._published: Any = None
        self._started = rospy.Time.now()
        self._transforms = TransformLookup()
        self._publisher = rospy.Publisher(names.COVERAGE, OccupancyGridArray, queue_size=1, latch=True)
        self._markers = rospy.Publisher(f"{names.COVERAGE}/outlines", MarkerArray, queue_size=1, latch=True)
        self._beat = node.Beat(LOOK_EACH)
        self._worker = node.Worker(self._beat, lambda _woken: self._look())
        self._subscribers = [
            rospy.Subscriber(names.PHYSICAL_MAP, OccupancyGridArray, self._on_map, queue_size=1),
            *(rospy.Subscriber(f"{name}/camera_info", rospy.AnyMsg, functools.partial(self._infos.__setitem__, name),
                               queue_size=1) for name in params.cameras)]

    def close(self) -> None:
        """Ends the worker."""
        self._beat.close()

    def _on_map(self, message: Any) -> None:
        self._map_message = message
        self._beat.set()

    def _look(self) -> None:
        """Computes what has changed since the last look."""
        if self._map_message is not self._map_taken:
            self._map_taken = self._map_message
            self._map = grid_from_message(self._map_taken)
            self._seen.clear()
        if self._map is None:
            return
        for name, packed in list(self._infos.items()):
            try:
                self._look_at(name, CameraInfo().deserialize(packed._buff), self._map)
            except CodedError as error:
                # during start-up a transform may be missing for a moment
                if rospy.Time.now() - self._started > START:
                    rospy.logwarn_throttle(30.0, f"{rospy.get_name()}: camera '{name}': {error}")
        key = (id(self._map), tuple(sorted((name, entry[0]) for name, entry in self._seen.items())))
        if key != self._published:
            self._published = key
            self._publish(self._map, {name: entry[1] for name, entry in self._seen.items()})

    def _look_at(self, name: str, info: CameraInfo, grid: GridMap) -> None:
        camera = camera_from_info(info)
        pose = self._transforms.lookup(names.MAP_FRAME, info.header.frame_id or f"{name}_optical_frame", rospy.Time(0), 0.0)
        numbers = (camera.width, camera.height, *camera.matrix.ravel(), *camera.distortion, *np.round(pose, 4).ravel())
        if name not in self._seen or self._seen[name][0] != numbers:
            heights = obstacle_heights(grid, self._coverage)
            self._seen[name] = (numbers, floor_seen(grid, heights, camera, pose, self._coverage))

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
