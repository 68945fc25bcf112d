"""The rendered cameras and their calibration errors, against independently computed geometry."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from refusals import refused
from vb_testing import assert_fields
from vb_core import geometry
from vb_core.camera_model import CameraModel, project_to_floor, project_to_pixels
from vb_core.image_format import PixelReader
from vb_sim.cameras.camera_calibration import calibrated_pose
from vb_sim.rendering.ceiling_view import CeilingView
from vb_sim.rendering.floor_texture import render_floor
from vb_sim.cameras.frame_clock import FrameSchedule, SmoothClock
from vb_sim.lab_history import LabHistory, Snapshot
from vb_sim.rendering.mesh import DepthBuffer, RayGrid, world_mesh
from vb_sim.model_params import CameraNoise, Models, Optics, RobotCamera
from vb_sim.rendering.robot_view import RobotView
from vb_sim.rendering.laser_spot import render_spot
from vb_sim.world import CeilingCamera, load_world, world_from_mapping

WORLD = {
    "room": {"size": [4.0, 3.0]},
    "floor": {"kind": "plain", "color": [120, 120, 120], "contrast": 0.0},
    "furniture": [{"name": "box", "x": 3.0, "y": 1.0, "size": [0.4, 0.4], "height": 0.8, "color": [200, 40, 40]}],
    "cameras": [
        {"name": "mono", "x": 2.0, "y": 1.5, "width": 960, "image_height": 540, "encoding": "mono8"},
        {"name": "bayer", "x": 2.0, "y": 1.5, "yaw": 30, "width": 960, "image_height": 540},
    ],
    "robots": [
        {"name": "robot", "start": [0.5, 1.5, 0.0]},
        {"name": "other", "namespace": "other", "start": [3.5, 2.5, 0.0]},
    ],
}
RADII = {"robot": 0.18, "other": 0.18}
NO_NOISE = {"read_sigma": 0.0, "full_well_e": 1e12}  # so many electrons have no photon noise
NO_DEPTH_NOISE = {"depth_sigma": 0.0, "depth_sigma_quadratic": 0.0, "depth_holes": 0.0}
QUIET = Models(camera_noise=CameraNoise(prnu=0.0, **NO_NOISE), robot_camera=RobotCamera(**NO_NOISE, **NO_DEPTH_NOISE))


@pytest.fixture(scope="module")
def lab():
    world = world_from_mapping(WORLD)
    return world, render_floor(world, 3, resolution=0.005), world_mesh(world)


def view_from_ceiling(lab, name, models=QUIET, **changes):
    world, floor, mesh = lab
    return CeilingView(dataclasses.replace(world.camera(name), **changes), RADII, floor, mesh, models, 5)


def view_from_robot(lab, models=QUIET):
    world, floor, mesh = lab
    return RobotView(world.robots[0], RADII, floor, mesh, models, 5)


def expected_pixel(model, T_map_optical, x, y):
    return project_to_pixels(model, T_map_optical, np.array([[x, y, 0.0]]))[0]


def added_light(view, scene):
    """Returns what the laser adds to the image of a scene."""
    lit = view.image(scene).astype(float)
    return lit - view.image(dataclasses.replace(scene, laser=None))


# ------------------------------------------------------------------ the spot
@pytest.mark.parametrize("name, color", [("mono", "red"), ("mono", "green"), ("bayer", "green")])
def test_spot_lies_where_the_camera_model_says(lab, name, color):
    view = view_from_ceiling(lab, name)
    rng = np.random.default_rng(1)
    for x, y in np.column_stack([rng.uniform(0.8, 2.5, 15), rng.uniform(0.6, 2.4, 15)]):
        change = added_light(view, Snapshot(1.0, laser=(x, y), laser_color=color))
        if name == "bayer":
            # keep only the green pixels, which lie in every row and column
            change[0::2, 0::2] = change[1::2, 1::2] = 0.0
        rows, columns = np.indices(change.shape)
        centroid = np.array([(change * columns).sum(), (change * rows).sum()]) / change.sum()
        assert np.linalg.norm(centroid - expected_pixel(view.model, view.pose, x, y)) < 0.2


def test_spot_has_a_white_core_and_a_coloured_halo(lab):
    view = view_from_robot(lab)
    image = view.image(Snapshot(1.0, {"robot": (0.5, 1.5, 0.0)}, (1.3, 1.5), "red")).astype(int)
    u, v = np.round(expected_pixel(view.model, view.camera_pose(Snapshot(1.0)), 1.3, 1.5)).astype(int)
    assert (image[v, u] > 250).all()
    ring = image[v, u + 2 : u + 7]
    assert ((ring[:, 0] > ring[:, 1] + 40) & (ring[:, 0] > ring[:, 2] + 40)).any()


def test_bloom_grows_with_exposure_and_shrinks_with_distance(lab):
    world, _, _ = lab
    camera = world.camera("mono")

    def saturated(height, exposure):
        pose = dataclasses.replace(camera, height=height).pose()
        spot = render_spot((2.0, 1.5), (0, 0), None, camera.model(), pose, Optics(exposure_gain=exposure))
        return int((spot.light > 255).sum())

    assert saturated(1.5, 1.0) > saturated(2.95, 1.0) > 0
    assert saturated(2.95, 2.0) > saturated(2.95, 0.5)


def test_a_fast_spot_is_smeared_over_the_exposure(lab):
    view = view_from_ceiling(lab, "mono")
    still = view.spot(Snapshot(1.0, laser=(2.0, 1.5)))
    fast = view.spot(Snapshot(1.0, laser=(2.0, 1.5), laser_velocity=(2.0, 0.0)))
    spread = [np.ptp(np.nonzero((spot.light > 100).any(axis=0))[0]) for spot in (still, fast)]
    assert spread[1] - spread[0] == pytest.approx(2.0 * 0.01 * view.model.focal_px / view.pose[2, 3], abs=2.0)
    assert fast.light.sum() == pytest.approx(still.light.sum(), rel=0.02)


# ------------------------------------------------------------------ occlusion
def test_person_and_furniture_hide_the_spot(lab):
    view = view_from_ceiling(lab, "mono")
    # from the camera, the ray to a point beyond the person passes through the shoulders
    hidden, behind_box = (0.9, 1.5), (3.28, 0.9)
    assert added_light(view, Snapshot(1.0, laser=hidden)).max() > 80
    u, v = np.round(expected_pixel(view.model, view.pose, *hidden)).astype(int)
    with_person = view.image(Snapshot(1.0, laser=hidden, person=(1.2, 1.5, 0.0)))
    assert with_person[v - 3 : v + 4, u - 3 : u + 4].max() < 200
    assert np.abs(added_light(view, Snapshot(1.0, laser=behind_box))).max() <= 2
    assert added_light(view, Snapshot(1.0, laser=(2.6, 1.0))).max() > 80
    # the box hides it from the robot, too
    scenes = (Snapshot(1.0, {"robot": (2.0, 1.0, 0.0)}, place) for place in ((3.4, 1.0), (2.6, 1.0)))
    hidden_light, visible_light = (np.abs(added_light(view_from_robot(lab), scene)).max() for scene in scenes)
    assert hidden_light == 0
    assert visible_light > 80


# ------------------------------------------------------------------ frames
def test_a_frame_leaves_no_trace_in_the_next(lab):
    view = view_from_ceiling(lab, "bayer")
    empty = view.image(Snapshot(1.0)).copy()
    robots = {"robot": (2.0, 1.5, 0.3), "other": (2.2, 1.6, 0.0)}
    scene = Snapshot(1.0, robots, (1.9, 1.6), "red", (0.5, 0.1), (1.6, 1.4, 0.2))
    busy = view.image(scene).copy()
    assert (busy != empty).sum() > 10000
    np.testing.assert_array_equal(view.image(Snapshot(1.1)), empty)
    np.testing.assert_array_equal(view.image(scene), busy)


def test_noise_is_as_large_as_the_model_says(lab):
    view = view_from_ceiling(lab, "mono", Models())
    first, second = (view.image(Snapshot(1.0)).astype(float) for _ in range(2))
    middle = (slice(200, 340), slice(300, 500))
    sigma = Models().camera_noise.sigma(first[middle].mean())
    # rounding to whole grey levels adds a variance of 1/12
    assert (first - second)[middle].std() == pytest.approx(np.sqrt(2 * (sigma**2 + 1 / 12)), rel=0.05)


@pytest.mark.parametrize("encoding,channels", [("bgr8", 3), ("mono8", 1), ("bayer_rggb8", 1)])
def test_every_encoding_shows_the_same_scene(lab, encoding, channels):
    view = view_from_ceiling(lab, "mono", encoding=encoding)
    image = view.image(Snapshot(1.0, {"robot": (1.5, 1.5, 0.0)}, (2.0, 1.5), "red", (0, 0), (2.5, 2.2, -1.0)))
    assert image.dtype == np.uint8
    assert image.shape == ((540, 960) if channels == 1 else (540, 960, 3))
    shown = PixelReader().read(image, encoding).bgr()
    u, v = np.round(expected_pixel(view.model, view.pose, 3.0, 1.0)).astype(int)
    assert shown.shape == (540, 960, 3)
    if encoding != "mono8":
        assert shown[v, u, 2] > shown[v, u, 0] + 60


# ------------------------------------------------------------------ depth
def test_depth_of_the_floor_is_analytic(lab):
    view = view_from_robot(lab)
    scene = Snapshot(1.0, {"robot": (0.6, 2.2, -0.5)})
    depth = view.depth(scene).astype(float) / 1000.0
    pose = view.camera_pose(scene)
    u, v = np.meshgrid(np.arange(160), np.arange(60, 120))
    points = project_to_floor(view.depth_model, pose, np.column_stack([u.ravel(), v.ravel()]))
    expected = geometry.transform_points(geometry.invert_transform(pose), points)[:, 2].reshape(60, 160)
    measured = depth[60:] > 0
    assert measured.mean() > 0.95
    assert np.abs(depth[60:] - expected)[measured].max() < 0.001


def test_depth_of_a_box_and_a_ray_caster_agree(lab):
    view = view_from_robot(lab)
    scene = Snapshot(1.0, {"robot": (1.6, 1.0, 0.0)})
    depth = view.depth(scene) / 1000.0
    pose = view.camera_pose(scene)
    # the front face is the plane x = 2.8
    column, row = 80, 6
    ray = pose[:3, :3] @ view.depth_model.pixels_to_rays(np.array([[column, row]]))[0]
    assert depth[row, column] == pytest.approx((2.8 - pose[0, 3]) / ray[0], abs=0.002)


def test_depth_has_holes_at_flat_angles_and_noise_that_grows(lab):
    view = view_from_robot(lab, Models())
    scene = Snapshot(1.0, {"robot": (0.5, 1.5, 0.0)})
    stack = np.array([view.depth(scene) for _ in range(30)]).astype(float)
    assert (stack[:, :3] == 0).mean() > 0.5
    near, far = (np.ma.masked_equal(stack[:, row], 0).std(axis=0).mean() for row in (110, 30))
    assert 0.5 < near < far


# ------------------------------------------------------------------ geometry of the drawing
def test_rays_of_a_distorted_camera_are_exact(lab):
    camera = lab[0].camera("mono").model()
    grid = RayGrid(camera)
    pixels = np.array([(0, 0), (959, 539), (13, 500), (480, 270)])
    rays = np.stack([grid.x, grid.y], axis=-1)[pixels[:, 1], pixels[:, 0]]
    assert np.abs(rays - camera.pixels_to_rays(pixels)[:, :2]).max() * camera.focal_px < 0.02


def test_the_nearer_box_hides_the_other_whatever_the_order():
    boxes = [
        {"name": "a", "x": 2.0, "y": 1.0, "size": [0.3, 0.3], "height": 0.5, "color": [200, 0, 0]},
        {"name": "b", "x": 2.6, "y": 1.0, "size": [0.3, 0.9], "height": 0.5, "color": [0, 0, 200]},
    ]
    scene = Snapshot(1.0, {"robot": (0.8, 1.0, 0.0)})
    pictures = []
    for order in (boxes, boxes[::-1]):
        world = world_from_mapping({**WORLD, "furniture": order})
        view = RobotView(world.robots[0], RADII, render_floor(world, 3, 0.01), world_mesh(world), QUIET, 5)
        pictures.append(view.image(scene))
    np.testing.assert_array_equal(*pictures)
    front = project_to_pixels(view.model, view.camera_pose(scene), np.array([[1.85, 1.0, 0.25]]))
    u, v = np.round(front[0]).astype(int)
    red, _, blue = pictures[0][v, u]
    assert red > 80
    assert blue < 20


def test_a_thing_seen_in_one_pixel_is_drawn():
    camera = CameraModel(40, 30, np.array([[50.0, 0.0, 20.0], [0.0, 50.0, 15.0], [0.0, 0.0, 1.0]]), np.zeros(5))
    buffer = DepthBuffer(RayGrid(camera))
    beyond_the_corner = np.array([(-9.0, -9.0), (0.0, -9.0), (0.0, 0.0), (-9.0, 0.0)])
    buffer.draw_flat(beyond_the_corner, 2.0, (10, 20, 30), np.array([0.0, 0.0, -1.0]))
    assert buffer.inverse[0, 0] == pytest.approx(0.5)
    assert np.count_nonzero(buffer.inverse) == 1


# ------------------------------------------------------------------ time
def test_history_interpolates_and_forgets():
    history = LabHistory()
    assert history.at(5.0).person is None
    for step in range(10):
        t = 5.0 + 0.02 * step
        history.add(Snapshot(t, {"robot": (t, 0.0, 3.1)}, (2 * t, 1.0), "red", (0, 0), (t, t, 0.0)))
    scene = history.at(5.05)
    assert scene.robots["robot"][0] == pytest.approx(5.05)
    assert (scene.laser[0], scene.laser_velocity[0]) == pytest.approx((10.10, 2.0))
    assert history.at(5.19).laser[0] == pytest.approx(10.38)
    assert_fields(history.at(6.5), laser=None, robots={})
    history.add(Snapshot(5.20, laser=(12.0, 1.0)))  # a spot that jumps is not smeared over the floor
    assert_fields(history.at(5.192), laser=(12.0, 1.0), laser_velocity=(0.0, 0.0))


def test_frames_are_spread_evenly_and_on_time():
    schedule = FrameSchedule([25.0, 25.0, 25.0], 0.015)
    frames = [image for step in range(1, 1001) for image in schedule.due(10.0 + step * 0.002)]
    for index in range(3):
        stamps = [stamp for i, stamp in frames if i == index]
        assert len(stamps) in (50, 51)
        np.testing.assert_allclose(np.diff(stamps), 0.04, atol=1e-9)
    np.testing.assert_allclose(np.diff(sorted(stamp for _, stamp in frames)), 0.04 / 3, atol=1e-9)
    assert schedule.skipped == 0
    # a computer that is too slow takes the newest frames
    assert (len(schedule.due(14.0)), schedule.skipped) == (3, 3 * 49)
    assert len(schedule.due(2.0)) == 3  # time has jumped back


def test_smooth_clock_runs_between_ticks_and_stops_with_time():
    times = {"sim": 1.0, "wall": 100.0}
    clock = SmoothClock(lambda: times["sim"], lambda: times["wall"])
    assert clock.now() == 1.0
    times["wall"] += 0.01
    assert clock.now() == pytest.approx(1.01)
    times["wall"] += 5.0
    assert clock.now() == pytest.approx(1.025)


# ------------------------------------------------------------------ calibration errors
CAMERAS = load_world(str(Path(__file__).resolve().parents[1] / "worlds" / "lab.yaml")).cameras
TILTED = CeilingCamera(name="tilted", pitch=35.0)


def floor_errors(camera, pose, far=8.0):
    """Returns (N,) [m], the errors of the image's floor points up to a distance [m]."""
    model, true = camera.model(), camera.pose()
    u, v = np.meshgrid(np.linspace(0, model.width - 1, 15), np.linspace(0, model.height - 1, 9))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    measured, expected = (project_to_floor(model, T, pixels) for T in (pose, true))
    near = np.linalg.norm(expected - true[:3, 3], axis=1) < far
    return np.linalg.norm((measured - expected)[near], axis=1)


