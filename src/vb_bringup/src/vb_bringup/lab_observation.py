"""Observes the running lab: what its cameras, robots, maps and nodes send within some seconds, and what they tell people."""

from __future__ import annotations

import os
import shutil
import struct
import threading
import time
from pathlib import Path
from typing import Any, Dict, Iterable, List, Mapping, Optional, Sequence, Tuple

import numpy as np
import rosgraph
import rospy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, LaserScan

from vb_bringup.lab_checks import (
    BorderObservation,
    CameraInfoObservation,
    CameraObservation,
    CheckLine,
    CheckState,
    MapObservation,
    RobotObservation,
    check_borders,
    check_cameras,
    check_disk,
    check_map,
    check_nodes,
    check_robot,
    check_robots,
    lines_from_notices,
)
from vb_core.node_graph import NodeGraph
from vb_core import names
from vb_core.errors import CodedError
from vb_core.offer import offer
from vb_core.ros.graph import read_graph
from vb_core.ros.images import array_from_compressed_image, array_from_image
from vb_core.ros.messages import OccupancyGridArray, grid_from_message
from vb_core.ros.node import wait_for_publishers
from vb_core.ros.notices import NoticeListener
from vb_core.ros.robots import connections_from_message
from vb_core.ros.transforms import TransformLookup
from vb_laser_detect.detection.exposure import saturated_share
from vb_msgs.msg import RobotStatus, RobotStatusArray, VirtualBorderArray

_DETECTOR = "spot_detector"
_MONITOR, _ROBOT_MONITOR = "/lab_monitor", "/robot_monitor"
_CONNECTION_TIMEOUT = 5.0  # [s] a publisher that cannot be reached by then is one of the faults to report
_HARDLY_ANY = 0.01  # share of unknown cells; shades between may be left where all else was read as free
_IMAGE_TYPES = {"sensor_msgs/Image": Image, "sensor_msgs/CompressedImage": CompressedImage}


class ObservedTopic:
    """A topic observed for a while: its messages' times and ages, and one whole message."""

    def __init__(self, topic: str, kind: Any) -> None:
        self._kind = kind
        self._lock = threading.Lock()
        self._began = time.monotonic()
        self._times: List[float] = []
        self._ages: List[float] = []
        self._raw: Optional[bytes] = None
        # undecoded: images would keep this process busy for nothing
        self.subscriber = rospy.Subscriber(topic, rospy.AnyMsg, self._on_message, queue_size=5, buff_size=2**24)

    def _on_message(self, message: rospy.AnyMsg) -> None:
        with self._lock:
            self._times.append(time.monotonic())
            if len(message._buff) >= 12:
                _, seconds, nanoseconds = struct.unpack("<III", message._buff[:12])
                self._ages.append(rospy.get_time() - (seconds + 1e-9 * nanoseconds))
            self._raw = message._buff

    def rate(self) -> float:
        """Returns how many messages arrive per second [1/s]; 0 if none did."""
        with self._lock:
            if len(self._times) < 2:
                return len(self._times) / (time.monotonic() - self._began)
            return (len(self._times) - 1) / max(self._times[-1] - self._times[0], 1e-6)

    def age(self) -> float:
        """Returns the time [s] from a message's stamp to its arrival, of the quickest one; negative: from the future.

        A busy computer delays some messages; clocks that differ shift all of them. Simulated time comes
        as messages that are delayed, too, which makes others look too early: there the smallest
        difference in either direction counts.
        """
        with self._lock:
            return min(self._ages, key=None if rospy.rostime.is_wallclock() else abs, default=0.0)

    def message(self) -> Optional[Any]:
        """Returns the newest message; None if none arrived or it is not of the right type."""
        with self._lock:
            raw = self._raw
        if raw is None:
            return None
        try:
            return self._kind().deserialize(raw)
        except Exception:  # genpy raises various errors for messages of another type
            return None

    def close(self) -> None:
        """Stops listening."""
        self.subscriber.unregister()


