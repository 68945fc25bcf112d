"""A camera's lens from camera_info, and the poses of camera and robots at an image's time, from tf2's real buffer."""

import contextlib
import math
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
import rospy
import tf2_ros

from refusals import refused
from vb_core import geometry
from vb_core.camera_model import CameraModel
from vb_core.robot_profile import Limits, RobotProfile, RobotShape
from vb_core.ros import images, robot_profile
from vb_core.ros.messages import message_from_transform
from vb_core.ros.transforms import TransformLookup
from vb_laser_detect.detection.projection import FloorProjection
from vb_laser_detect.ros import camera_geometry
from vb_laser_detect.ros.camera_geometry import CameraGeometry, InfoTopic, is_rectified

PROFILE = RobotProfile(shape=RobotShape(radius=0.2, height=0.3), limits=Limits(max_speed=0.4))


@pytest.fixture
def lab(monkeypatch):
    """Returns the geometry of a camera `red`, tf's buffer, and a list of the codes that the geometry counts as dropped."""
    monkeypatch.setattr(tf2_ros, "TransformListener", lambda buffer: None)
    monkeypatch.setattr(tf2_ros.Buffer, "__init__", tf2_ros.BufferCore.__init__)
    # a buffer that waits asks for the time, and no node provides it here
    monkeypatch.setattr(rospy, "get_rostime", lambda: rospy.Time(10))
    monkeypatch.setattr(rospy.Time, "now", staticmethod(lambda: rospy.Time(10)))
    monkeypatch.setattr(robot_profile, "read", lambda name: PROFILE)
    dropped_codes, transforms = [], TransformLookup()
    drive(transforms._buffer, "red", 2.0, 5.0, static=True)
    report = SimpleNamespace(count_dropped=dropped_codes.append, frames_of_others=dict)
    lens = Mock(model_for=Mock(side_effect=lambda size: CameraModel.ideal(*size, 500.0)))
    camera = CameraGeometry("red", False, transforms, lens, None, FloorProjection(), ["/", "/second"], report)
    return camera, transforms._buffer, dropped_codes


def drive(buffer, frame, x, stamp, static=False):
    """Puts a pose at (x, 1) [m] into tf, at a time [s]."""
    message = message_from_transform(geometry.transform_from_pose2d(x, 1.0, 0.3), "map", frame, rospy.Time(stamp))
    (buffer.set_transform_static if static else buffer.set_transform)(message, "test")


def test_robots_are_where_they_were_at_the_images_time_or_are_larger(lab):
    camera, buffer, dropped_codes = lab
    for stamp, x in ((5.0, 2.0), (5.1, 2.04), (5.2, 2.2)):
        drive(buffer, "base_link", x, stamp)
        drive(buffer, "second/base_link", 4.0 - x, stamp)
    first, second = camera.robot_cylinders(rospy.Time(5.05))
    assert (first.x, first.y, second.x) == pytest.approx((2.02, 1.0, 1.98))
    assert first.height == 0.3 and 0.2 < first.radius < 0.3
    late, _ = camera.robot_cylinders(rospy.Time(5.45))  # whose pose has not arrived
    assert late.x == 2.2
    assert late.radius == pytest.approx(first.radius + 0.25 * 0.4)
    assert not dropped_codes


def test_a_robot_without_a_recent_pose_hides_nothing_and_is_counted(lab):
    camera, buffer, dropped_codes = lab
    drive(buffer, "base_link", 2.0, 5.0)
    # the second robot never had a pose
    for stamp, cylinder_count, dropped_count in ((5.0, 1, 1), (7.0, 0, 3), (4.0, 0, 5)):  # at 4 s tf has no pose yet
        assert len(camera.robot_cylinders(rospy.Time(stamp))) == cylinder_count
        assert dropped_codes == ["robot_without_pose"] * dropped_count


def test_a_robot_with_a_fixed_pose_is_never_out_of_date(lab):
    camera, buffer, dropped_codes = lab
    drive(buffer, "base_link", 2.0, 5.0, static=True)
    drive(buffer, "second/base_link", 3.0, 5.0, static=True)
    radius = camera.robot_cylinders(rospy.Time(5.0))[0].radius
    for cylinder, x in zip(camera.robot_cylinders(rospy.Time(900.0)), (2.0, 3.0)):
        assert cylinder.x == x and math.isclose(cylinder.radius, radius)
    assert not dropped_codes


def test_lens_is_looked_up_twice_a_second_and_for_each_new_size(lab, monkeypatch):
    red, *_ = lab
    clock = SimpleNamespace(monotonic=lambda: 100.0)
    monkeypatch.setattr(camera_geometry, "time", clock)
    large, small = (640, 480), (320, 240)
    for seconds, size in ((0.0, large), (0.4, large), (0.4, small), (0.8, small), (0.91, small), (1.0, large)):
        clock.monotonic = lambda seconds=seconds: 100.0 + seconds
        red.geometry_at("red", rospy.Time(5.0 + seconds), size)
    assert [call.args[0] for call in red._info.model_for.call_args_list] == [large, small, small, large]
    assert red.focal == 500.0


@pytest.mark.parametrize("mobile", [False, True])
def test_ceiling_cameras_that_share_a_frame_are_named(lab, mobile):
    red, *_ = lab
    red._mobile = mobile
    red._report.frames_of_others = lambda: {"green": "red", "blue": "blue"}
    with contextlib.nullcontext() if mobile else refused("shared_frame") as raised:
        red.geometry_at("red", rospy.Time(5.0), (640, 480))
    assert mobile or raised.value.values["cameras"] == "green, red"


# ------------------------------------------------------------------ camera_info
def info_of(distortion, binning=0):
    """Returns the camera_info of a lens whose images were rectified with another focal length."""
    lens = CameraModel(640, 480, CameraModel.ideal(640, 480, 400.0).matrix, np.array(distortion))
    message = images.info_from_camera(lens, rospy.Time(1), "lens")
    message.P = [350.0, 0, 319.5, 0, 0, 350.0, 239.5, 0, 0, 0, 1, 0]
    message.binning_x = binning
    return message


def test_rectified_images_are_not_undistorted_again(monkeypatch):
    assert is_rectified("/hall/image_rect_color") and is_rectified("/hall/image_rect")
    assert not is_rectified("/rect/image_raw") and not is_rectified("/hall/image_raw")
    monkeypatch.setattr(rospy, "Subscriber", Mock())
    models = {}
    for rectified in (False, True):
        topic = InfoTopic("/hall/camera_info", Mock(), rectified)
        topic._on_info(info_of([-0.33, 0.12, 0.0, 0.0, 0.0]))
        models[rectified] = topic.model_for((640, 480))
    assert models[False].is_distorted and not models[True].is_distorted
    assert models[True].matrix[0, 0] == 350.0
    topic._on_info(info_of([0.0] * 5, binning=2))
    with refused("no_camera_info"):  # not the lens that it had before
        topic.model_for((640, 480))
