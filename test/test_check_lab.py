"""check_lab's judgement: each mistake that people made is named, with what cures it."""

import dataclasses
import struct
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from vb_bringup import lab_observation
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
    drop_recovered,
    lines_from_notices,
    notices_from_lines,
    worst_state,
)
from vb_bringup.lab_monitor import CameraComparison, DetectorWatch
from nav_msgs.msg import OccupancyGrid
from vb_core import names, sentences
from vb_core.grid_map import GridMap
from vb_core.map_files import read_map, write_map
from vb_core.notices import Notice, Severity
from vb_core.offer import ConnectedRobot, Connections, offer

GOOD = CameraObservation(
    name="north",
    topic="/north/image_raw",
    publishers=["/north/usb_cam"],
    rate=15.0,
    age=0.03,
    width=640,
    height=480,
    encoding="rgb8",
    frame="north_optical_frame",
    info=CameraInfoObservation(640, 480, 500.0),
    detector="/spot_detector_north",
    has_pose=True,
    file="/lab/north.yaml",
    file_frame="north_optical_frame",
)


def codes(lines):
    return [line.code for line in lines if line.state is not CheckState.OK]


def test_a_good_camera_is_one_line():
    lines = check_cameras([GOOD])
    assert len(lines) == 1 and lines[0].state is CheckState.OK


@pytest.mark.parametrize(
    "changes, code",
    [
        (dict(detector=""), "lab_camera_no_detector"),
        (dict(publishers=[]), "lab_camera_no_publisher"),
        (dict(publishers=[], others=["/north/image_rect_color"]), "lab_camera_other_topic"),
        (dict(rate=0.0), "lab_camera_silent"),
        (dict(publishers=["/a", "/b"]), "lab_camera_many_publishers"),
        (dict(rate=2.0), "lab_camera_slow"),
        (dict(age=3600.0), "lab_camera_clock"),
        (dict(age=-4.0), "lab_camera_clock"),
        (dict(no_delay=True), "lab_camera_no_delay"),
        (dict(bright=0.3), "lab_camera_too_bright"),
        (dict(info=None), "lab_camera_no_info"),
        (dict(info=CameraInfoObservation(640, 480, 0.0)), "lab_camera_not_calibrated"),
        (dict(info=CameraInfoObservation(1280, 720, 500.0)), "lab_camera_info_size"),
        (dict(frame=""), "lab_camera_no_frame"),
        (
            dict(file_error="there is no '/lab/north.yaml'.", file_missing=True, has_pose=False),
            "lab_camera_no_calibration",
        ),
        (dict(file_error="there is no '/lab/north.yaml'.", file_missing=True), "lab_camera_file_broken"),
        (dict(file_error="it is no YAML", has_pose=False), "lab_camera_file_broken"),
        (dict(file_error="of another", file_camera="south"), "lab_camera_wrong_file"),
        (dict(file_frame="head_camera"), "lab_camera_frame_differs"),
        (dict(file_focal=1.04 * GOOD.info.focal), "lab_camera_other_lens"),
        (dict(file="", file_frame="", has_pose=False), "lab_camera_no_pose"),
    ],
)
def test_each_mistake_with_a_camera_is_named(changes, code):
    assert codes(check_cameras([dataclasses.replace(GOOD, **changes)])) == [code]


def test_two_cameras_with_the_drivers_default_frame_are_both_named():
    shared = dataclasses.replace(GOOD, frame="head_camera", file_frame="", file_error="there is no such file")
    both = [dataclasses.replace(shared, name=name) for name in "ab"]
    lines = check_cameras(both)
    # not also that the pose is not known: it will get another frame first
    assert codes(lines) == ["lab_camera_frame_shared"] * 2 and len(notices_from_lines(lines)) == 2
    assert "b" in lines[0].values["others"] and "a_optical_frame" in lines[0].sentence()
    # one that was calibrated under its own frame gets that one back
    known = check_cameras([both[0], dataclasses.replace(both[1], file_error="", file_frame="b_frame")])[1]
    assert known.code == "lab_camera_frame_shared" and known.values["own"] == "b_frame"


def test_every_notice_about_a_camera_or_robot_names_it():
    from vb_core.sentences import catalog, languages, placeholders

    for language in languages():
        for code, sentence in catalog(language).items():
            if code.startswith("lab_camera_"):
                assert "camera" in placeholders(sentence.split(":")[0]), code
            if code.startswith("lab_robot_"):
                assert "robot" in placeholders(sentence), code


