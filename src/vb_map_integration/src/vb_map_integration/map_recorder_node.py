"""Node: stores each new map with borders on disk, for evaluation."""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict

import rospy
from vb_msgs.msg import VirtualBorderArray

from vb_core import names
from vb_core.parameters import Parameters, param
from vb_core.ros import messages, node, parameters
from vb_map_integration.borders.border_messages import border_from_message
from vb_map_integration.storage.recording import MapRecording

_MOST_WAITING = 10  # maps or lists of borders whose counterpart has not come


@dataclass(frozen=True)
class RecorderParams(Parameters):
    """The recorder's parameters."""

    recording_dir: str = param(
        "~/.ros/virtual_borders/recordings", doc="folder of the numbered maps, their borders, and index.jsonl"
    )


class MapRecorderNode:
    """Stores each new map with borders as map_server files, with its borders and time.

    Subscribed topics:
        /virtual_borders/map (nav_msgs/OccupancyGrid), /virtual_borders/borders (vb_msgs/VirtualBorderArray): the
            integrator gives both the same stamp for the same state.
    Parameters:
        ~* RecorderParams: numbering goes on where an earlier recording in the same folder ended
    """

    def __init__(self, params: RecorderParams) -> None:
        self._recording = MapRecording(Path(params.recording_dir).expanduser())
        self._lock = threading.Lock()
        self._waiting: "OrderedDict[rospy.Time, Dict[str, Any]]" = OrderedDict()
        # maps are rare and each one counts: they queue up
        self._work: "node.Queue[Dict[str, Any]]" = node.Queue()
        self._worker = node.Worker(self._work, self._record)
        for key, topic, type_ in (
            ("borders", names.BORDERS, VirtualBorderArray),
            ("map", names.MAP_WITH_BORDERS, messages.OccupancyGridArray),
        ):
            rospy.Subscriber(topic, type_, self._on_message, key, queue_size=10, buff_size=2**24)

    def close(self) -> None:
        """Writes what has come and ends."""
        self._work.close()
        self._worker.join(5.0)

    def _on_message(self, message: Any, key: str) -> None:
        with self._lock:
            pair = self._waiting.setdefault(message.header.stamp, {})
            pair[key] = message
            if len(pair) == 2:
                self._work.put(self._waiting.pop(message.header.stamp))
            while len(self._waiting) > _MOST_WAITING:
                self._waiting.popitem(last=False)

    def _record(self, pair: Dict[str, Any]) -> None:
        path = self._recording.record(
            messages.grid_from_message(pair["map"]),
            [border_from_message(border) for border in pair["borders"].borders],
            pair["map"].header.stamp.to_sec(),
        )
        rospy.loginfo("%s: wrote %s", rospy.get_name(), path)


def build() -> MapRecorderNode:
    """Reads the parameters and makes the node."""
    return MapRecorderNode(parameters.read(RecorderParams))
