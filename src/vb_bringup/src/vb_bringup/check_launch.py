"""Refuses a launch that cannot work, before roslaunch starts its first node.

A wrong value of a launch argument is refused in one sentence; without this check, several nodes would start and die
again and again. The launch files begin with `<param command="python3 -m vb_bringup.check_launch ...">`, and roslaunch
runs that command while it reads the file.

    check_launch lab cameras:="north south" robot:=false      as lab.launch and borders_only.launch call it
    check_launch simulation navigation:=standin               as simulation.launch calls it
    check_launch navigation amcl move_base                    as navigation.launch calls it
"""

from __future__ import annotations

import argparse
import difflib
import os
import signal
import socket
import sys
import xml.etree.ElementTree as ElementTree
import xmlrpc.client
from functools import partial
from pathlib import Path
from typing import Any, Callable, Dict, Iterable, List, Mapping, Sequence, Tuple

import rosgraph
import rosgraph.network
import rosparam
import rospkg
import yaml

from vb_core import sentences
from vb_core.errors import CodedError
from vb_core.parameters import NAME
from vb_core.robot_profile import RobotProfile, find_profile

# modules that are slow to import are imported by the functions that need them: every launch waits for this program
STARTED, REFUSED = 0, 1
ANSWER_TIMEOUT = 3.0  # [s] in which a running node must answer with its process id
UNIQUE_NODE = "/map_integrator"  # every lab has exactly one, because two would publish to the same topic
_CALLER = "/check_launch"


def check_arguments(arguments: Iterable[str], declared: Sequence[str]) -> None:
    """Refuses arguments that the launch files do not declare. roslaunch would ignore them without a word.

    Raises:
        CodedError: "launch_mistyped_argument" if one resembles a declared one, else "launch_unknown_argument".
    """
    for name in arguments:
        if name in declared:
            continue
        matches = difflib.get_close_matches(name, declared, 1)
        if matches:
            raise CodedError("launch_mistyped_argument", argument=name, nearest=matches[0])
        raise CodedError("launch_unknown_argument", argument=name, known=", ".join(sorted(declared)) or "-")


# ------------------------------------------------------------ values of arguments
def check_choice(argument: str, value: str, choices: Sequence[str]) -> None:
    """Raises CodedError "launch_bad_choice" for any other value: a node would use its default or fail."""
    if value not in choices:
        raise CodedError("launch_bad_choice", argument=argument, value=value, choices=", ".join(choices))


def check_names(argument: str, value: str) -> None:
    """Raises CodedError "launch_bad_names" unless the value is empty or unique names separated by spaces."""
    names = value.split()
    invalid = [name for name in names if not NAME.fullmatch(name) or names.count(name) > 1]
    if invalid:
        raise CodedError("launch_bad_names", argument=argument, value=value, wrong=" ".join(invalid))


def parse_pairs(argument: str, value: str) -> Dict[str, str]:
    """Parses words of the form NAME=VALUE to values by name. Raises CodedError "launch_bad_pairs"."""
    values, invalid = {}, []
    for word in value.split():
        name, _, text = word.partition("=")
        if not NAME.fullmatch(name) or not text:
            invalid.append(word)
        values[name] = text
    if invalid:
        raise CodedError("launch_bad_pairs", argument=argument, wrong=" ".join(invalid))
    return values


def check_file(argument: str, value: str) -> None:
    """Raises CodedError "launch_no_file" unless the value is empty or the path of a readable file."""
    try:
        if value:
            Path(value).open("rb").close()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", "") or error
        raise CodedError("launch_no_file", argument=argument, file=value, why=reason) from None


def check_map_file(argument: str, value: str) -> None:
    """Raises CodedError "bad_map_file" unless the value is empty or the path of a map that map_server can read."""
    if value:
        from vb_core.map_files import path_from_caller, read_map

        read_map(path_from_caller(value))


