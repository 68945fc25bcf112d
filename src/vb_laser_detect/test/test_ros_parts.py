"""What the nodes make of messages, without a master: descriptions of cameras, depth, other cameras."""

import gc
import threading
import weakref

import cv2
import numpy as np
import pytest
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from diagnostic_updater import DiagnosticStatusWrapper
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header

from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError
from vb_core.image_format import Picture
from vb_core.ros import cameras
from vb_core.ros.images import compressed_encoding, array_from_compressed_image
from vb_laser_detect import calibrate_camera_node, spot_detector_node
from vb_laser_detect.detection.detector_counts import DetectorCounts
from vb_laser_detect.detector_params import DetectorParams
from vb_laser_detect import camera_geometry
from vb_laser_detect.camera_geometry import is_rectified
from vb_laser_detect.detector_diagnostics import DetectorDiagnostics, _Fault
from vb_msgs.msg import DetectorStatus


class Faults:
    """A report that keeps what it is told."""

    def __init__(self):
        self.codes = []

    def fault(self, error, missing=False):
        self.codes.append(error.code)

    def require_own_frame(self, frame_id):
        pass


@pytest.fixture(autouse=True)
def no_master(monkeypatch):
    monkeypatch.setattr(rospy, "Subscriber", lambda *_args, **_named: None)


def info_of(distortion, **changes):
    """camera_info of a lens whose images were rectified with another focal length."""
    lens = CameraModel(640, 480, CameraModel.ideal(640, 480, 400.0).matrix, np.array(distortion))
    message = cameras.info_from_camera(lens, rospy.Time(1), "lens")
    message.P = [350.0, 0, 319.5, 0, 0, 350.0, 239.5, 0, 0, 0, 1, 0]
    for name, value in changes.items():
        setattr(message, name, value)
    return message


def test_rectified_images_are_not_undistorted_again():
    assert is_rectified("/hall/image_rect_color") and is_rectified("/hall/image_rect")
    assert not is_rectified("/rect/image_raw") and not is_rectified("/hall/image_raw")
    models = {}
    for rectified in (False, True):
        topic = camera_geometry.InfoTopic("/hall/camera_info", Faults(), rectified)
        topic._on_info(info_of([-0.33, 0.12, 0.0, 0.0, 0.0]))
        models[rectified] = topic.model_for((480, 640))
    assert models[False].distorted and not models[True].distorted
    assert models[True].matrix[0, 0] == 350.0


def test_a_fisheye_and_a_region_that_is_the_whole_image_are_accepted():
    topic, report = camera_geometry.InfoTopic, Faults()
    whole = info_of([-0.02, 0.004, 0.0, 0.0], distortion_model="equidistant")
    whole.roi.width, whole.roi.height = 640, 480
    info = topic("/hall/camera_info", report)
    info._on_info(whole)
    assert info.model_for((480, 640)).fisheye and not report.codes
    part = info_of([0.0] * 5)
    part.roi.width, part.roi.height = 320, 240
    info._on_info(part)
    assert report.codes == ["unsupported_camera"]
    with pytest.raises(CodedError):
        info.model_for((480, 640))


def test_depth_of_another_frame_is_not_used():
    report = Faults()
    topic = camera_geometry.DepthTopic("/depth/image_raw", "/depth/camera_info", report)
    depth = np.full((48, 64), 1500, np.uint16)
    topic._images.append(
        Image(Header(stamp=rospy.Time(5), frame_id="depth_frame"), 48, 64, "16UC1", 0, 128, depth.tobytes())
    )
    assert topic.nearest(rospy.Time(5), "color_frame") == (None, None)
    assert report.codes == ["depth_not_registered"]
    assert topic.nearest(rospy.Time(5), "depth_frame")[0].shape == (48, 64)


def test_ceiling_cameras_that_share_a_frame_are_named():
    def report_of(mobile):
        report = DetectorDiagnostics.__new__(DetectorDiagnostics)
        report._camera, report._mobile, report._others, report._lock = "red", mobile, {}, threading.Lock()
        for camera, robots in (("green", False), ("robot", True), ("red", False)):
            report.record_detector(DetectorStatus(camera=camera, mobile=robots, frame_id="head_camera"))
        return report

    with pytest.raises(CodedError) as raised:
        report_of(False).require_own_frame("head_camera")
    assert (
        raised.value.code == "shared_frame" and "green, red" in str(raised.value) and "robot" not in str(raised.value)
    )
    report_of(False).require_own_frame("red_optical_frame")
    report_of(True).require_own_frame("head_camera")


