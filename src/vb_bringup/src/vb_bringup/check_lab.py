"""Checks a running lab before people use it. Each line of the output says what is wrong, and how to fix it."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import sys
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Set, Tuple
from urllib.parse import urlparse

import numpy as np
import rosgraph
import rospy
import rosservice
from rich.console import Console
from rich.table import Column, Table
from rosgraph.names import ns_join
from rosgraph.network import is_local_address
from sensor_msgs.msg import LaserScan
from vb_msgs.msg import DetectorStatus, RobotStatus, RobotStatusArray, VirtualBorderArray

from vb_bringup.lab_readiness import check_camera, check_disk, check_map, check_nodes, check_robot, is_fully_known
from vb_bringup.check_launch import UNIQUE_NODE, read_parameter_file
from vb_bringup.new_lab import parse_source
from vb_core import names, sentences
from vb_core.errors import CodedError
from vb_core.capabilities import derive_capabilities
from vb_core.node_graph import NodeGraph
from vb_core.notices import Notice, Severity
from vb_core.robot_profile import Scanner
from vb_core.ros import robot_profile
from vb_core.ros.master import read_graph
from vb_core.ros.messages import NumpyOccupancyGrid, grid_from_message
from vb_core.ros.node import wait_for_publishers
from vb_core.ros.notices import NoticeListener
from vb_core.ros.robot_status import connections_from_message
from vb_laser_detect.camera.camera_report import REPORTED, describe_camera, describe_camera_command
from vb_laser_detect.camera.v4l2_controls import CaptureParams

READY, FAULTS, NO_MASTER = 0, 1, 3
_STATES = {Severity.INFO: "ok", Severity.WARNING: "warning", Severity.ERROR: "error"}
_STYLES = {Severity.INFO: "green", Severity.WARNING: "yellow", Severity.ERROR: "bold red"}
# nodes that must run if the launch file has set their parameters; camera_poses itself reports missing detectors
_NODES = ("/border_fusion", "/interaction_manager", "/camera_poses", "/robot_monitor")
_CONNECTION_TIMEOUT = 5.0  # [s]; a publisher that is not reached by then is a fault


def observe_lab(seconds: float) -> List[Notice]:
    """Listens to the nodes for some seconds, inspects the rest of the lab, and returns a notice for each check."""
    graph = read_graph()
    newest, statuses, notices = _listen(seconds)
    # looks twice, because the master does not list a node while it restarts
    running = graph.nodes | read_graph().nodes
    lines = [
        *_check_nodes(running),
        *_check_cameras(graph, statuses, notices),
        *_check_map(graph, newest),
        *_check_borders(newest),
        *_check_robots(newest),
        *_check_display(running),
        _check_storage(),
    ]
    return lines + _find_further(notices, lines)


def _listen(seconds: float) -> Tuple[Dict[str, Any], Dict[str, DetectorStatus], List[Notice]]:
    """Returns the newest message of each topic, the newest status of each camera, and the notices in force."""
    newest: Dict[str, Any] = {}
    statuses: Dict[str, DetectorStatus] = {}
    robots = rospy.get_param("/robot_monitor/robots", []) or [""]
    scans = {_scan_topic(robot) for robot in robots} - {""}
    topics = {
        names.PHYSICAL_MAP: NumpyOccupancyGrid,
        names.MAP_WITH_BORDERS: NumpyOccupancyGrid,
        names.BORDERS: VirtualBorderArray,
        names.ROBOTS: RobotStatusArray,
        **dict.fromkeys(scans, LaserScan),
    }
    subscribers = [
        rospy.Subscriber(name, kind, lambda message, name=name: newest.update({name: message}), queue_size=1)
        for name, kind in topics.items()
    ]
    detectors = rospy.Subscriber(
        names.DETECTORS, DetectorStatus, lambda status: statuses.update({status.camera: status})
    )
    notices = NoticeListener()
    wait_for_publishers([notices.subscriber, detectors, *subscribers], _CONNECTION_TIMEOUT)
    rospy.rostime.wallsleep(seconds)
    return dict(newest), dict(statuses), notices.current()


def _check_nodes(running: Set[str]) -> List[Notice]:
    needed = [UNIQUE_NODE, *filter(rospy.has_param, _NODES)]
    return check_nodes([node for node in needed if node not in running])


def _check_cameras(graph: NodeGraph, statuses: Mapping[str, DetectorStatus], notices: List[Notice]) -> List[Notice]:
    """Checks how the cameras' images arrive. No line says that a camera works if a notice names it."""
    if rospy.has_param("/border_fusion") and not statuses:
        return [Notice("lab_no_cameras", Severity.WARNING)]
    lines = []
    for camera, status in sorted(statuses.items()):
        detector = _parameters(f"/spot_detector_{camera}")
        lines.append(check_camera(graph, camera, detector, _has_delay(detector), status.rate_hz))
    cameras_in_notices = {notice.camera for notice in notices}
    return [line for line in lines if line.severity is not Severity.INFO or line.camera not in cameras_in_notices]


