"""Node: reports a camera that fails while people work; checks the lab whenever a node starts or stops; logs faults."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from typing import Any, Dict, FrozenSet, List, Optional, Set, Tuple

import rosgraph
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from tf2_msgs.msg import TFMessage

from vb_bringup.lab_checks import BORDERS, CheckLine, CheckState, drop_recovered, lines_from_notices, notices_from_lines
from vb_bringup.lab_monitor import START_TIMEOUT, CameraComparison, DetectorWatch
from vb_core import names
from vb_core.notices import Notice
from vb_core.parameters import Parameters, param
from vb_core.ros import node, parameters
from vb_core.ros.messages import values_from_mapping
from vb_core.ros.notices import NoticeListener, NoticePublisher
from vb_msgs.msg import DetectorStatus, LaserSpot

# all in seconds of wall time
COMPARISON_PERIOD = 5.0  # [s] between two comparisons of the cameras' spots
POLL_PERIOD = 1.0  # [s] between two looks at which nodes run
SETTLING_TIME = 6.0  # [s] without a node that comes or goes: before, a lab is starting or ending
CHECK_PERIOD = {CheckState.ERROR: 60.0, CheckState.OK: 600.0}  # [s] a check takes two seconds of processor time
LOG_PERIOD = 60.0  # [s] before what comes and goes is logged again
# what rospy appends to the names of tools, whose coming and going does not change the lab
_ANONYMOUS = re.compile(r"_\d+_\d{10,}$")
_LEVELS = {
    CheckState.OK: DiagnosticStatus.OK,
    CheckState.UNKNOWN: DiagnosticStatus.WARN,
    CheckState.WARNING: DiagnosticStatus.WARN,
    CheckState.ERROR: DiagnosticStatus.ERROR,
}
# in a separate process, which gives its memory back; below everything that people wait for
_CHECK = ["nice", "-n", "15", sys.executable, "-c", "from vb_bringup.check_lab import main; main()", "--json"]


@dataclass(frozen=True)
class LabMonitorParams(Parameters):
    """The node's parameters."""

    cameras: str = param("", doc="names of the cameras that should be there, separated by spaces")


