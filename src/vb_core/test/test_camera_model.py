import cv2
import numpy as np
import pytest

from refusals import refused
from vb_core.camera_model import CameraModel, intersect_floor

WIDE = CameraModel(1920, 1080, CameraModel.ideal(1920, 1080, 1100.0).matrix, [-0.28, 0.09, 1e-3, -5e-4, -0.01])


@pytest.mark.parametrize("camera", [WIDE, CameraModel.ideal(640, 480, 577.0)])
def test_points_behind_the_camera_have_no_pixel(camera):
    pixels = camera.project(np.array([[0.1, 0.1, 2.0], [0.1, 0.1, -2.0], [0.0, 0.0, 0.0]]))
    assert np.isfinite(pixels[0]).all()
    assert np.isnan(pixels[1:]).all()
    assert list(camera.contains(pixels)) == [True, False, False]


IMPOSSIBLE_CAMERAS = {
    "no width": (0, 480, np.eye(3), np.zeros(5)),
    "no horizontal focal length": (640, 480, np.diag([0.0, 1.0, 1.0]), np.zeros(5)),
    "no vertical focal length": (640, 480, np.diag([1.0, 0.0, 1.0]), np.zeros(5)),
    "a matrix of NaN": (640, 480, np.full((3, 3), np.nan), np.zeros(5)),
    "three coefficients": (640, 480, np.eye(3), np.zeros(3)),
    "infinite distortion": (640, 480, np.eye(3), np.full(5, np.inf)),
    "a fisheye with five coefficients": (640, 480, np.eye(3), [0.1, 0.2, 0.3, 0.4, 0.01], True),
}


@pytest.mark.parametrize("camera", IMPOSSIBLE_CAMERAS.values(), ids=IMPOSSIBLE_CAMERAS)
def test_impossible_cameras_are_refused(camera):
    with refused("bad_camera_info"):
        CameraModel(*camera)


LENSES = {
    "116 degrees": ([-0.30, 0.08, 0.0, 0.0, 0.0], 260.0),
    "turns back within the image": ([-0.32, 0.12, 0.0, 0.0, -0.02], 300.0),
    "with tangential distortion": ([-0.28, 0.06, 0.004, -0.003, 0.0], 260.0),
    "rational": ([0.5, 0.1, 0.001, 0.0, 0.02, 0.9, 0.3, 0.05], 250.0),
}


@pytest.mark.parametrize("lens", LENSES)
def test_rays_of_wide_lenses_are_exact(lens):
    distortion, focal = LENSES[lens]
    matrix = np.array([[focal, 0, 319.5], [0, focal, 239.5], [0, 0, 1]])
    camera = CameraModel(640, 480, matrix, np.array(distortion))
    # OpenCV's own projection is the oracle, up to where the radius in the image stops growing
    radii = np.linspace(0.0, 4.0, 4001)
    axis = np.column_stack([radii, np.zeros(4001), np.ones(4001)])
    rise = cv2.projectPoints(axis, np.zeros(3), np.zeros(3), matrix, camera.distortion)[0][:, 0, 0]
    falls = np.flatnonzero(np.diff(rise) <= 0)
    end = radii[falls[0]] if len(falls) else 4.0
    angles, reach = np.meshgrid(np.linspace(0, 2 * np.pi, 73), np.linspace(0, 0.97 * end, 60))
    points = np.column_stack([(reach * np.cos(angles)).ravel(), (reach * np.sin(angles)).ravel(), np.ones(angles.size)])
    pixels = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, camera.distortion)[0][:, 0]
    in_image = camera.contains(pixels)
    rays = camera.pixels_to_rays(pixels[in_image])
    assert in_image.sum() > 500
    assert np.abs(rays - points[in_image]).max() < 1e-6
    if len(falls):
        # no ray for a pixel beyond the model's image, and no pixel for a point beyond its limit
        nowhere = np.array([(319.5 + 1.05 * (rise.max() - 319.5), 239.5), (0.0, 0.0)])
        assert np.isnan(camera.pixels_to_rays(nowhere)[:, 0]).all()
        assert np.isnan(camera.project(np.array([[1.1 * end, 0.0, 1.0]]))).all()


