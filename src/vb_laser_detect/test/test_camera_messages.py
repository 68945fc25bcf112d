"""How the nodes handle messages, without a master: camera_info, images, the status of other detectors."""

import contextlib
import weakref
from types import SimpleNamespace
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
import rospy
from sensor_msgs.msg import CompressedImage

from refusals import refused
from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError
from vb_core.image_format import Picture
from vb_core.notices import Severity
from vb_core.ros import images
from vb_core.ros.images import decode
from vb_laser_detect.ros import camera_geometry, detector_diagnostics
from vb_laser_detect.ros.camera_feed import LensFile
from vb_laser_detect.ros.camera_geometry import is_rectified
from vb_laser_detect.ros.camera_setup import CameraImages
from vb_laser_detect.ros.detector_diagnostics import DetectorDiagnostics
from vb_laser_detect.detection.spot_detector import DetectorParams
from vb_msgs.msg import DetectorStatus


@pytest.fixture(autouse=True)
def no_master(monkeypatch):
    monkeypatch.setattr(rospy, "Subscriber", lambda *_args, **_named: None)


def info_of(distortion, **changes):
    """Returns the camera_info of a lens whose images were rectified with another focal length."""
    lens = CameraModel(640, 480, CameraModel.ideal(640, 480, 400.0).matrix, np.array(distortion))
    message = images.info_from_camera(lens, rospy.Time(1), "lens")
    message.P = [350.0, 0, 319.5, 0, 0, 350.0, 239.5, 0, 0, 0, 1, 0]
    for name, value in changes.items():
        setattr(message, name, value)
    return message


def test_rectified_images_are_not_undistorted_again():
    assert is_rectified("/hall/image_rect_color") and is_rectified("/hall/image_rect")
    assert not is_rectified("/rect/image_raw") and not is_rectified("/hall/image_raw")
    models = {}
    for rectified in (False, True):
        topic = camera_geometry.InfoTopic("/hall/camera_info", Mock(), rectified)
        topic._on_info(info_of([-0.33, 0.12, 0.0, 0.0, 0.0]))
        models[rectified] = topic.model_for((640, 480))
    assert models[False].distorted and not models[True].distorted
    assert models[True].matrix[0, 0] == 350.0
    topic._on_info(info_of([0.0] * 5, binning_x=2))
    with refused("no_camera_info"):  # not the lens that it had before
        topic.model_for((640, 480))


def test_no_picture_outlives_its_search_without_a_lens(tmp_path):
    lens, pictures = LensFile(tmp_path / "red.yaml"), []

    def search():
        picture = np.zeros(3)
        pictures.append(weakref.ref(picture))
        with contextlib.suppress(CodedError):
            lens.model_for((640, 480))

    for _ in range(3):
        search()
    assert not any(picture() is not None for picture in pictures)


@pytest.fixture
def report(monkeypatch):
    """Returns a function that makes a detector's diagnostics, with a clock set by the test, which publish nothing."""
    monkeypatch.setattr(rospy, "Publisher", Mock())
    monkeypatch.setattr(detector_diagnostics, "Worker", Mock())
    notices, clock = Mock(), [rospy.Time(100)]
    monkeypatch.setattr(detector_diagnostics, "NoticePublisher", lambda source: notices)
    monkeypatch.setattr(rospy.Time, "now", staticmethod(lambda: clock[0]))
    monkeypatch.setattr(rospy, "get_time", lambda: clock[0].to_sec())

    def make(mobile=False, own_source=False):
        found = DetectorDiagnostics("/red", "red", SimpleNamespace(received=0, dropped=0), mobile, own_source)
        found.at = lambda seconds: clock.__setitem__(0, rospy.Time.from_sec(seconds))

        def told():
            found._publish()
            (newest,), _ = notices.set.call_args
            return [(notice.code, notice.severity, notice.camera) for notice in newest]

        found.told = told
        return found

    return make