def observe_lab(seconds: float) -> List[CheckLine]:
    """Listens to cameras, scans and notices for some seconds, looks at everything else, and judges it."""
    graph = read_graph()
    listener = NoticeListener()
    transforms = TransformLookup()
    robots = _robot_names()
    running = sorted(node for node in graph.nodes if node.split("/")[-1].startswith(_DETECTOR))
    detectors = {
        node: {"camera": node.split("/")[-1][len(_DETECTOR) :].strip("_"), **_parameters(node)}
        for node in [*running, *_missing_detectors(running)]
    }
    images = {node: _image_topic(graph, node, found) for node, found in detectors.items()}
    streams = {topic: ObservedTopic(topic, kind) for topic, kind in _wanted_topics(images.values(), robots).items()}
    wait_for_publishers([listener.subscriber, *(stream.subscriber for stream in streams.values())], _CONNECTION_TIMEOUT)
    rospy.rostime.wallsleep(seconds)

    poses = _CalibrationFiles(graph)
    cameras = [_camera(graph, node, detectors[node], images[node][0], streams, transforms, poses) for node in detectors]
    # one that was just being started again has no name for a moment
    running_now = graph.nodes | read_graph().nodes
    lines = check_nodes([node for node in _needed_nodes() if node not in running_now])
    if cameras or rospy.has_param(_MONITOR):
        lines += check_cameras(cameras)
    lines += check_map(_map(graph, streams))
    stored = streams[names.BORDERS].message()
    if stored is not None:
        borders = [BorderObservation(border.name, border.in_force, border.reason) for border in stored.borders]
        lines += check_borders(borders, stored.needs_confirmation)
    connected = streams[names.ROBOTS].message()
    if connected is not None:
        lines += check_robots(offer(connections_from_message(connected)))
        for robot in connected.robots:
            lines += check_robot(_robot(robot, streams, transforms))
    lines += _check_output(graph)
    for stream in streams.values():
        stream.close()
    listener.close()
    return lines + lines_from_notices(listener.current(), lines)


def _wanted_topics(images: Iterable[Tuple[str, type]], robots: Sequence[str]) -> Dict[str, type]:
    """Lists the topics to subscribe to, with their types: detectors' images, robots' sensors, maps and borders."""
    found: Dict[str, type] = {}
    for topic, kind in images:
        found.update({topic: kind, _info_topic(topic): CameraInfo})
    for robot in robots:
        found[_within(robot, "scan")] = LaserScan
        for name in ("camera/rgb/image_raw", "camera/depth_registered/image_raw"):
            found.setdefault(_within(robot, name), Image)
    return {
        **found,
        names.PHYSICAL_MAP: OccupancyGridArray,
        names.MAP_WITH_BORDERS: OccupancyGridArray,
        names.BORDERS: VirtualBorderArray,
        names.ROBOTS: RobotStatusArray,
    }


def _check_output(graph: NodeGraph) -> List[CheckLine]:
    """Judges voice and display, and the folder that borders are stored in."""
    voice = any(node.split("/")[-1] == "voice_commands" for node in graph.nodes)
    lines = [CheckLine("voice", CheckState.OK, "lab_voice_ok" if voice else "lab_voice_off")]
    display = next((node for node in sorted(graph.nodes) if node.split("/")[-1] in ("smart_display", "rviz")), "")
    state, code = CheckState.OK, "lab_display_ok" if display else "lab_display_off"
    lacking = rospy.get_param(f"{display}/lacking", "") if display else ""
    if lacking:
        state, code = CheckState.WARNING, lacking
    lines.append(CheckLine("display", state, code, {"node": display}))
    place = Path(str(rospy.get_param("/map_integrator/database_dir", "~"))).expanduser()
    while not place.exists():
        place = place.parent
    lines.append(check_disk(str(place), shutil.disk_usage(str(place)).free / 2**20, os.access(str(place), os.W_OK)))
    return lines


