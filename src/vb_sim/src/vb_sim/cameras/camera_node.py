"""The shared part of the simulated cameras' nodes: they receive the lab's state, and render images when due."""

from __future__ import annotations

import threading
import time
from typing import Sequence

import rospy

from vb_core import names
from vb_core.ros import node
from vb_msgs.msg import LabState
from vb_sim.cameras.frame_clock import FrameSchedule, SmoothClock
from vb_sim.lab_history import History
from vb_sim.lab_messages import snapshot_from_message

_REPORT_PERIOD = 60.0  # [s]


class CameraNode:
    """Calls `_publish` for each image that is due; `_start` begins.

    Args:
        rates: [1/s] of its cameras.
        latency_ms: [ms] from an image's stamp to its delivery.
    """

    def __init__(self, rates: Sequence[float], latency_ms: float) -> None:
        self._history = History()
        self._running = True
        self._schedule = FrameSchedule(rates, latency_ms * 1e-3)
        self._clock = SmoothClock(rospy.get_time, time.monotonic)

    def _start(self) -> None:
        rospy.Subscriber(names.LAB_STATE, LabState, self._on_state, queue_size=10, tcp_nodelay=True)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Ends the thread."""
        self._running = False

    def _publish(self, index: int, stamp_s: float) -> None:
        """Renders and publishes one image: index of the camera, stamp [s]."""
        raise NotImplementedError

    def _on_state(self, message: LabState) -> None:
        self._history.add(snapshot_from_message(message))

    def _run(self) -> None:
        node.wait_for_clock()
        skipped = 0
        while self._running and not rospy.is_shutdown():
            now = self._clock.now()
            try:
                for index, stamp in self._schedule.due(now):
                    self._publish(index, stamp)
                if self._schedule.skipped > skipped:
                    skipped = self._schedule.skipped
                    text = f"{rospy.get_name()}: {skipped} images left out so far: this computer is too slow"
                    rospy.logwarn_throttle(_REPORT_PERIOD, text)
            except rospy.ROSException:
                # the topics close during shutdown
                return
            # simulated time may run slower than the wall's: look again at least every few milliseconds
            time.sleep(min(max(self._schedule.wait(self._clock.now()), 0.001), 0.02))
