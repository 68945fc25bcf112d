"""Notices: each node's list replaces its last one; what a silent node said is forgotten."""

from vb_core.notices import EXPIRY_TIME, Notice, ActiveNotices, Severity


def test_a_node_takes_back_by_saying_less():
    book = ActiveNotices()
    book.update("monitor1", [Notice("robot_inside", robot="r1"), Notice("goal_inside", robot="r1")], 1.0)
    book.update("monitor2", [Notice("robot_inside", robot="r2")], 1.0)
    book.update("monitor1", [Notice("goal_inside", robot="r1")], 2.0)
    assert {(notice.code, notice.robot) for notice in book.current(2.0)} == {
        ("goal_inside", "r1"),
        ("robot_inside", "r2"),
    }


def test_what_a_silent_node_said_is_forgotten():
    book = ActiveNotices()
    book.update("monitor", [Notice("robot_inside")], 1.0)
    assert book.current(1.0 + EXPIRY_TIME)
    assert not book.current(1.1 + EXPIRY_TIME)


def test_the_most_severe_comes_first():
    book = ActiveNotices()
    book.update("a", [Notice("x"), Notice("y", Severity.ERROR)], 0.0)
    book.update("b", [Notice("z", Severity.WARNING)], 0.0)
    assert [notice.code for notice in book.current(0.0)] == ["y", "z", "x"]


def test_a_stop_of_all_robots_is_not_said_again_of_each_one():
    book = ActiveNotices()
    book.update("driver", [Notice("robot_stopped", robot="r1")], 0.0)
    assert [notice.code for notice in book.current(0.0)] == ["robot_stopped"]
    book.update("manager", [Notice("stopped")], 0.0)
    assert [notice.code for notice in book.current(0.0)] == ["stopped"]


def test_a_sentence_by_language_or_else_the_message():
    notice = Notice("no_response", values={"who": "lidar"}, message="of another version")
    assert notice.sentence("de") == "lidar antwortet nicht."
    assert Notice("unheard_of", message="It rains.").sentence("de") == "It rains."


def test_a_silent_camera_is_told_once_if_its_detector_knows_why():
    book = ActiveNotices()
    book.update(
        "a_detector", [Notice("camera_silent", Severity.ERROR, camera=name) for name in ("north", "south")], 10.0
    )
    book.update("spot_detector_north", [Notice("camera_unplugged", Severity.ERROR, camera="north")], 10.0)
    assert {(notice.code, notice.camera) for notice in book.current(10.0)} == {
        ("camera_unplugged", "north"),
        ("camera_silent", "south"),
    }


def test_a_mere_warning_about_a_camera_does_not_hide_that_it_is_silent():
    book = ActiveNotices()
    warning = Notice("camera_too_bright", Severity.WARNING, camera="north")
    book.update("spot_detector_north", [Notice("camera_silent", Severity.ERROR, camera="north"), warning], 10.0)
    assert [notice.code for notice in book.current(10.0)] == ["camera_silent", "camera_too_bright"]