def _needed_nodes() -> List[str]:
    """Lists the nodes that the running launch is meant to have, by the parameters that it has set."""
    found = ["/map_integrator", *(["/border_fusion"] if rospy.has_param(_MONITOR) else [])]
    if rospy.has_param(_ROBOT_MONITOR):
        found.append(_ROBOT_MONITOR)
    if rospy.has_param(_MONITOR) or rospy.get_param(f"{_ROBOT_MONITOR}/interaction", False):
        found.append("/interaction_manager")
    return found


def _robot_names() -> List[str]:
    return list(rospy.get_param(f"{_ROBOT_MONITOR}/robots", [])) or [""]


def _within(robot: str, name: str) -> str:
    return f"/{robot}/{name}" if robot else f"/{name}"


def _missing_detectors(running: Sequence[str]) -> List[str]:
    """Lists the detectors that should run, by the cameras that the lab was started with, and do not."""
    expected = [f"/{_DETECTOR}_{name}" for name in str(rospy.get_param("/lab_monitor/cameras", "")).split()]
    return [node for node in expected if node not in running]


def _parameters(node: str) -> Mapping[str, Any]:
    found = rospy.get_param(node, {})
    return found if isinstance(found, dict) else {}


def _info_topic(topic: str) -> str:
    whole = topic[: -len("/compressed")] if topic.endswith("/compressed") else topic
    return whole.rsplit("/", 1)[0] + "/camera_info"


def _image_topic(graph: NodeGraph, node: str, parameters: Mapping[str, Any]) -> Tuple[str, Any]:
    """Finds the topic that the detector really listens to, remappings included; else the one in its parameters."""
    found = [topic for topic in graph.subscriptions(node, list(_IMAGE_TYPES)) if "depth" not in topic]
    if found:
        return found[0], _IMAGE_TYPES[graph.types[found[0]]]
    name = str(parameters.get("image") or f"{parameters.get('camera', '')}/image_raw")
    topic = rosgraph.names.resolve_name(name, node)
    if parameters.get("image_transport") == "compressed":
        return topic + "/compressed", CompressedImage
    return topic, Image


class _CalibrationFiles:
    """The files whose poses camera_poses publishes."""

    def __init__(self, graph: NodeGraph) -> None:
        from vb_laser_detect.calibration import calibration_file

        self._files = calibration_file
        node = next((node for node in graph.nodes if node.split("/")[-1] == "camera_poses"), "")
        found = _parameters(node) if node else {}
        self._folder = str(found.get("calibration_dir", ""))
        self._cameras = str(found.get("cameras", "")).split()

    def describe(self, camera: str) -> Mapping[str, Any]:
        """Returns what CameraObservation holds of a camera's file; nothing if others publish the pose."""
        if not self._folder or camera not in self._cameras:
            return {}
        path = self._files.calibration_path(self._folder, camera)
        try:
            found = self._files.load(path)
        except CodedError as error:
            return {
                "file": str(path),
                "file_missing": error.code == "no_calibration",
                "file_error": error.message,
                "file_camera": error.values.get("camera", ""),
            }
        return {"file": str(path), "file_frame": found.frame, "file_focal": found.focal}


def _other_images(graph: NodeGraph, topic: str) -> List[str]:
    """Lists image topics in the namespace of one that no node publishes: the driver may name its images differently."""
    name = topic.strip("/").split("/")[0]
    return sorted(
        other
        for other, nodes in graph.publishers.items()
        if nodes and other != topic and other.startswith(f"/{name}/") and graph.types.get(other) == "sensor_msgs/Image"
        if not other.endswith("/debug_image")
    )