@pytest.mark.parametrize(
    "mobile, color, said", [(False, True, ""), (True, True, ""), (False, False, ""), (True, False, "no_color")]
)
def test_a_robots_camera_without_colour_is_not_called_well(monkeypatch, mobile, color, said):
    monkeypatch.setattr(rospy.Time, "now", staticmethod(lambda: rospy.Time(10)))
    report = DetectorDiagnostics.__new__(DetectorDiagnostics)
    report._camera, report._mobile, report._frame_id, report._lock = "red", mobile, "red_frame", threading.Lock()
    report._missing_input, report._faults, report._started = "", {}, rospy.Time(1)
    report._status, report.color = DetectorStatus(rate_hz=2.0), color
    status = report._diagnose(DiagnosticStatusWrapper())
    assert status.level == (DiagnosticStatus.WARN if said else DiagnosticStatus.OK)
    assert not said or f"[{said}]" in status.message


def test_a_missing_pose_is_logged_once_it_has_lasted_then_on_change_and_ever_more_rarely():
    fault, logged = _Fault(), []
    for now in np.append(np.arange(0.0, 220.0, 0.1), np.arange(290.0, 300.0, 0.1)):
        text = "no transform from 'a'" if now < 20.0 else "no transform from 'b'"
        if fault.meet(text, rospy.Time(5), now, 3.0):
            logged.append((round(now), text[-3:]))
    assert logged == [(3, "'a'"), (20, "'b'"), (80, "'b'"), (200, "'b'"), (293, "'b'")]  # at last: it had been gone
    # what is met once, as camera_info that is no camera's, is logged at once; a pose that was only late is not
    assert _Fault().meet("bad", rospy.Time(5), 7.0, 0.0)
    late = _Fault()
    assert not any(late.meet("no transform", rospy.Time(5), now, 3.0) for now in (0.0, 1.0, 30.0, 31.0))


def test_an_image_without_a_place_is_freed_at_once():
    """Thirty megabytes a second would wait for the garbage collector otherwise."""

    class Unplaced:
        def geometry_of(self, *_arguments):
            try:
                raise KeyError("tf")
            except KeyError:
                raise CodedError("no_transform", "no pose") from None

    node = spot_detector_node.SpotDetectorNode.__new__(spot_detector_node.SpotDetectorNode)
    node._camera_geometry, node._report = Unplaced(), Faults()

    def search():
        image = np.zeros((4, 4), np.uint8)
        frame, unplaced = node._place("red_frame", rospy.Time(5), Picture(image, "mono"), 1)
        assert frame is None and unplaced.code == "no_transform" and unplaced.message == "no pose"
        return weakref.ref(image)

    gc.disable()
    try:
        assert search()() is None
    finally:
        gc.enable()


def test_counts_are_the_status_s_fields():
    counts = DetectorCounts()
    counts.count_image(10.0, 9.98, 0.002, 1)
    status = DetectorStatus(camera="red", **counts.summary(10.5))
    assert (status.processed, status.spots, status.rejections) == (1, 1, []) and status.rate_hz > 0.0


def test_a_calibration_sees_spots_as_the_camera_s_detector_does(monkeypatch):
    monkeypatch.setattr(
        rospy,
        "get_param",
        lambda name, default=None: {
            "/spot_detector_red/detector": {"max_diameter_mm": 60.0, "max_dwell_time": 20.0}
        }.get(name, default),
    )
    assert calibrate_camera_node.detector_params_of("red").max_diameter_mm == 60.0
    assert calibrate_camera_node.detector_params_of("green") == DetectorParams.stationary()


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
    assert compressed_encoding(message, array_from_compressed_image(message)) == encoding


def test_a_camera_info_that_others_of_the_process_get_too_is_left_as_it_came():
    topic = camera_geometry.InfoTopic("camera_info", Faults())
    message = cameras.info_from_camera(CameraModel.ideal(640, 480, 500.0), rospy.Time(5), "optical")
    topic._on_info(message)
    assert message.header.frame_id == "optical" and message.header.stamp == rospy.Time(5)
    assert topic.model_for((480, 640)).width == 640
