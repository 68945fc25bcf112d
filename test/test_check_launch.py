"""A launch that cannot work is refused with one sentence, before roslaunch starts anything."""

import os
import re
import sys
import threading
from contextlib import nullcontext
from xmlrpc.server import SimpleXMLRPCServer

import pytest

from refusals import refused
from vb_testing import TOP, run_command
from vb_bringup.check_launch import ARGUMENT_CHECKS, check_arguments, check_installed, check_values, declared_arguments

LAUNCH = TOP / "launch"


@pytest.fixture
def lab():
    """Yields the URI of a ROS master that knows a lab's node, which answers at the same address."""
    with SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False) as server:
        uri = "http://127.0.0.1:{}/".format(server.server_address[1])
        server.register_function(lambda caller, node: (1, "", uri), "lookupNode")
        server.register_function(lambda caller: (1, "", 4711), "getPid")
        threading.Thread(target=server.serve_forever).start()
        yield uri
        server.shutdown()


def with_master(uri, *words):
    return run_command(*words, env={**os.environ, "ROS_MASTER_URI": uri})


def test_a_mistyped_argument_is_refused_with_a_suggestion():
    with refused("launch_mistyped_argument") as caught:
        check_arguments(["camera"], ["cameras", "robot"])
    assert caught.value.values["nearest"] == "cameras"
    with refused("launch_unknown_argument") as caught:
        check_arguments(["zzz"], ["cameras", "robot"])  # like neither of them: there is no suggestion
    assert caught.value.values["known"] == "cameras, robot"
    with refused("launch_unknown_argument"):
        check_arguments(["cameras"], [])
    check_arguments(["robot"], ["cameras", "robot"])


def test_only_a_files_own_arguments_count(tmp_path):
    path = tmp_path / "lab.launch"
    own = '<arg name="rviz" default="true"/><arg name="fixed" value="1"/>'
    inner = '<group><arg name="inner" default=""/></group>'
    path.write_text(f'<launch>{own}{inner}<include file="x"><arg name="cameras" value="north"/></include></launch>')
    assert declared_arguments([path]) == ["inner", "rviz"]


@pytest.fixture
def files(tmp_path):
    """Writes good and bad files, whose names stand for their paths below."""
    for name, text in (
        ("good.yaml", "image: x\ndetector: {max_dwell_time: 12}"),
        ("empty.yaml", "{}"),
        ("mistyped.yaml", "detector: {noise: 3}"),
        ("list.yaml", "[1, 2]"),
        ("broken.yaml", "a: [1"),
        ("robot.yaml", "shape: {radius: 0.2}"),
        ("wheels.yaml", "wheels: 3"),
        ("map.yaml", "image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0]"),
        ("map.pgm", "P5 2 1 255 ~ "),
    ):
        (tmp_path / name).write_text(text)
    return tmp_path


@pytest.mark.parametrize(
    "given, code",
    [
        ({"map": "@map.yaml", "language": "de", "cameras": "north south_2", "config": "@good.yaml"}, ""),
        ({"configs": "north=@good.yaml south=@empty.yaml", "machines": "north=loft"}, ""),
        ({"robot_types": "turtlebot2 @robot.yaml", "navigation": "move_base", "robot": "true"}, ""),
        ({"map": "", "cameras": "", "navigation": "none", "robot": "false"}, ""),
        ({"map": "@none.yaml"}, "bad_map_file"),
        ({"language": "gr"}, "launch_bad_choice"),
        ({"cameras": "north, south"}, "launch_bad_names"),
        ({"cameras": "north north"}, "launch_bad_names"),
        ({"robots": "r1;r2"}, "launch_bad_names"),
        ({"config": "@mistyped.yaml"}, "bad_parameter"),
        ({"config": "@list.yaml"}, "launch_bad_file"),
        ({"config": "@broken.yaml"}, "launch_bad_file"),
        ({"config": "@none.yaml"}, "launch_no_file"),
        ({"configs": "north=@none.yaml"}, "launch_no_file"),
        ({"configs": "north=@good.yaml south=@mistyped.yaml"}, "bad_parameter"),
        ({"configs": "@good.yaml"}, "launch_bad_pairs"),
        ({"configs": "north= @good.yaml"}, "launch_bad_pairs"),
        ({"machines": "north"}, "launch_bad_pairs"),
        ({"machines_file": "@none"}, "launch_no_file"),
        ({"robot_types": "turtle"}, "unknown_robot_type"),
        ({"robot_types": "@wheels.yaml"}, "bad_parameter"),
        ({"robot_types": "@none.yaml"}, "launch_no_file"),
        ({"navigation": "move_base", "robot": "false"}, "launch_navigation_without_robot"),
        ({"navigation": "none", "robot": "perhaps"}, "launch_bad_choice"),
    ],
)
def test_each_argument_is_judged_by_its_kind(files, given, code):
    values = {argument: value.replace("@", f"{files}/") for argument, value in given.items()}
    with refused(code) if code else nullcontext():
        check_values(values)


def test_a_misspelt_parameter_is_named_with_its_file(files):
    (files / "n.yaml").write_text("imaeg: x")
    with refused("bad_parameter") as caught:
        check_values({"configs": f"north={files}/n.yaml"})
    assert f"{files}/n.yaml/imaeg" in caught.value.message
    assert {"image", "detector", "projection"} <= set(re.findall(r"\w+", caught.value.message))


@pytest.mark.parametrize("name", ["lab", "simulation", "borders_only"])
def test_every_argument_that_has_a_kind_is_judged(name):
    path = LAUNCH / f"{name}.launch"
    judged = set(re.findall(r'(\w+):="\$\(arg \1\)"', path.read_text()))
    assert judged == set(ARGUMENT_CHECKS) & set(declared_arguments([path]))


def test_missing_programs_are_refused():
    with refused("launch_not_installed"):
        check_installed(["no_such_navigation"])


@pytest.mark.parametrize(
    "words, said",
    [
        ([LAUNCH / "lab.launch", "navigation:=move_base", "robot:=false"], "[launch_navigation_without_robot]"),
        (["vb_bringup", "borders_only.launch", "maps:=room.yaml"], "[launch_mistyped_argument]"),
        ([LAUNCH / "simulation.launch"], "4711"),  # the lab that is running already
    ],
)
def test_roslaunch_ends_before_it_starts_a_node(lab, words, said):
    done = with_master(lab, "roslaunch", *words)
    assert done.returncode != 0
    assert said in done.stdout.strip().splitlines()[-1]  # where our sentence is
    assert "process[" not in done.stdout  # which roslaunch prints for each node


def test_calls_that_start_nothing_there_are_not_refused(lab):
    """A test has its own master, whatever the environment says; and asking what a launch file contains is allowed."""
    assert with_master(lab, sys.executable, "-m", "vb_bringup.check_launch", "lab").returncode == 0
    asked = with_master(lab, "roslaunch", "--nodes", LAUNCH / "lab.launch", "cameras:=none")
    assert asked.returncode == 0
    assert "/map_integrator" in asked.stdout
