"""Observes the running lab for some seconds: its nodes, their notices, and how topics are connected."""

from __future__ import annotations

import contextlib
import os
import shutil
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Tuple

import numpy as np
import rospy
from rosgraph.names import ns_join
from sensor_msgs.msg import LaserScan

from vb_bringup.lab_readiness import check_camera, check_disk, check_map, check_nodes, check_robot, is_all_known
from vb_bringup.launch_check import read_parameters
from vb_core import names
from vb_core.errors import CodedError
from vb_core.node_graph import NodeGraph
from vb_core.notices import Notice, Severity
from vb_core.lab_offer import offer
from vb_core.robot_profile import Scanner
from vb_core.ros import robot_profile
from vb_core.ros.master import read_graph
from vb_core.ros.messages import OccupancyGridArray, grid_from_message
from vb_core.ros.node import wait_for_publishers
from vb_core.ros.notices import NoticeListener
from vb_core.ros.robot_status import connections_from_message
from vb_msgs.msg import DetectorStatus, RobotStatus, RobotStatusArray, VirtualBorderArray

# nodes that must run if the launch file has set their parameters; camera_poses reports missing detectors
_NODES = ("/map_integrator", "/border_fusion", "/interaction_manager", "/camera_poses", "/robot_monitor")
_CONNECTION_TIMEOUT = 5.0  # [s] a publisher that is not reached within this is a fault to report


def observe_lab(seconds: float) -> List[Notice]:
    """Listens to the nodes for some seconds, inspects everything else, and judges the result."""
    graph = read_graph()
    newest, statuses, notices = _listen(seconds)
    running = graph.nodes | read_graph().nodes  # while a node restarts, the master does not list it
    lines = check_nodes(
        [node for node in _NODES if node not in running and (node == _NODES[0] or rospy.has_param(node))]
    )
    if rospy.has_param("/border_fusion") and not statuses:
        lines.append(Notice("lab_no_cameras", Severity.WARNING))
    for camera, status in sorted(statuses.items()):
        detector = _parameters(f"/spot_detector_{camera}")
        line = check_camera(graph, camera, detector, _has_delay(detector), status.rate_hz)
        if line.severity is Severity.ERROR:  # the line says why the camera is silent
            notices = [one for one in notices if (one.code, one.camera) != ("camera_silent", camera)]
        if line.severity is not Severity.INFO or all(one.camera != camera for one in notices):
            lines.append(line)
    lines += _check_map(graph, newest)
    if names.BORDERS in newest:
        borders = newest[names.BORDERS].borders
        values = {"in_force": sum(border.in_force for border in borders), "count": len(borders)}
        lines.append(Notice("lab_borders_ok", Severity.INFO, values=values))
    if names.ROBOTS in newest:
        lines += offer(connections_from_message(newest[names.ROBOTS])).lines
        for robot in newest[names.ROBOTS].robots:
            lines += _check_robot(robot, newest)
    lines += _check_computer(running)
    said = {(line.code, line.camera, line.robot) for line in lines}
    return lines + [one for one in notices if (one.code, one.camera, one.robot) not in said]


def _listen(seconds: float) -> Tuple[Dict[str, Any], Dict[str, DetectorStatus], List[Notice]]:
    """Returns the newest message of each topic, the newest status of each camera, and the notices that hold."""
    newest: Dict[str, Any] = {}
    statuses: Dict[str, DetectorStatus] = {}
    scans = {_scan(robot) for robot in rospy.get_param("/robot_monitor/robots", []) or [""]} - {""}
    topics = {
        names.PHYSICAL_MAP: OccupancyGridArray,
        names.MAP_WITH_BORDERS: OccupancyGridArray,
        names.BORDERS: VirtualBorderArray,
        names.ROBOTS: RobotStatusArray,
        **dict.fromkeys(scans, LaserScan),
    }
    subscribers = [
        rospy.Subscriber(name, kind, lambda message, name=name: newest.update({name: message}), queue_size=1)
        for name, kind in topics.items()
    ]
    detectors = rospy.Subscriber(names.DETECTORS, DetectorStatus, lambda one: statuses.update({one.camera: one}))
    notices = NoticeListener()
    wait_for_publishers([notices.subscriber, detectors, *subscribers], _CONNECTION_TIMEOUT)
    rospy.rostime.wallsleep(seconds)
    return dict(newest), dict(statuses), notices.current()


def _has_delay(detector: Mapping[str, Any]) -> bool:
    """Returns whether a camera's own file has a delay: as a parameter, a measured 0 cannot be told from the default."""
    with contextlib.suppress(CodedError):  # there is none, or it is on another computer
        return "delay_ms" in (read_parameters("configs", str(detector.get("settings", ""))).get("capture") or {})
    return False


def _scan(robot: str) -> str:
    """Returns the topic of a robot's scanner; "" if it has none."""
    try:
        scanner = robot_profile.read(robot).scanner
    except CodedError:  # the driver that uses this profile says what is wrong with it
        scanner = Scanner()
    return ns_join(f"/{robot}", scanner.topic) if scanner.present else ""


def _check_robot(status: RobotStatus, newest: Mapping[str, Any]) -> List[Notice]:
    navigation = _parameters(status.move_base) if status.move_base else {}
    topic = _scan(status.robot)
    scan: Optional[LaserScan] = newest.get(topic)
    covered = 0.0 if scan is None else float(np.degrees(scan.angle_max - scan.angle_min))
    has_margin = any(name.endswith(names.MAP_WITH_MARGIN) for name in status.maps)
    return check_robot(
        status.robot,
        has_margin or not (status.driver and status.plans_round_borders),
        topic,
        covered if status.driver and topic else None,
        bool(navigation.get("make_plan_clear_costmap", True)) and "global_costmap" in navigation,
    )


def _check_map(graph: NodeGraph, newest: Mapping[str, Any]) -> List[Notice]:
    physical, size, all_known = newest.get(names.PHYSICAL_MAP), None, False
    if physical is not None:
        size = physical.info.width * physical.info.resolution, physical.info.height * physical.info.resolution
        with contextlib.suppress(CodedError):  # the map integrator reports a map of the wrong size
            all_known = is_all_known(grid_from_message(physical).data)
    publishers, file = graph.publishers.get(names.PHYSICAL_MAP, []), str(rospy.get_param("/map_server/map_yaml", ""))
    return check_map(size, publishers, names.MAP_WITH_BORDERS in newest, file, all_known)


def _check_computer(running: Any) -> List[Notice]:
    """Judges the display, and the folder in which borders are stored."""
    lines = []
    display = next((node for node in sorted(running) if node.split("/")[-1] in ("smart_display", "rviz")), "")
    lacking = rospy.get_param(f"{display}/lacking", "") if display else ""
    if lacking:
        lines.append(Notice(lacking, Severity.WARNING, values={"node": display}))
    place = Path(str(rospy.get_param("/map_integrator/database_dir", "~"))).expanduser()
    while not place.exists():
        place = place.parent
    lines.append(check_disk(str(place), shutil.disk_usage(str(place)).free / 2**20, os.access(str(place), os.W_OK)))
    return lines


def _parameters(node: str) -> Mapping[str, Any]:
    values = rospy.get_param(node, {})
    return values if isinstance(values, dict) else {}
