"""What a detector's diagnostics report about its camera, without a master."""

from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
import rospy

from vb_core.errors import CodedError
from vb_core.image_format import Picture
from vb_core.notices import Severity
from vb_laser_detect.ros import detector_diagnostics
from vb_laser_detect.ros.detector_diagnostics import DetectorDiagnostics
from vb_msgs.msg import DetectorStatus


class RedDiagnostics(DetectorDiagnostics):
    """The diagnostics of a camera `red`, whose clock [s] the test sets by `now`, and which publish nothing."""

    now = 100.0

    def __init__(self, mobile=False, own_source=False):
        super().__init__("/red", "red", SimpleNamespace(received=0, dropped=0), mobile, own_source)

    def record_images(self, start, end, rate=10.0, age=0.02, search=0.01, level=100, content="color"):
        """Records images from one time [s] to another, whose pixels are all `level` [grey levels]."""
        for now in np.arange(start, end, 1.0 / rate):
            RedDiagnostics.now = now
            picture = Picture(np.full((48, 64), level, np.uint8), content)
            self.record_image(rospy.Time.from_sec(now - age - search), "red_frame", picture, 0.0, None, search)

    def notices(self):
        """Returns the code and severity of each notice that is published now."""
        self._publish()
        (newest,), _ = self._notices.set.call_args
        assert all(notice.camera == "red" for notice in newest)
        return [(notice.code, notice.severity) for notice in newest]


@pytest.fixture(autouse=True)
def no_master(monkeypatch):
    monkeypatch.setattr(rospy, "Publisher", Mock())
    monkeypatch.setattr(detector_diagnostics, "Worker", Mock())
    monkeypatch.setattr(detector_diagnostics, "NoticePublisher", Mock())
    monkeypatch.setattr(RedDiagnostics, "now", 100.0)
    monkeypatch.setattr(rospy, "get_time", lambda: RedDiagnostics.now)
    monkeypatch.setattr(rospy.Time, "now", staticmethod(lambda: rospy.Time.from_sec(RedDiagnostics.now)))


def test_only_frames_of_other_ceiling_cameras_are_recorded():
    red = RedDiagnostics()
    for camera, is_on_robot in (("green", False), ("robot", True), ("red", False)):
        red.record_detector(DetectorStatus(camera=camera, mobile=is_on_robot, frame_id="head_camera"))
    assert red.frames_of_others() == {"green": "head_camera"}


@pytest.mark.parametrize(
    "camera, images, notices",
    [
        ({}, {}, []),
        ({}, {"content": "mono"}, []),
        ({"mobile": True}, {"content": "mono"}, [("no_color", Severity.WARNING)]),
        ({}, {"rate": 2.0}, [("camera_slow", Severity.WARNING)]),
        ({}, {"level": 255}, [("camera_too_bright", Severity.WARNING)]),
        ({}, {"age": 60.0}, [("camera_clock", Severity.ERROR)]),
        ({}, {"age": -4.0}, [("camera_clock", Severity.ERROR)]),
        ({}, {"search": 2.0}, []),  # a busy computer is not a wrong clock
        ({"own_source": True}, {"age": 3.0}, []),  # its delay is known, and it shares our clock
    ],
)
def test_faults_of_images_are_reported(camera, images, notices):
    red = RedDiagnostics(**camera)
    red.record_images(100.0, 108.0, **images)
    assert red.notices() == notices


def test_a_camera_that_sends_nothing_is_silent_and_not_too_bright():
    red = RedDiagnostics()
    red.record_images(100.0, 108.0, level=255, age=60.0)
    assert [code for code, _ in red.notices()] == ["camera_clock", "camera_too_bright"]
    for now in np.arange(108.0, 120.0, 0.5):
        RedDiagnostics.now = now
        codes = [code for code, _ in red.notices()]
        assert codes == ["camera_silent"] or "camera_silent" not in codes
    assert codes == ["camera_silent"]


def test_source_reports_only_why_it_is_silent():
    red = RedDiagnostics(own_source=True)
    red.set_source_fault(CodedError("camera_unplugged", source="/dev/video0"), is_silent=True)
    RedDiagnostics.now = 200.0
    red.clear_refused_setting()
    assert red.notices() == [("camera_unplugged", Severity.ERROR)]
    red.set_source_fault(CodedError("control_refused", source="/dev/video0", why="gain"), is_silent=False)
    red.record_images(200.0, 208.0)
    assert red.notices() == [("control_refused", Severity.WARNING)]
    red.clear_refused_setting()  # somebody chose other settings, which the camera accepted
    assert red.notices() == []
    RedDiagnostics.now = 220.0
    assert red.notices() == [("camera_silent", Severity.ERROR)]


def test_a_rate_that_varies_about_the_limit_is_reported_throughout():
    red = RedDiagnostics()
    for now in range(100, 160):
        red.record_images(float(now), now + 1.0, rate=7.0 if now // 4 % 2 else 3.0)
        assert red.notices() == [("camera_slow", Severity.WARNING)] or now < 110
    red.record_images(160.0, 175.0)
    assert red.notices() == []
