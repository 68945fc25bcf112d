"""Judges whether a lab is ready, from what was observed. No ROS.

Every check is one line: a subject, a state, and a code whose sentence (vb_core/languages) says what is wrong and how to
fix it. What the lab's nodes report anyway is not measured again: their notices are lines too (`from_notice`).
`lab_observation` observes the running lab; this module only judges.
"""

from __future__ import annotations

import enum
import math
from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any, Collection, Dict, Iterable, List, Mapping, Optional, Sequence, Tuple

from vb_core import sentences
from vb_core.notices import Notice, Severity
from vb_core.offer import Offer
from vb_laser_detect.detection.exposure import TOO_BRIGHT

# [Hz] a stroke at 0.5 m/s leaves one spot per 10 cm then; slower cameras work, but lines get coarse
SLOW_CAMERA_RATE = 5.0
# [s] clocks: a pointer moved at 0.5 m/s is 5 cm further on after 0.1 s
MAX_CLOCK_OFFSET = 0.1
# lenses of one model differ by more, two calibrations of one lens by less
MAX_FOCAL_CHANGE = 0.01
# room for a day of logs and recordings
MIN_DISK_MB = 500
# a robot that drives by its scan should see at least what is ahead
MIN_SCAN_DEG = 60.0
# [s] localisation speaks several times a second; AMCL dates its poses 0.3 s ahead
MAX_POSE_AGE = 1.0
# subject of all lines about borders, which people change at any time
BORDERS = "borders"


class CheckState(enum.IntEnum):
    """Severity of a line; the worst of all lines decides the exit status."""

    OK = 0
    UNKNOWN = 1
    WARNING = 2
    ERROR = 3


@dataclass(frozen=True)
class CheckLine:
    """The result of one check, or, if `from_notice`, what a node of the lab tells people."""

    subject: str
    state: CheckState
    code: str
    values: Mapping[str, Any] = field(default_factory=dict)
    from_notice: bool = False

    def sentence(self, language: str = sentences.ENGLISH) -> str:
        """Returns the sentence that people read."""
        return sentences.translate(self.code, self.values, language)


@dataclass(frozen=True)
class CameraInfoObservation:
    """A camera_info message; `focal` [px] is 0 for an uncalibrated lens, `rectified` belongs to rectified images."""

    width: int
    height: int
    focal: float
    rectified: float = 0.0


@dataclass(frozen=True)
class CameraObservation:
    """What was observed of one camera and its detector.

    Attributes:
        topic: of its images; publishers: nodes that publish it; others: topics of images that its driver does publish.
        rate: [1/s]; age: [s] from stamp to arrival, of the quickest image, beyond its camera's known delay; both 0 without
            images.
        no_delay: it is a network camera whose delay nobody has measured.
        frame: that the images name; bright: share of the image at its white level.
        detector: the detector's node; "" if none runs.
        has_pose: whether tf knows the frame in the map.
        file: the calibration file, "" if others publish the pose; file_missing: there is none; file_error: why it
            cannot be used; file_camera: the other camera that it is of;
        file_frame: the frame that it names; file_focal: [px] of the lens with which it was made, 0 if that is not
            known.
    """

    name: str
    topic: str
    publishers: Sequence[str] = ()
    others: Sequence[str] = ()
    rate: float = 0.0
    age: float = 0.0
    no_delay: bool = False
    width: int = 0
    height: int = 0
    encoding: str = ""
    frame: str = ""
    bright: float = 0.0
    info: Optional[CameraInfoObservation] = None
    detector: str = ""
    has_pose: bool = False
    file: str = ""
    file_missing: bool = False
    file_error: str = ""
    file_camera: str = ""
    file_frame: str = ""
    file_focal: float = 0.0


def check_cameras(cameras: Sequence[CameraObservation]) -> List[CheckLine]:
    """Checks the cameras: one line for each that is fine, one for each fault otherwise."""
    if not cameras:
        return [CheckLine("cameras", CheckState.WARNING, "lab_no_cameras")]
    by_frame: Dict[str, List[str]] = defaultdict(list)
    for camera in cameras:
        if camera.frame:
            by_frame[camera.frame].append(camera.name)
    lines: List[CheckLine] = []
    for camera in cameras:
        faults = list(_camera_faults(camera, by_frame))
        values = {
            "camera": camera.name,
            "rate": f"{camera.rate:.1f}",
            "size": f"{camera.width} x {camera.height}",
            "encoding": camera.encoding,
        }
        lines += faults or [CheckLine(f"camera {camera.name}", CheckState.OK, "lab_camera_ok", values)]
    return lines