@pytest.mark.parametrize("k, end", [([0.0] * 4, 90.0), ([0.05, -0.01, 0.002, 0.0], 90.0), ([-0.2, 0, 0, 0], 73.97)])
def test_a_fisheye_follows_its_polynomial_up_to_its_limit(k, end):
    camera = CameraModel(1280, 960, CameraModel.ideal(1280, 960, 300.0).matrix, np.array(k), fisheye=True)
    angles = np.radians(np.linspace(0.0, min(0.99 * end, 85.0), 50))
    points = np.column_stack([0.6 * np.tan(angles), 0.8 * np.tan(angles), np.ones(50)])
    radii = 300.0 * angles * (1.0 + sum(k[i] * angles ** (2 * i + 2) for i in range(4)))
    pixels = camera.project(points)
    assert np.allclose(pixels, np.column_stack([639.5 + 0.6 * radii, 479.5 + 0.8 * radii]), atol=1e-6)
    assert np.allclose(camera.project(camera.pixels_to_rays(pixels)), pixels, atol=1e-3)
    # the limit is where 1 + 3 k1 a^2 + 5 k2 a^4 + ... is 0, if that is below 90 degrees
    assert np.isnan(camera.project([[np.tan(np.radians(1.01 * end)), 0.0, 1.0 if end < 90.0 else -1.0]])).all()
    assert np.degrees(np.arctan(camera.max_ray_tangent)) == pytest.approx(end, abs=0.01)


@pytest.mark.parametrize("camera", [WIDE, CameraModel.ideal(640, 480, 577.0), CameraModel(8, 6, np.eye(3), [], True)])
def test_empty_arrays_stay_empty(camera):
    assert camera.project(np.zeros((0, 3))).shape == (0, 2)
    assert camera.pixels_to_rays(np.zeros((0, 2))).shape == (0, 3)


@pytest.mark.parametrize("given", [[0.1], [0.1, 0.2, 0.3, 0.4], [0.1, 0.2, 0.3, 0.4, 0, 0, 0, 0, 0]])
def test_a_fisheye_ignores_zeros_after_four_coefficients(given):
    assert CameraModel(8, 6, np.eye(3), given, True).distortion.tolist() == [*given, 0.0, 0.0, 0.0][:4]


MODELS = {
    "no distortion": ([], False),
    "plumb_bob": (WIDE.distortion, False),
    "rational": ([0.1, 0.02, 0, 0, 0.01, 0.05, 0.01, 0.003], False),
    "thin prism": (np.full(12, 1e-3), False),
    "fisheye": ([0.02, 0, 0, 0], True),
}


@pytest.mark.parametrize("distortion, fisheye", MODELS.values(), ids=MODELS)
def test_projection_and_rays_agree_with_opencv(distortion, fisheye):
    matrix = np.array([[900.0, 0.0, 500.0], [0.0, 1300.0, 700.0], [0.0, 0.0, 1.0]])
    camera = CameraModel(1400, 1200, matrix, np.array(distortion), fisheye)
    points = np.random.default_rng(8).uniform([-0.3, -0.3, 0.8], [0.5, 0.3, 1.4], (100, 3))
    project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
    expected = project(points[:, None], np.zeros(3), np.zeros(3), matrix, camera.distortion)[0][:, 0]
    assert np.abs(camera.project(points) - expected).max() < 1e-6
    assert np.abs(camera.pixels_to_rays(expected) - points / points[:, 2:]).max() < 1e-6
    assert camera.focal_px == 1100.0
    # in an image of another shape, a point lies at the same fraction of width and height
    half = camera.scaled_to(350, 600)
    shares = (camera.project(points) + 0.5) / (1400, 1200)
    assert np.allclose((half.project(points) + 0.5) / (350, 600), shares)
    assert half.fisheye == fisheye
    assert half.matrix[2].tolist() == [0, 0, 1]


def test_an_image_contains_the_pixels_within_its_edges():
    camera = CameraModel.ideal(4, 3, 5.0)
    columns, rows = np.meshgrid(np.arange(-1.0, 5.0, 0.25), np.arange(-1.0, 4.0, 0.25))
    pixels = np.vstack([np.column_stack([columns.ravel(), rows.ravel()]), (np.nan, 1.0)])
    expected = [-0.5 <= column <= 3.5 and -0.5 <= row <= 2.5 for column, row in pixels.tolist()]
    assert camera.contains(pixels).tolist() == expected


def test_rays_meet_the_floor_or_nothing():
    """A camera 3 m up, looking straight down: its x axis is the map's, its y and z axes are reversed."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = 1.0, 2.0, 3.0
    points = intersect_floor(pose, np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1], [0, 0, -1], [1, 0, 0], [np.nan, 0, 1]]))
    assert np.allclose(points[:3], [[1, 2, 0], [4, 2, 0], [1, -1, 0]])
    assert np.isnan(points[3:5]).all()
    assert np.isnan(points[5]).any()