def _camera(
    graph: NodeGraph,
    node: str,
    parameters: Mapping[str, Any],
    topic: str,
    streams: Mapping[str, ObservedTopic],
    transforms: TransformLookup,
    poses: _CalibrationFiles,
) -> CameraObservation:
    name, delay = str(parameters.get("camera", node)), 1e-3 * parameters.get("capture", {}).get("delay_ms", 0.0)
    image, info = streams[topic].message(), streams[_info_topic(topic)].message()
    pixels = _pixels(image)
    frame = str(parameters.get("frame", "")) or (image.header.frame_id if image is not None else "")
    return CameraObservation(
        name=name,
        topic=topic,
        publishers=graph.publishers.get(topic, []),
        others=_other_images(graph, topic),
        rate=streams[topic].rate(),
        age=streams[topic].age() - delay,
        no_delay="://" in str(parameters.get("source", "")) and not delay,  # a camera in the network
        width=pixels.shape[1],
        height=pixels.shape[0],
        encoding=getattr(image, "encoding", "") or getattr(image, "format", ""),
        frame=frame,
        bright=saturated_share(pixels),
        info=None
        if info is None
        else CameraInfoObservation(info.width, info.height, float(info.K[0]), float(info.P[0])),
        detector=node if node in graph.nodes else "",
        has_pose=bool(frame) and _transform_age(transforms, frame) is not None,
        **poses.describe(name),
    )


def _pixels(image: Optional[Any]) -> np.ndarray:
    if image is None:
        return np.zeros((0, 0), np.uint8)
    try:
        return array_from_compressed_image(image) if hasattr(image, "format") else array_from_image(image)
    except CodedError:
        return np.zeros((0, 0), np.uint8)


def _transform_age(transforms: TransformLookup, frame: str) -> Optional[float]:
    """Returns the age [s] of the newest transform from a frame to the map; 0 for a fixed one, None if there is none."""
    try:
        transforms.lookup(names.MAP_FRAME, frame, rospy.Time(0))
    except CodedError:
        return None
    newest = transforms.newest(names.MAP_FRAME, frame)
    return 0.0 if newest.is_zero() else (rospy.Time.now() - newest).to_sec()


def _robot(status: RobotStatus, streams: Mapping[str, ObservedTopic], transforms: TransformLookup) -> RobotObservation:
    scan = streams[_within(status.robot, "scan")].message()
    color = streams[_within(status.robot, "camera/rgb/image_raw")].message()
    depth = streams[_within(status.robot, "camera/depth_registered/image_raw")].message()
    found = _parameters(status.move_base) if status.move_base else {}
    return RobotObservation(
        name=status.robot,
        driven=status.driver,
        pose_age=_transform_age(transforms, status.frame),
        keeps_margin=not status.plans_round_borders
        or any(name.endswith(names.MAP_WITH_MARGIN) for name in status.maps),
        scan_topic=_within(status.robot, "scan"),
        scan_deg=0.0 if scan is None else float(np.degrees(scan.angle_max - scan.angle_min)),
        color_frame="" if color is None else color.header.frame_id,
        depth_frame="" if depth is None else depth.header.frame_id,
        clears_plans=bool(found.get("make_plan_clear_costmap", True)) and "global_costmap" in found,
    )


def is_all_known(cells: np.ndarray) -> bool:
    """Returns whether a map (H, W) int8 has hardly any unknown cell although free floor reaches its edge.

    No robot records such a map: what it has not seen was read as free, for instance a pixel of 205 with free_thresh 0.25.
    """
    edges = np.concatenate([cells[0], cells[-1], cells[:, 0], cells[:, -1]])
    return bool((edges == 0).any()) and float((cells < 0).mean()) < _HARDLY_ANY


def _map(graph: NodeGraph, streams: Mapping[str, ObservedTopic]) -> MapObservation:
    physical, virtual = streams[names.PHYSICAL_MAP].message(), streams[names.MAP_WITH_BORDERS].message()
    publishers = graph.publishers.get(names.PHYSICAL_MAP, [])
    if physical is None:
        return MapObservation(file=str(rospy.get_param("/map_server/map_yaml", "")), publishers=publishers)
    try:
        all_known = is_all_known(grid_from_message(physical).data)
    except CodedError:  # a map that says other than it carries: the map integrator tells it
        all_known = False
    return MapObservation(
        shape=(physical.info.height, physical.info.width),
        resolution=physical.info.resolution,
        publishers=publishers,
        with_borders=virtual is not None
        and (virtual.info.width, virtual.info.height) == (physical.info.width, physical.info.height),
        all_known=all_known,
    )
