"""A projector's light on the floor of the simulated lab, and that no detector takes it for a laser spot."""

from pathlib import Path

import numpy as np
import pytest

from vb_core import geometry
from vb_core.errors import ParameterError
from vb_feedback.projector import projector_calibration
from vb_feedback.projector.floor_image import FloorContent, FloorImage
from vb_feedback.display.scene import Border, Drawing
from vb_laser_detect.detector import DetectorParams, SpotDetector
from vb_sim.cameras.ceiling_view import CeilingView
from vb_sim.room.floor_texture import render_floor
from vb_sim.lab_history import Snapshot
from vb_sim.room.mesh import world_mesh
from vb_sim.room.camera_models import CameraModels, Optics
from vb_sim.room.projected_light import floor_light
from vb_sim.cameras.robot_view import RobotView
from vb_sim.room.world import Projector, load_world, world_from_mapping

PACKAGE = Path(__file__).resolve().parent.parent
WORLD = {
    "room": {"size": [4.0, 3.0]},
    "floor": {"kind": "plain", "color": [120, 120, 120], "contrast": 0.0},
    "furniture": [{"name": "box", "x": 3.0, "y": 1.0, "size": [0.4, 0.4], "height": 0.8, "color": [200, 40, 40]}],
    "cameras": [
        {"name": "mono", "x": 2.0, "y": 1.5, "width": 960, "image_height": 540, "encoding": "mono8"},
        {"name": "bayer", "x": 2.0, "y": 1.5, "yaw": 30, "width": 960, "image_height": 540},
        {
            "name": "elsewhere",
            "x": 0.5,
            "y": 2.6,
            "height": 0.6,
            "width": 320,
            "image_height": 240,
            "horizontal_fov": 50,
        },
    ],
    "robots": [{"name": "robot", "start": [0.5, 1.5, 0.0]}],
    "projector": {"corners": [[1.1, 2.2], [3.3, 2.1], [3.2, 0.6], [1.0, 0.7]], "lumens": 1500},
}
SIZE = (320, 200)


@pytest.fixture(scope="module")
def lab():
    world = world_from_mapping(WORLD)
    return world, render_floor(world, 3, resolution=0.005), world_mesh(world)


def ceiling(lab, name, noise=False):
    world, floor, mesh = lab
    return CeilingView(world.camera(name), {"robot": 0.18}, floor, mesh, CameraModels(), 5, noise)


def square(lab, place, half=0.06):
    """A picture with a white square about a place on the floor [m]."""
    world = lab[0]
    picture = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    matrix = floor_light(picture, world.projector, Optics()).matrix
    rows, columns = np.indices(picture.shape[:2])
    floor = np.linalg.inv(matrix) @ np.stack([columns.ravel(), rows.ravel(), np.ones(rows.size)])
    inside = (np.abs(floor[:2] / floor[2] - np.reshape(place, (2, 1))) < half).all(axis=0)
    picture[inside.reshape(rows.shape)] = 255
    return floor_light(picture, world.projector, Optics())


def centroid(change):
    rows, columns = np.indices(change.shape)
    return np.array([(change * columns).sum(), (change * rows).sum()]) / change.sum()


def expected(model, pose, x, y):
    return model.project(geometry.apply(geometry.invert(pose), np.array([[x, y, 0.0]])))[0]


@pytest.mark.parametrize("name", ["mono", "bayer"])
@pytest.mark.parametrize("place", [(1.5, 1.2), (2.3, 1.8), (2.0, 0.9)])
def test_light_falls_where_the_projector_points(lab, name, place):
    view = ceiling(lab, name)
    dark = view.frame(Snapshot(1.0)).astype(float)
    view.set_floor_light(square(lab, place))
    change = view.frame(Snapshot(1.0)).astype(float) - dark
    # a projector's pixel is 7 mm here, a camera's 3
    assert np.linalg.norm(centroid(change) - expected(view.model, view.pose, *place)) < 2.0
    view.set_floor_light(None)
    assert np.array_equal(view.frame(Snapshot(1.0)), dark.astype(np.uint8))


def test_light_adds_up_by_the_floors_colour(lab):
    view = ceiling(lab, "mono")
    dark = view.frame(Snapshot(1.0)).astype(float)
    light = square(lab, (2.0, 1.4), 0.2)
    u, v = np.rint(expected(view.model, view.pose, 2.0, 1.4)).astype(int)
    view.set_floor_light(light)
    lit = view.frame(Snapshot(1.0)).astype(float)
    area = lab[0].projector.area_m2()
    ratio = 1500 / area / 297.0  # 0.33 W/m2 per channel are 297 lx
    assert light.strength == pytest.approx(ratio)
    # all channels of a grey floor alike, up to what 255 cuts off
    assert lit[v, u] == pytest.approx(min(255.0, dark[v, u] * (1 + ratio)), abs=3.0)


def test_things_hide_the_floor_and_its_light(lab):
    view = ceiling(lab, "mono")
    dark = view.frame(Snapshot(1.0)).copy()
    view.set_floor_light(square(lab, (3.0, 1.0), 0.05))
    assert np.abs(view.frame(Snapshot(1.0)).astype(int) - dark).max() <= 1


def test_images_follow_each_other_without_a_trace(lab):
    view, other = ceiling(lab, "bayer"), ceiling(lab, "bayer")
    laser = Snapshot(1.0, {"robot": (1.5, 1.2, 0.3)}, (2.2, 1.5))
    for place in ((1.5, 1.2), (2.3, 1.8)):
        view.set_floor_light(square(lab, place))
        view.frame(laser)
    other.set_floor_light(square(lab, (2.3, 1.8)))
    assert np.array_equal(view.frame(laser), other.frame(laser))


