"""check_lab names the faults that only the whole lab shows, and repeats the notices of its nodes."""

from types import SimpleNamespace

import numpy as np
import pytest
from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import LaserScan

from vb_bringup import check_lab, lab_readiness
from vb_bringup.lab_readiness import is_fully_known
from vb_core import names
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.map_files import read_map, write_map
from vb_core.node_graph import NodeGraph
from vb_core.notices import Notice, Severity
from vb_core.capabilities import derive_capabilities
from vb_core.ros.robot_status import connections_from_message
from vb_laser_detect.camera import camera_report
from vb_laser_detect.camera.camera_source import CapturedImage
from vb_msgs.msg import RobotStatus, RobotStatusArray


def codes(lines):
    return [line.code for line in lines if line.severity is not Severity.INFO]


def graph_of(*publishers, topic="/north/image_raw"):
    """Returns the graph of a topic's publishers."""
    return NodeGraph([(topic, publishers)], [], types={topic: "sensor_msgs/Image"})


DETECTOR = {"image_transport": "raw"}
GOOD = {
    "camera": dict(graph=graph_of("/north/usb_cam"), name="north", parameters=DETECTOR, has_delay=False, rate=15.0),
    "robot": dict(name="ada", lacks_margin=False, scan_topic="/ada/scan", scan_deg=270.0, clears_plans=False),
    "map": dict(size=(5.0, 10.0), publishers=["/map_server"], with_borders=True, file="", lacks_unknown=False),
    "disk": dict(folder="/x", free_mb=9000.0),
    "nodes": dict(missing=[]),
}


@pytest.mark.parametrize(
    "what, changes, code",
    [
        *((what, {}, "") for what in GOOD),
        ("camera", dict(graph=graph_of(), parameters={"source": "/dev/video0"}), ""),  # read by the detector itself
        ("camera", dict(graph=graph_of()), "lab_camera_no_publisher"),
        ("camera", dict(graph=graph_of("/usb_cam", topic="/north/image_rect")), "lab_camera_other_topic"),
        ("camera", dict(graph=graph_of("/a", "/b")), "lab_camera_many_publishers"),
        ("robot", dict(scan_deg=0.0), "lab_robot_no_scan"),
        ("robot", dict(scan_deg=30.0), "lab_robot_narrow_scan"),
        ("robot", dict(scan_deg=None), ""),
        ("robot", dict(lacks_margin=True), "lab_robot_without_margin"),
        ("robot", dict(clears_plans=True), "lab_robot_clears_plans"),
        ("map", dict(size=None), "lab_map_missing"),
        ("map", dict(size=None, file="room.yaml"), "lab_map_not_served"),
        ("map", dict(publishers=["/a", "/b"]), "lab_map_many_publishers"),
        ("map", dict(with_borders=False), "lab_map_without_borders"),
        ("map", dict(lacks_unknown=True), "lab_map_all_known"),
        ("disk", dict(writable=False), "lab_disk_read_only"),
        ("disk", dict(free_mb=10.0), "lab_disk_full"),
        ("nodes", dict(missing=["/map_integrator"]), "lab_node_missing"),
    ],
)
def test_each_mistake_in_a_lab_is_named(what, changes, code):
    arguments = {**GOOD[what], **changes}
    result = getattr(lab_readiness, f"check_{what}")(**arguments)
    lines = result if isinstance(result, list) else [result]
    assert codes(lines) == ([code] if code else [])
    # the sentence names the camera or the robot
    assert all(arguments.get("name", "") in line.sentence() for line in lines)


@pytest.mark.parametrize(
    "delay, written, said",
    [
        (0.0, "capture:", "calibrate_camera delay north"),
        (0.0, "capture: {delay_ms: 0.0}", "stored delay: 0 ms"),  # which was measured
        (80.5, "", "stored delay: 80.5 ms"),
    ],
)
def test_a_network_camera_s_delay_is_shown_or_asked_for(tmp_path, delay, written, said):
    (tmp_path / "north.yaml").write_text(written)
    detector = {"source": "rtsp://a/", "settings": str(tmp_path / "north.yaml"), "capture": {"delay_ms": delay}}
    line = lab_readiness.check_camera(graph_of(), "north", detector, check_lab._has_delay(detector), 15.0)
    assert said in line.sentence()


def camera(address, _params, take, tell):
    """Stands in for a CameraSource: sends three images, which cannot be decoded, 40 ms apart, and ends."""

    def start():
        for number in range(3):
            take(CapturedImage(0.04 * number, b"no JPEG"))
        tell(CodedError("camera_ended", source=address))

    return SimpleNamespace(start=start, close=lambda: None)


DESCRIBED = ["source /dev/x", "Driver Info", "fault: camera_ended", "3 images", "cannot decode", "stamps: 40.0 ms"]
ELSEWHERE = "on 192.0.2.7:\nrosrun vb_bringup check_lab --camera /dev/x"


