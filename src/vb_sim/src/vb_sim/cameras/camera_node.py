"""The shared part of the simulated cameras' nodes: they receive the lab's state, render images when due, and report."""

from __future__ import annotations

import threading
import time
from typing import Dict, List, Sequence

import rospy
from diagnostic_msgs.msg import DiagnosticArray

from vb_core import names
from vb_core.ros import node
from vb_msgs.msg import LabState
from vb_sim.cameras.frame_clock import FrameSchedule, SmoothClock
from vb_sim.lab_history import History
from vb_sim.lab_messages import camera_diagnostics, snapshot_from_message

_REPORT_PERIOD = 1.0  # [s]


class CameraNode:
    """Calls `_publish` for each image that is due, and `_figures` once a second; `_start` begins.

    Args:
        name: of the kind of node.
        rates: [1/s] of its cameras.
        latency_ms: [ms] from an image's stamp to its delivery.
    """

    def __init__(self, name: str, rates: Sequence[float], latency_ms: float) -> None:
        self._name = name
        self._history = History()
        self._running = True
        self._schedule = FrameSchedule(rates, latency_ms * 1e-3)
        self._clock = SmoothClock(rospy.get_time, time.monotonic)

    def _start(self) -> None:
        self._diagnostics = rospy.Publisher("/sim/cameras", DiagnosticArray, queue_size=1, latch=True)
        rospy.Subscriber(names.LAB_STATE, LabState, self._on_state, queue_size=10, tcp_nodelay=True)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Ends the thread."""
        self._running = False

    def _publish(self, index: int, stamp_s: float) -> None:
        """Renders and publishes one image: index of the camera, stamp [s]."""
        raise NotImplementedError

    def _figures(self) -> List[Dict[str, object]]:
        """Returns each camera's figures by name, with its name as "camera"."""
        raise NotImplementedError

    def _on_state(self, message: LabState) -> None:
        self._history.add(snapshot_from_message(message))

    def _run(self) -> None:
        node.wait_for_clock()
        report_at = 0.0
        while self._running and not rospy.is_shutdown():
            now = self._clock.now()
            try:
                for index, stamp in self._schedule.due(now):
                    self._publish(index, stamp)
                # on a steady clock: the counts matter most when simulated time is in trouble
                if time.monotonic() >= report_at:
                    report_at = time.monotonic() + _REPORT_PERIOD
                    self._diagnostics.publish(camera_diagnostics(self._name, self._figures(), rospy.Time.from_sec(now)))
            except rospy.ROSException:
                # the topics close during shutdown
                return
            # simulated time may run slower than the wall's: look again at least every few milliseconds
            time.sleep(min(max(self._schedule.wait(self._clock.now()), 0.001), 0.02))
