"""Looking up transforms, with tf2's real buffer and a listener that hears nothing."""

from __future__ import annotations

import math

import numpy as np
import pytest
import rospy
import tf2_ros

from refusals import refused
from vb_core import geometry
from vb_core.ros import transforms
from vb_core.ros.messages import message_from_transform

CAMERA = geometry.transform(geometry.rotation_from_rpy(math.pi, 0, 0.3), (1.0, 2.0, 3.0))


@pytest.fixture
def lookup(monkeypatch):
    monkeypatch.setattr(tf2_ros, "TransformListener", lambda buffer: None)
    # a buffer asks for the time, which no node gives here
    monkeypatch.setattr(rospy, "get_rostime", lambda: rospy.Time(10))
    monkeypatch.setattr(rospy.Time, "now", staticmethod(lambda: rospy.Time(10)))
    monkeypatch.setattr(tf2_ros.Buffer, "__init__", tf2_ros.BufferCore.__init__)
    return transforms.TransformLookup()


def place(lookup, child, T=CAMERA, parent="map", stamp=5, static=True):
    message = message_from_transform(T, parent, child, rospy.Time(stamp))
    (lookup._buffer.set_transform_static if static else lookup._buffer.set_transform)(message, "test")


def test_static_transforms_are_enough_for_a_fixed_camera(lookup):
    place(lookup, "camera")
    assert lookup.lookup("map", "camera", rospy.Time(0), 0.0) == pytest.approx(CAMERA)
    # what is published later on /tf_static counts
    place(lookup, "camera", np.eye(4))
    assert lookup.lookup("map", "camera", rospy.Time(0), 0.0) == pytest.approx(np.eye(4))


def test_missing_transforms_and_loops_are_refused_with_a_reason(lookup):
    with refused("no_transform") as raised:
        lookup.lookup("map", "camera", rospy.Time(0), 0.0)
    assert "camera" in str(raised.value) and "calibrated" in str(raised.value)
    place(lookup, "camera", parent="a")
    place(lookup, "a", parent="b")
    place(lookup, "b", parent="a")
    place(lookup, "other")
    with refused("no_transform") as raised:
        lookup.lookup("map", "camera", rospy.Time(0), 0.0)
    assert "loop" in str(raised.value)


def test_an_unknown_time_is_refused(lookup):
    place(lookup, "camera", static=False, stamp=5)
    place(lookup, "camera", static=False, stamp=6)
    assert lookup.lookup("map", "camera", rospy.Time(5.5), 0.0) == pytest.approx(CAMERA)
    with refused("no_transform"):
        lookup.lookup("map", "camera", rospy.Time(9), 0.0)


def test_a_frames_pose_on_the_map_expires(lookup):
    assert lookup.pose_on_map("base", 3.0) is None
    place(lookup, "base", geometry.transform_from_pose2d(1.0, 2.0, 0.5), stamp=8, static=False)  # it is 10 s now
    assert lookup.pose_on_map("base", 3.0) == pytest.approx((1.0, 2.0, 0.5))
    assert lookup.pose_on_map("base", 1.5) is None
    place(lookup, "fixed", geometry.transform_from_pose2d(math.inf, 2.0, 0.5))
    assert lookup.pose_on_map("fixed", 3.0) is None
    place(lookup, "fixed", geometry.transform_from_pose2d(3.0, 2.0, 0.5))
    assert lookup.pose_on_map("fixed", 0.0) == pytest.approx((3.0, 2.0, 0.5))