def _camera_faults(camera: CameraObservation, by_frame: Mapping[str, Sequence[str]]) -> Iterable[CheckLine]:
    subject = f"camera {camera.name}"

    def fault(state: CheckState, code: str, **values: Any) -> CheckLine:
        return CheckLine(subject, state, code, {"camera": camera.name, "topic": camera.topic, **values})

    if not camera.detector:
        yield fault(CheckState.ERROR, "lab_camera_no_detector")
    if not camera.publishers:
        if camera.others:
            yield fault(
                CheckState.ERROR,
                "lab_camera_other_topic",
                others=", ".join(camera.others),
                image=camera.others[0].strip("/"),
            )
        else:
            yield fault(CheckState.ERROR, "lab_camera_no_publisher")
        return
    if camera.rate == 0.0:
        yield fault(CheckState.ERROR, "lab_camera_silent", node=", ".join(camera.publishers))
        return
    if len(camera.publishers) > 1:
        yield fault(CheckState.ERROR, "lab_camera_many_publishers", nodes=", ".join(camera.publishers))
    if camera.rate < SLOW_CAMERA_RATE:
        yield fault(CheckState.WARNING, "lab_camera_slow", rate=f"{camera.rate:.1f}")
    if abs(camera.age) > MAX_CLOCK_OFFSET + 2.0 / camera.rate:
        yield fault(CheckState.ERROR, "lab_camera_clock", age=f"{camera.age:.2f}")
    if camera.no_delay:
        yield fault(CheckState.WARNING, "lab_camera_no_delay")
    if camera.bright > TOO_BRIGHT:
        yield fault(CheckState.WARNING, "lab_camera_too_bright", percent=f"{100 * camera.bright:.0f}")
    yield from _lens_faults(camera, fault)
    yield from _pose_faults(camera, by_frame, fault)


def _lens_faults(camera: CameraObservation, fault: Any) -> Iterable[CheckLine]:
    info = camera.info
    if info is None:
        yield fault(CheckState.ERROR, "lab_camera_no_info")
    elif not info.focal > 0.0:
        yield fault(CheckState.ERROR, "lab_camera_not_calibrated")
    elif (info.width, info.height) != (camera.width, camera.height):
        yield fault(
            CheckState.ERROR,
            "lab_camera_info_size",
            size=f"{camera.width} x {camera.height}",
            info_size=f"{info.width} x {info.height}",
        )
    elif camera.file_focal > 0.0 and all(
        abs(focal / camera.file_focal - 1.0) > MAX_FOCAL_CHANGE for focal in (info.focal, info.rectified)
    ):
        yield fault(
            CheckState.ERROR,
            "lab_camera_other_lens",
            focal=f"{info.focal:.0f}",
            file_focal=f"{camera.file_focal:.0f}",
            file=camera.file,
        )


def _pose_faults(camera: CameraObservation, by_frame: Mapping[str, Sequence[str]], fault: Any) -> Iterable[CheckLine]:
    if not camera.frame:
        yield fault(CheckState.ERROR, "lab_camera_no_frame")
        return
    sharing = [name for name in by_frame[camera.frame] if name != camera.name]
    if sharing:
        # it will get another frame: then comes the pose
        own = camera.file_frame if camera.file_frame not in ("", camera.frame) else f"{camera.name}_optical_frame"
        yield fault(CheckState.ERROR, "lab_camera_frame_shared", frame=camera.frame, others=", ".join(sharing), own=own)
    elif camera.file_error and (camera.has_pose or not camera.file_missing):
        # the running lab still has the last good pose; calibrating again is not the first thing to do
        yield fault(
            CheckState.ERROR,
            "lab_camera_wrong_file" if camera.file_camera else "lab_camera_file_broken",
            file=camera.file,
            error=camera.file_error,
            other=camera.file_camera,
            pose="$lab_pose_kept" if camera.has_pose else "$lab_pose_missing",
        )
    elif camera.file_error:
        yield fault(CheckState.ERROR, "lab_camera_no_calibration", file=camera.file, error=camera.file_error)
    elif camera.file_frame and camera.file_frame != camera.frame:
        yield fault(
            CheckState.ERROR,
            "lab_camera_frame_differs",
            frame=camera.frame,
            file=camera.file,
            file_frame=camera.file_frame,
        )
    elif not camera.has_pose:
        yield fault(CheckState.ERROR, "lab_camera_no_pose", frame=camera.frame)


def check_robots(found: Offer) -> List[CheckLine]:
    """Makes lines of what is connected to each robot and follows from that."""
    states = {Severity.INFO: CheckState.OK, Severity.WARNING: CheckState.WARNING, Severity.ERROR: CheckState.ERROR}
    return [
        CheckLine(f"robot {line.robot}".strip(), states[line.severity], line.code, line.values, from_notice=True)
        for line in found.lines
    ]