def test_no_camera_at_all_is_a_warning():
    assert check_cameras([])[0].state is CheckState.WARNING


@pytest.mark.parametrize(
    "changes, code",
    [
        (dict(scan_deg=0.0), "lab_robot_no_scan"),
        (dict(scan_deg=30.0), "lab_robot_narrow_scan"),
        (dict(pose_age=1.5), "lab_robot_old_pose"),
        (dict(pose_age=-1.5), "lab_robot_old_pose"),
        (dict(keeps_margin=False), "lab_robot_without_margin"),
        (dict(color_frame="rgb", depth_frame="ir"), "lab_robot_depth_not_registered"),
        (dict(clears_plans=True), "lab_robot_clears_plans"),
    ],
)
def test_each_mistake_with_a_robot_is_named(changes, code):
    good = RobotObservation("", driven=True, pose_age=0.2, scan_deg=270.0)
    assert not codes(check_robot(good))
    assert codes(check_robot(dataclasses.replace(good, **changes))) == [code]


def test_what_readme_links_to_asks_for_no_map_that_only_a_driver_publishes():
    """move_base waits for such a map for ever, and offers no action server meanwhile."""
    top = Path(__file__).resolve().parents[1]
    assert "(docs/tutorials/your-own-robot.md)" in (top / "README.md").read_text(encoding="utf-8")
    page = (top / "docs" / "tutorials" / "your-own-robot.md").read_text(encoding="utf-8")
    before_the_driver, step_3 = page.split("## 3. The driver")
    assert "keep_out" not in before_the_driver and "keep_out_layer" in step_3
    assert len(page.splitlines()) <= 60


def test_a_robot_without_a_driver_needs_no_scan_of_ours():
    assert not codes(check_robot(RobotObservation("")))


def test_what_is_connected_to_a_robot_is_a_line_with_its_severity():
    good = ConnectedRobot("ada", navigation=True, plans_round_borders=True, localized=True)
    lines = check_robots(offer(Connections((good, dataclasses.replace(good, name="bob", plans_round_borders=False)))))
    assert [line.code for line in lines if line.subject == "robot ada"] == [
        "robot_plans_round_borders",
        "robot_obeys_borders_only",
    ]
    assert [(line.subject, line.code) for line in lines if line.state is CheckState.ERROR] == [
        ("robot bob", "robot_ignores_borders")
    ]
    assert notices_from_lines(lines) == []  # robot_monitor tells them


@pytest.mark.parametrize(
    "changes, code",
    [
        (dict(shape=None), "lab_map_missing"),
        (dict(shape=None, file="room.yaml"), "lab_map_not_served"),
        (dict(publishers=["/a", "/b"]), "lab_map_many_publishers"),
        (dict(with_borders=False), "lab_map_without_borders"),
        (dict(all_known=True), "lab_map_all_known"),
    ],
)
def test_each_mistake_with_the_map_is_named(changes, code):
    good = MapObservation((100, 200), 0.05, ["/map_server"], True)
    assert not codes(check_map(good))
    assert codes(check_map(dataclasses.replace(good, **changes))) == [code]


@pytest.mark.parametrize("free_thresh, is_told", [(0.196, False), (0.25, True)])
def test_a_map_file_whose_unknown_is_read_as_free_is_told(tmp_path, free_thresh, is_told):
    """10 of 183 maps of public repositories had free_thresh 0.25 with pixels of 205."""
    cells = np.full((20, 20), -1, np.int8)
    cells[5:15, 5:15] = 100
    cells[6:14, 6:14] = 0
    _, path = write_map(tmp_path / "map", GridMap(cells, 0.05))
    path.write_text(path.read_text().replace("free_thresh: 0.196", f"free_thresh: {free_thresh}"))
    assert lab_observation.is_all_known(read_map(path).data) is is_told
    assert not lab_observation.is_all_known(
        read_map(path).data[5:15, 5:15]
    )  # a room that is known whole, with walls all round


@pytest.mark.parametrize("height, width", [(0, 0), (3, 4), (2, 2)])
def test_a_map_that_says_other_than_it_carries_does_not_end_the_check(height, width):
    message = OccupancyGrid()
    message.info.height, message.info.width, message.data = height, width, [0] * 5
    streams = {
        names.PHYSICAL_MAP: SimpleNamespace(message=lambda: message),
        names.MAP_WITH_BORDERS: SimpleNamespace(message=lambda: None),
    }
    seen = lab_observation._map(SimpleNamespace(publishers={}), streams)
    assert (seen.shape, seen.all_known) == ((height, width), False)


