"""Publishes which floor the stationary cameras see, and which none of them sees."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, Dict, Optional, Tuple

import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo

from vb_core import names
from vb_core.errors import CodedError, ParameterError
from vb_core.grid_map import GridMap
from vb_core.parameters import Parameters, param
from vb_core.ros import node, parameters
from vb_core.ros.cameras import camera_from_info
from vb_core.ros.messages import OccupancyGridArray, message_from_grid
from vb_core.ros.transforms import TransformLookup
from vb_robot.clearance_map import BLOCKED_THRESHOLD
from vb_robot.coverage import floor_seen
from vb_robot.inputs import subscribe_map

START_DELAY = rospy.Duration(10.0)
CHECK_PERIOD = 2.0  # [s] between two looks whether a camera has come or was moved: one costs a millisecond


@dataclass(frozen=True)
class CameraCoverageParams(Parameters):
    """The node's own parameters."""

    cameras: list = param([], doc="names of the stationary cameras")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not all(isinstance(name, str) and name for name in self.cameras):
            raise ParameterError("cameras", f"expected names of cameras, got {self.cameras!r}")


class CameraCoverageNode:
    """Computes which floor the stationary cameras see, and again when the map, a camera's lens or its pose changes.

    A camera that is missing counts as seeing nothing until it comes.

    Subscribed topics:
        /map (nav_msgs/OccupancyGrid): where floor is, and what is on it
        <camera>/camera_info (sensor_msgs/CameraInfo)
        /tf, /tf_static (tf2_msgs/TFMessage): <camera's optical frame> to map
    Published topics:
        /virtual_borders/coverage (nav_msgs/OccupancyGrid, latched): in the geometry of /map, how many cameras see each
            cell; 0: none; -1: no free floor
    Parameters:
        ~* CameraCoverageParams
    """

    def __init__(self, params: CameraCoverageParams) -> None:
        self._map: Optional[GridMap] = None
        self._computed_on: Optional[GridMap] = None
        self._infos: Dict[str, Any] = {}  # as they came: at image rate unpacking them would cost time for nothing
        self._seen: Dict[str, Tuple[Any, np.ndarray]] = {}  # by camera: what it was computed from, (H, W) bool
        self._published: Any = None
        self._started = rospy.Time.now()
        self._transforms = TransformLookup()
        self._publisher = rospy.Publisher(names.COVERAGE, OccupancyGridArray, queue_size=1, latch=True)
        self._timer = node.WakeTimer(CHECK_PERIOD)
        self._worker = node.Worker(self._timer, lambda _woken: self._update())
        self._subscribers = [
            subscribe_map(names.PHYSICAL_MAP, self._on_map),
            *(
                rospy.Subscriber(
                    f"{name}/camera_info", rospy.AnyMsg, functools.partial(self._infos.__setitem__, name), queue_size=1
                )
                for name in params.cameras
            ),
        ]

    def close(self) -> None:
        """Ends the worker."""
        self._timer.close()

    def _on_map(self, grid: GridMap) -> None:
        self._map = grid
        self._timer.set()

    def _update(self) -> None:
        """Computes what has changed since the last look."""
        grid = self._map
        if grid is None:
            return
        if grid is not self._computed_on:
            self._computed_on, self._published = grid, None
            self._seen.clear()
        for name, packed in list(self._infos.items()):
            try:
                self._update_camera(name, CameraInfo().deserialize(packed._buff), grid)
            except CodedError as error:
                # during start-up a transform may be missing for a moment
                if rospy.Time.now() - self._started > START_DELAY:
                    rospy.logwarn_throttle(30.0, f"{rospy.get_name()}: camera '{name}': {error}")
        key = sorted((name, entry[0]) for name, entry in self._seen.items())
        if key != self._published:
            self._published = key
            self._publish(grid, {name: entry[1] for name, entry in self._seen.items()})

    def _update_camera(self, name: str, info: CameraInfo, grid: GridMap) -> None:
        camera = camera_from_info(info)
        pose = self._transforms.lookup(
            names.MAP_FRAME, info.header.frame_id or f"{name}_optical_frame", rospy.Time(0), 0.0
        )
        numbers = (camera.width, camera.height, *camera.matrix.ravel(), *camera.distortion, *np.round(pose, 4).ravel())
        if name not in self._seen or self._seen[name][0] != numbers:
            self._seen[name] = (numbers, floor_seen(grid, camera, pose))

    def _publish(self, grid: GridMap, seen: Dict[str, np.ndarray]) -> None:
        floor = (grid.data >= 0) & (grid.data < BLOCKED_THRESHOLD)
        values = np.where(floor, sum(seen.values(), np.zeros(grid.shape, np.int8)), np.int8(-1))
        self._publisher.publish(message_from_grid(grid.with_data(values), rospy.Time.now()))
        share = float((values[floor] > 0).mean()) if floor.any() else 0.0
        cameras = " and ".join(sorted(seen)) or "no camera"
        rospy.loginfo("%s: seen by %s: %.0f %% of the floor", rospy.get_name(), cameras, 100.0 * share)


def build() -> CameraCoverageNode:
    """Reads the parameters and makes the node."""
    return CameraCoverageNode(parameters.read(CameraCoverageParams, "~"))
