"""A lab's own folder: launch files that roslaunch can read, and nothing is overwritten."""

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
import yaml

from refusals import refused
from vb_testing import TOP, assert_fields
from vb_bringup.new_lab import parse_cameras, write_lab
from vb_core.grid_map import GridMap
from vb_core.map_files import read_map, write_map
from vb_evaluation.user_study import conduct_run

PROFILES = TOP / "robots"
OWN = {"cameras", "configs", "calibration", "state", "robot_types"}  # arguments with a lab's own values


def arguments_of(launch_file):
    """Returns the arguments of a launch file, and their defaults."""
    return {arg.get("name"): arg.get("default") for arg in ElementTree.parse(str(launch_file)).getroot().findall("arg")}


def test_a_new_labs_launch_file_has_the_stacks_defaults_and_what_other_programs_set(tmp_path):
    write_lab(tmp_path / "lab", {"north": "", "south": ""}, "turtlebot2", None, PROFILES)
    defaults = arguments_of(tmp_path / "lab" / "lab.launch")
    stack_defaults = arguments_of(TOP / "launch" / "lab.launch")
    assert {name for name in defaults if defaults[name] != stack_defaults[name]} == OWN
    assert_fields(defaults, cameras="north south", robot="true")
    assert len(defaults["configs"].split()) == 2
    (container_call,) = re.findall(r"roslaunch /lab/lab.launch (.*)", (TOP / "scripts" / "container").read_text())
    methods = yaml.safe_load(conduct_run.TEMPLATE)["methods"].values()
    set_by_study = {name for arguments in methods for name in arguments}
    assert {"record", *set_by_study, *re.findall(r"(\w+):=", container_call)} <= set(defaults)


def test_a_new_lab_is_complete_without_the_original_map_file(tmp_path):
    lab = tmp_path / "lab"
    grid = GridMap(np.array([[0, 100], [100, -1]], np.int8), 0.05, (1.0, 2.0, 0.0))
    write_map(tmp_path / "room", grid)
    written = write_lab(lab, {"north": "/dev/video0", "south": ""}, "turtlebot2", tmp_path / "room.yaml", PROFILES)
    assert {lab / "robot.yaml", lab / "map.pgm"} <= set(written)
    assert arguments_of(lab / "lab.launch")["map"] == "$(dirname)/map.yaml"
    (tmp_path / "room.pgm").unlink()
    copy = read_map(lab / "map.yaml")
    assert copy.origin == grid.origin
    assert copy.data.tolist() == grid.data.tolist()
    ElementTree.parse(str(lab / "cameras.launch"))
    settings = {name: yaml.safe_load((lab / "detectors" / f"{name}.yaml").read_text()) for name in ("north", "south")}
    assert settings == {"north": {"source": "/dev/video0"}, "south": {}}


def test_cameras_are_read_with_and_without_a_source(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sources = parse_cameras("north=/dev/video0 south=rtsp://a:b@1.2.3.4/x?y=1 hall clip=room.mp4 desk=2")
    others = {"north": "/dev/video0", "south": "rtsp://a:b@1.2.3.4/x?y=1", "hall": "", "desk": "/dev/video2"}
    assert sources == {**others, "clip": str(tmp_path / "room.mp4")}
    with refused("bad_camera_name"):
        parse_cameras("a=1 a=2")


@pytest.mark.parametrize(
    "name, cameras, robot, room, code",
    [
        ("lab", {"1st": ""}, "", None, "bad_camera_name"),
        ("lab", {"a": ""}, "r2d2", None, "unknown_robot_type"),
        ("lab", {"a": ""}, "", Path("rooom.yaml"), "bad_map_file"),
        ("my lab", {"a": ""}, "", None, "folder_with_space"),
        ("old", {"a": ""}, "", None, "folder_not_empty"),
    ],
)
def test_bad_labs_are_refused_before_anything_is_written(tmp_path, name, cameras, robot, room, code):
    own_file = tmp_path / "old" / "lab.launch"
    own_file.parent.mkdir()
    own_file.write_text("mine")
    with refused(code):
        write_lab(tmp_path / name, cameras, robot, room, PROFILES)
    assert own_file.read_text() == "mine"
    assert set(tmp_path.rglob("*")) == {own_file.parent, own_file}
