"""A spot detector as seen from outside: status, diagnostics, warnings."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from typing import Any, Dict, Optional, Tuple

import diagnostic_updater
import rospy
from diagnostic_msgs.msg import DiagnosticStatus

from vb_core import names
from vb_core.errors import CodedError
from vb_core.ros.node import Mailbox
from vb_laser_detect.calibration.calibration_file import require_own_frame
from vb_laser_detect.detection.detector_counts import DetectorCounts, InputWatch
from vb_msgs.msg import DetectorStatus

_SILENCE_TIMEOUT = 2.0  # [s] without an image for this long, diagnostics call the camera silent
_FAULT_LIFETIME = 5.0  # [s] a fault of its input stays in the diagnostics for this long
# [s] of wall time. A fault is logged once, when its sentence changes, and as a reminder, each after twice the
# time of the one before: a person who calibrates cameras for half an hour knows that they have no pose. A missing
# input not before it has lasted: while nodes start inputs come late, and a camera whose frame is another's should
# not be told of its pose first
_CHANGE_PERIOD, _REMINDER_PERIOD, _MIN_DURATION = 10.0, 60.0, 3.0
_DETECTOR_TIMEOUT = 5.0  # [s] a detector that is silent for this long is gone


@dataclass
class _Fault:
    """One kind of fault: when it was last met, and what was logged of it. `at` is ROS time, the others [s] wall time."""

    at: rospy.Time = field(default_factory=rospy.Time)
    text: str = ""
    since: float = 0.0
    met: float = float("-inf")
    told: float = float("-inf")
    told_text: str = ""
    again_s: float = _REMINDER_PERIOD

    def meet(self, text: str, at: rospy.Time, now: float, lasts_s: float) -> bool:
        """Records that it is there, and returns whether that is to be logged."""
        if now - self.met > _FAULT_LIFETIME:
            self.since, self.again_s = now, _REMINDER_PERIOD
        self.at, self.text, self.met = at, text, now
        same = text == self.told_text
        due = now - self.since >= lasts_s and now - self.told >= (self.again_s if same else _CHANGE_PERIOD)
        if due:
            self.again_s = 2.0 * self.again_s if same else _REMINDER_PERIOD
            self.told, self.told_text = now, text
        return due


class DetectorDiagnostics:
    """Counts what a detector does, and says what is wrong with its input.

    Published topics:
        /virtual_borders/detectors (vb_msgs/DetectorStatus), once a second
        /diagnostics (diagnostic_msgs/DiagnosticArray), once a second

    Args:
        camera: its name.
        mailbox: of its images.
        mobile: whether it is on a robot.

    Attributes:
        color: whether the images show colours.
    """

    def __init__(self, camera: str, mailbox: Mailbox, mobile: bool = False) -> None:
        self._camera, self._mobile = camera, mobile
        self._frame_id = ""
        self._others: Dict[str, Tuple[str, float]] = {}  # frame of each other stationary camera, and when it arrived
        self._twice = float("-inf")  # when another detector said that it is this camera's
        self.color = True
        self._mailbox = mailbox
        self._counts = DetectorCounts()
        self._lock = threading.Lock()
        self._faults: Dict[str, _Fault] = {}
        self._missing_input, self._watch = "", InputWatch()
        self._started = rospy.Time.now()
        self._status = DetectorStatus()  # the last one that was published
        self._publisher = rospy.Publisher(names.DETECTORS, DetectorStatus, queue_size=5)
        self._updater = diagnostic_updater.Updater()
        self._updater.setHardwareID(camera)
        self._updater.add(f"spot detector of camera {camera}", self._diagnose)
        self._timer = rospy.Timer(rospy.Duration(1.0), self._publish, reset=True)

    # ------------------------------------------------------------- what the node tells
    def count(self, code: str) -> None:
        """Counts an ordinary rejection: a candidate that is not a spot."""
        self._counts.count_rejection(code)

    def fault(self, error: CodedError, severe: bool = False, missing: bool = False) -> None:
        """Counts a fault of the input, shows it in the diagnostics, and logs it now and then.

        Args:
            severe: a fault of the program.
            missing: of an input that may only be late.
        """
        self._counts.count_rejection(error.code)
        with self._lock:
            known = self._faults.setdefault(error.code, _Fault())
            due = known.meet(error.message, rospy.Time.now(), time.monotonic(), _MIN_DURATION if missing else 0.0)
        if due:
            (rospy.logerr if severe else rospy.logwarn)("%s: %s", rospy.get_name(), error)

    def set_missing_input(self, reason: Optional[CodedError]) -> None:
        """Records why no spot of an image can be published; None: all inputs are available."""
        with self._lock:
            self._missing_input = "" if reason is None else str(reason)
            self._watch.see_image(rospy.Time.now().to_sec(), "" if reason is None else reason.code)

    def record_detector(self, message: DetectorStatus) -> None:
        """Records another detector's status."""
        sender = (getattr(message, "_connection_header", None) or {}).get("callerid", "")
        if message.camera == self._camera and sender and sender != rospy.get_name():
            self._twice = time.monotonic()
            self.fault(CodedError("camera_name_twice", camera=self._camera))
        if message.camera != self._camera and not message.mobile and message.frame_id:
            with self._lock:
                self._others[message.camera] = (message.frame_id, time.monotonic())

    def require_own_frame(self, frame_id: str) -> None:
        """Checks that no other stationary camera has this frame: a frame has one pose.

        Raises:
            CodedError: "shared_frame"
        """
        with self._lock:
            frames = {
                name: frame for name, (frame, at) in self._others.items() if time.monotonic() - at < _DETECTOR_TIMEOUT
            }
        if not self._mobile:
            require_own_frame(self._camera, frame_id, frames)

    def count_image(self, stamp: rospy.Time, search_s: float, spots: int, backfilled: int, frame_id: str) -> None:
        """Counts a searched image, see `DetectorCounts`."""
        self._frame_id = frame_id
        self._counts.count_image(rospy.Time.now().to_sec(), stamp.to_sec(), search_s, spots, backfilled)

    # ------------------------------------------------------------- what goes out
    def _publish(self, _event: Any) -> None:
        now = rospy.Time.now()
        with self._lock:
            fault = self._watch.fault(now.to_sec())
        if time.monotonic() - self._twice < _DETECTOR_TIMEOUT:
            fault = "camera_name_twice"
        self._status = DetectorStatus(
            header=rospy.Header(stamp=now),
            camera=self._camera,
            mobile=self._mobile,
            frame_id=self._frame_id,
            received=self._mailbox.received,
            dropped=self._mailbox.dropped,
            fault=fault,
            **self._counts.summary(now.to_sec()),
        )
        self._publisher.publish(self._status)
        self._updater.force_update()

    def _diagnose(self, status: Any) -> Any:
        now, told = rospy.Time.now(), self._status
        with self._lock:
            missing = [self._missing_input] if self._missing_input else []
            faults = [
                (code, one.text) for code, one in self._faults.items() if abs((now - one.at).to_sec()) < _FAULT_LIFETIME
            ]
        recent = [f"{text} [{code}]" for code, text in faults]
        level, lines = DiagnosticStatus.OK, [f"{told.rate_hz:.1f} images per second"]
        if told.rate_hz == 0.0 and (now - self._started).to_sec() > _SILENCE_TIMEOUT:
            level, lines = DiagnosticStatus.ERROR, ["no images"] + missing + recent
        elif missing:
            level, lines = DiagnosticStatus.ERROR, missing + recent
        elif recent:
            level, lines = DiagnosticStatus.WARN, recent
        elif self._mobile and not self.color:
            level, lines = DiagnosticStatus.WARN, [str(CodedError("no_color", camera=self._camera))]
        status.summary(level, "; ".join(dict.fromkeys(lines)))
        # the other numbers are in the detector's own status
        status.add("latency, median [ms]", f"{told.latency_ms:.1f}")
        status.add("images dropped", str(told.dropped))
        status.add("colour", "yes" if self.color else "no")
        for code, count in zip(told.rejections, told.rejection_counts):
            status.add(f"refused: {code}", str(count))
        return status
