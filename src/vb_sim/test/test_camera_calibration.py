"""The errors that a calibration leaves: on the floor, where they count; none where nothing is measured wrong."""

from pathlib import Path

import numpy as np
import pytest

from refusals import refused

from vb_core import geometry
from vb_sim.cameras.camera_calibration import calibrated_pose
from vb_sim.models import Optics
from vb_sim.room.world import CeilingCamera, load_world

CAMERAS = load_world(str(Path(__file__).resolve().parents[1] / "worlds" / "lab.yaml")).cameras
TILTED = CeilingCamera(name="tilted", pitch=35.0)


def off_on_floor(camera, pose, far=8.0):
    """(N,) [m] by which the floor points of the image are wrong, up to a distance [m]."""
    model, true = camera.model(), camera.pose()
    u, v = np.meshgrid(np.linspace(0, model.width - 1, 15), np.linspace(0, model.height - 1, 9))
    rays = model.rays(np.column_stack([u.ravel(), v.ravel()]))
    found, expected = (geometry.intersect_floor(T[:3, 3], rays @ T[:3, :3].T) for T in (pose, true))
    near = np.linalg.norm(expected - true[:3, 3], axis=1) < far
    return np.linalg.norm((found - expected)[near], axis=1)


@pytest.mark.parametrize("camera", [*CAMERAS, TILTED], ids=lambda camera: camera.name)
def test_exact_measurements_give_the_true_pose(camera):
    found = calibrated_pose(camera, Optics(calibration_point_m=0.0), 1)
    np.testing.assert_allclose(found, camera.pose(), atol=1e-6)


def test_floor_is_as_wrong_as_least_squares_says():
    # N places measured to sigma per coordinate leave sigma * sqrt(6 / N) at themselves, whatever else they are
    camera, rms = CAMERAS[1], {}
    for count in (4, 8, 32):
        optics = Optics(calibration_points=count, calibration_point_m=0.01)
        errors = np.concatenate([off_on_floor(camera, calibrated_pose(camera, optics, seed)) for seed in range(40)])
        rms[count] = np.sqrt(np.mean(errors**2))
        assert 0.6 < rms[count] / (0.01 * np.sqrt(6.0 / count)) < 1.2
    assert rms[4] > rms[8] > rms[32]


def test_tilted_camera_is_calibrated_where_it_sees_floor():
    errors = [np.median(off_on_floor(TILTED, calibrated_pose(TILTED, Optics(), seed))) for seed in range(10)]
    assert np.median(errors) < 0.03
    with refused("no_floor"):
        calibrated_pose(CeilingCamera(pitch=5.0, horizontal_fov=6.0), Optics(), 1)
