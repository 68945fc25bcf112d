"""Light, sun, reflections and other people in the pictures of both kinds of cameras."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from vb_core import geometry
from vb_core.image_format import PixelReader
from vb_sim.cameras.ceiling_view import CeilingView
from vb_sim.room.disturbances import Bystander, Glint, SceneConditions
from vb_sim.room.floor_texture import render_floor
from vb_sim.lab_history import Snapshot
from vb_sim.room.mesh import world_mesh
from vb_sim.room.camera_models import CameraModels
from vb_sim.cameras.robot_view import RobotView
from vb_sim.room.world import load_world

SUN = ((1.3, 0.8), (1.7, 0.8), (1.7, 1.2), (1.3, 1.2))


@pytest.fixture(scope="module")
def views():
    world = load_world(str(Path(__file__).with_name("cameras_world.yaml")))
    floor, mesh, models = render_floor(world, 1, 0.005), world_mesh(world), CameraModels()
    ceiling = CeilingView(world.cameras[0], world.robot_radii(), floor, mesh, models, 1, noise=False)
    return ceiling, RobotView(world.robots[0], world.robot_radii(), floor, mesh, models, 1, noise=False)


def seen_at(model, pose, point):
    in_camera = geometry.apply(geometry.invert(pose), np.array([point], dtype=float))
    return model.project(in_camera)[0]


def render(views, place, around, **more):
    """Both pictures of a scene in bgr, and where each sees a place on the floor."""
    ceiling, robot = views
    snapshot = Snapshot(0.0, robots={robot.robot.name: robot.robot.start_pose()}, around=around, **more)
    pictures = [
        PixelReader().read(ceiling.frame(snapshot), ceiling.encoding).bgr(),
        cv2.cvtColor(robot.color(snapshot), cv2.COLOR_RGB2BGR),
    ]
    return pictures, [
        seen_at(ceiling.model, ceiling.pose, place),
        seen_at(robot.color_model, robot.camera_pose(snapshot), place),
    ]


def level(picture, pixel):
    column, row = np.rint(pixel).astype(int)
    return picture[row - 1 : row + 2, column - 1 : column + 2].mean(axis=(0, 1))


def test_nothing_unusual_is_the_default(views):
    pictures, _ = render(views, (1.5, 1.0, 0.0), SceneConditions())
    again, _ = render(views, (1.5, 1.0, 0.0), SceneConditions(light=0.4, sun=SUN, glints=(Glint((1.5, 1.0, 0.0)),)))
    after, _ = render(views, (1.5, 1.0, 0.0), SceneConditions())
    for before, changed, later in zip(pictures, again, after):
        assert (before != changed).any() and (before == later).all()


@pytest.mark.parametrize("around", [SceneConditions(light=0.5), SceneConditions(exposure=1.5)])
def test_lamps_and_exposure(views, around):
    plain, places = render(views, (1.5, 1.0, 0.0), SceneConditions())
    lit, _ = render(views, (1.5, 1.0, 0.0), around)
    for before, after, pixel in zip(plain, lit, places):
        assert level(after, pixel) == pytest.approx(around.light * around.exposure * level(before, pixel), abs=1.5)


def test_sun_lights_its_polygon_only(views):
    around = SceneConditions(sun=SUN, sun_gain=1.6)
    for place, gain in (((1.5, 1.0, 0.0), 1.6), ((1.5, 1.35, 0.0), 1.0), ((1.1, 1.0, 0.0), 1.0)):
        plain, places = render(views, place, SceneConditions())
        lit, _ = render(views, place, around)
        for before, after, pixel in zip(plain, lit, places):
            assert level(after, pixel) == pytest.approx(gain * level(before, pixel), abs=1.5)


def test_a_glint_is_where_it_should_be(views):
    place = (1.4, 1.1, 0.06)
    plain, places = render(views, place, SceneConditions())
    shiny, _ = render(views, place, SceneConditions(glints=(Glint(place, 0.02, 150.0),)))
    for before, after, pixel in zip(plain, shiny, places):
        more = cv2.absdiff(after, before).sum(axis=2, dtype=float)
        rows, columns = np.indices(more.shape)
        assert np.array([(more * columns).sum(), (more * rows).sum()]) / more.sum() == pytest.approx(pixel, abs=0.6)


def test_bystanders_wear_what_they_wear(views):
    # a ceiling camera sees shirts, the robot's camera sees shoes
    dark, white = (
        render(
            views, (1.5, 1.0, 0.0), SceneConditions(bystanders=(Bystander((1.5, 1.0, 0.3), (tone,) * 3, (tone,) * 3),))
        )[0]
        for tone in (40, 240)
    )
    assert all((cv2.absdiff(a, b) > 60).any(axis=2).sum() > 300 for a, b in zip(dark, white))
