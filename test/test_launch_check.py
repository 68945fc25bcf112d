"""What cannot work is refused before roslaunch starts anything, in one sentence."""
import os
import subprocess
import sys
import threading
from pathlib import Path
from xmlrpc.server import SimpleXMLRPCServer

import pytest

from vb_bringup.launch_check import check_alone, check_arguments, check_installed, check_robot, declared_arguments
from vb_core.errors import CodedError

LAUNCH = Path(__file__).resolve().parents[1] / "launch"


def code_of(check, *arguments):
    try:
        check(*arguments)
    except CodedError as error:
        return error.code
    return ""


@pytest.fixture
def lab():
    """The URI of a ROS master that knows a lab's node, which answers at the same address."""
    server = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False)
    uri = "http://127.0.0.1:{}/".format(server.server_address[1])
    server.register_function(lambda caller, node: (1, "", uri), "lookupNode")
    server.register_function(lambda caller: (1, "", 4711), "getPid")
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield uri
    server.shutdown()
    thread.join()
    server.server_close()


def run(*words, uri):
    environment = {**os.environ, "ROS_MASTER_URI": uri}
    return subprocess.run([*map(str, words)], env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                          universal_newlines=True)


def test_a_mistyped_argument_is_refused_with_the_one_that_was_meant_or_all_of_them():
    with pytest.raises(CodedError) as caught:
        check_arguments(["camera"], ["cameras", "robot"])
    assert caught.value.code == "launch_mistyped_argument" and caught.value.values["nearest"] == "cameras"
    with pytest.raises(CodedError) as caught:
        check_arguments(["zzz"], ["cameras", "robot"])  # like none of them: nothing is guessed
    assert caught.value.code == "launch_unknown_argument" and caught.value.values["known"] == "cameras, robot"
    assert code_of(check_arguments, ["cameras"], []) == "launch_unknown_argument"
    assert code_of(check_arguments, ["robot"], ["cameras", "robot"]) == ""


def test_only_a_files_own_arguments_count(tmp_path):
    path = tmp_path / "lab.launch"
    path.write_text('<launch><arg name="rviz" default="true"/><arg name="fixed" value="1"/><group><arg name="inner" default=""/>'
                    '</group><include file="x"><arg name="cameras" value="north"/></include></launch>')
    assert declared_arguments([path]) == ["inner", "rviz"]


@pytest.mark.parametrize("navigation, robot, code", [
    ("move_base", "false", "launch_navigation_without_robot"), ("move_base", "0", "launch_navigation_without_robot"),
    ("none", "perhaps", "launch_bad_choice"), ("move_base", "true", ""), ("none", "false", "")])
def test_navigation_needs_a_robot(navigation, robot, code):
    assert code_of(check_robot, navigation, robot) == code


def test_what_is_not_installed_is_refused():
    assert code_of(check_installed, ["no_such_navigation"]) == "launch_not_installed"


def test_a_lab_runs_alone_on_its_master(lab):
    assert code_of(check_alone, lab) == "lab_already_running"
    assert code_of(check_alone, "http://127.0.0.1:1") == ""


@pytest.mark.parametrize("words, code", [
    ([LAUNCH / "lab.launch", "navigation:=move_base", "robot:=false"], "launch_navigation_without_robot"),
    (["vb_bringup", "borders_only.launch", "maps:=room.yaml"], "launch_mistyped_argument"),
    ([LAUNCH / "simulation.launch"], "lab_already_running"),
])
def test_roslaunch_ends_before_it_starts_a_node(lab, words, code):
    done = run("roslaunch", *words, uri=lab)
    assert done.returncode != 0 and f"[{code}]" in done.stdout
    assert "process[" not in done.stdout  # which roslaunch prints for each node


def test_what_starts_nothing_on_that_master_is_not_refused(lab):
    """A test has a master of its own, whatever the environment says; and one may ask what a launch file holds."""
    assert run(sys.executable, "-m", "vb_bringup.launch_check", "lab", uri=lab).returncode == 0
    asked = run("roslaunch", "--nodes", LAUNCH / "lab.launch", "cameras:=none", uri=lab)
    assert asked.returncode == 0 and "/map_integrator" in asked.stdout
