"""Node: tells people when a camera fails while they work."""
from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any

import rospy

from vb_bringup.lab_monitor import LabMonitor
from vb_core import names
from vb_core.parameters import Parameters, param
from vb_core.ros import node, parameters
from vb_core.ros.notices import NoticePublisher
from vb_msgs.msg import DetectorStatus


@dataclass(frozen=True)
class LabMonitorParams(Parameters):
    """The node's parameters."""

    cameras: str = param("", doc="names of the cameras that should be there, separated by spaces")


class LabMonitorNode:
    """Watches the detectors' status.

    Subscribed topics:
        /virtual_borders/detectors (vb_msgs/DetectorStatus)
    Published topics:
        /virtual_borders/notices (vb_msgs/NoticeArray): camera_silent, camera_no_pose, camera_no_lens, detector_missing
    Parameters:
        ~* LabMonitorParams
    """

    def __init__(self, params: LabMonitorParams) -> None:
        self._lock = threading.Lock()
        self._monitor = LabMonitor(params.cameras.split())
        node.wait_for_clock()
        self._monitor.begin(rospy.get_time())
        self._notices = NoticePublisher()
        self._subscriber = rospy.Subscriber(names.DETECTORS, DetectorStatus, self._on_status, queue_size=50)
        self._timer = rospy.Timer(rospy.Duration(1.0), self._on_timer, reset=True)

    def close(self) -> None:
        """Takes its notices back."""
        self._timer.shutdown()
        self._notices.close()

    def _on_status(self, message: DetectorStatus) -> None:
        dropped = dict(zip(message.refusals, message.refusal_counts))
        with self._lock:
            self._monitor.hear(message.camera, message.received, dropped, rospy.get_time())

    def _on_timer(self, _event: Any) -> None:
        with self._lock:
            found = self._monitor.notices(rospy.get_time())
        self._notices.set(found)


def build() -> LabMonitorNode:
    """Reads the parameters and makes the node."""
    return LabMonitorNode(parameters.read(LabMonitorParams))


def main() -> None:
    """Entry point of the executable lab_monitor."""
    node.run("lab_monitor", build)