@dataclass(frozen=True)
class RobotObservation:
    """What was observed of one robot; `name` is "" for the only one.

    Attributes:
        driven: whether it has a driver, which needs its scan.
        pose_age: [s] of its newest pose; None: there is none. keeps_margin: whether it plans on the driver's keep_out.
        scan_topic, scan_deg: [deg] what the scan covers; 0: no scan arrived.
        depth_frame, color_frame: frames of its depth and colour images; "": no image arrived.
        clears_plans: whether make_plan clears the costmap around the robot first, and borders with it.
    """

    name: str
    driven: bool = False
    pose_age: Optional[float] = None
    keeps_margin: bool = True
    scan_topic: str = "scan"
    scan_deg: float = 0.0
    color_frame: str = ""
    depth_frame: str = ""
    clears_plans: bool = False


def check_robot(robot: RobotObservation) -> List[CheckLine]:
    """Checks what no node knows of a robot: its scanner, its camera, and a parameter of its navigation."""
    subject = f"robot {robot.name}".strip()
    lines: List[CheckLine] = []

    def found(state: CheckState, code: str, **values: Any) -> None:
        lines.append(CheckLine(subject, state, code, {"robot": sentences.robot_value(robot.name), **values}))

    if robot.pose_age is not None and abs(robot.pose_age) > MAX_POSE_AGE:
        found(CheckState.ERROR, "lab_robot_old_pose", age=f"{robot.pose_age:.1f}")
    if robot.driven and not robot.keeps_margin:
        found(CheckState.WARNING, "lab_robot_without_margin")
    if robot.driven and robot.scan_deg == 0.0:
        found(CheckState.WARNING, "lab_robot_no_scan", topic=robot.scan_topic)
    elif robot.driven and robot.scan_deg < MIN_SCAN_DEG:
        found(CheckState.WARNING, "lab_robot_narrow_scan", degrees=f"{robot.scan_deg:.0f}")
    if robot.depth_frame and robot.color_frame and robot.depth_frame != robot.color_frame:
        found(CheckState.ERROR, "lab_robot_depth_not_registered", depth=robot.depth_frame, color=robot.color_frame)
    if robot.clears_plans:
        found(CheckState.ERROR, "lab_robot_clears_plans")
    return lines


@dataclass(frozen=True)
class MapObservation:
    """What was observed of the map.

    Attributes:
        shape: (rows, columns) of /map; None: no map arrived.
        publishers: nodes that publish /map; with_borders: whether /virtual_borders/map has the same geometry.
        file: what the lab was given as its map; "" if nothing.
        all_known: whether no cell of /map is unknown although free floor reaches its edge.
    """

    shape: Optional[Tuple[int, int]] = None
    resolution: float = 0.0
    publishers: Sequence[str] = ()
    with_borders: bool = False
    file: str = ""
    all_known: bool = False


def check_map(seen: MapObservation) -> List[CheckLine]:
    """Checks whether there is one physical map, and one with the borders."""
    if seen.shape is None:
        return [
            CheckLine(
                "map", CheckState.ERROR, "lab_map_not_served" if seen.file else "lab_map_missing", {"file": seen.file}
            )
        ]
    lines = []
    if len(seen.publishers) > 1:
        lines.append(
            CheckLine("map", CheckState.ERROR, "lab_map_many_publishers", {"nodes": ", ".join(seen.publishers)})
        )
    if not seen.with_borders:
        lines.append(CheckLine("map", CheckState.ERROR, "lab_map_without_borders"))
    if seen.all_known:
        lines.append(CheckLine("map", CheckState.WARNING, "lab_map_all_known"))
    rows, columns = seen.shape
    values = {"width": f"{columns * seen.resolution:.1f}", "height": f"{rows * seen.resolution:.1f}"}
    return lines or [CheckLine("map", CheckState.OK, "lab_map_ok", values)]


@dataclass(frozen=True)
class BorderObservation:
    """A border as people know it; `reason` is the code why it is not in force."""

    name: str
    in_force: bool
    reason: str = ""


# why a border is not in force where its owner wants it so; with any other reason it should be in force and cannot
_WISHED = {
    "disabled": "lab_borders_disabled",
    "off_schedule": "lab_borders_off_schedule",
    "other_robot": "lab_borders_other_robot",
}
# a line names no more borders than these
_NAMED_BORDERS = 3


