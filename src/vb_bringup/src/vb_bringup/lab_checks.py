"""Judges whether a lab is ready: what its nodes tell, and what no node can know. No ROS.

The idea: each fault has one owner, the node that has it, and that tells it as a notice for as long as it lasts: a
detector that its camera is silent, camera_poses that a calibration does not fit, robot_monitor that a robot drives
through borders. `lines_from_notices` makes a line of each. Left for this module is what shows from outside only: a node
that does not run, topics that do not meet, a map that was read wrongly.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import Any, Iterable, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from vb_core import sentences
from vb_core.notices import Notice

MIN_DISK_MB = 500  # room for a day of logs and recordings
MIN_SCAN_DEG = 60.0  # a robot that drives by its scan should see at least what is ahead
_HARDLY_ANY = 0.01  # share of unknown cells; shades between may be left where all else was read as free


class CheckState(enum.IntEnum):
    """Severity of a line; the worst of all lines decides the exit status."""

    OK = 0
    WARNING = 1
    ERROR = 2


@dataclass(frozen=True)
class CheckLine:
    """The result of one check, or what a node of the lab tells people."""

    subject: str
    state: CheckState
    code: str
    values: Mapping[str, Any] = field(default_factory=dict)
    message: str = ""

    def sentence(self, language: str = sentences.ENGLISH) -> str:
        """Returns the sentence that people read."""
        return sentences.translate(self.code, self.values, language, self.message)


def lines_from_notices(notices: Iterable[Notice], others: Iterable[CheckLine] = ()) -> List[CheckLine]:
    """Makes lines of what the lab's nodes tell people; what another line says already is left out."""
    known = {(line.subject, line.code) for line in others}
    lines = []
    for notice in notices:
        subject = "lab"
        if notice.camera:
            subject = f"camera {notice.camera}"
        elif notice.robot or notice.code.startswith("robot_"):
            subject = f"robot {notice.robot}".strip()
        elif notice.border_id or notice.code.startswith("borders_"):
            subject = "borders"
        if (subject, notice.code) not in known:
            lines.append(CheckLine(subject, CheckState(notice.severity), notice.code, notice.values, notice.message))
    return lines


@dataclass(frozen=True)
class CameraWiring:
    """How a camera's images come to its detector.

    Attributes:
        topic: of its images; "" if the detector reads the camera itself.
        publishers: nodes that publish it; others: topics of images beside it that its driver does publish.
        rate: [1/s] of images that are searched.
        no_delay: it is a network camera whose delay nobody has measured.
    """

    name: str
    topic: str = ""
    publishers: Sequence[str] = ()
    others: Sequence[str] = ()
    rate: float = 0.0
    no_delay: bool = False


def check_camera(camera: CameraWiring) -> CheckLine:
    """Checks how the images come; whether they can be used its detector tells."""

    def line(state: CheckState, code: str, **values: Any) -> CheckLine:
        return CheckLine(f"camera {camera.name}", state, code, {"camera": camera.name, "topic": camera.topic, **values})

    if camera.topic and not camera.publishers and camera.others:
        others = {"others": ", ".join(camera.others), "image": camera.others[0].strip("/")}
        return line(CheckState.ERROR, "lab_camera_other_topic", **others)
    if camera.topic and not camera.publishers:
        return line(CheckState.ERROR, "lab_camera_no_publisher")
    if len(camera.publishers) > 1:
        return line(CheckState.ERROR, "lab_camera_many_publishers", nodes=", ".join(camera.publishers))
    if camera.no_delay:
        return line(CheckState.WARNING, "lab_camera_no_delay")
    return line(CheckState.OK, "lab_camera_ok", rate=f"{camera.rate:.1f}")


@dataclass(frozen=True)
class RobotWiring:
    """What a robot of somebody's own is set to; `name` is "" for the only one.

    Attributes:
        keeps_margin: whether it plans on the driver's keep_out.
        scan_topic, scan_deg: [deg] what the scan of a robot with a driver covers; 0: no scan arrived, None: it has no driver.
        clears_plans: whether make_plan clears the costmap around the robot first, and borders with it.
    """

    name: str
    keeps_margin: bool = True
    scan_topic: str = "scan"
    scan_deg: Optional[float] = None
    clears_plans: bool = False