@pytest.mark.parametrize("camera", [*CAMERAS, TILTED], ids=lambda camera: camera.name)
def test_exact_measurements_give_the_true_pose(camera):
    np.testing.assert_allclose(calibrated_pose(camera, Optics(calibration_point_m=0.0), 1), camera.pose(), atol=1e-6)


def test_floor_is_as_wrong_as_least_squares_says():
    # N points measured to sigma per coordinate leave an RMS of sigma * sqrt(6 / N) at these points, wherever they are
    camera, rms = CAMERAS[1], {}
    for count in (4, 8, 32):
        optics = Optics(calibration_points=count, calibration_point_m=0.01)
        errors = np.concatenate([floor_errors(camera, calibrated_pose(camera, optics, seed)) for seed in range(40)])
        rms[count] = np.sqrt(np.mean(errors**2))
        assert 0.6 < rms[count] / (0.01 * np.sqrt(6.0 / count)) < 1.2
    assert rms[4] > rms[8] > rms[32]


def test_tilted_camera_is_calibrated_where_it_sees_floor():
    errors = [np.median(floor_errors(TILTED, calibrated_pose(TILTED, Optics(), seed))) for seed in range(10)]
    assert np.median(errors) < 0.03
    with refused("no_floor"):
        calibrated_pose(CeilingCamera(pitch=5.0, horizontal_fov=6.0), Optics(), 1)