def check_borders(borders: Sequence[BorderObservation], needs_confirmation: bool = False) -> List[CheckLine]:
    """Checks whether the borders that should be in force are; says why others are not, one line for each reason."""
    if needs_confirmation:
        return [CheckLine(BORDERS, CheckState.ERROR, "lab_borders_need_confirmation")]
    by_code: Dict[str, List[str]] = defaultdict(list)
    for border in borders:
        if not border.in_force:
            by_code[_WISHED.get(border.reason, "lab_borders_not_in_force")].append(border.name)
    in_force = sum(border.in_force for border in borders)
    lines = [CheckLine(BORDERS, CheckState.OK, "lab_borders_ok", {"in_force": in_force, "count": len(borders)})]
    for code, found in by_code.items():
        state = CheckState.OK if code in _WISHED.values() else CheckState.WARNING
        named = ", ".join(found[:_NAMED_BORDERS]) + (", ..." if len(found) > _NAMED_BORDERS else "")
        lines.append(CheckLine(BORDERS, state, code, {"borders": named}))
    return lines


def check_nodes(missing: Sequence[str]) -> List[CheckLine]:
    """Checks whether the nodes that every lab needs are running; `missing` names those that are not."""
    if not missing:
        return [CheckLine("nodes", CheckState.OK, "lab_node_ok")]
    return [CheckLine("nodes", CheckState.ERROR, "lab_node_missing", {"node": node}) for node in missing]


_NO_IMAGES = ("lab_camera_silent", "lab_camera_no_publisher", "lab_camera_other_topic")


def drop_recovered(lines: Sequence[CheckLine], running: Collection[str], sending: Collection[str]) -> List[CheckLine]:
    """Drops the lines of an earlier check that are over: the next check is seconds away.

    Args:
        running: nodes; sending: cameras that have sent images: if they do not any more, their detectors say so.
    """
    cured = {"lab_node_missing": ("node", running), **dict.fromkeys(_NO_IMAGES, ("camera", sending))}
    return [
        line for line in lines if line.code not in cured or line.values[cured[line.code][0]] not in cured[line.code][1]
    ]


def check_disk(folder: str, free_mb: float, writable: bool = True) -> CheckLine:
    """Checks whether the folder of borders and records has room, and can be written."""
    if not writable:
        code = "lab_disk_read_only"
    else:
        code = "lab_disk_full" if free_mb < MIN_DISK_MB else "lab_disk_ok"
    state = CheckState.OK if code == "lab_disk_ok" else CheckState.ERROR
    free = "unknown" if math.isnan(free_mb) else f"{free_mb:.0f}"
    return CheckLine("disk", state, code, {"folder": folder, "free": free})


# people are told of these at once, by the node that the fault is in: a check that comes later adds nothing
_REPORTED_BY_OTHERS = frozenset({"lab_camera_no_detector", "lab_borders_need_confirmation"})


def notices_from_lines(lines: Iterable[CheckLine]) -> List[Notice]:
    """Makes notices of the errors that no other node tells people."""
    return [
        Notice.from_values(line.code, Severity.ERROR, line.values)
        for line in lines
        if line.state is CheckState.ERROR and not line.from_notice and line.code not in _REPORTED_BY_OTHERS
    ]


# the same, seen by a node that knows less: an error that a check found with that camera, or with the borders, says
# what lies behind
_EXPLAINED = frozenset({"camera_silent", "detector_missing", "camera_no_pose", "camera_no_lens", "borders_unconfirmed"})


def lines_from_notices(notices: Iterable[Notice], checked: Iterable[CheckLine]) -> List[CheckLine]:
    """Makes lines of the warnings and errors that the lab's nodes tell people.

    What a check says more exactly is left out.

    Args:
        notices: the present notices of all nodes.
        checked: what the checks found.
    """
    checked = list(checked)
    faulty = {line.subject for line in checked if line.state is CheckState.ERROR}
    own = {(line.code, str(line.values.get("camera", ""))) for line in checked}
    lines = []
    for notice in notices:
        if notice.camera:
            subject = f"camera {notice.camera}"
        elif notice.robot:
            subject = f"robot {notice.robot}"
        else:
            subject = BORDERS if notice.border_id or notice.code in _EXPLAINED else "lab"
        known = (notice.code, notice.camera) in own or (notice.code in _EXPLAINED and subject in faulty)
        if notice.severity >= Severity.WARNING and not known:
            state = CheckState.ERROR if notice.severity is Severity.ERROR else CheckState.WARNING
            lines.append(CheckLine(subject, state, notice.code, notice.values, from_notice=True))
    return lines


def worst_state(lines: Iterable[CheckLine]) -> CheckState:
    """Returns the worst state of all lines."""
    return max((line.state for line in lines), default=CheckState.UNKNOWN)
