"""Notices: each node's list replaces its last one, and those of a silent node expire."""

from types import SimpleNamespace

import pytest
import rospy

from vb_core.ros import notices
from vb_core.notices import EXPIRY_TIME, Notice, ActiveNotices, Severity


def active_notices(published, now):
    """Returns (code, robot or camera) of what is active at `now` [s], of what was `published`: (node, time, notices)."""
    book = ActiveNotices()
    for node, stamp, node_notices in published:
        book.update(node, node_notices, stamp)
    return [(notice.code, notice.robot or notice.camera) for notice in book.current(now)]


INSIDE = [Notice("robot_inside", robot="r1")]


@pytest.mark.parametrize("silent, expected", [(EXPIRY_TIME, [("robot_inside", "r1")]), (EXPIRY_TIME + 0.1, [])])
def test_the_notices_of_a_silent_node_expire(silent, expected):
    assert active_notices([("monitor", 1.0, INSIDE)], 1.0 + silent) == expected


def test_a_nodes_newest_notices_replace_its_former_ones():
    newest = [Notice("goal_inside", robot="r1")]
    of_another = [Notice("robot_inside", robot="r2"), Notice("x", Severity.WARNING), Notice("y", Severity.ERROR)]
    published = [("monitor1", 1.0, INSIDE + newest), ("monitor2", 1.0, of_another), ("monitor1", 2.0, newest)]
    assert active_notices(published, 2.0) == [("y", ""), ("x", ""), ("goal_inside", "r1"), ("robot_inside", "r2")]


def test_a_stop_of_all_robots_replaces_that_of_each():
    of_one = ("driver", 0.0, [Notice("robot_stopped", robot="r1")])
    assert active_notices([of_one], 0.0) == [("robot_stopped", "r1")]
    assert active_notices([of_one, ("manager", 0.0, [Notice("stopped")])], 0.0) == [("stopped", "")]


def test_the_reason_replaces_a_missing_pose_of_its_camera():
    unplaced = [Notice("camera_no_pose", Severity.ERROR, camera=name) for name in ("north", "south")]
    reason = [Notice("camera_not_calibrated", Severity.ERROR, camera="north")]
    active = active_notices([("a_detector", 10.0, unplaced), ("camera_poses", 10.0, reason)], 10.0)
    assert set(active) == {("camera_not_calibrated", "north"), ("camera_no_pose", "south")}


@pytest.mark.parametrize("code", ["cameras_disagree", "camera_clock", "camera_not_calibrated", "camera_too_bright"])
def test_no_other_notice_hides_a_silent_camera(code):
    # a notice of another kind says nothing about the cable
    silent = [Notice("camera_silent", Severity.ERROR, camera="north")]
    other = [Notice(code, Severity.ERROR, camera="north")]
    active = active_notices([("spot_detector_north", 10.0, silent), ("camera_poses", 10.0, other)], 10.0)
    assert ("camera_silent", "north") in active


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
