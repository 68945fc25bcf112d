"""Robots that hide the floor from a camera."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vb_core import geometry
from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError
from vb_laser_detect.detection.projection import ImageGeometry, RobotCylinder
from vb_laser_detect.detection.projection import FloorProjection, pixels_of

ROBOT = RobotCylinder(2.0, 1.0, 0.2, 0.4)


@settings(max_examples=200, deadline=None)
@given(x=st.floats(-3, 3), y=st.floats(-3, 3), u=st.floats(1, 3), v=st.floats(0, 2), height=st.floats(0.2, 4.0))
def test_a_ray_that_passes_through_a_robot_has_a_point_in_it(x, y, u, v, height):
    origin, floor = np.array([x, y, height]), np.array([u, v, 0.0])
    points = origin + np.linspace(0.0, 1.0, 4001)[:, None] * (floor - origin)
    low = points[points[:, 2] <= ROBOT.height]
    off = np.hypot(low[:, 0] - ROBOT.x, low[:, 1] - ROBOT.y).min() - ROBOT.radius
    if abs(off) > 0.01:  # nearer than the points are to each other nothing is decided
        assert ROBOT.occludes(origin, floor) is bool(off < 0.0)


def test_what_a_robot_hides_is_rejected_and_robots_are_asked_for_once():
    camera = CameraModel.ideal(1920, 1080, 1100.0)
    pose = geometry.transform(geometry.rotation_from_rpy(math.pi, 0.0, 0.3), (1.5, 1.0, 2.9))
    asked = []

    def cylinders():
        asked.append(1)
        return [ROBOT]

    frame = ImageGeometry(camera, lambda: pose, FloorProjection(), cylinders=cylinders)
    assert not asked
    on, beside = pixels_of(camera, pose, np.array([[2.05, 1.0, 0.2], [1.6, 1.3, 0.0]]))
    assert np.allclose(frame.point(*beside).position, (1.6, 1.3, 0.0))
    with pytest.raises(CodedError) as raised:
        frame.point(*on)
    assert raised.value.code == "on_robot" and len(asked) == 1
    assert ImageGeometry(camera, lambda: pose, FloorProjection()).point(*on) is not None
