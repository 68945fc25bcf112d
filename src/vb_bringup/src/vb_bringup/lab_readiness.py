"""Checks whether a lab is ready, as far as its nodes cannot check it themselves. No ROS.

A node that detects a fault reports it in a notice as long as it lasts: a detector reports that its camera is silent,
camera_poses that a calibration does not fit, robot_monitor that a robot drives through borders. check_lab repeats these
notices. This module finds the faults that only an observer sees: a node that does not run, topics that do not match, a
map that was read wrongly.
"""

from __future__ import annotations

from typing import Any, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from vb_core import sentences
from vb_core.node_graph import NodeGraph
from vb_core.notices import Notice, Severity
from vb_laser_detect.spot_detector_node_params import image_topic

MIN_DISK_MB = 500  # [MB] for a day of logs and recordings
MIN_SCAN_DEG = 60.0  # [deg]; a robot that drives by its scan should see at least the floor ahead
_IMAGE = "sensor_msgs/Image"
# share of unknown cells; a few shades of grey may be read as unknown even where the unknown area was read as free
_HARDLY_ANY = 0.01


def check_camera(graph: NodeGraph, name: str, parameters: Mapping[str, Any], has_delay: bool, rate: float) -> Notice:
    """Checks how a camera's images reach its detector. The detector itself reports whether they are usable.

    Args:
        parameters: the detector's parameters; empty if the camera is on a robot.
        has_delay: whether the source's delay was measured, even if it is 0.
        rate: [1/s] images that the detector searches per second.
    """
    source = str(parameters.get("source", ""))
    delay = parameters.get("capture", {}).get("delay_ms", 0.0)
    topic = ""
    if parameters and not source:
        topic = "/" + image_topic(name, parameters.get("image", "")).lstrip("/")
        if parameters.get("image_transport") == "compressed":
            topic += "/compressed"
    publishers = graph.publishers.get(topic, [])
    namespace = f"/{topic.strip('/').split('/')[0]}/"
    published = sorted(other for other, nodes in graph.publishers.items() if nodes)
    other_topics = [other for other in published if graph.types.get(other) == _IMAGE and other.startswith(namespace)]

    def line(severity: Severity, code: str, **values: str) -> Notice:
        return Notice(code, severity, camera=name, values={"camera": name, "topic": topic, **values})

    if topic and not publishers and other_topics:
        values = {"others": ", ".join(other_topics), "image": other_topics[0].strip("/")}
        return line(Severity.ERROR, "lab_camera_other_topic", **values)
    if topic and not publishers:
        return line(Severity.ERROR, "lab_camera_no_publisher")
    if len(publishers) > 1:
        return line(Severity.ERROR, "lab_camera_many_publishers", nodes=", ".join(publishers))
    if "://" in source and not (delay or has_delay):
        return line(Severity.WARNING, "lab_camera_no_delay")
    code = "lab_camera_ok_delay" if source else "lab_camera_ok"
    return line(Severity.INFO, code, rate=f"{rate:.1f}", delay=f"{delay:g}")


def check_robot(
    name: str, lacks_margin: bool, scan_topic: str, scan_deg: Optional[float], clears_plans: bool
) -> List[Notice]:
    """Checks the scanner of a lab's own robot, and the costmaps and parameters of its navigation.

    Args:
        name: "" for the only robot.
        lacks_margin: whether it plans round borders, but not on its driver's map with a margin (keep_out).
        scan_deg: [deg] angle that its scan covers; 0 if no scan arrived, None if nothing needs its scan.
        clears_plans: whether make_plan first clears the costmap around the robot, and the borders there.
    """

    def line(severity: Severity, code: str, **values: str) -> Notice:
        return Notice(code, severity, robot=name, values={**sentences.robot_values(name, key="robot"), **values})

    faults = []
    if lacks_margin:
        faults.append(line(Severity.WARNING, "lab_robot_without_margin"))
    if scan_deg == 0.0:
        faults.append(line(Severity.WARNING, "lab_robot_no_scan", topic=scan_topic))
    elif scan_deg is not None and scan_deg < MIN_SCAN_DEG:
        faults.append(line(Severity.WARNING, "lab_robot_narrow_scan", degrees=f"{scan_deg:.0f}"))
    if clears_plans:
        faults.append(line(Severity.ERROR, "lab_robot_clears_plans"))
    return faults


def check_map(
    size: Optional[Tuple[float, float]], publishers: Sequence[str], with_borders: bool, file: str, lacks_unknown: bool
) -> List[Notice]:
    """Checks whether there is exactly one physical map, and a map with the borders.

    Args:
        size: (width, height) [m] of /map; None if no map arrived.
        publishers: nodes that publish /map.
        with_borders: whether /virtual_borders/map arrived.
        file: the map file in the lab's launch arguments, or "".
        lacks_unknown: see `is_fully_known`.
    """
    if size is None:
        return [Notice("lab_map_not_served" if file else "lab_map_missing", Severity.ERROR, values={"file": file})]
    lines = []
    if len(publishers) > 1:
        lines.append(Notice("lab_map_many_publishers", Severity.ERROR, values={"nodes": ", ".join(publishers)}))
    if not with_borders:
        lines.append(Notice("lab_map_without_borders", Severity.ERROR))
    if lacks_unknown:
        lines.append(Notice("lab_map_all_known", Severity.WARNING))
    values = {"width": f"{size[0]:.1f}", "height": f"{size[1]:.1f}"}
    return lines or [Notice("lab_map_ok", Severity.INFO, values=values)]


def is_fully_known(cells: np.ndarray) -> bool:
    """Returns whether a map (H, W) int8 has hardly any unknown cells although free floor reaches its edge.

    No robot records such a map: its unknown cells, pixels of 205, were read as free, as a free_thresh of 0.25 does.
    """
    edges = np.concatenate([cells[0], cells[-1], cells[:, 0], cells[:, -1]])
    reaches_edge = bool((edges == 0).any())
    unknown_share = float((cells < 0).mean())
    return reaches_edge and unknown_share < _HARDLY_ANY


def check_nodes(missing: Sequence[str]) -> List[Notice]:
    """Checks whether the lab's nodes are running. `missing` lists those that are not."""
    if not missing:
        return [Notice("lab_node_ok", Severity.INFO)]
    return [Notice("lab_node_missing", Severity.ERROR, values={"node": node}) for node in missing]


def check_disk(folder: str, free_mb: float, writable: bool = True) -> Notice:
    """Checks whether the folder of borders and records has enough space and can be written to."""
    code = "lab_disk_full" if free_mb < MIN_DISK_MB else "lab_disk_ok"
    if not writable:
        code = "lab_disk_read_only"
    severity = Severity.INFO if code == "lab_disk_ok" else Severity.ERROR
    return Notice(code, severity, values={"folder": folder, "free": f"{free_mb:.0f}"})
