import cv2
import numpy as np
import pytest

from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError

WIDE = CameraModel(
    1920, 1080, CameraModel.ideal(1920, 1080, 1100.0).matrix, np.array([-0.28, 0.09, 0.001, -0.0005, -0.01])
)


@pytest.mark.parametrize("camera", [CameraModel.ideal(640, 480, 577.0), WIDE])
def test_project_and_rays_are_inverse_over_the_whole_image(camera):
    columns, rows = np.meshgrid(np.linspace(0, camera.width - 1, 25), np.linspace(0, camera.height - 1, 15))
    pixels = np.column_stack([columns.ravel(), rows.ravel()])
    rays = camera.rays(pixels)
    assert np.abs(camera.project(rays * 3.7) - pixels).max() < 0.01


@pytest.mark.parametrize(
    "distortion", [np.zeros(5), WIDE.distortion, [0.1, 0.02, 0, 0, 0.01, 0.05, 0.01, 0.003], np.full(12, 1e-3)]
)
@pytest.mark.parametrize("count", [1, 3, 500])
def test_projection_is_opencvs(distortion, count):
    camera = CameraModel(1920, 1080, WIDE.matrix, np.array(distortion))
    points = np.random.default_rng(count).uniform([-2, -1, 0.5], [2, 1, 4], (count, 3))
    pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.matrix, camera.distortion)
    assert np.abs(camera.project(points) - pixels[:, 0]).max() < 1e-6
    rays = cv2.undistortPoints(pixels, camera.matrix, camera.distortion)[:, 0]
    if not camera.distorted:
        assert np.abs(camera.rays(pixels)[:, :2] - rays).max() < 1e-9


def test_points_behind_the_camera_have_no_pixel():
    pixels = WIDE.project(np.array([[0.1, 0.1, 2.0], [0.1, 0.1, -2.0], [0.0, 0.0, 0.0]]))
    assert np.isfinite(pixels[0]).all() and np.isnan(pixels[1:]).all()
    assert list(WIDE.contains(pixels)) == [True, False, False]


def test_a_coarser_image_of_the_same_camera_sees_along_the_same_rays():
    fine = CameraModel.ideal(640, 480, 577.0)
    coarse = fine.scaled_to(160, 120)
    # the middle of a coarse pixel is the middle of its 4 x 4 fine pixels
    assert np.allclose(coarse.rays([[10, 20]]), fine.rays([[41.5, 81.5]]))


@pytest.mark.parametrize(
    "width, height, matrix, distortion",
    [
        (0, 480, np.eye(3), np.zeros(5)),
        (640, 480, np.zeros((3, 3)), np.zeros(5)),
        (640, 480, np.full((3, 3), np.nan), np.zeros(5)),
        (640, 480, np.eye(3), np.zeros(3)),
        (640, 480, np.eye(3), np.full(5, np.inf)),
    ],
)
def test_what_cannot_be_a_camera_is_refused(width, height, matrix, distortion):
    with pytest.raises(CodedError) as caught:
        CameraModel(width, height, matrix, distortion)
    assert caught.value.code == "bad_camera_info"
