"""Publishes a spot detector's status, and notices of faults in its input."""

from __future__ import annotations

import threading
import time
from typing import Dict, List, NamedTuple, Optional, Sequence, Tuple

import rospy

from vb_core import names
from vb_core.errors import CodedError
from vb_core.image_format import AnyPicture
from vb_core.notices import Notice, Severity
from vb_core.ros.node import Mailbox, WakeTimer, Worker
from vb_core.ros.notices import NoticePublisher
from vb_laser_detect.detection.detector_counts import DetectorCounts, InputWatch
from vb_laser_detect.camera.exposure import TOO_BRIGHT, saturated_share
from vb_msgs.msg import DetectorStatus

_FAULT_LIFETIME = 5.0  # [s] for which a fault is reported after it last occurred
_DETECTOR_TIMEOUT = 5.0  # [s] a detector that is silent for this long is gone


class _Fault(NamedTuple):
    notice: Notice
    last_occurred: rospy.Time
    concerns_image_quality: bool


class DetectorDiagnostics:
    """Counts what a detector does, and reports its camera's faults, which nothing else watches for.

    Published topics:
        /virtual_borders/detectors (vb_msgs/DetectorStatus), once a second
        /virtual_borders/notices (vb_msgs/NoticeArray): what keeps spots from being found or located

    Args:
        namespace: namespace of the camera's parameters and debug image.
        mailbox: mailbox through which the detector receives images, which counts them.
        mobile: whether the camera is on a robot.
        own_source: whether the detector reads the camera directly, so that stamps come from this computer's clock.
    """

    def __init__(
        self, namespace: str, camera: str, mailbox: Mailbox, mobile: bool = False, own_source: bool = False
    ) -> None:
        self._namespace = namespace
        self._camera = camera
        self._mailbox = mailbox
        self._mobile = mobile
        self._own_source = own_source
        self._frame_id = ""
        self._focal = 0.0
        self._others: Dict[str, Tuple[str, float]] = {}  # frame of each other stationary camera, and when it arrived
        self._color = True  # whether the images show colours
        self._saturated_share = 0.0
        self._measured_at = float("-inf")  # [s] when that was; it is measured once a second
        self._lock = threading.Lock()
        self._counts = DetectorCounts()
        self._watch = InputWatch(rospy.get_time())
        self._faults: Dict[str, _Fault] = {}  # by code
        self._source_fault: Optional[Notice] = None  # an ERROR if it keeps images from coming
        self._publisher = rospy.Publisher(names.DETECTORS, DetectorStatus, queue_size=5)
        self._notices = NoticePublisher(namespace)
        self._timer = WakeTimer(1.0)
        Worker(self._timer, lambda _: self._publish())

    def close(self) -> None:
        """Stops publishing, and withdraws the notices."""
        self._timer.close()
        self._notices.close()

    # ------------------------------------------------------------- what the node reports
    def count_dropped(self, code: str) -> None:
        """Counts something that was left out, by the code of the reason, without a notice."""
        with self._lock:
            self._counts.count_rejections(code)

    def report_fault(self, error: CodedError, severe: bool = False) -> None:
        """Counts a fault of the input, or if `severe` of the program, and reports it for some seconds."""
        with self._lock:
            self._counts.count_rejections(error.code)
            self._faults[error.code] = _Fault(self._notice(error, severe), rospy.Time.now(), False)

    def set_source_fault(self, error: Optional[CodedError], is_silent: bool) -> None:
        """Reports, until the next call, what is wrong with a camera read directly, and whether it is silent because of it."""
        with self._lock:
            self._source_fault = None
            if error is not None:
                self._counts.count_rejections(error.code)
                self._source_fault = self._notice(error, is_silent)
        self._publish_notices()

    def clear_refused_setting(self) -> None:
        """Withdraws the notice that the camera refused its settings. A notice that it sends no images stays."""
        with self._lock:
            self._source_fault = self._source_fault if self._is_silent else None
        self._publish_notices()

    def record_image(
        self,
        stamp: rospy.Time,
        frame_id: str,
        picture: AnyPicture,
        focal: float,
        missing: Optional[CodedError],
        search_s: float,
        spots: int = 0,
        rejected: Sequence[str] = (),
    ) -> None:
        """Records an image in which spots were searched for.

        Args:
            focal: [px] focal length of the lens with which its spots are located; 0 if it is not known.
            missing: why none of its spots can be published; None: all inputs are available.
            search_s: [s] duration of the search itself.
            spots: number of spots published after it, including those of earlier images.
            rejected: codes that say why candidates, or the image, were rejected.
        """
        now = rospy.get_time()
        self._frame_id = frame_id
        self._focal = focal
        self._color = picture.color_format != "mono"
        if abs(now - self._measured_at) > 1.0:
            self._saturated_share = saturated_share(picture.search_pixels)
            self._measured_at = now
        with self._lock:
            self._watch.record_image(now, missing)
            self._counts.count_rejections(*rejected)
            if missing is not None:
                self._counts.count_rejections(missing.code)
            self._counts.count_image(now, stamp.to_sec(), search_s, spots)

    def record_detector(self, message: DetectorStatus) -> None:
        """Records the frame of another stationary camera, or reports another node that uses this camera's name."""
        if message.camera == self._camera:
            sender = (getattr(message, "_connection_header", None) or {}).get("callerid", "")
            if sender and sender != rospy.get_name():
                nodes = ", ".join(sorted((sender, rospy.get_name())))
                self.report_fault(CodedError("camera_name_twice", camera=self._camera, nodes=nodes))
        elif not message.mobile and message.frame_id:
            with self._lock:
                self._others[message.camera] = (message.frame_id, time.monotonic())

    def frames_of_others(self) -> Dict[str, str]:
        """Returns the frame of each other stationary camera that has a detector."""
        oldest = time.monotonic() - _DETECTOR_TIMEOUT
        with self._lock:
            return {name: frame for name, (frame, arrival) in self._others.items() if arrival > oldest}

    # ------------------------------------------------------------- what is published
    def _notice(self, error: CodedError, severe: bool) -> Notice:
        return Notice.from_error(error, Severity.ERROR if severe else Severity.WARNING, self._camera)

    @property
    def _is_silent(self) -> bool:
        """Whether a camera that the detector reads directly sends no images; the notice says why."""
        return self._source_fault is not None and self._source_fault.severity is Severity.ERROR

    def _publish_notices(self) -> None:
        """Publishes the current faults. Image-quality faults are omitted while the camera is silent or has no pose."""
        now = rospy.Time.now()
        with self._lock:
            missing = None if self._is_silent else self._watch.current_fault(now.to_sec())
            if missing is not None and self._mobile and missing.code == "camera_no_pose":
                missing = CodedError("camera_robot_lost", **missing.values)
            usable = missing is None and not self._is_silent
            quality_faults = self._quality_faults() if usable else []
            for error in quality_faults:
                self._faults[error.code] = _Fault(self._notice(error, error.code == "camera_clock"), now, True)
            notices = [] if missing is None else [self._notice(missing, True)]
            for fault in self._faults.values():
                is_recent = abs((now - fault.last_occurred).to_sec()) < _FAULT_LIFETIME
                if is_recent and (usable or not fault.concerns_image_quality):
                    notices.append(fault.notice)
            if self._source_fault is not None:
                notices.append(self._source_fault)
        self._notices.set(notices)

    def _quality_faults(self) -> List[CodedError]:
        """Returns the faults of usable images. A value that hovers around its limit is reported continuously."""
        faults = self._counts.find_image_faults(not self._own_source)
        if self._saturated_share > TOO_BRIGHT:
            faults.append(CodedError("camera_too_bright", percent=f"{100 * self._saturated_share:.0f}"))
        if self._mobile and not self._color:
            faults.append(CodedError("no_color", camera=self._camera))
        return faults

    def _publish(self) -> None:
        """Publishes the notices and the status."""
        self._publish_notices()
        now = rospy.Time.now()
        with self._lock:
            counts = self._counts.summary(now.to_sec())
        self._publisher.publish(
            header=rospy.Header(stamp=now),
            camera=self._camera,
            detector=self._namespace,
            mobile=self._mobile,
            frame_id=self._frame_id,
            focal_px=self._focal,
            received=self._mailbox.received,
            dropped=self._mailbox.dropped,
            **counts,
        )
