"""Judges whether a lab is ready: what its nodes report, and what no node can know. No ROS.

The idea: each fault belongs to one node, which reports it in a notice as long as it lasts: a detector reports that its
camera is silent, camera_poses that a calibration does not fit, robot_monitor that a robot drives through borders.
`lines_from_notices` makes a line of each. This module checks what shows only from outside: a node that does not run,
topics that do not meet, a map that was read wrongly.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Iterable, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from vb_core import sentences
from vb_core.notices import Notice, Severity

MIN_DISK_MB = 500  # room for a day of logs and recordings
MIN_SCAN_DEG = 60.0  # a robot that drives by its scan should see at least what is ahead
_HARDLY_ANY = 0.01  # share of unknown cells; shades between may be left where all else was read as free


@dataclass(frozen=True)
class CheckLine:
    """The result of one check, or a notice of one of the lab's nodes; a `state` of INFO: nothing is wrong."""

    subject: str
    state: Severity
    code: str
    values: Mapping[str, Any] = field(default_factory=dict)
    message: str = ""

    def sentence(self, language: str = sentences.ENGLISH) -> str:
        """Returns the sentence that people read."""
        return sentences.translate(self.code, self.values, language, self.message)


def lines_from_notices(notices: Iterable[Notice], others: Iterable[CheckLine] = ()) -> List[CheckLine]:
    """Makes a line of each notice, unless one of the other lines has the same subject and code."""
    present = {(line.subject, line.code) for line in others}
    lines = []
    for notice in notices:
        subject = "lab"
        if notice.camera:
            subject = f"camera {notice.camera}"
        elif notice.robot or notice.code.startswith("robot_"):
            subject = f"robot {notice.robot}".strip()
        elif notice.border_id or notice.code.startswith("borders_"):
            subject = "borders"
        if (subject, notice.code) not in present:
            lines.append(CheckLine(subject, Severity(notice.severity), notice.code, notice.values, notice.message))
    return lines


def check_camera(
    name: str,
    topic: str = "",
    publishers: Sequence[str] = (),
    others: Sequence[str] = (),
    rate: float = 0.0,
    no_delay: bool = False,
) -> CheckLine:
    """Checks how a camera's images reach its detector; the detector itself reports whether they can be used.

    Args:
        topic: the topic of its images; "" if the detector reads the camera itself.
        publishers: nodes that publish it.
        others: topics of images that its driver publishes instead.
        rate: [1/s] searched images per second.
        no_delay: whether it is a network camera whose delay nobody has measured.
    """

    def line(state: Severity, code: str, **values: Any) -> CheckLine:
        return CheckLine(f"camera {name}", state, code, {"camera": name, "topic": topic, **values})

    if topic and not publishers and others:
        shown = {"others": ", ".join(others), "image": others[0].strip("/")}
        return line(Severity.ERROR, "lab_camera_other_topic", **shown)
    if topic and not publishers:
        return line(Severity.ERROR, "lab_camera_no_publisher")
    if len(publishers) > 1:
        return line(Severity.ERROR, "lab_camera_many_publishers", nodes=", ".join(publishers))
    if no_delay:
        return line(Severity.WARNING, "lab_camera_no_delay")
    return line(Severity.INFO, "lab_camera_ok", rate=f"{rate:.1f}")


def check_robot(
    name: str, keeps_margin: bool, scan_topic: str, scan_deg: Optional[float], clears_plans: bool
) -> List[CheckLine]:
    """Checks the scanner of a lab's own robot, and the costmaps and parameters of its navigation.

    Args:
        name: "" for the only robot.
        keeps_margin: whether it plans on the driver's keep_out.
        scan_deg: [deg] what the scan of a robot with a driver covers; 0: no scan arrived, None: it has no driver.
        clears_plans: whether make_plan clears the costmap around the robot first, and borders with it.
    """
    faults = []
    if scan_deg is not None and not keeps_margin:
        faults.append((Severity.WARNING, "lab_robot_without_margin", {}))
    if scan_deg == 0.0:
        faults.append((Severity.WARNING, "lab_robot_no_scan", {"topic": scan_topic}))
    elif scan_deg is not None and scan_deg < MIN_SCAN_DEG:
        faults.append((Severity.WARNING, "lab_robot_narrow_scan", {"degrees": f"{scan_deg:.0f}"}))
    if clears_plans:
        faults.append((Severity.ERROR, "lab_robot_clears_plans", {}))
    subject, who = f"robot {name}".strip(), {"robot": sentences.robot_value(name)}
    return [CheckLine(subject, state, code, {**who, **values}) for state, code, values in faults]


def check_map(
    size: Optional[Tuple[float, float]], publishers: Sequence[str], with_borders: bool, file: str, all_known: bool
) -> List[CheckLine]:
    """Checks whether there is one physical map, and one with the borders.

    Args:
        size: (width, height) [m] of /map; None: no map arrived.
        publishers: nodes that publish /map.
        with_borders: whether there is /virtual_borders/map.
        file: the map file that the lab was given, or "".
        all_known: see `is_all_known`.
    """
    if size is None:
        return [CheckLine("map", Severity.ERROR, "lab_map_not_served" if file else "lab_map_missing", {"file": file})]
    lines = []
    if len(publishers) > 1:
        lines.append(CheckLine("map", Severity.ERROR, "lab_map_many_publishers", {"nodes": ", ".join(publishers)}))
    if not with_borders:
        lines.append(CheckLine("map", Severity.ERROR, "lab_map_without_borders"))
    if all_known:
        lines.append(CheckLine("map", Severity.WARNING, "lab_map_all_known"))
    values = {"width": f"{size[0]:.1f}", "height": f"{size[1]:.1f}"}
    return lines or [CheckLine("map", Severity.INFO, "lab_map_ok", values)]


def is_all_known(cells: np.ndarray) -> bool:
    """Returns whether a map (H, W) int8 has hardly any unknown cell although free floor reaches its edge.

    No robot records such a map: its unknown cells were read as free, as pixels of 205 are with a free_thresh of 0.25.
    """
    edges = np.concatenate([cells[0], cells[-1], cells[:, 0], cells[:, -1]])
    return bool((edges == 0).any()) and float((cells < 0).mean()) < _HARDLY_ANY


def check_nodes(missing: Sequence[str]) -> List[CheckLine]:
    """Checks whether the nodes that belong to the lab are running; `missing` names those that are not."""
    if not missing:
        return [CheckLine("nodes", Severity.INFO, "lab_node_ok")]
    return [CheckLine("nodes", Severity.ERROR, "lab_node_missing", {"node": node}) for node in missing]


def check_disk(folder: str, free_mb: float, writable: bool = True) -> CheckLine:
    """Checks whether the folder of borders and records has room, and can be written."""
    code = "lab_disk_ok" if free_mb >= MIN_DISK_MB else "lab_disk_full"
    code = code if writable else "lab_disk_read_only"
    state = Severity.INFO if code == "lab_disk_ok" else Severity.ERROR
    return CheckLine("disk", state, code, {"folder": folder, "free": f"{free_mb:.0f}"})
