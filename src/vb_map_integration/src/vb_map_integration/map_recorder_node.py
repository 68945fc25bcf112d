"""Node: stores each new map with borders on disk, for evaluation."""

from __future__ import annotations

import datetime
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Optional

import rospy
from vb_msgs.msg import VirtualBorderArray

from vb_core import names
from vb_core.parameters import Parameters, param
from vb_core.ros import messages, node, parameters
from vb_map_integration.borders.border_messages import border_from_message
from vb_map_integration.storage.recording import MapRecording


@dataclass(frozen=True)
class RecorderParams(Parameters):
    """The recorder's parameters."""

    recording_dir: str = param("~/.ros/virtual_borders/recordings")
    borders_timeout: float = param(2.0, "s", above=0.0)


class MapRecorderNode:
    """Stores each new map with borders as map_server files, with the borders, time and trigger.

    The oldest ones are deleted once the folder has grown to `recording.MAX_BYTES`.

    Subscribed topics:
        /virtual_borders/map (nav_msgs/OccupancyGrid), /virtual_borders/borders (vb_msgs/VirtualBorderArray): the
            integrator gives both the same stamp for the same state. A map whose borders do not arrive is stored
            after ~borders_timeout with those that came last.
    Parameters:
        config/map_recorder.yaml: numbering goes on where an earlier recording in the same folder ended
    """

    def __init__(self, params: RecorderParams) -> None:
        self._params = params
        self._recording = MapRecording(Path(params.recording_dir).expanduser())
        self._lock = threading.Lock()
        self._map: Optional[Any] = None
        self._arrived = rospy.Time(0)
        self._borders = VirtualBorderArray()
        # maps are rare and each one counts: they queue up
        self._work: "node.Queue[Any]" = node.Queue()
        self._worker = node.Worker(self._work, self._record)
        # first the borders: a map that comes without them would be stored as one that has none
        self._maps: Optional[rospy.Subscriber] = None
        rospy.Subscriber(names.BORDERS, VirtualBorderArray, self._on_borders, queue_size=10)
        node.start_timer(params.borders_timeout, self._on_timer)

    def close(self) -> None:
        """Writes what has come and ends."""
        with self._lock:
            self._flush()
        self._work.close()
        self._worker.join(5.0)

    def _on_map(self, message: Any) -> None:
        with self._lock:
            self._flush()
            self._map, self._arrived = message, rospy.get_rostime()
            self._match()

    def _on_borders(self, message: VirtualBorderArray) -> None:
        with self._lock:
            self._borders = message
            self._match()
            if self._maps is None:
                self._maps = rospy.Subscriber(
                    names.MAP_WITH_BORDERS, messages.OccupancyGridArray, self._on_map, queue_size=10, buff_size=2**24
                )

    def _on_timer(self) -> None:
        with self._lock:
            if self._map is None:
                return
            age = (rospy.get_rostime() - self._arrived).to_sec()
            if not 0.0 <= age < self._params.borders_timeout:  # below 0: the time jumped back
                self._flush()

    def _match(self) -> None:
        if self._map is not None and self._map.header.stamp == self._borders.header.stamp:
            self._flush()

    def _flush(self) -> None:
        if self._map is not None:
            self._work.put((self._map, self._borders))
            self._map = None

    def _record(self, item: Any) -> None:
        grid, array = item
        path = self._recording.record(
            messages.grid_from_message(grid),
            [border_from_message(border) for border in array.borders],
            grid.header.stamp.to_sec(),
            {
                "revision": array.revision,
                # for people who look for a session; no program uses it
                "wall_time": datetime.datetime.now().astimezone().isoformat(timespec="milliseconds"),
            },
        )
        rospy.loginfo("%s: wrote %s", rospy.get_name(), path)


def build() -> MapRecorderNode:
    """Reads the parameters and makes the node."""
    return MapRecorderNode(parameters.read(RecorderParams))