def check_robot(robot: RobotWiring) -> List[CheckLine]:
    """Checks a robot's scanner, and its navigation's costmaps and parameters."""
    found = []
    if robot.scan_deg is not None and not robot.keeps_margin:
        found.append((CheckState.WARNING, "lab_robot_without_margin", {}))
    if robot.scan_deg == 0.0:
        found.append((CheckState.WARNING, "lab_robot_no_scan", {"topic": robot.scan_topic}))
    elif robot.scan_deg is not None and robot.scan_deg < MIN_SCAN_DEG:
        found.append((CheckState.WARNING, "lab_robot_narrow_scan", {"degrees": f"{robot.scan_deg:.0f}"}))
    if robot.clears_plans:
        found.append((CheckState.ERROR, "lab_robot_clears_plans", {}))
    subject, who = f"robot {robot.name}".strip(), {"robot": sentences.robot_value(robot.name)}
    return [CheckLine(subject, state, code, {**who, **values}) for state, code, values in found]


@dataclass(frozen=True)
class MapObservation:
    """What was observed of the map.

    Attributes:
        size: (width, height) [m] of /map; None: no map arrived.
        publishers: nodes that publish /map; with_borders: whether there is /virtual_borders/map.
        file: what the lab was given as its map; "" if nothing.
        all_known: see `is_all_known`.
    """

    size: Optional[Tuple[float, float]] = None
    publishers: Sequence[str] = ()
    with_borders: bool = False
    file: str = ""
    all_known: bool = False


def check_map(seen: MapObservation) -> List[CheckLine]:
    """Checks whether there is one physical map, and one with the borders."""
    if seen.size is None:
        code = "lab_map_not_served" if seen.file else "lab_map_missing"
        return [CheckLine("map", CheckState.ERROR, code, {"file": seen.file})]
    lines = []
    if len(seen.publishers) > 1:
        nodes = {"nodes": ", ".join(seen.publishers)}
        lines.append(CheckLine("map", CheckState.ERROR, "lab_map_many_publishers", nodes))
    if not seen.with_borders:
        lines.append(CheckLine("map", CheckState.ERROR, "lab_map_without_borders"))
    if seen.all_known:
        lines.append(CheckLine("map", CheckState.WARNING, "lab_map_all_known"))
    values = {"width": f"{seen.size[0]:.1f}", "height": f"{seen.size[1]:.1f}"}
    return lines or [CheckLine("map", CheckState.OK, "lab_map_ok", values)]


def is_all_known(cells: np.ndarray) -> bool:
    """Returns whether a map (H, W) int8 has hardly any unknown cell although free floor reaches its edge.

    No robot records such a map: what it has not seen was read as free, for instance a pixel of 205 with free_thresh 0.25.
    """
    edges = np.concatenate([cells[0], cells[-1], cells[:, 0], cells[:, -1]])
    return bool((edges == 0).any()) and float((cells < 0).mean()) < _HARDLY_ANY


def check_nodes(missing: Sequence[str]) -> List[CheckLine]:
    """Checks whether the nodes that belong to the lab are running; `missing` names those that are not."""
    if not missing:
        return [CheckLine("nodes", CheckState.OK, "lab_node_ok")]
    return [CheckLine("nodes", CheckState.ERROR, "lab_node_missing", {"node": node}) for node in missing]


def check_disk(folder: str, free_mb: float, writable: bool = True) -> CheckLine:
    """Checks whether the folder of borders and records has room, and can be written."""
    code = "lab_disk_ok" if free_mb >= MIN_DISK_MB else "lab_disk_full"
    code = code if writable else "lab_disk_read_only"
    state = CheckState.OK if code == "lab_disk_ok" else CheckState.ERROR
    return CheckLine("disk", state, code, {"folder": folder, "free": f"{free_mb:.0f}"})


def worst_state(lines: Iterable[CheckLine]) -> CheckState:
    """Returns the worst state of all lines."""
    return max((line.state for line in lines), default=CheckState.OK)