def read_parameter_file(argument: str, path: str) -> Mapping[str, Any]:
    """Reads the parameters in a YAML file as roslaunch does. Raises CodedError "launch_no_file" or "launch_bad_file"."""
    check_file(argument, path)
    try:
        documents = [values for values, _ in rosparam.load_file(path)]
    except (rosparam.RosParamException, yaml.YAMLError, ValueError) as error:
        raise CodedError("launch_bad_file", file=path, why=" ".join(str(error).split())) from None
    if not all(isinstance(values, dict) for values in documents):
        raise CodedError("launch_bad_file", file=path, why="expected keys and values")
    return {key: value for values in documents for key, value in values.items()}


def check_detector(argument: str, value: str) -> None:
    """Checks a file of a detector's parameters. Raises CodedError "bad_parameter", or as `read_parameter_file` does."""
    from vb_laser_detect.spot_detector_node_params import SpotDetectorNodeParams

    SpotDetectorNodeParams.from_mapping(read_parameter_file(argument, value), value)


def check_pairs(argument: str, value: str) -> None:
    """Raises CodedError "launch_bad_pairs" unless the value is words of the form NAME=VALUE."""
    parse_pairs(argument, value)


def check_detectors(argument: str, value: str) -> None:
    """Checks each camera's own file as `check_detector` does. Raises "launch_bad_pairs" too."""
    for path in parse_pairs(argument, value).values():
        check_detector(argument, path)


def check_robot_types(argument: str, value: str) -> None:
    """Checks robot types or paths of profiles, separated by spaces.

    Raises:
        CodedError: "unknown_robot_type", "launch_no_file", "bad_parameter"
    """
    folder = Path(rospkg.RosPack().get_path("vb_bringup")) / "robots"
    for name in value.split():
        path = Path(name) if "/" in name else find_profile(name, folder)
        check_file(argument, str(path))
        RobotProfile.load(path)


ArgumentCheck = Callable[[str, str], None]  # of an argument and its value; raises a CodedError
# roslaunch or a node checks the arguments that are not listed, such as conditions and ports
ARGUMENT_CHECKS: Dict[str, ArgumentCheck] = {
    "robot": partial(check_choice, choices=("true", "false", "1", "0")),
    "cameras": check_names,
    "robots": check_names,
    "robot_types": check_robot_types,
    "config": check_detector,
    "configs": check_detectors,
    "machines": check_pairs,
    "machines_file": check_file,
    "map": check_map_file,
    "image_transport": partial(check_choice, choices=("raw", "compressed")),
    "method": partial(check_choice, choices=("nrs", "robot_only")),
    "language": partial(check_choice, choices=sentences.languages()),
    "navigation": partial(check_choice, choices=("none", "move_base")),
}
_SIMULATED_NAVIGATION = partial(check_choice, choices=("standin", "move_base", "none"))
SIMULATION_CHECKS: Dict[str, ArgumentCheck] = {**ARGUMENT_CHECKS, "navigation": _SIMULATED_NAVIGATION}


def check_values(values: Mapping[str, str], checks: Mapping[str, ArgumentCheck] = ARGUMENT_CHECKS) -> None:
    """Checks the value of each argument, then whether the arguments fit together.

    Raises:
        CodedError: an error of the checks, or "launch_navigation_without_robot".
    """
    without_robot = values.get("robot") in ("false", "0")
    for name, value in values.items():
        if not (without_robot and name == "robot_types"):
            checks[name](name, value)
    if without_robot and values.get("navigation") == "move_base":
        raise CodedError("launch_navigation_without_robot")


# ------------------------------------------------------------ what is installed, and what runs
def declared_arguments(files: Iterable[Path]) -> List[str]:
    """Lists the arguments that launch files declare without a fixed value, but not those of included files."""
    names = set()
    for path in files:
        root = ElementTree.parse(str(path)).getroot()
        arguments = [*root.findall("arg"), *root.findall(".//group/arg")]
        settable = [argument for argument in arguments if argument.get("value") is None]
        names.update(str(argument.get("name")) for argument in settable)
    return sorted(names)