def test_a_camera_that_sees_none_of_it(lab):
    view = ceiling(lab, "elsewhere")
    dark = view.frame(Snapshot(1.0)).copy()
    view.set_floor_light(square(lab, (2.0, 1.5)))
    assert np.array_equal(view.frame(Snapshot(1.0)), dark)
    view.set_floor_light(None)


def test_the_robot_sees_it_too(lab):
    world, floor, mesh = lab
    view = RobotView(world.robots[0], {"robot": 0.18}, floor, mesh, CameraModels(), 5, False)
    snapshot = Snapshot(1.0, {"robot": (0.5, 1.5, 0.0)})
    dark = view.color(snapshot).astype(float)
    view.set_floor_light(square(lab, (1.5, 1.45)))
    change = (view.color(snapshot).astype(float) - dark).sum(axis=2)
    assert change[:100].max() == 0  # nothing above the horizon
    assert np.linalg.norm(centroid(change) - expected(view.color_model, view.camera_pose(snapshot), 1.5, 1.45)) < 5.0
    view.set_floor_light(None)
    assert np.array_equal(view.color(snapshot), dark.astype(np.uint8))


@pytest.mark.parametrize(
    "projector, key",
    [
        ({"corners": [[0, 0], [1, 0], [1, 1]]}, "corners"),
        ({"corners": [[0, 0], [1, 1], [1, 0], [0, 1]]}, "corners"),
        ({"corners": "none"}, "corners"),
        ({"lumens": 0}, "lumens"),
        ({"lumen": 1}, "lumen"),
    ],
)
def test_mistakes_in_a_world_are_named(projector, key):
    with pytest.raises(ParameterError) as caught:
        world_from_mapping({**WORLD, "projector": projector})
    assert key in str(caught.value)
    assert isinstance(Projector(), Projector)


# ------------------------------------------------------------------ no detector is fooled
class Lit:
    """The paper's lab with its projector on, seen by one camera and its detector, 25 frames a second."""

    def __init__(self):
        world = load_world(str(PACKAGE / "worlds" / "lab.yaml"))
        self.world, self.models = world, CameraModels()
        self.scenario = world.scenarios["carpet"]
        calibration = projector_calibration.load(str(PACKAGE / "config" / "lab_projector.yaml"))
        self.picture = FloorImage(calibration)
        self.view = CeilingView(
            world.camera("green"), {"robot": 0.18}, render_floor(world, 1), world_mesh(world), self.models, 1
        )
        chain = np.vstack([self.scenario.border, self.scenario.border[:1]])
        self.line = geometry.resample_chain(chain, 0.02)
        self.border = Border("Carpet", points(self.scenario.border), True, tuple(self.scenario.seed))
        self.start()

    def start(self):
        self.detector = SpotDetector(DetectorParams.stationary())
        self.detector.encoding = self.view.encoding
        self.now = 0.0
        self.view.set_floor_light(None)
        self.see(30)

    def show(self, content):
        picture = self.picture.render(content)
        self.view.set_floor_light(floor_light(picture, self.world.projector, self.models.optics))

    def see(self, frames, laser=None, velocity=(0.0, 0.0)):
        """The spots found in each frame."""
        found = []
        for _ in range(frames):
            person = (4.6, 2.75, -2.0) if laser is not None else None
            frame = self.view.frame(Snapshot(self.now, {"robot": (7.0, 0.5, 2.0)}, laser, "red", velocity, person))
            found.append(self.detector.detect(frame, self.now))
            self.now += 0.04
        return found


def points(chain):
    return tuple(map(tuple, np.asarray(chain).tolist()))


@pytest.fixture(scope="module")
def lit():
    return Lit()


def test_the_labs_calibration_is_that_of_its_projector(lit):
    np.testing.assert_allclose(lit.picture.calibration.footprint(), lit.world.projector.corners, atol=1e-3)


def test_the_projector_alone_gives_no_spot(lit):
    lit.start()
    region = Drawing(chain=points(lit.line), seed=tuple(lit.scenario.seed))
    for content in (
        FloorContent(),
        FloorContent("default", (lit.border,)),
        FloorContent(),
        FloorContent("border"),
        FloorContent("seed", (), region),
        FloorContent("seed", (lit.border,)),
        FloorContent("guide"),
    ):
        lit.show(content)
        assert not any(lit.see(8)), f"a spot in the light of {content.state}"
    # the drawing grows, without the dark place that it leaves about a real spot
    for length in range(5, len(lit.line), 16):
        lit.show(FloorContent("border", (), Drawing(chain=points(lit.line[:length]))))
        assert not any(lit.see(3))


def test_the_laser_is_found_in_the_projectors_light(lit):
    counts = []
    for projector in (False, True):
        lit.start()
        if projector:
            # the border to be drawn stands there already, the hardest case
            lit.show(FloorContent("border", (lit.border,)))
            lit.see(20)
        found = 0
        for number in range(0, len(lit.line) // 2, 2):
            spot = points(lit.line[number : number + 1])[0]
            if projector and number % 10 == 0:
                lit.show(FloorContent("border", (lit.border,), Drawing(chain=points(lit.line[: number + 1])), spot))
            spots = lit.see(1, spot, (0.5, 0.0))[0]
            wanted = expected(lit.view.model, lit.view.pose, *spot)
            assert all(np.hypot(spot.u - wanted[0], spot.v - wanted[1]) < 4.0 for spot in spots)
            found += len(spots)
        counts.append(found)
    assert counts[0] > 75 and counts[1] >= 0.95 * counts[0]
