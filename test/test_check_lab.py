"""check_lab names the faults that only the whole lab shows, and repeats the notices of its nodes."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from nav_msgs.msg import OccupancyGrid

from vb_bringup import lab_checks, lab_observation
from vb_bringup.lab_checks import is_all_known, lines_from_notices
from vb_core import names
from vb_core.grid_map import GridMap
from vb_core.map_files import read_map, write_map
from vb_core.notices import Notice, Severity
from vb_core.offer import ConnectedRobot, Connections, offer


def codes(lines):
    return [line.code for line in lines if line.state is not Severity.INFO]


GOOD = {
    "camera": dict(name="north", topic="/north/image_raw", publishers=["/north/usb_cam"], rate=15.0),
    "robot": dict(name="ada", keeps_margin=True, scan_topic="/ada/scan", scan_deg=270.0, clears_plans=False),
    "map": dict(size=(5.0, 10.0), publishers=["/map_server"], with_borders=True, file="", all_known=False),
    "disk": dict(folder="/x", free_mb=9000.0),
    "nodes": dict(missing=[]),
}


@pytest.mark.parametrize(
    "what, changes, code",
    [
        *((what, {}, "") for what in GOOD),
        ("camera", dict(topic=""), ""),  # the detector reads the camera itself
        ("camera", dict(publishers=[]), "lab_camera_no_publisher"),
        ("camera", dict(publishers=[], others=["/north/image_rect_color"]), "lab_camera_other_topic"),
        ("camera", dict(publishers=["/a", "/b"]), "lab_camera_many_publishers"),
        ("camera", dict(topic="", publishers=(), no_delay=True), "lab_camera_no_delay"),
        ("robot", dict(scan_deg=0.0), "lab_robot_no_scan"),
        ("robot", dict(scan_deg=30.0), "lab_robot_narrow_scan"),
        ("robot", dict(scan_deg=None), ""),  # without a driver nobody here needs it
        ("robot", dict(keeps_margin=False), "lab_robot_without_margin"),
        ("robot", dict(keeps_margin=False, scan_deg=None), ""),
        ("robot", dict(clears_plans=True), "lab_robot_clears_plans"),
        ("map", dict(size=None), "lab_map_missing"),
        ("map", dict(size=None, file="room.yaml"), "lab_map_not_served"),
        ("map", dict(publishers=["/a", "/b"]), "lab_map_many_publishers"),
        ("map", dict(with_borders=False), "lab_map_without_borders"),
        ("map", dict(all_known=True), "lab_map_all_known"),
        ("disk", dict(writable=False), "lab_disk_read_only"),
        ("disk", dict(free_mb=10.0), "lab_disk_full"),
        ("nodes", dict(missing=["/map_integrator"]), "lab_node_missing"),
    ],
)
def test_each_mistake_in_a_lab_is_named(what, changes, code):
    arguments = {**GOOD[what], **changes}
    result = getattr(lab_checks, f"check_{what}")(**arguments)
    lines = result if isinstance(result, list) else [result]
    assert codes(lines) == [code] * bool(code)
    assert all(what not in ("camera", "robot") or arguments["name"] in line.sentence() for line in lines)


@pytest.mark.parametrize("free_thresh, is_reported", [(0.196, False), (0.25, True)])
def test_a_map_whose_unknown_cells_are_read_as_free_is_reported(tmp_path, free_thresh, is_reported):
    """10 of 183 maps of public repositories had free_thresh 0.25 with pixels of 205."""
    cells = np.full((20, 20), -1, np.int8)
    cells[5:15, 5:15] = 100
    cells[6:14, 6:14] = 0
    _, path = write_map(tmp_path / "map", GridMap(cells, 0.05))
    path.write_text(path.read_text().replace("free_thresh: 0.196", f"free_thresh: {free_thresh}"))
    again = read_map(path).data
    assert is_all_known(again) is is_reported
    assert not is_all_known(again[5:15, 5:15])  # a room that is known completely, with walls all round


@pytest.mark.parametrize("height, width", [(0, 0), (3, 4), (2, 2)])
def test_a_map_of_the_wrong_size_does_not_end_the_check(height, width, monkeypatch):
    monkeypatch.setattr(lab_observation.rospy, "get_param", lambda _name, default: default)
    message = OccupancyGrid()
    message.info.height, message.info.width, message.data = height, width, [0] * 5
    found = lab_observation._check_map(SimpleNamespace(publishers={}), {names.PHYSICAL_MAP: message})
    assert codes(found) == ["lab_map_without_borders"]


def test_each_notice_is_a_line():
    cameras = {"first": "north", "second": "south", "cm": "9"}
    found = lines_from_notices(
        [
            Notice("cameras_disagree", Severity.ERROR, camera="south", values=cameras),
            Notice("robot_sent", Severity.INFO),
            Notice("strokes_left_out", Severity.WARNING, values={"spots": "7"}),
            Notice("borders_unconfirmed", Severity.WARNING),
            Notice("of_another_version", Severity.ERROR, robot="ada", message="It rains."),
        ]
    )
    assert [(line.subject, line.state, line.code) for line in found] == [
        ("camera south", Severity.ERROR, "cameras_disagree"),
        ("robot", Severity.INFO, "robot_sent"),
        ("lab", Severity.WARNING, "strokes_left_out"),
        ("borders", Severity.WARNING, "borders_unconfirmed"),
        ("robot ada", Severity.ERROR, "of_another_version"),
    ]
    assert "9 cm" in found[0].sentence() and "Kameras" in found[0].sentence("de")
    assert found[-1].sentence() == "It rains."


def test_each_connection_of_a_robot_is_one_line():
    good = ConnectedRobot("ada", navigation=True, plans_round_borders=True, localized=True)
    bad = dataclasses.replace(good, name="bob", plans_round_borders=False)
    lines = lines_from_notices(offer(Connections((good, bad))).lines)
    assert {line.subject for line in lines} == {"robot ada", "robot bob"}
    assert [(line.subject, line.code) for line in lines if line.state is Severity.ERROR] == [
        ("robot bob", "robot_ignores_borders")
    ]
    # robot_monitor reports the same some seconds later
    assert lines_from_notices(offer(Connections((good, bad))).notices(), lines) == []