@pytest.mark.parametrize(
    "arguments, code, host, said",
    [
        (["--camera", "/dev/x"], "", "", DESCRIBED),  # without a lab
        ([], "control_refused", "127.0.0.1", DESCRIBED),
        ([], "camera_no_pose", "127.0.0.1", []),
        ([], "camera_unplugged", "192.0.2.7", [ELSEWHERE]),
    ],
)
def test_a_camera_that_does_not_work_is_described(monkeypatch, capsys, arguments, code, host, said):
    monkeypatch.setattr(camera_report, "CameraSource", camera)
    monkeypatch.setattr(camera_report, "_WATCH_TIME", 0.0)
    monkeypatch.setattr(camera_report, "run_v4l2", lambda *_: "Driver Info")
    monkeypatch.setattr(check_lab, "observe_lab", lambda _: [Notice(code, Severity.WARNING, camera="north")])
    monkeypatch.setattr(check_lab.rosgraph, "is_master_online", lambda: bool(code))
    monkeypatch.setattr(check_lab.rosservice, "get_service_uri", lambda *_: f"rosrpc://{host}:1")
    monkeypatch.setattr(check_lab.rospy, "init_node", lambda *_, **__: None)
    monkeypatch.setattr(check_lab.rospy, "get_param", lambda *_: {"source": "/dev/x"})
    assert check_lab.main(arguments) == check_lab.READY
    output = capsys.readouterr().out
    assert [part for part in (*DESCRIBED, ELSEWHERE) if part in output] == said


@pytest.mark.parametrize("free_thresh, is_reported", [(0.196, False), (0.25, True)])
def test_a_map_without_unknown_cells_is_reported(tmp_path, free_thresh, is_reported):
    """Of 183 maps in public repositories, 10 had free_thresh 0.25 with pixels of 205."""
    cells = np.full((20, 20), -1, np.int8)
    cells[5:15, 5:15] = 100
    cells[6:14, 6:14] = 0
    _, path = write_map(tmp_path / "map", GridMap(cells, 0.05))
    path.write_text(path.read_text().replace("free_thresh: 0.196", f"free_thresh: {free_thresh}"))
    again = read_map(path).data
    assert is_fully_known(again) is is_reported
    assert not is_fully_known(again[5:15, 5:15])  # a completely known room, with walls all round


@pytest.mark.parametrize("height, width", [(0, 0), (3, 4), (2, 2)])
def test_a_map_of_the_wrong_size_does_not_end_the_check(height, width, monkeypatch):
    monkeypatch.setattr(check_lab.rospy, "get_param", lambda _name, default: default)
    message = OccupancyGrid(data=[0] * 5)
    message.info.height, message.info.width = height, width
    lines = check_lab._check_map(SimpleNamespace(publishers={}), {names.PHYSICAL_MAP: message})
    assert codes(lines) == ["lab_map_without_borders"]


@pytest.mark.parametrize(
    "driver, scanner, heard, expected",
    [
        (True, {}, "/ada/scan", []),
        (True, {}, "/scan", [("lab_robot_no_scan", "/ada/scan")]),
        (True, {"topic": "front/scan"}, "/ada/front/scan", []),
        (True, {"topic": "/front"}, "/ada/scan", [("lab_robot_no_scan", "/front")]),
        (True, {"present": False}, "", []),
        (False, {}, "", []),  # without a driver nothing here needs the scan
    ],
)
def test_a_scan_is_expected_where_the_profile_says(monkeypatch, driver, scanner, heard, expected):
    profile = {"/ada/robot_profile": {"scanner": scanner}}
    monkeypatch.setattr(check_lab.rospy, "get_param", lambda name, default: profile.get(name, default))
    status = RobotStatus(robot="ada", driver=driver, plans_round_borders=not driver)
    lines = check_lab._check_robot(status, {heard: LaserScan(angle_min=-1.5, angle_max=1.5)})
    assert [(line.code, line.values["topic"]) for line in lines] == expected


def test_a_robots_fault_is_one_line(monkeypatch):
    good = RobotStatus(robot="ada", move_base="/ada/move_base", plans_round_borders=True, localized=True)
    bad = RobotStatus(robot="bob", move_base="/bob/move_base", localized=True)
    newest = {names.ROBOTS: RobotStatusArray(robots=[good, bad])}
    notices = derive_capabilities(connections_from_message(newest[names.ROBOTS])).problems()
    monkeypatch.setattr(check_lab, "_listen", lambda seconds: (newest, {}, notices))
    monkeypatch.setattr(check_lab, "read_graph", lambda: NodeGraph([], []))
    monkeypatch.setattr(check_lab.rospy, "get_param", lambda _name, default: default)
    monkeypatch.setattr(check_lab.rospy, "has_param", lambda _name: False)
    lines = [line for line in check_lab.observe_lab(0.0) if line.robot]
    assert {line.robot for line in lines} == {"ada", "bob"}
    errors = [(line.robot, line.code) for line in lines if line.severity is Severity.ERROR]
    assert errors == [("bob", "robot_ignores_borders")]
