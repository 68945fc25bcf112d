"""What is on a robot is not on the floor: a robot with a bright button below two ceiling cameras, rendered."""

import math
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from vb_core.image_format import PixelReader
from vb_core.robot_profile import RobotProfile
from vb_laser_detect.detection.projection import ImageGeometry, RobotCylinder
from vb_laser_detect.detection.projection import FloorProjection
from vb_laser_detect.detector import DetectorParams, SpotDetector
from vb_sim.cameras.ceiling_view import CeilingView
from vb_sim.lab_history import Snapshot
from vb_sim.room.bodies import piece_outlines, robot_pieces
from vb_sim.room.floor_texture import render_floor
from vb_sim.room.mesh import world_mesh
from vb_sim.models import Models, Optics
from vb_sim.room.world import load_world, world_from_mapping

TOP = Path(__file__).resolve().parents[3]
WORLD = world_from_mapping(
    {
        "room": {"size": [4.0, 3.0]},
        "floor": {"kind": "planks", "color": [70, 50, 40], "contrast": 0.16},
        "cameras": [
            {"name": "left", "x": 1.4, "y": 1.5, "width": 960, "image_height": 540, "encoding": "bgr8"},
            {"name": "right", "x": 2.8, "y": 1.5, "yaw": 30, "width": 960, "image_height": 540, "encoding": "bgr8"},
        ],
        "robots": [{"name": "robot", "start": [2.0, 1.5, 0.0]}],
    }
)
# so long that the button, which is of a medium green, is saturated, and the floor is not
LONG_EXPOSURE = Models(optics=Optics(exposure_ms=26.0, exposure_gain=2.6))
RATE, EMPTY, ALONE, DRAWN = 25.0, 25, 50, 75  # images per second; images of the empty room, of the robot, of both
BESIDE = 0.4  # [m] from the robot's middle to the spot


def pose_at(step):
    """(x, y, yaw) of a robot that drives round a circle at 0.3 m/s."""
    angle = 0.3 / 0.6 * step / RATE
    return 2.1 + 0.6 * math.cos(angle), 1.5 + 0.6 * math.sin(angle), angle + math.pi / 2


@lru_cache(maxsize=None)
def found(camera, hides):
    """(number of true spots that the camera saw, of these found, false ones)."""
    floor = render_floor(WORLD, 3, resolution=0.005)
    view = CeilingView(WORLD.camera(camera), {"robot": 0.18}, floor, world_mesh(WORLD), LONG_EXPOSURE, 5)
    detector, projector, reader = SpotDetector(DetectorParams.stationary()), FloorProjection(), PixelReader()
    seen, spots = {}, []
    for step in range(EMPTY + ALONE + DRAWN):
        x, y, yaw = pose = pose_at(step)
        laser = (x - BESIDE * math.sin(yaw), y + BESIDE * math.cos(yaw)) if step >= EMPTY + ALONE else None
        snapshot = Snapshot(step / RATE, {"robot": pose} if step >= EMPTY else {}, laser)
        image = view.frame(snapshot)
        if view.spot_share(snapshot) > 0.5:
            seen[step] = laser
        # localisation is a little off, as it always is
        body = RobotCylinder(x + 0.02, y - 0.02, 0.23, 0.45)
        frame = ImageGeometry(view.model, lambda: view.pose, projector, cylinders=lambda: [body] if hides else [])
        spots += detector.detect(reader.read(image, view.encoding), step / RATE, frame)
    off = {}
    for spot in spots:
        step = round(spot.stamp * RATE)
        off.setdefault(step, []).append(
            math.hypot(*(spot.place.position[:2] - seen[step])) if step in seen else math.inf
        )
    true = sum(min(distances) < 0.03 for distances in off.values())
    return len(seen), true, sum(distance > 0.1 for distances in off.values() for distance in distances)


@pytest.mark.parametrize("robot, world", [("turtlebot2", "lab"), ("turtlebot3_burger", "burger")])
def test_a_robot_is_drawn_within_the_cylinder_that_its_profile_describes(robot, world):
    # else simulated cameras see parts of it that no detector takes for a robot's
    shape = RobotProfile.load(TOP / "robots" / f"{robot}.yaml").shape
    (drawn,) = load_world(TOP / "src" / "vb_sim" / "worlds" / f"{world}.yaml").robots
    points = piece_outlines(robot_pieces((2.0, 1.0, 0.4), drawn.radius)).reshape(-1, 3)
    assert points[:, 2].max() <= shape.height and np.hypot(*(points[:, :2] - (2.0, 1.0)).T).max() <= shape.radius + 1e-6


@pytest.mark.parametrize("camera", ["left", "right"])
def test_a_button_on_a_robot_is_no_spot_and_the_laser_beside_it_is_found(camera):
    seen, true, false = found(camera, True)
    assert seen > 0.8 * DRAWN  # the robot hides it now and then
    assert true >= 0.95 * seen and false == 0


@pytest.mark.parametrize("camera", ["left", "right"])
def test_without_the_robots_place_the_button_is_taken_for_the_laser(camera):
    # else the scene would prove nothing
    assert found(camera, False)[2] > 20
