"""Poses of robots and of a camera at an image's time, from tf2's real buffer."""

import math
from types import SimpleNamespace

import pytest
import rospy
import tf2_ros

from vb_core import geometry
from vb_core.camera_model import CameraModel
from vb_core.robot_profile import Limits, RobotProfile, RobotShape
from vb_core.ros import robot_profile
from vb_core.ros.messages import message_from_transform
from vb_core.ros.transforms import TransformLookup
from vb_laser_detect.ros import camera_geometry
from vb_laser_detect.ros.camera_geometry import CameraGeometry
from vb_laser_detect.detection.projection import FloorProjection

PROFILE = RobotProfile(shape=RobotShape(radius=0.2, height=0.3), limits=Limits(max_speed=0.4))


@pytest.fixture
def lab(monkeypatch):
    """Returns (camera geometry, tf's buffer, the codes counted); `drive` puts robots' poses into tf."""
    monkeypatch.setattr(tf2_ros, "TransformListener", lambda buffer: None)
    monkeypatch.setattr(tf2_ros.Buffer, "__init__", tf2_ros.BufferCore.__init__)
    # a buffer that waits asks for the time, and no node provides it here
    monkeypatch.setattr(rospy, "get_rostime", lambda: rospy.Time(10))
    monkeypatch.setattr(rospy.Time, "now", staticmethod(lambda: rospy.Time(10)))
    monkeypatch.setattr(robot_profile, "read", lambda name: PROFILE)
    counted, transforms = [], TransformLookup()
    camera = CameraGeometry(
        False,
        transforms,
        None,
        None,
        FloorProjection(),
        ["/", "/second"],
        SimpleNamespace(count_dropped=counted.append),
    )
    return camera, transforms._buffer, counted


def drive(buffer, frame, x, stamp, static=False):
    T = geometry.transform(geometry.rotation_from_rpy(0, 0, 0.3), (x, 1.0, 0.0))
    message = message_from_transform(T, "map", frame, rospy.Time(stamp))
    (buffer.set_transform_static if static else buffer.set_transform)(message, "test")


def test_robots_are_where_they_were_at_the_images_time(lab):
    robots, buffer, counted = lab
    for stamp, x in ((5.0, 2.0), (5.1, 2.04), (5.2, 2.2)):
        drive(buffer, "base_link", x, stamp)
        drive(buffer, "second/base_link", 4.0 - x, stamp)
    first, second = robots.robot_cylinders(rospy.Time(5.05))
    assert (first.x, first.y, second.x) == pytest.approx((2.02, 1.0, 1.98)) and not counted
    assert first.height == 0.3 and 0.2 < first.radius < 0.3


def test_a_pose_that_has_not_arrived_makes_a_robot_larger(lab):
    robots, buffer, _ = lab
    drive(buffer, "base_link", 2.0, 5.0)
    then, later = robots.robot_cylinders(rospy.Time(5.0))[0], robots.robot_cylinders(rospy.Time(5.25))[0]
    assert later.x == then.x and later.radius == pytest.approx(then.radius + 0.25 * 0.4)


def test_a_robot_without_a_recent_pose_hides_nothing_and_is_counted(lab):
    robots, buffer, counted = lab
    drive(buffer, "base_link", 2.0, 5.0)
    # the second robot never had a pose
    assert len(robots.robot_cylinders(rospy.Time(5.0))) == 1 and counted == ["robot_without_pose"]
    assert robots.robot_cylinders(rospy.Time(7.0)) == [] and counted == ["robot_without_pose"] * 3
    assert robots.robot_cylinders(rospy.Time(4.0)) == [] and len(counted) == 5  # before the first pose in tf


def test_a_robot_with_a_fixed_pose_is_never_out_of_date(lab):
    robots, buffer, counted = lab
    drive(buffer, "base_link", 2.0, 5.0, static=True)
    drive(buffer, "second/base_link", 3.0, 5.0, static=True)
    for cylinder, x in zip(robots.robot_cylinders(rospy.Time(900.0)), (2.0, 3.0)):
        assert cylinder.x == x and math.isclose(cylinder.radius, robots.robot_cylinders(rospy.Time(5.0))[0].radius)
    assert not counted


def test_lens_is_looked_up_twice_a_second_and_for_each_new_size(lab, monkeypatch):
    asked, clock = [], SimpleNamespace(monotonic=lambda: 100.0)
    monkeypatch.setattr(camera_geometry, "time", clock)
    info = SimpleNamespace(model_for=lambda size: asked.append(size) or CameraModel.ideal(*size, 500.0))
    transforms = TransformLookup()
    red = CameraGeometry(False, transforms, info, None, FloorProjection(), (), SimpleNamespace())
    drive(transforms._buffer, "red", 2.0, 5.0, static=True)
    large, small = (640, 480), (320, 240)
    for seconds, size in ((0.0, large), (0.4, large), (0.4, small), (0.8, small), (0.91, small), (1.0, large)):
        clock.monotonic = lambda seconds=seconds: 100.0 + seconds
        red.geometry_of("red", rospy.Time(5.0 + seconds), size)
    assert asked == [large, small, small, large]