def _has_delay(detector: Mapping[str, Any]) -> bool:
    """Returns whether a camera's own file has a delay. The parameter does not tell: a measured 0 equals the default."""
    with contextlib.suppress(CodedError):  # there is no file, or it is on another computer
        settings = read_parameter_file("configs", str(detector.get("settings", "")))
        return "delay_ms" in (settings.get("capture") or {})
    return False


def _scan_topic(robot: str) -> str:
    """Returns the topic of a robot's scanner, or "" if it has none."""
    try:
        scanner = robot_profile.read(robot).scanner
    except CodedError:  # the driver uses this profile too, and says what is wrong with it
        scanner = Scanner()
    return ns_join(f"/{robot}", scanner.topic) if scanner.present else ""


def _check_robots(newest: Mapping[str, Any]) -> List[Notice]:
    if names.ROBOTS not in newest:
        return []
    status: RobotStatusArray = newest[names.ROBOTS]
    lines = [line for robot in status.robots for line in _check_robot(robot, newest)]
    return [*derive_capabilities(connections_from_message(status)).robot_notices, *lines]


def _check_robot(status: RobotStatus, newest: Mapping[str, Any]) -> List[Notice]:
    navigation = _parameters(status.move_base) if status.move_base else {}
    scan_topic = _scan_topic(status.robot)
    scan: Optional[LaserScan] = newest.get(scan_topic)
    covered_deg = 0.0 if scan is None else float(np.degrees(scan.angle_max - scan.angle_min))
    needs_scan = status.driver and scan_topic != ""
    has_margin = any(topic.endswith(names.MAP_WITH_MARGIN) for topic in status.maps)
    is_move_base = "global_costmap" in navigation
    return check_robot(
        status.robot,
        lacks_margin=status.driver and status.plans_round_borders and not has_margin,
        scan_topic=scan_topic,
        scan_deg=covered_deg if needs_scan else None,
        clears_plans=is_move_base and bool(navigation.get("make_plan_clear_costmap", True)),
    )


def _check_map(graph: NodeGraph, newest: Mapping[str, Any]) -> List[Notice]:
    physical = newest.get(names.PHYSICAL_MAP)
    size = None
    lacks_unknown = False
    if physical is not None:
        info = physical.info
        size = info.width * info.resolution, info.height * info.resolution
        with contextlib.suppress(CodedError):  # the map integrator reports a map of the wrong size
            lacks_unknown = is_fully_known(grid_from_message(physical).data)
    publishers = graph.publishers.get(names.PHYSICAL_MAP, [])
    file = str(rospy.get_param("/map_server/map_yaml", ""))
    return check_map(size, publishers, names.MAP_WITH_BORDERS in newest, file, lacks_unknown)


def _check_borders(newest: Mapping[str, Any]) -> List[Notice]:
    if names.BORDERS not in newest:
        return []
    borders = newest[names.BORDERS].borders
    values = {"in_force": sum(border.in_force for border in borders), "count": len(borders)}
    return [Notice("lab_borders_ok", Severity.INFO, values=values)]


def _check_display(running: Set[str]) -> List[Notice]:
    displays = [node for node in sorted(running) if node.split("/")[-1] in ("smart_display", "rviz")]
    code = rospy.get_param(f"{displays[0]}/lacking", "") if displays else ""
    return [Notice(code, Severity.WARNING, values={"node": displays[0]})] if code else []


