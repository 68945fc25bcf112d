"""The launch files as roslaunch reads them: nodes' machines, publishers of poses, parameters."""

import pytest
from roslaunch.config import ROSLaunchConfig
from roslaunch.xmlloader import XmlLoader

from vb_testing import TOP

LAUNCH = TOP / "launch"


def load(*arguments, file="parts/perception.launch"):
    config = ROSLaunchConfig()
    XmlLoader().load(str(LAUNCH / file), config, argv=list(arguments), verbose=False)
    return config


def placed(config):
    return {node.name: node.machine_name for node in config.nodes}


@pytest.mark.parametrize("names", ["true", "on off", "7"])
def test_names_that_look_like_yaml_values_stay_names(names):
    config = load(f"cameras:={names}")
    # roslaunch itself capitalises a truth value; the detector's notice that no image comes from such a camera is enough
    cameras = [name.capitalize() if name == "true" else name for name in names.split()]
    assert [config.params[f"/spot_detector_{name}/camera"].value for name in cameras] == cameras
    assert config.params["/camera_poses/cameras"].value == names


def test_one_detector_on_each_machine_searches_its_cameras():
    example = f"machines_file:={LAUNCH / 'machines.launch'}"
    config = load("cameras:=red green blue", "machines:=green=loft blue=loft", example)
    assert placed(config) == {"spot_detectors": None, "spot_detectors_loft": "loft", "camera_poses": None}
    assert config.params["/spot_detectors/cameras"].value == ["spot_detector_red"]
    assert config.params["/spot_detectors_loft/cameras"].value == ["spot_detector_green", "spot_detector_blue"]
    assert placed(load("cameras:=red")) == {"spot_detectors": None, "camera_poses": None}
    assert placed(load("cameras:=")) == {}
    # no node is assigned to a machine just because the machine is listed
    assert config.machines["loft"].assignable is False
    assert config.machines["loft"].env_loader.endswith("scripts/ros_env")
    assert (LAUNCH.parent / "scripts" / "ros_env").stat().st_mode & 0o111


@pytest.mark.parametrize("count", [8, 9, 24])
def test_a_node_has_at_most_eight_cameras(count):
    names = [f"c{number}" for number in range(count)]
    config = load(f"cameras:={' '.join(names)}")
    nodes = [param.value for name, param in config.params.items() if name.startswith("/spot_detectors")]
    assert sorted(sum(nodes, [])) == sorted(f"spot_detector_{name}" for name in names)
    assert len(nodes) == -(-count // 8)
    assert max(map(len, nodes)) <= 8


def test_poses_are_published_from_calibrations():
    lab = load("cameras:=red", "robot:=false", "rviz:=false", "state:=/tmp/vb", file="lab.launch")
    assert lab.params["/camera_poses/calibration_dir"].value == "/tmp/vb/cameras"
    assert "camera_poses" not in placed(load("robot:=false", "cameras:=none", "rviz:=false", file="lab.launch"))


def test_parameters_can_be_set_for_all_detectors_and_for_one(tmp_path):
    files = {name: tmp_path / f"{name}.yaml" for name in ("ceiling", "wall", "rear")}
    for path, value in zip(files.values(), (11, 12, 14)):
        path.write_text(f"detector:\n  max_dwell_time: 20.0\n  max_diameter_mm: {value}.0\n")
    lab = ["cameras:=red green", "robots:=front rear", "rviz:=false", f"config:={files['ceiling']}"]
    config = load(*lab, f"configs:=green={files['wall']} rear={files['rear']}", file="lab.launch")
    detectors = ("/spot_detector_red", "/spot_detector_green", "/rear/spot_detector_rear")
    assert [config.params[f"{name}/detector/max_diameter_mm"].value for name in detectors] == [11.0, 12.0, 14.0]


@pytest.mark.parametrize(
    "file, arguments, robots",
    [
        ("parts/perception.launch", [], []),
        ("lab.launch", ["rviz:=false"], ["/"]),
        ("lab.launch", ["rviz:=false", "robots:=one two"], ["one", "two"]),
        ("lab.launch", ["rviz:=false", "robot:=false"], []),
        ("lab.launch", ["rviz:=false", "robot:=false", "robots:=one"], ["one"]),
        ("simulation.launch", ["rviz:=false"], ["/"]),
    ],
)
def test_detectors_know_the_robots_of_the_lab(file, arguments, robots):
    params = load("cameras:=red green", *arguments, file=file).params
    assert [params[f"/spot_detector_{camera}/robots"].value for camera in ("red", "green")] == [robots, robots]
