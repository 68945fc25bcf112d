"""Poses from points with noise and outliers, and from a rectangle, against the truth; and what determines no pose."""

import math

import numpy as np
import pytest

from board_scene import CAMERA, POSE
from refusals import refused
from vb_core import geometry
from vb_core.camera_model import CameraModel, project_to_floor
from vb_laser_detect.calibration import pose as pose_module
from vb_laser_detect.calibration.pose import Correspondences, click_uncertainty, estimate_pose
from vb_laser_detect.calibration.pose import estimate_camera_from_rectangle

NOISES = [(4, 0.005, 0.018, 0.05), (8, 0.005, 0.012, 0.035), (8, 0.015, 0.035, 0.1)]
GRID = np.array([(u, v) for u in (96, 960, 1824) for v in (54, 540, 1026)], float)
SPREAD = np.array([(150, 120), (1780, 130), (1750, 960), (170, 950), (960, 150), (960, 930), (200, 540), (1700, 540)])


def observe(rng, count=8, pixel_noise=0.3, point_noise=0.005, pose=POSE, jitter=35.0):
    """Returns measurements of points near the image's edge, as a person would choose them."""
    pixels = SPREAD[:count] + rng.uniform(-jitter, jitter, (count, 2))
    points = project_to_floor(CAMERA, pose, pixels)[:, :2]
    noisy_pixels = pixels + rng.normal(0, pixel_noise, pixels.shape)
    return Correspondences(noisy_pixels, points + rng.normal(0, point_noise, points.shape))


def errors_on_floor(estimate, pose=POSE):
    """Returns the errors [m] of spots all over the image."""
    truth = project_to_floor(CAMERA, pose, GRID)
    return np.linalg.norm(project_to_floor(CAMERA, estimate.T_map_camera, GRID) - truth, axis=1)


@pytest.mark.parametrize("count", [4, 5, 8])
@pytest.mark.parametrize(
    "pose",
    [
        POSE,
        geometry.make_transform(geometry.rotation_from_rpy(math.pi, 0, 0), (1.0, -2.0, 2.4)),
        geometry.make_transform(geometry.rotation_from_rpy(math.pi + 0.3, -0.1, -2.4), (-3.0, 7.0, 3.4)),
    ],
)
def test_exact_points_give_the_exact_pose(count, pose):
    observed = observe(np.random.default_rng(count), count, 0.0, 0.0, pose)
    estimate = estimate_pose(CAMERA, observed)
    assert estimate.used.all() and estimate.rms_px < 0.05
    assert np.abs(estimate.T_map_camera - pose).max() < 1e-4


@pytest.mark.parametrize("count, point_noise, median, most", NOISES)
def test_noise_moves_the_floor_as_much_as_is_reported(count, point_noise, median, most):
    largest_errors, reported_sigmas = [], []
    for seed in range(12):
        estimate = estimate_pose(CAMERA, observe(np.random.default_rng(seed), count, 0.3, point_noise), point_noise)
        largest_errors.append(errors_on_floor(estimate).max())
        reported_sigmas.append(estimate.floor_sigma[1])
    assert np.median(largest_errors) < median and max(largest_errors) < most
    # the largest of nine errors is a little more than the standard deviation at the worst place
    assert 0.5 < np.median(largest_errors) / np.median(reported_sigmas) < 2.0


@pytest.mark.parametrize("wrong", [1, 2])
def test_wrong_points_are_found_and_left_out(wrong):
    for seed in range(8):
        rng = np.random.default_rng(100 + seed)
        observed = observe(rng, 8)
        points = observed.points.copy()
        bad = rng.choice(8, wrong, replace=False)
        angle = rng.uniform(0, 2 * math.pi, wrong)
        # another tile taken for the right one, or a slip of the mouse
        points[bad] += (rng.uniform(0.25, 1.0, wrong) * np.array([np.cos(angle), np.sin(angle)])).T
        estimate = estimate_pose(CAMERA, Correspondences(observed.pixels, points))
        assert not estimate.used[bad].any() and estimate.used.sum() >= 7 - wrong
        assert errors_on_floor(estimate).max() < 0.08


# ------------------------------------------------------------------ points that determine no pose
def exact_at(pixels):
    """Returns the floor points at these pixels, without noise."""
    pixels = np.asarray(pixels, float)
    return Correspondences(pixels, project_to_floor(CAMERA, POSE, pixels)[:, :2])


EXACT = observe(np.random.default_rng(5), 8, 0.0, 0.0)
LINE = np.column_stack([np.linspace(100, 1800, 8), np.linspace(200, 900, 8)])
NEAR = np.random.default_rng(1).uniform(0, 120, (10, 2))


@pytest.mark.parametrize(
    "observed, code",
    [
        (EXACT.select(np.arange(3)), "too_few_calibration_points"),
        (Correspondences(np.zeros((0, 2)), np.zeros((0, 2))), "too_few_calibration_points"),
        (Correspondences(np.full((5, 2), 500.0), np.full((5, 2), 2.0)), "too_few_calibration_points"),
        (exact_at(LINE), "collinear"),
        *((exact_at(NEAR + corner), "clustered") for corner in ((900, 500), (10, 10), (1780, 950))),
        (Correspondences(EXACT.pixels, EXACT.points * (1, -1)), "below_floor"),
        (Correspondences(EXACT.pixels, EXACT.points[[3, 0, 6, 1, 7, 2, 5, 4]]), "no_consistent_pose"),
        (Correspondences(EXACT.pixels + (2000, 0), EXACT.points), "outside_image"),
        (Correspondences(EXACT.pixels * np.nan, EXACT.points), "outside_image"),
    ],
)
def test_points_that_determine_no_pose_are_refused(observed, code):
    with refused(code):
        estimate_pose(CAMERA, observed)