def _check_storage() -> Notice:
    """Checks the folder in which borders are stored, or its nearest parent that exists."""
    database = Path(str(rospy.get_param("/map_integrator/database_dir", "~"))).expanduser()
    folder = str(next(path for path in (database, *database.parents) if path.exists()))
    return check_disk(folder, shutil.disk_usage(folder).free / 2**20, os.access(folder, os.W_OK))


def _find_further(notices: List[Notice], lines: List[Notice]) -> List[Notice]:
    """Returns the notices that add something to the lines: neither repeated nor explained by one of them."""
    reported = {(line.code, line.camera, line.robot) for line in lines}
    # an error of a camera's topic explains why the camera is silent
    errors = [line for line in lines if line.severity is Severity.ERROR]
    reported |= {("camera_silent", line.camera, line.robot) for line in errors}
    return [notice for notice in notices if (notice.code, notice.camera, notice.robot) not in reported]


def _parameters(node: str) -> Mapping[str, Any]:
    values = rospy.get_param(node, {})
    return values if isinstance(values, dict) else {}


def print_table(lines: List[Notice], language: str, console: Console) -> None:
    """Prints the lines as a table. The faults come last, where people notice them."""
    table = Table(Column(overflow="fold"), Column(overflow="fold"), box=None, padding=(0, 2, 0, 0))
    for line in sorted(lines, key=lambda line: line.severity):
        table.add_row(f"[{_STYLES[line.severity]}]{_STATES[line.severity]}[/]", line.sentence(language))
    console.print(table)


def print_camera(camera: str) -> None:
    """Prints the report to send in about a camera that a detector reads, or the command for it on that computer."""
    parameters = rospy.get_param(f"/spot_detector_{camera}", {})
    source = str(parameters.get("source", ""))
    if not source:
        return
    # a detector that has just ended has no address, and is assumed to run on this computer
    service = rosservice.get_service_uri(f"/spot_detector_{camera}/capture/set_parameters")
    host = urlparse(service or "").hostname
    lines = [f"what this prints on {host}:", describe_camera_command(source)]
    if is_local_address(host):
        lines = ["these:", *describe_camera(source, CaptureParams.from_mapping(parameters.get("capture"), "capture"))]
    print(f"\nIf the camera {camera} still does not work, report the lines above, and", "\n".join(lines))


def to_json(lines: List[Notice], language: str) -> str:
    """Formats the lines for programs: each with state, code, camera, robot, values, and the sentence for people."""
    rows = []
    for line in lines:
        fields = {name: getattr(line, name) for name in ("code", "camera", "robot", "values")}
        rows.append({"state": _STATES[line.severity], **fields, "message": line.sentence(language)})
    return json.dumps(rows, indent=1, ensure_ascii=False, default=str)


def main(arguments: Optional[List[str]] = None) -> int:
    """Checks the lab and prints the result. Returns the exit status, which --help explains; warnings leave it at 0."""
    parser = argparse.ArgumentParser(
        prog="check_lab",
        description=__doc__,
        epilog="Exit status: 0 ready, 1 something is wrong, 2 wrong call, 3 the ROS master does not answer.",
    )
    parser.add_argument("--json", action="store_true", help="for programs")
    parser.add_argument("--seconds", type=float, default=4.0, help="how long to listen to the nodes (4)")
    parser.add_argument("--language", default=sentences.ENGLISH, choices=sentences.languages())
    parser.add_argument("--camera", metavar="SOURCE", help="only describe a camera, given as to new_lab; without a lab")
    options = parser.parse_args(rospy.myargv()[1:] if arguments is None else arguments)
    if options.camera:
        print("\n".join(describe_camera(parse_source(options.camera), CaptureParams())))
        return READY
    if not rosgraph.is_master_online():
        print(
            f"The ROS master does not answer at {rosgraph.get_master_uri()}: start lab.launch first, and set "
            "ROS_MASTER_URI if it runs on another computer.",
            file=sys.stderr,
        )
        return NO_MASTER
    rospy.init_node("check_lab", anonymous=True, disable_signals=True, log_level=rospy.ERROR)
    lines = observe_lab(options.seconds)
    if options.json:
        print(to_json(lines, options.language))
    else:
        print_table(lines, options.language, Console())
        for camera in sorted({line.camera for line in lines if line.code in REPORTED}):
            print_camera(camera)
    return FAULTS if any(line.severity is Severity.ERROR for line in lines) else READY
