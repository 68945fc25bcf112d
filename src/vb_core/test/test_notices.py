"""Notices: each node's list replaces its last one; what a silent node said is forgotten."""

from types import SimpleNamespace

import pytest
import rospy

from vb_core.ros import notices
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


def test_that_a_camera_has_no_pose_is_told_once_if_its_calibration_says_why():
    book = ActiveNotices()
    book.update(
        "a_detector", [Notice("camera_no_pose", Severity.ERROR, camera=name) for name in ("north", "south")], 10.0
    )
    book.update("camera_poses", [Notice("camera_not_calibrated", Severity.ERROR, camera="north")], 10.0)
    assert {(notice.code, notice.camera) for notice in book.current(10.0)} == {
        ("camera_not_calibrated", "north"),
        ("camera_no_pose", "south"),
    }


@pytest.mark.parametrize("other", ["cameras_disagree", "camera_clock", "camera_not_calibrated", "camera_too_bright"])
def test_nothing_else_about_a_camera_hides_that_it_is_silent(other):
    # what two cameras saw minutes ago says nothing about the cable
    book = ActiveNotices()
    book.update("spot_detector_north", [Notice("camera_silent", Severity.ERROR, camera="north")], 10.0)
    book.update("camera_poses", [Notice(other, Severity.ERROR, camera="north")], 10.0)
    assert "camera_silent" in [notice.code for notice in book.current(10.0)]


def test_a_warning_that_becomes_an_error_is_logged_again(monkeypatch):
    logged = []
    monkeypatch.setattr(rospy, "Publisher", lambda *_, **__: SimpleNamespace(publish=lambda message: None))
    monkeypatch.setattr(notices.node, "Worker", lambda *_: None)
    monkeypatch.setattr(rospy.Time, "now", lambda: rospy.Time(1))
    for level in ("logwarn", "logerr"):
        monkeypatch.setattr(rospy, level, lambda text, *_, level=level: logged.append(level))
    publisher = notices.NoticePublisher()
    for severity in (Severity.INFO, Severity.WARNING, Severity.ERROR, Severity.WARNING, Severity.ERROR):
        publisher.set([Notice("robot_inside", severity, robot="r1")])
    assert logged == ["logwarn", "logerr"]
