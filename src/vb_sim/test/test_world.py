"""World files based on another one by `like`, and the files that come with the package."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import yaml

from refusals import refused
from vb_core.errors import ParameterError
from vb_core.robot_profile import RobotProfile
from vb_sim.model_params import MODELS_FILE, BodyProportions, Models, load_models
from vb_sim.rendering.bodies import hand_position, person_pieces, piece_outlines, robot_pieces
from vb_sim.world import load_world

WORLDS = Path(__file__).resolve().parents[1] / "worlds"


@pytest.mark.parametrize("path", sorted(WORLDS.glob("*.yaml")), ids=lambda path: path.stem)
def test_worlds_of_the_package_are_sound(path):
    world = load_world(str(path))
    assert all((world.robots, world.cameras, world.scenarios))


def test_like_replaces_whole_keys_and_its_mistakes_are_named(tmp_path):
    (tmp_path / "base.yaml").write_text("name: base\nroom: {size: [4.0, 3.0]}\nrobots: [{name: a}, {name: b}]\n")
    (tmp_path / "other.yaml").write_text("like: base.yaml\nrobots: [{name: c}]\n")
    world = load_world(str(tmp_path / "other.yaml"))
    assert world.name == "base"
    assert world.room.size == (4.0, 3.0)
    assert [robot.name for robot in world.robots] == ["c"]
    (tmp_path / "round.yaml").write_text("like: round.yaml\n")
    with pytest.raises(ParameterError, match="like"):
        load_world(str(tmp_path / "round.yaml"))
    (tmp_path / "lost.yaml").write_text("like: nowhere.yaml\n")
    with refused("no_world"):
        load_world(str(tmp_path / "lost.yaml"))


@pytest.mark.parametrize("robot, world", [("turtlebot2", "lab"), ("turtlebot3_burger", "burger")])
def test_robot_is_drawn_within_its_profiles_cylinder(robot, world):
    # otherwise simulated cameras see parts that no detector attributes to the robot
    shape = RobotProfile.load(WORLDS.parents[2] / "robots" / f"{robot}.yaml").shape
    (robot_model,) = load_world(WORLDS / f"{world}.yaml").robots
    points = piece_outlines(robot_pieces((2.0, 1.0, 0.4), robot_model.radius)).reshape(-1, 3)
    assert points[:, 2].max() <= shape.height
    assert np.hypot(*(points[:, :2] - (2.0, 1.0)).T).max() <= shape.radius + 1e-6


@pytest.mark.parametrize("height, breadth", [(1.45, 0.8), (1.75, 1.0), (2.05, 1.2)])
def test_the_drawn_hand_is_where_the_beam_begins(height, breadth):
    models = Models(body=BodyProportions(height, breadth))
    person, target = (2.0, 1.0, 0.4), (3.0, 2.0)
    hand = hand_position(person, target, models.hand_height)
    body = person_pieces(person, target, models.hand_height, models.body)
    assert np.linalg.norm(body.low - hand, axis=1).min() < 1e-9
    average = person_pieces(person, target, 1.15)
    assert body.high[:, 2].max() == pytest.approx(average.high[:, 2].max() * height / 1.75)


def test_the_file_has_every_figure_of_the_code():
    assert load_models() == Models()
    written = yaml.safe_load(MODELS_FILE.read_text())
    for section in fields(Models):
        assert set(written[section.name]) == {entry.name for entry in fields(section.default)}