@pytest.mark.parametrize("reason", ["disabled", "off_schedule", "other_robot"])
def test_a_border_that_its_owner_wants_out_of_force_is_no_problem_and_is_named(reason):
    lines = check_borders([BorderObservation("rug", True), BorderObservation("wall 1", False, reason)])
    assert [line.state for line in lines] == [CheckState.OK, CheckState.OK]
    assert lines[0].sentence() == "Borders in force: 1 of 2." and "Wall 1" in lines[1].sentence()
    assert "Wand 1" in lines[1].sentence("de")


@pytest.mark.parametrize("reason", ["inactive_on_this_map", "no_effect", "of_a_newer_version", ""])
def test_a_border_that_should_be_in_force_and_cannot_is_a_warning(reason):
    lines = check_borders([BorderObservation("rug", False, reason), BorderObservation("desk", False, "disabled")])
    assert codes(lines) == ["lab_borders_not_in_force"] and worst_state(lines) is CheckState.WARNING
    [warning] = [line for line in lines if line.state is CheckState.WARNING]
    assert "rug" in warning.sentence() and "desk" not in warning.sentence()


def test_many_borders_do_not_fill_the_line():
    lines = check_borders([BorderObservation(f"border {number}", False, "disabled") for number in range(1, 6)])
    assert lines[1].values["borders"] == "border 1, border 2, border 3, ..."


def test_a_doubtful_place_is_told_once_and_only_by_the_check_while_it_says_more():
    lines = check_borders([BorderObservation("rug", True)], needs_confirmation=True)
    assert codes(lines) == ["lab_borders_need_confirmation"]
    doubt = Notice("borders_unconfirmed", Severity.WARNING)
    assert lines_from_notices([doubt], lines) == []
    assert [line.subject for line in lines_from_notices([doubt], [])] == ["borders"]


def test_errors_that_no_node_reports_are_reported():
    slow = CheckLine("x", CheckState.WARNING, "lab_camera_slow")
    lines = [check_disk("/x", 10.0), *check_cameras([dataclasses.replace(GOOD, detector="")]), slow]
    assert [(notice.code, notice.severity) for notice in notices_from_lines(lines)] == [
        ("lab_disk_full", Severity.ERROR)
    ]
    assert notices_from_lines(lines)[0].sentence() == lines[0].sentence()


def test_what_the_nodes_tell_people_is_part_of_the_result():
    apart = Notice(
        "cameras_disagree", Severity.ERROR, camera="south", values={"first": "north", "second": "south", "cm": "9"}
    )
    everyday = Notice("goal_cancelled", Severity.INFO)
    doubt = Notice("strokes_left_out", Severity.WARNING, values={"spots": "7"})
    fine = check_cameras([GOOD])
    found = lines_from_notices([apart, everyday, doubt], fine)
    assert [(line.subject, line.state, line.code) for line in found] == [
        ("camera south", CheckState.ERROR, "cameras_disagree"),
        ("lab", CheckState.WARNING, "strokes_left_out"),
    ]
    assert "9 cm" in found[0].sentence() and worst_state(fine + found) is CheckState.ERROR
    assert not notices_from_lines(found)  # the node that told it goes on telling it


def test_what_a_check_says_more_exactly_is_not_reported_twice():
    south = dataclasses.replace(GOOD, name="south", frame="south", file_frame="head_camera")
    lines = check_cameras([dataclasses.replace(GOOD, rate=0.0), south])
    told = [
        Notice("camera_silent", Severity.ERROR, camera="north"),
        Notice("camera_no_pose", Severity.ERROR, camera="south"),
        *notices_from_lines(lines),
    ]
    assert lines_from_notices(told, lines) == []
    assert [line.code for line in lines_from_notices(told, check_cameras([GOOD]))] == [
        "camera_silent",
        "camera_no_pose",
        "lab_camera_silent",
        "lab_camera_frame_differs",
    ]


def test_a_node_that_is_back_is_no_longer_missing():
    lines = [*check_nodes(["/map_integrator", "/border_fusion"]), check_disk("/x", 10.0)]
    assert drop_recovered(lines, {"/map_integrator", "/page"}, ()) == lines[1:]


