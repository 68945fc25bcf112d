import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from vb_core import geometry

angles = st.floats(-math.pi, math.pi)
coordinates = st.floats(-50.0, 50.0)


@given(angles, angles, angles)
def test_rotations_agree_with_scipy(roll, pitch, yaw):
    ours = geometry.rotation_from_rpy(roll, pitch, yaw)
    theirs = Rotation.from_euler("xyz", [roll, pitch, yaw])
    assert np.allclose(ours, theirs.as_matrix(), atol=1e-9)
    quaternion = geometry.quaternion_from_rotation(ours)
    assert np.allclose(geometry.rotation_from_quaternion(quaternion), ours, atol=1e-9)
    # of the two quaternions of a rotation, the one with a positive real part
    assert abs(quaternion @ theirs.as_quat()) == pytest.approx(1.0, abs=1e-9)
    assert quaternion[3] >= 0.0


@pytest.mark.parametrize("quaternion", [(0, 0, 0, 0), (math.nan, 0, 0, 1), (math.inf, 0, 0, 1)])
def test_invalid_quaternions_are_refused(quaternion):
    with pytest.raises(ValueError):
        geometry.rotation_from_quaternion(quaternion)


@given(coordinates, coordinates, angles)
def test_a_plane_pose_turns_about_z_and_can_be_inverted(x, y, yaw):
    T = geometry.transform_from_pose2d(x, y, yaw)
    assert np.allclose(geometry.invert_transform(T) @ T, np.eye(4), atol=1e-9)
    rotation = Rotation.from_euler("z", yaw).as_matrix()
    assert np.allclose(T, geometry.make_transform(rotation, (x, y, 0.0)), atol=1e-9)
    expected = rotation @ [1.0, 2.0, 3.0] + [x, y, 0.0]
    assert np.allclose(geometry.transform_points(T, [1.0, 2.0, 3.0]), expected, atol=1e-9)
    *place, byaw = geometry.pose2d_from_transform(T)
    assert place == [x, y]
    for back in (byaw, geometry.yaw_from_quaternion(geometry.quaternion_from_yaw(yaw))):
        assert abs(geometry.wrap_angle(back - yaw)) < 1e-9


@given(st.floats(-1000, 1000))
def test_wrapped_angles_point_the_same_way(angle):
    wrapped = geometry.wrap_angle(angle)
    assert -math.pi < wrapped <= math.pi
    assert math.isclose(math.cos(wrapped), math.cos(angle), abs_tol=1e-9)
    assert math.isclose(math.sin(wrapped), math.sin(angle), abs_tol=1e-9)


def test_optical_frame_is_that_of_rep_103():
    body = geometry.optical_rotation()
    assert np.allclose(body @ [0, 0, 1], [1, 0, 0])  # forward
    assert np.allclose(body @ [1, 0, 0], [0, -1, 0])  # right
    assert np.allclose(body @ [0, 1, 0], [0, 0, -1])  # down


@given(st.floats(-3.0, 3.0), st.floats(0.0, 0.9), st.floats(-0.2, 0.2))
def test_distances_along_an_arc_match_driving_along_it(curvature, share, left):
    length = share * math.pi / max(abs(curvature), 0.5)
    yaw = 0.0
    end = np.array([length, 0.0])
    if abs(curvature) >= 1e-3:
        yaw = curvature * length
        end = np.array([math.sin(yaw), 1.0 - math.cos(yaw)]) / curvature
    place = end + left * np.array([-math.sin(yaw), math.cos(yaw)])
    (along,), (across,) = geometry.arc_coordinates(place[None], curvature)
    assert (along, across) == pytest.approx((length, left), abs=1e-9)


RECTANGLE = np.array([[0, 0], [2, 0], [2, 1], [0, 1]], dtype=float)


@pytest.mark.parametrize("closed, length", [(False, 5.0), (True, 6.0)])
def test_a_chain_is_as_long_as_its_sides(closed, length):
    assert geometry.chain_length(RECTANGLE, closed) == length


def test_a_resampled_chain_keeps_its_ends():
    dense = geometry.resample_chain(RECTANGLE, 0.1)
    assert np.allclose(dense[[0, -1]], RECTANGLE[[0, -1]])
    assert np.linalg.norm(np.diff(dense, axis=0), axis=1).max() <= 0.1 + 1e-9


@pytest.mark.parametrize("chain, closed, count", [(RECTANGLE, True, 60), (np.zeros((4, 2)), False, 1)])
def test_a_resampled_chain_has_points_for_its_length(chain, closed, count):
    assert len(geometry.resample_chain(chain, 0.1, closed)) == count