class LabMonitorNode:
    """Monitors the detectors, repeats `check_lab`, and logs what is new in its result and in the nodes' notices.

    Subscribed topics:
        /virtual_borders/detectors (vb_msgs/DetectorStatus)
        /virtual_borders/spots (vb_msgs/LaserSpot): to compare the positions at which overlapping cameras see the laser
        /map, /virtual_borders/map (nav_msgs/OccupancyGrid): for `check_lab`
        /virtual_borders/borders (vb_msgs/VirtualBorderArray): for `check_lab`
        <camera>/image_raw (sensor_msgs/Image), <camera>/camera_info (sensor_msgs/CameraInfo): for `check_lab`
        [<robot>/]scan (sensor_msgs/LaserScan): for `check_lab`
        /tf, /tf_static (tf2_msgs/TFMessage): for `check_lab`; spots seen before a camera's pose changed are ignored
        /virtual_borders/notices (vb_msgs/NoticeArray): problems that any node reports to people are logged here
    Published topics:
        /virtual_borders/notices (vb_msgs/NoticeArray): camera_silent, camera_no_pose, camera_no_lens, detector_missing,
            cameras_disagree, and the errors of `check_lab` that no other node reports
        /diagnostics (diagnostic_msgs/DiagnosticArray): each line of `check_lab` but those about borders, and each
            warning and error among the notices
    Parameters:
        ~* LabMonitorParams
    """

    def __init__(self, params: LabMonitorParams) -> None:
        self._lock = threading.Lock()
        self._comparison, self._disagreeing, self._compared = CameraComparison(), [], 0.0
        self._frames: Dict[str, str] = {}  # of each camera
        self._sending: Set[str] = set()  # cameras that have sent images
        self._poses: Dict[str, Any] = {}  # by frame
        self._own_notices: List[Notice] = []
        self._lines: List[CheckLine] = []
        self._running: FrozenSet[str] = frozenset()  # nodes
        self._logged: Dict[Tuple[str, str], float] = {}  # subject and code of a notice, and when it held last
        self._closed = threading.Event()
        node.wait_for_clock()
        self._detectors = DetectorWatch(params.cameras.split(), rospy.get_time())
        self._notices = NoticePublisher()
        self._diagnostics = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=5)
        self._subscriber = rospy.Subscriber(names.DETECTORS, DetectorStatus, self._on_status, queue_size=50)
        rospy.Subscriber(names.SPOTS, LaserSpot, self._on_spot, queue_size=100)
        rospy.Subscriber("/tf_static", TFMessage, self._on_poses, queue_size=100)
        self._all_notices = NoticeListener()
        self._timer = rospy.Timer(rospy.Duration(1.0), self._on_timer, reset=True)
        self._checks = node.start_thread(self._check_repeatedly)

    def close(self) -> None:
        """Withdraws its notices."""
        self._closed.set()
        self._timer.shutdown()
        self._notices.close()

    def _on_status(self, message: DetectorStatus) -> None:
        with self._lock:
            self._frames[message.camera] = message.frame_id
            if message.received:
                self._sending.add(message.camera)
            self._detectors.update(message.camera, message.fault, rospy.get_time())

    def _on_spot(self, message: LaserSpot) -> None:
        if not message.mobile:
            with self._lock:
                place = message.position
                self._comparison.add_spot(message.camera, message.header.stamp.to_sec(), place.x, place.y)

    def _on_poses(self, message: TFMessage) -> None:
        with self._lock:
            for entry in message.transforms:
                before = self._poses.get(entry.child_frame_id)
                self._poses[entry.child_frame_id] = entry.transform
                if before is not None and before != entry.transform:
                    for camera in [name for name, frame in self._frames.items() if frame == entry.child_frame_id]:
                        self._comparison.clear(camera, rospy.get_time())
                        self._compared = float("-inf")

    def _on_timer(self, _event: Any) -> None:
        with self._lock:
            if time.monotonic() - self._compared > COMPARISON_PERIOD:
                self._disagreeing, self._compared = self._comparison.notices(rospy.get_time()), time.monotonic()
            self._own_notices = self._detectors.notices(rospy.get_time())
            lines = drop_recovered(self._lines, self._running, self._sending)
            notices = [*self._own_notices, *self._disagreeing, *notices_from_lines(lines)]
            others = lines_from_notices(self._all_notices.current(), lines)
            new = self._new_lines(others)
        self._notices.set(notices)
        for line in new:
            self._log(line)
        if lines or others:
            self._diagnostics.publish(_diagnostics([*lines, *others]))

    def _new_lines(self, others: List[CheckLine]) -> List[CheckLine]:
        """Returns the lines that did not hold a moment ago: what flickers is logged once."""
        now = time.monotonic()
        new = [line for line in others if now - self._logged.get((line.subject, line.code), float("-inf")) > LOG_PERIOD]
        self._logged.update({(line.subject, line.code): now for line in others})
        return new

    @staticmethod
    def _log(line: CheckLine) -> None:
        logs = {CheckState.ERROR: rospy.logerr, CheckState.WARNING: rospy.logwarn}
        logs.get(line.state, rospy.loginfo)("%s: %s", rospy.get_name(), line.sentence())

    # ------------------------------------------------------------ the whole lab
    def _check_repeatedly(self) -> None:
        """Checks once all nodes have started, whenever one came or went or a camera's notices changed, and now and then."""
        situation: Tuple[FrozenSet[str], List[Notice]] = (frozenset(), [])
        began = checked = time.monotonic()
        due = float("inf")
        while not self._closed.wait(POLL_PERIOD):
            before, situation = situation, self._situation()
            with self._lock:
                self._running = situation[0]
            if situation != before:
                # a node that dies again and again must not keep it from the others
                due = min(time.monotonic() + SETTLING_TIME, checked + CHECK_PERIOD[CheckState.ERROR])
                due = max(due, began + START_TIMEOUT)
            if situation[0] and time.monotonic() > due:
                lines = self._check()
                if self._situation() != situation and time.monotonic() < checked + CHECK_PERIOD[CheckState.ERROR]:
                    continue  # on a slow computer a check may end when what it found is over: look again
                checked = time.monotonic()
                if lines is not None:
                    due = checked + CHECK_PERIOD[CheckState.ERROR if notices_from_lines(lines) else CheckState.OK]
                    self._adopt(lines)

    def _situation(self) -> Tuple[FrozenSet[str], List[Notice]]:
        """Returns which nodes run, and the notices about the cameras."""
        with self._lock:
            notices = self._own_notices
        return _running_nodes(), notices

    def _check(self) -> Optional[List[CheckLine]]:
        """Runs `check_lab`; returns what it finds by itself and stays true until the next, or None if it was ended."""
        process = subprocess.Popen(_CHECK, stdout=subprocess.PIPE, universal_newlines=True)
        while True:
            try:
                text, _ = process.communicate(timeout=0.5)
                break
            except subprocess.TimeoutExpired:
                if self._closed.is_set():
                    process.terminate()
        try:
            found = json.loads(text)
        except ValueError:
            return None  # the ROS master has ended
        # borders change between two checks; of one that cannot be in force, map_integrator's notice tells at once
        return [
            CheckLine(line["subject"], CheckState[line["state"].upper()], line["code"], line["values"])
            for line in found
            if not line["from_notice"] and line["subject"] != BORDERS
        ]

    def _adopt(self, lines: List[CheckLine]) -> None:
        with self._lock:
            before, self._lines = self._lines, lines
        known = {(line.subject, line.code) for line in before}
        cured = {line.subject for line in before if line.state >= CheckState.WARNING}
        for line in lines:
            if (line.subject, line.code) not in known and (line.state >= CheckState.WARNING or line.subject in cured):
                self._log(line)


def _running_nodes() -> FrozenSet[str]:
    """Lists all nodes but tools; none if the ROS master does not answer."""
    try:
        state = rosgraph.Master(rospy.get_name()).getSystemState()
    except (rosgraph.MasterException, OSError):
        return frozenset()
    return frozenset(name for kind in state for _, nodes in kind for name in nodes if not _ANONYMOUS.search(name))


def _diagnostics(lines: List[CheckLine]) -> DiagnosticArray:
    array = DiagnosticArray()
    array.header.stamp = rospy.Time.now()
    array.status = [
        DiagnosticStatus(
            name=f"lab: {line.subject}",
            level=_LEVELS[line.state],
            message=line.sentence(),
            hardware_id="lab",
            values=values_from_mapping({"code": line.code, **line.values}),
        )
        for line in lines
    ]
    return array


def build() -> LabMonitorNode:
    """Reads the parameters and makes the node."""
    return LabMonitorNode(parameters.read(LabMonitorParams))
