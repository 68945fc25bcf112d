"""The camera's pose from the four corners of a rectangle on the floor, against known cameras."""

import numpy as np
import pytest

from refusals import refused
from vb_core import geometry
from vb_core.camera_model import CameraModel, floor_points
from vb_laser_detect.calibration.pose import click_uncertainty, view_rectangle

IMAGE = (1280, 720)
SIZE = (2.0, 1.25)
CORNERS = np.array([[0, 0, 0], [2.0, 0, 0], [2.0, 1.25, 0], [0, 1.25, 0]])


def looking(eye, at, roll=0.0):
    """Returns the pose (4, 4) of a camera that looks at a point."""
    z = np.subtract(at, eye) / np.linalg.norm(np.subtract(at, eye))
    x = np.cross(z, [0.0, 0.05, 1.0])
    x /= np.linalg.norm(x)
    R = np.column_stack([x, np.cross(z, x), z]) @ geometry.rotation_from_rpy(0.0, 0.0, roll)
    return geometry.transform(R, np.array(eye, float))


POSES = [
    looking((1.0, 0.6, 2.9), (1.0, 0.7, 0.0)),  # from the ceiling
    looking((-1.0, -2.0, 2.2), (1.0, 0.6, 0.0), 0.2),
    looking((3.5, 3.0, 1.8), (1.0, 0.6, 0.0), -0.1),
]


def seen(focal, T, points):
    return CameraModel.ideal(*IMAGE, focal).project(geometry.apply(geometry.invert(T), points))


@pytest.mark.parametrize("T", POSES)
@pytest.mark.parametrize("focal", [700.0, 1100.0])
@pytest.mark.parametrize("order", [[0, 1, 2, 3], [0, 3, 2, 1], [2, 3, 0, 1]])
def test_the_floor_is_where_it_is(T, focal, order):
    pixels = seen(focal, T, CORNERS)[order]
    size = SIZE if abs(order[1] - order[0]) == 1 else SIZE[::-1]
    view = view_rectangle(pixels, size, IMAGE)
    # the person defines the map: its origin is the first corner, x runs along the first side, z upwards
    first, second = CORNERS[order[0]], CORNERS[order[1]]
    along = (second - first)[:2] / np.linalg.norm(second - first)
    frame = np.column_stack([along, [-along[1], along[0]]])
    places = np.array([[0.5, 0.3], [1.5, 1.0], [1.0, -0.2]])
    expected = (places - first[:2]) @ frame
    found = floor_points(view.camera, view.T_map_camera, seen(focal, T, np.column_stack([places, np.zeros(3)])))[:, :2]
    assert np.abs(found - expected).max() < 0.01


def test_a_slanted_view_tells_the_focal_length_and_the_height():
    view = view_rectangle(seen(700.0, POSES[1], CORNERS), SIZE, IMAGE)
    assert view.camera.focal_px == pytest.approx(700.0, rel=0.03)
    assert view.T_map_camera[2, 3] == pytest.approx(POSES[1][2, 3], rel=0.03)


@pytest.mark.parametrize(
    "pixels, size",
    [
        ([[0, 0], [100, 0], [100, 100], [100, 100]], SIZE),
        ([[100, 100], [500, 400], [500, 100], [100, 400]], SIZE),  # crosswise
        ([[100, 100], [500, 100], [500, 400], [100, 400]], (0.0, 1.0)),
        ([[100, 100], [900, 100], [900, 110], [100, 700]], (1.0, 1.0)),
    ],
)
def test_what_is_no_rectangle_is_refused(pixels, size):
    with refused("bad_rectangle"):
        view_rectangle(np.array(pixels, float), size, IMAGE)


def test_the_uncertainty_is_that_of_clicks():
    T, focal = POSES[0], 900.0
    places = np.array([[100.0, 100.0], [1200.0, 650.0]])
    true = floor_points(CameraModel.ideal(*IMAGE, focal), T, places)[:, :2]
    for share, least, most in ((1.0, 0.001, 0.05), (0.15, 0.02, 1.0)):
        corners = CORNERS * share
        pixels = seen(focal, T, corners)
        told = click_uncertainty(pixels, (SIZE[0] * share, SIZE[1] * share), IMAGE, places)
        assert least < told < most
        random = np.random.default_rng(7)
        errors = []
        for _ in range(20):
            view = view_rectangle(pixels + random.normal(0, 1.0, (4, 2)), (SIZE[0] * share, SIZE[1] * share), IMAGE)
            errors.append(floor_points(view.camera, view.T_map_camera, places)[:, :2] - true)
        assert 0.4 * told < np.sqrt(np.mean(np.sum(np.square(errors), axis=2), axis=0)).max() < 2.5 * told
