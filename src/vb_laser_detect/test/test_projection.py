"""Pixels to the floor and back."""

import math
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from board_scene import CAMERA
from vb_core import geometry
from vb_core.camera_model import CameraModel, project_to_floor, project_to_pixels
from vb_core.grid_map import GridMap
from vb_laser_detect.detection.projection import DEPTH, GROUND_PLANE, GROUND_PLANE_FALLBACK, FloorProjection
from vb_laser_detect.detection.projection import ImageGeometry, RobotCylinder
from vb_laser_detect.detection.stage_results import Spot

ROBOT = CameraModel.ideal(640, 480, 525.0)
UP = geometry.make_transform(np.eye(3), (1.0, 1.0, 2.0))  # the line through camera and pixel meets the floor behind it


def down(x=4.0, y=2.5, z=2.95, tilt=0.0):
    return geometry.make_transform(geometry.rotation_from_rpy(math.pi + tilt, 0.02, 0.3), (x, y, z))


def forward(pitch=0.6, height=0.6):
    rotation = geometry.rotation_from_rpy(0, pitch, 0.4) @ geometry.optical_rotation()
    return geometry.make_transform(rotation, (1.0, 1.0, height))


def locate(camera, T, u, v, depth=None, floor=None):
    """Returns the point on the floor at a pixel, or the reason why there is none. `depth`: a depth image and its camera."""
    image = ImageGeometry(camera, FloorProjection(floor=floor), lambda: T, depth and (lambda: depth))
    (spot,) = image.locate([Spot(u, v, 8.0)])
    return spot.rejection or spot.floor_point


@settings(max_examples=60, deadline=None)
@given(u=st.floats(0, 1919), v=st.floats(0, 1079), tilt=st.floats(-0.3, 0.3))
def test_plane_round_trip(u, v, tilt):
    T = down(tilt=tilt)
    point = locate(CAMERA, T, u, v)
    assert point.source == GROUND_PLANE and point.position[2] == pytest.approx(0.0, abs=1e-9)
    assert project_to_pixels(CAMERA, T, point.position)[0] == pytest.approx((u, v), abs=0.02)


def test_metres_per_pixel_of_a_camera_that_looks_down():
    camera = CameraModel.ideal(1920, 1080, 1000.0)
    T = geometry.make_transform(geometry.rotation_from_rpy(math.pi, 0, 0), (0, 0, 2.95))
    assert locate(camera, T, 300, 800).meters_per_pixel == pytest.approx(0.00295, rel=1e-3)


@pytest.mark.parametrize(
    "T, u, v, code",
    [
        (forward(pitch=-0.5), 320, 240, "no_floor_intersection"),
        (UP, 320, 240, "no_floor_intersection"),
        (forward(pitch=-0.5, height=-0.5), 320, 240, "no_floor_intersection"),
        (forward(pitch=0.05), 320, 240, "grazing_view"),
        (down(z=20.0), 950, 545, "too_far"),
        (down(), -3.0, 10.0, "outside_image"),
        (down(), float("nan"), 10.0, "outside_image"),
    ],
)
def test_pixels_without_a_floor_in_reach_are_rejected(T, u, v, code):
    camera = CAMERA if T[2, 2] < -0.9 else ROBOT
    assert locate(camera, T, u, v) == code


def test_points_outside_the_map():
    floor = GridMap(np.zeros((40, 40), np.int8), 0.05, (3.0, 1.5, 0.0))
    inside, outside = project_to_pixels(CAMERA, down(), np.array([[4.5, 3.0, 0], [5.2, 2.5, 0]]))
    assert locate(CAMERA, down(), *inside, floor=floor).position[:2] == pytest.approx((4.5, 3.0), abs=1e-3)
    assert locate(CAMERA, down(), *outside, floor=floor) == "spot_outside_map"


# ------------------------------------------------------------------ depth
def depth_image(T, small, dtype="mm"):
    grid = np.stack(np.meshgrid(np.arange(small.width), np.arange(small.height)), axis=-1).reshape(-1, 2)
    floor = project_to_floor(small, T, grid)
    depth = geometry.transform_points(geometry.invert_transform(T), floor)[:, 2].reshape(small.height, small.width)
    depth[~(depth < 6)] = np.nan
    return np.where(np.isnan(depth), 0, depth * 1000).round().astype(np.uint16) if dtype == "mm" else depth


COLOR = CameraModel(640, 480, [[525.0, 0, 322], [0, 520.0, 236], [0, 0, 1]], [-0.25, 0.06, 0.001, 0, 0])
FORWARD, SMALL = forward(), ROBOT.scaled_to(160, 120)
LENSES = [(ROBOT, SMALL), (ROBOT, ROBOT), (ROBOT, ROBOT.scaled_to(213, 160))]
LENSES.append((COLOR, CameraModel.ideal(160, 120, 95.0)))  # another lens, undistorted and with a wider field of view
FLOOR = depth_image(FORWARD, SMALL, "m")
VIEW = ROBOT, FORWARD, 320, 300
PLANE = locate(*VIEW)