@pytest.mark.parametrize("mobile", [False, True])
def test_ceiling_cameras_that_share_a_frame_are_named(report, mobile):
    red = report(mobile=mobile)
    for camera, robots in (("green", False), ("robot", True), ("red", False)):
        red.record_detector(DetectorStatus(camera=camera, mobile=robots, frame_id="head_camera"))
    red.require_own_frame("red_optical_frame")
    with contextlib.nullcontext() if mobile else refused("shared_frame") as raised:
        red.require_own_frame("head_camera")
    assert mobile or raised.value.values["cameras"] == "green, red"


def play(report, began, ends, rate=10.0, age=0.02, search=0.01, level=100, content="color"):
    """Reports images as searched, from one time [s] to another."""
    for now in np.arange(began, ends, 1.0 / rate):
        report.at(now)
        picture = Picture(np.full((48, 64), level, np.uint8), content)
        report.record_image(rospy.Time.from_sec(now - age - search), "red_frame", picture, None, search)


@pytest.mark.parametrize(
    "kinds, images, told",
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
def test_what_is_wrong_with_images_is_told(report, kinds, images, told):
    red = report(**kinds)
    play(red, 100.0, 108.0, **images)
    assert red.told() == [(code, severity, "red") for code, severity in told]


def test_a_camera_that_sends_nothing_is_silent_and_not_too_bright(report):
    red = report()
    play(red, 100.0, 108.0, level=255, age=60.0)
    assert [code for code, _, _ in red.told()] == ["camera_clock", "camera_too_bright"]
    for now in np.arange(108.0, 120.0, 0.5):
        red.at(now)
        codes = [code for code, _, _ in red.told()]
        assert codes == ["camera_silent"] or "camera_silent" not in codes
    assert codes == ["camera_silent"]


def test_source_reports_only_why_it_is_silent(report):
    red = report(own_source=True)
    red.set_source_fault(CodedError("camera_unplugged", source="/dev/video0"), is_silent=True)
    red.at(200.0)
    red.clear_refused_setting()
    assert red.told() == [("camera_unplugged", Severity.ERROR, "red")]
    red.set_source_fault(CodedError("control_refused", source="/dev/video0", why="gain"), is_silent=False)
    play(red, 200.0, 208.0)
    assert red.told() == [("control_refused", Severity.WARNING, "red")]
    red.clear_refused_setting()  # somebody chose other settings, which the camera accepted
    assert red.told() == []
    red.at(220.0)
    assert red.told() == [("camera_silent", Severity.ERROR, "red")]


def test_a_rate_that_varies_about_the_limit_is_told_throughout(report):
    red, told = report(), []
    for now in range(100, 160):
        play(red, float(now), now + 1.0, rate=7.0 if now // 4 % 2 else 3.0)
        told.append([code for code, *_ in red.told()])
    assert all(codes == ["camera_slow"] for codes in told[10:])
    for now in range(160, 175):
        play(red, float(now), now + 1.0)
        told.append([code for code, *_ in red.told()])
    assert told[-1] == []


def test_a_calibration_sees_spots_as_the_camera_s_detector_does(monkeypatch):
    params = {"/spot_detector_red": {"detector": {"max_diameter_mm": 60.0, "max_dwell_time": 20.0}}}
    monkeypatch.setattr(rospy, "get_param", params.get)
    assert CameraImages("red", own_source=False).detector_params.max_diameter_mm == 60.0
    assert CameraImages("green", own_source=False).detector_params == DetectorParams()


@pytest.mark.parametrize(
    "kind, shape, encoding",
    [
        ("bgr8; jpeg compressed bgr8", (32, 32, 3), "bgr8"),
        ("bayer_rggb8; jpeg compressed bgr8", (32, 32, 3), "bgr8"),  # converted by the driver
        ("bayer_rggb8; png compressed ", (32, 32), "bayer_rggb8"),
        ("mono8; jpeg compressed ", (32, 32), "mono8"),
        ("jpeg", (32, 32), "mono8"),
    ],
)
def test_a_compressed_image_s_format_says_whether_it_is_a_mosaic(kind, shape, encoding):
    message = CompressedImage(format=kind, data=cv2.imencode(".png", np.zeros(shape, np.uint8))[1].tobytes())
    assert decode(message)[1] == encoding
