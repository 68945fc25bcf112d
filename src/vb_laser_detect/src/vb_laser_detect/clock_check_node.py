"""Watches whether the clocks of the computers that run detectors agree with this one's."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import dataclass
from typing import Any, Dict, List, Optional

import diagnostic_updater
import rospy
from diagnostic_msgs.msg import DiagnosticStatus

from vb_core.errors import CodedError, ParameterError
from vb_core.parameters import Parameters, param
from vb_core.ros import parameters
from vb_laser_detect.calibration.clock_offset import ClockOffset, Exchange, estimate_clock_offset
from vb_msgs.srv import GetTime


_TIMEOUT = 5.0  # [s] beyond the next measurement; then a clock counts as not answering


@dataclass(frozen=True)
class ClockCheckParams(Parameters):
    """See config/clock_check.yaml."""

    nodes: str = param("", doc="names of the detectors, separated by spaces")
    max_offset_ms: float = param(10.0, "ms", above=0.0, high=10000.0)
    measurement_period: float = param(10.0, "s", above=0.0, high=3600.0)
    samples: int = param(8, "", low=1, high=1000)


class ClockCheckNode:
    """Measures how far other computers' clocks differ from this one's, and warns.

    A spot is stamped by the clock of its camera's computer and matched with transforms of the robot's: 10 ms are 5 mm
    at 0.5 m/s, and with 100 ms a detector would wait for each transform in vain.

    Services called:
        <detector>/get_time (vb_msgs/GetTime): which each detector offers
    Published topics:
        /diagnostics (diagnostic_msgs/DiagnosticArray): one status per detector
    Parameters:
        config/clock_check.yaml
        ~* ClockCheckParams
    """

    def __init__(self, params: ClockCheckParams) -> None:
        names = params.nodes.split()
        if not names:
            raise ParameterError(rospy.resolve_name("~nodes"), "the names of the detectors must be set")
        self._params = params
        self._lock = threading.Lock()
        self._offsets: Dict[str, Optional[ClockOffset]] = {name: None for name in names}
        self._measured: Dict[str, float] = {}  # [s] monotonic, when each was compared last
        self._wrong: Dict[str, bool] = {}  # what each clock's last log line said
        self._closed = threading.Event()
        self._updater = diagnostic_updater.Updater()
        self._updater.setHardwareID("clocks")
        for name in names:
            self._updater.add(f"clock of {name}", lambda status, name=name: self._diagnose(status, name))
        # a computer that hangs keeps only its own thread waiting
        self._threads = [threading.Thread(target=self._watch, args=(name,), daemon=True) for name in names]
        for thread in self._threads:
            thread.start()
        self._timer = rospy.Timer(rospy.Duration(1.0), lambda _event: self._updater.update(), reset=True)

    def close(self) -> None:
        """Stops measuring."""
        self._closed.set()

    def _watch(self, name: str) -> None:
        # the clocks' own time: simulated time says nothing about them
        while not rospy.is_shutdown():
            try:
                offset: Optional[ClockOffset] = self._measure(name)
                self._judge(name, offset)
            except (rospy.ROSException, rospy.ServiceException, CodedError):
                offset = None  # a detector restarts or is down: the diagnostics show it
            with self._lock:
                self._offsets[name], self._measured[name] = offset, time.monotonic()
            if self._closed.wait(
                self._params.measurement_period if offset is not None else min(2.0, self._params.measurement_period)
            ):
                return

    def _measure(self, name: str) -> ClockOffset:
        service = f"{rospy.resolve_name(name)}/get_time"
        rospy.wait_for_service(service, timeout=2.0)
        # one connection for all samples: connecting takes longer than asking
        proxy = rospy.ServiceProxy(service, GetTime, persistent=True)
        try:
            proxy()
            samples: List[Exchange] = []
            for _ in range(self._params.samples):
                sent = time.time()
                answer: Any = proxy()
                samples.append((sent, answer.received.to_sec(), answer.sent.to_sec(), time.time()))
            return estimate_clock_offset(samples)
        finally:
            proxy.close()

    def _judge(self, name: str, offset: ClockOffset) -> None:
        limit = self._params.max_offset_ms / 1e3
        wrong = offset.exceeds(limit)
        if not wrong and offset.uncertainty > limit:
            return  # on a busy network an exchange may say nothing: neither that it is right nor that it became so
        before, self._wrong[name] = self._wrong.get(name), wrong
        if wrong and not before:
            rospy.logwarn("%s: %s", rospy.get_name(), CodedError("clocks_differ", _sentence(name, offset)))
        elif not wrong and before is not False:
            rospy.loginfo("%s: %s", rospy.get_name(), _sentence(name, offset))

    def _diagnose(self, status: Any, name: str) -> Any:
        with self._lock:
            offset = self._offsets[name]
            age = time.monotonic() - self._measured.get(name, -math.inf)
        if age > 2.0 * self._params.measurement_period + _TIMEOUT:
            # a request to a computer whose cable was pulled waits for ever, and its last answer says nothing any more
            offset = None
        limit = self._params.max_offset_ms / 1e3
        if offset is None:
            status.summary(DiagnosticStatus.WARN, f"{name} does not answer")
            return status
        if offset.exceeds(limit):
            status.summary(DiagnosticStatus.WARN, _sentence(name, offset))
        elif offset.uncertainty > limit:
            status.summary(DiagnosticStatus.WARN, f"the way to {name} takes too long to compare clocks")
        else:
            status.summary(DiagnosticStatus.OK, _sentence(name, offset))
        status.add("offset [ms]", f"{1e3 * offset.offset:.2f}")
        status.add("uncertainty [ms]", f"{1e3 * offset.uncertainty:.2f}")
        return status


def _sentence(name: str, offset: ClockOffset) -> str:
    where = "ahead of" if offset.offset >= 0 else "behind"
    return (
        f"the clock of {name} is {1e3 * abs(offset.offset):.1f} ms {where} this computer's, "
        f"to within {1e3 * offset.uncertainty:.2f} ms"
    )


def build() -> ClockCheckNode:
    """Reads the parameters and makes the node."""
    return ClockCheckNode(parameters.read(ClockCheckParams))