def test_holes_fall_back_to_the_plane():
    holes = FLOOR.copy()
    holes[60:90, 60:100] = np.nan
    for missing in (holes, None, np.zeros((0, 0), np.uint16), np.zeros((120, 160), np.uint16)):
        point = locate(*VIEW, depth=(missing, None))
        assert point.source == GROUND_PLANE_FALLBACK and point.position == pytest.approx(PLANE.position)


def test_outliers_and_a_thing_beside_the_spot_do_not_lift_it():
    wild, leg = FLOOR.copy(), FLOOR.copy()
    wild[::3, ::2] = 5.5
    wild[1::4, 1::5] = 0.0
    column = int(round(SMALL.project(ROBOT.pixels_to_rays(np.array([[320.0, 300.0]])))[0, 0]))
    leg[:, column + 1 :] *= 0.6  # a table's leg covers two of the five columns of the neighbourhood
    for depth in (wild, leg):
        point = locate(*VIEW, depth=(depth, None))
        assert point.source == DEPTH and np.linalg.norm(point.position - PLANE.position) < 0.03


def test_points_above_and_below_the_floor_are_rejected():
    for scale in (0.7, 1.3):
        assert locate(*VIEW, depth=(scale * FLOOR, None)) == "not_on_floor"


@settings(max_examples=200, deadline=None)
@given(
    lens=st.sampled_from(LENSES),
    place=st.tuples(st.floats(0, 639), st.floats(120, 479)),
    seed=st.integers(0, 2**32 - 1),
    holes=st.sampled_from([0.0, 0.1, 0.4, 0.7]),
    has_side=st.booleans(),
    dtype=st.sampled_from(["m", "mm"]),
    hole=st.sampled_from([np.nan, np.inf, 0.0]),
)
def test_depth_of_any_size_and_lens_meets_the_plane(lens, place, seed, holes, has_side, dtype, hole):
    (color, own), random = lens, np.random.default_rng(seed)
    depth = depth_image(FORWARD, own, dtype)
    missing = random.random(depth.shape) < holes
    missing[:, : has_side * random.integers(0, own.width)] = True  # and everything on one side
    depth[missing] = hole if dtype == "m" else 0
    plane = locate(color, FORWARD, *place)
    point = locate(color, FORWARD, *place, depth=(depth, own if color is COLOR else None))
    assert point.source == DEPTH or missing.any()
    distance = np.linalg.norm(plane.position - FORWARD[:3, 3])
    assert np.linalg.norm(point.position - plane.position) < 0.002 + 0.001 * distance
    assert point.meters_per_pixel == pytest.approx(plane.meters_per_pixel, rel=0.002)


# ------------------------------------------------------------------ robots that hide the floor
CYLINDER = RobotCylinder(2.0, 1.0, 0.2, 0.4)


@settings(max_examples=200, deadline=None)
@given(x=st.floats(-3, 3), y=st.floats(-3, 3), u=st.floats(1, 3), v=st.floats(0, 2), height=st.floats(0.2, 4.0))
def test_a_ray_that_passes_through_a_robot_has_a_point_in_it(x, y, u, v, height):
    origin, floor = np.array([x, y, height]), np.array([u, v, 0.0])
    points = origin + np.linspace(0.0, 1.0, 4001)[:, None] * (floor - origin)
    low = points[points[:, 2] <= CYLINDER.height]
    off = np.hypot(low[:, 0] - CYLINDER.x, low[:, 1] - CYLINDER.y).min() - CYLINDER.radius
    if abs(off) > 0.01:  # within the spacing of the points the oracle is undecided
        assert CYLINDER.occludes(origin, floor) is bool(off < 0.0)


def test_what_a_robot_hides_is_rejected_and_pose_and_robots_are_looked_up_once():
    camera, find_robots = CameraModel.ideal(1920, 1080, 1100.0), Mock(return_value=[CYLINDER])
    pose = geometry.make_transform(geometry.rotation_from_rpy(math.pi, 0.0, 0.3), (1.5, 1.0, 2.9))
    find_pose = Mock(return_value=pose)
    frame = ImageGeometry(camera, FloorProjection(), find_pose, find_robots=find_robots)
    places = np.array([[2.05, 1.0, 0.2], [1.6, 1.3, 0.0]])
    on, beside = (Spot(*pixel, 8.0) for pixel in project_to_pixels(camera, pose, places))
    assert frame.locate([Spot(50, 50, 8.0, rejection="peak")])[0].rejection == "peak"
    assert not find_pose.called and not find_robots.called
    beside, hidden = frame.locate([beside, on])
    box = (beside.u - 2.0, beside.v - 2.0, beside.u + 2.0, beside.v + 2.0)
    diameters, _ = frame.max_diameters([box], 0.08)
    assert diameters[box] == pytest.approx(3.0 + 0.08 / beside.floor_point.meters_per_pixel)
    assert np.allclose(beside.floor_point.position, (1.6, 1.3, 0.0))
    assert hidden.rejection == "on_robot"
    assert find_pose.call_count == find_robots.call_count == 1
    (without_robots,) = ImageGeometry(camera, FloorProjection(), find_pose).locate([on])
    assert without_robots.floor_point is not None