def test_one_place_taken_again_and_again_does_not_count():
    for seed in range(5):
        rng = np.random.default_rng(seed)
        three = observe(rng, 3)
        again = three.select([0, 1, 2, 0, 1, 2, 0, 1])
        # with the noise of real measurements and clicks
        near = Correspondences(again.pixels + rng.normal(0, 1.5, (8, 2)), again.points + rng.normal(0, 0.001, (8, 2)))
        # the spot moved on, and the click stayed the same
        points = observe(rng, 4).points
        points[3] = points[2]
        for observed in (again, again.select(np.arange(4)), near, Correspondences(SPREAD[:4], points)):
            with refused("too_few_calibration_points"):
                estimate_pose(CAMERA, observed)


@pytest.mark.parametrize("focal, tilt, part, code", [(1100, 0.15, 0.25, "uncertain"), (3000, 0.3, 0.15, "ambiguous")])
def test_points_that_leave_the_pose_open_are_refused(focal, tilt, part, code, monkeypatch):
    monkeypatch.setattr(pose_module, "_MIN_AREA", 0.0)
    camera = CameraModel.ideal(1920, 1080, focal)
    pose = geometry.make_transform(geometry.rotation_from_rpy(math.pi + tilt, 0, 0), (0, 0, 3.0))
    pixels = (SPREAD[:4] - (960, 540)) * part + (960, 540)
    observed = Correspondences(pixels, project_to_floor(camera, pose, pixels)[:, :2])
    with refused(code):
        estimate_pose(camera, observed, 0.02)


# ------------------------------------------------------------ from the corners of a rectangle
IMAGE = (1280, 720)
SIZE = (2.0, 1.25)
CORNERS = np.array([[0, 0, 0], [2.0, 0, 0], [2.0, 1.25, 0], [0, 1.25, 0]])


def looking(eye, at, roll=0.0):
    """Returns the pose (4, 4) of a camera that looks at a point."""
    z = np.subtract(at, eye) / np.linalg.norm(np.subtract(at, eye))
    x = np.cross(z, [0.0, 0.05, 1.0])
    x /= np.linalg.norm(x)
    R = np.column_stack([x, np.cross(z, x), z]) @ geometry.rotation_from_rpy(0.0, 0.0, roll)
    return geometry.make_transform(R, np.array(eye, float))


POSES = [
    looking((1.0, 0.6, 2.9), (1.0, 0.7, 0.0)),  # from the ceiling
    looking((-1.0, -2.0, 2.2), (1.0, 0.6, 0.0), 0.2),
    looking((3.5, 3.0, 1.8), (1.0, 0.6, 0.0), -0.1),
]


def pixels_from(T, focal, points):
    """Returns where a camera with this pose and focal length [px] sees points (N, 3)."""
    return CameraModel.ideal(*IMAGE, focal).project(geometry.transform_points(geometry.invert_transform(T), points))


@pytest.mark.parametrize("T", POSES)
@pytest.mark.parametrize("focal", [700.0, 1100.0])
@pytest.mark.parametrize("order", [[0, 1, 2, 3], [0, 3, 2, 1], [2, 3, 0, 1]])
def test_the_floor_is_where_it_is(T, focal, order):
    pixels = pixels_from(T, focal, CORNERS)[order]
    size = SIZE if abs(order[1] - order[0]) == 1 else SIZE[::-1]
    view = estimate_camera_from_rectangle(pixels, size, IMAGE)
    # the person defines the map: its origin is the first corner, and x runs along the first side
    first, second = CORNERS[order[0]], CORNERS[order[1]]
    along = (second - first)[:2] / np.linalg.norm(second - first)
    frame = np.column_stack([along, [-along[1], along[0]]])
    places = np.array([[0.5, 0.3], [1.5, 1.0], [1.0, -0.2]])
    expected = (places - first[:2]) @ frame
    pixels = pixels_from(T, focal, np.column_stack([places, np.zeros(3)]))
    assert np.abs(project_to_floor(view.camera, view.T_map_camera, pixels)[:, :2] - expected).max() < 0.01


def test_a_slanted_view_gives_the_focal_length_and_the_height():
    view = estimate_camera_from_rectangle(pixels_from(POSES[1], 700.0, CORNERS), SIZE, IMAGE)
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
        estimate_camera_from_rectangle(np.array(pixels, float), size, IMAGE)


def test_the_uncertainty_is_that_of_clicks():
    T, focal = POSES[0], 900.0
    places = np.array([[100.0, 100.0], [1200.0, 650.0]])
    true = project_to_floor(CameraModel.ideal(*IMAGE, focal), T, places)[:, :2]
    for share, least, most in ((1.0, 0.001, 0.05), (0.15, 0.02, 1.0)):
        pixels = pixels_from(T, focal, CORNERS * share)
        size = SIZE[0] * share, SIZE[1] * share
        uncertainty = click_uncertainty(pixels, size, IMAGE, places)
        assert least < uncertainty < most
        random, errors = np.random.default_rng(7), []
        for _ in range(20):
            view = estimate_camera_from_rectangle(pixels + random.normal(0, 1.0, (4, 2)), size, IMAGE)
            errors.append(project_to_floor(view.camera, view.T_map_camera, places)[:, :2] - true)
        rms_errors = np.sqrt(np.mean(np.sum(np.square(errors), axis=2), axis=0))
        assert 0.4 * uncertainty < rms_errors.max() < 2.5 * uncertainty
