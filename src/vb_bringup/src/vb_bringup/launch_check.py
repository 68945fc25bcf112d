"""Refuses a launch that cannot work, before roslaunch starts its first node.

The idea: the stack's launch files begin with `<param command="python3 -m vb_bringup.launch_check ...">`. roslaunch runs that
command while it still reads the file, and ends if it fails: a mistake costs one sentence and leaves a lab that runs alone.

    launch_check lab --navigation move_base --robot false      what lab.launch, simulation.launch and borders_only.launch ask
    launch_check navigation amcl move_base                     what navigation.launch asks
"""
from __future__ import annotations

import argparse
import difflib
import os
import socket
import sys
import xml.etree.ElementTree as ElementTree
import xmlrpc.client
from pathlib import Path
from typing import Iterable, List, Optional, Sequence, Tuple

import rosgraph
import rosgraph.network

from vb_core.errors import CodedError

STARTED, REFUSED = 0, 1
ANSWER_S = 3.0  # a node that runs tells its process within it
UNIQUE_NODE = "/map_integrator"  # every lab has one, and two of them would publish each other's map
_CALLER = "/launch_check"
_TRUTHS = ("true", "false", "1", "0")  # what roslaunch takes as a condition


def check_arguments(given: Iterable[str], declared: Sequence[str]) -> None:
    """Refuses arguments that the launch files lack: roslaunch would ignore them without a word.

    Raises:
        CodedError: "launch_mistyped_argument" if one is much like a declared one, else "launch_unknown_argument".
    """
    for name in given:
        if name not in declared:
            nearest = difflib.get_close_matches(name, declared, 1)
            if nearest:
                raise CodedError("launch_mistyped_argument", argument=name, nearest=nearest[0])
            raise CodedError("launch_unknown_argument", argument=name, known=", ".join(sorted(declared)) or "-")


def check_choice(argument: str, value: str, choices: Sequence[str]) -> None:
    """Refuses a value that the launch file would take for its default.

    Raises:
        CodedError: "launch_bad_choice"
    """
    if value not in choices:
        raise CodedError("launch_bad_choice", argument=argument, value=value, choices=", ".join(choices))


def check_robot(navigation: str, robot: str) -> None:
    """Refuses navigation for a robot that the lab does not have.

    Raises:
        CodedError: "launch_bad_choice", "launch_navigation_without_robot"
    """
    check_choice("robot", robot, _TRUTHS)
    if navigation == "move_base" and robot in ("false", "0"):
        raise CodedError("launch_navigation_without_robot")


def declared_arguments(files: Iterable[Path]) -> List[str]:
    """The arguments that launch files themselves declare and do not fix; not those of files that they include."""
    names = []
    for path in files:
        pending = [ElementTree.parse(str(path)).getroot()]
        while pending:
            element = pending.pop()
            if element.tag == "arg" and element.get("value") is None:
                names.append(str(element.get("name")))
            pending += [child for child in element if child.tag in ("arg", "group")]
    return sorted(set(names))


def check_installed(programs: Iterable[str]) -> None:
    """Refuses to start programs of ROS's navigation stack that are not there; each is in the package of its name.

    Raises:
        CodedError: "launch_not_installed"
    """
    import rospkg
    from roslib.packages import find_node

    for program in programs:
        try:
            found = find_node(program, program)
        except rospkg.ResourceNotFound:
            found = []
        if not found:
            raise CodedError("launch_not_installed", program=program)


def check_alone(master_uri: str) -> None:
    """Refuses a second lab on one ROS master: each would end the other's nodes, and start its own again, for ever.

    Raises:
        CodedError: "lab_already_running"
    """
    before = socket.getdefaulttimeout()
    socket.setdefaulttimeout(ANSWER_S)
    try:
        there = rosgraph.Master(_CALLER, master_uri).lookupNode(UNIQUE_NODE)
        process = xmlrpc.client.ServerProxy(there).getPid(_CALLER)[2]
    except (rosgraph.MasterException, OSError, xmlrpc.client.Error):
        return  # no master, no lab, or one that died without a word
    finally:
        socket.setdefaulttimeout(before)
    raise CodedError("lab_already_running", process=process, where=there)


def launch_of(process: int) -> Tuple[List[str], List[Path], str]:
    """How roslaunch was called: names of the arguments, launch files, URI of the master that it will use.

    All are empty if the process starts nothing, or is another program: a test has a master of its own.
    """
    words = [os.fsdecode(word) for word in Path(f"/proc/{process}/cmdline").read_bytes().split(b"\0")[:-1]]
    start = next((index for index, word in enumerate(words[:3]) if os.path.basename(word) == "roslaunch"), None)
    if start is None:
        return [], [], ""
    import roslaunch
    import roslaunch.rlutil

    options, rest = roslaunch._get_optparse().parse_args(words[start + 1:])
    if any([options.node_args, options.node_list, options.find_node, options.dump_params, options.file_list]):
        return [], [], ""
    files = [Path(name) for name in roslaunch.rlutil.resolve_launch_arguments(rest) if os.path.isfile(name)]
    given = [word.split(":=")[0] for word in rest if ":=" in word and not word.startswith("_")]
    uri = rosgraph.network.create_local_xmlrpc_uri(options.port) if options.port else rosgraph.get_master_uri()
    return given if files else [], files, uri


def run(arguments: Optional[List[str]] = None, process: Optional[int] = None) -> int:
    """Checks; returns the exit status, 0 or 1. `process`: roslaunch, by default the parent process."""
    parser = argparse.ArgumentParser(prog="launch_check", description=__doc__.split("\n")[0])
    what = parser.add_subparsers(dest="what", required=True)
    lab = what.add_parser("lab")
    lab.add_argument("--navigation", default="none")
    lab.add_argument("--among", default="none,move_base")
    lab.add_argument("--robot", default="true")
    what.add_parser("navigation").add_argument("programs", nargs="+")
    chosen = parser.parse_args(arguments)
    try:
        given, files, master_uri = launch_of(os.getppid() if process is None else process)
        check_arguments(given, declared_arguments(files))
        if chosen.what == "navigation":
            check_installed(chosen.programs)
        else:
            check_choice("navigation", chosen.navigation, chosen.among.split(","))
            check_robot(chosen.navigation, chosen.robot)
            if master_uri:
                check_alone(master_uri)
    except CodedError as error:
        print(f"\n[FATAL] Nothing was started. {error.message} [{error.code}]\n", file=sys.stderr, flush=True)
        return REFUSED
    print("ok")  # the parameter's value
    return STARTED


if __name__ == "__main__":
    sys.exit(run())