def test_a_camera_that_never_sent_an_image_is_the_checks_and_later_its_detectors_own_matter():
    lines = check_cameras([dataclasses.replace(GOOD, rate=0.0), dataclasses.replace(GOOD, name="south", publishers=[])])
    assert [line.code for line in drop_recovered(lines, (), ())] == ["lab_camera_silent", "lab_camera_no_publisher"]
    assert [line.values["camera"] for line in drop_recovered(lines, (), {"north"})] == ["south"]


def test_a_full_disk_is_an_error():
    assert check_disk("/x", 9000.0, writable=False).code == "lab_disk_read_only"
    assert check_disk("/x", 10.0).state is CheckState.ERROR and check_disk("/x", 9000.0).state is CheckState.OK


def test_the_worst_line_decides():
    states = (CheckState.OK, CheckState.ERROR, CheckState.WARNING)
    assert worst_state([CheckLine("lab", state, "x") for state in states]) is CheckState.ERROR


def test_every_line_has_a_sentence_in_every_language():
    import ast
    from pathlib import Path

    import vb_bringup.lab_checks as lab

    used = {
        node.value
        for node in ast.walk(ast.parse(Path(lab.__file__).read_text()))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.startswith("lab_")
    }
    assert len(used) > 30
    for language in sentences.languages():
        assert used <= set(sentences.catalog(language)), language


# ------------------------------------------------------------ while people work
def told(watch, now):
    return [(notice.code, notice.camera) for notice in watch.notices(now)]


def test_what_a_detector_says_of_itself_is_told_until_it_says_otherwise():
    watch = DetectorWatch(["north", "south"], 0.0)
    watch.update("north", "", 1.0)
    watch.update("south", "camera_silent", 1.0)
    assert told(watch, 2.0) == [("camera_silent", "south")]
    watch.update("south", "", 2.0)
    assert told(watch, 3.0) == []


def test_a_detector_that_is_gone_is_reported():
    watch = DetectorWatch(["north", "south"], 0.0)
    watch.update("north", "", 1.0)
    assert told(watch, 16.0) == [("detector_missing", "north")]
    # one that was not heard yet may still be starting
    assert told(watch, 61.0) == [("detector_missing", "north"), ("detector_missing", "south")]
    assert all(notice.severity is Severity.ERROR for notice in watch.notices(61.0))


def test_cameras_that_see_the_laser_at_different_places_are_named_until_they_agree():
    comparison, random = CameraComparison(), np.random.default_rng(5)

    def draw(began, off, lasts=30.0):
        """Drawing where all three see it; the images of none come with those of another."""
        for camera, late, moved in (("north", 0.0, 0.0), ("south", 0.05, off), ("east", 0.02, 0.0)):
            for t in np.arange(began, began + lasts, 0.12) + late:
                x, y = 2.0 + 0.5 * np.cos(0.4 * t) + moved, 1.0 + 0.5 * np.sin(0.4 * t)
                comparison.add_spot(camera, t, *(np.array([x, y]) + random.normal(0.0, 0.02, 2)))

    draw(100.0, 0.02)
    assert comparison.notices(131.0) == []
    draw(200.0, 0.11)  # one was turned by two degrees
    found = comparison.notices(231.0)
    assert {(one.values["first"], one.values["second"]) for one in found} == {("east", "south"), ("north", "south")}
    assert {one.code for one in found} == {"cameras_disagree"} and all(8 < int(one.values["cm"]) < 14 for one in found)
    # calibrated again; the laser is still on, and the detector has the former pose a moment longer
    comparison.clear("south", 232.0)
    draw(230.5, 0.11, lasts=5.5)
    assert comparison.notices(237.0) == []
    draw(300.0, 0.0)
    assert comparison.notices(331.0) == []


@pytest.mark.parametrize("wall, expected", [(True, -0.25), (False, 0.125)])
def test_delayed_simulated_time_makes_no_image_early(monkeypatch, wall, expected):
    """A computer's clock that is behind shifts every image; /clock that comes late shifts some."""
    monkeypatch.setattr(lab_observation.rospy, "Subscriber", lambda *_, **__: None)
    monkeypatch.setattr(lab_observation.rospy.rostime, "is_wallclock", lambda: wall)
    topic = lab_observation.ObservedTopic("/north/image_raw", None)
    for now in (99.75, 100.125, 100.5):
        monkeypatch.setattr(lab_observation.rospy, "get_time", lambda now=now: now)
        topic._on_message(SimpleNamespace(_buff=struct.pack("<III", 0, 100, 0)))
    assert topic.age() == expected