def check_installed(programs: Iterable[str]) -> None:
    """Raises CodedError "launch_not_installed" if a program of ROS's navigation stack is not installed.

    Each of these programs is in a package of its own name.
    """
    from roslib.packages import find_node

    for program in programs:
        try:
            executables = find_node(program, program)
        except rospkg.ResourceNotFound:
            executables = []
        if not executables:
            raise CodedError("launch_not_installed", program=program)


def check_no_other_lab(master_uri: str) -> None:
    """Raises CodedError "lab_already_running" if the ROS master already has a lab.

    Two labs would end each other's nodes and restart their own forever.
    """
    previous_timeout = socket.getdefaulttimeout()
    socket.setdefaulttimeout(ANSWER_TIMEOUT)
    try:
        address = rosgraph.Master(_CALLER, master_uri).lookupNode(UNIQUE_NODE)
        process = xmlrpc.client.ServerProxy(address).getPid(_CALLER)[2]
    except (rosgraph.MasterException, OSError, xmlrpc.client.Error):
        return  # no master, no lab, or a lab that was killed
    finally:
        socket.setdefaulttimeout(previous_timeout)
    raise CodedError("lab_already_running", node=UNIQUE_NODE, process=process)


def find_roslaunch_call(process: int) -> Tuple[List[str], List[Path], str]:
    """Reads how roslaunch was called: names of launch arguments, launch files, and the URI of the master that it uses.

    All three are empty if roslaunch only prints something, or if the process is another program, such as a test.
    """
    command_line = Path(f"/proc/{process}/cmdline").read_bytes()
    words = [os.fsdecode(word) for word in command_line.split(b"\0")[:-1]]
    programs = [os.path.basename(word) for word in words[:3]]
    if "roslaunch" not in programs:
        return [], [], ""
    import roslaunch.rlutil

    after_program = words[programs.index("roslaunch") + 1 :]
    options, remaining = roslaunch._get_optparse().parse_args(after_program)
    if any([options.node_args, options.node_list, options.find_node, options.dump_params, options.file_list]):
        return [], [], ""
    files = [Path(name) for name in roslaunch.rlutil.resolve_launch_arguments(remaining) if os.path.isfile(name)]
    assignments = [word for word in remaining if ":=" in word and not word.startswith("_")]
    names = [word.split(":=")[0] for word in assignments]
    uri = rosgraph.network.create_local_xmlrpc_uri(options.port) if options.port else rosgraph.get_master_uri()
    return names, files, uri


def main() -> int:
    """Checks what the parent process, roslaunch, is about to start. Returns the exit status, 0 or 1."""
    parser = argparse.ArgumentParser(prog="check_launch", description=__doc__.split("\n")[0])
    parser.add_argument("launch_file", choices=("lab", "simulation", "navigation"))
    parser.add_argument(
        "words", nargs="*", help="NAME:=VALUE of the launch file's arguments; or programs of the navigation stack"
    )
    options = parser.parse_args()
    process = os.getppid()
    files: List[Path] = []
    try:
        arguments, files, master_uri = find_roslaunch_call(process)
        if files:
            check_arguments(arguments, declared_arguments(files))
        if options.launch_file == "navigation":
            check_installed(options.words)
        else:
            assignments = [word.partition(":=") for word in options.words]
            values = {name: value for name, _, value in assignments}
            checks = SIMULATION_CHECKS if options.launch_file == "simulation" else ARGUMENT_CHECKS
            check_values(values, checks)
            if master_uri:
                check_no_other_lab(master_uri)
    except CodedError as error:
        print(f"\n[FATAL] Nothing was started. {error.message} [{error.code}]\n", file=sys.stderr, flush=True)
        if files:
            # The exit status alone would end roslaunch too, but with a page of red text below the important sentence.
            # The signal does no harm, because roslaunch has not started any node yet.
            os.kill(process, signal.SIGTERM)
        return REFUSED
    print("ok")  # the parameter's value
    return STARTED


if __name__ == "__main__":
    sys.exit(main())
