"""Checks a running lab before people use it; prints one line per check: what is wrong, and how to fix it."""

from __future__ import annotations

import argparse
import json
import sys
from typing import List, Optional
from urllib.parse import urlparse

import rosgraph
import rospy
import rosservice
from rich.console import Console
from rich.table import Column, Table
from rosgraph.network import is_local_address

from vb_bringup.lab_observation import observe_lab
from vb_bringup.new_lab import parse_source
from vb_core import sentences
from vb_core.notices import Notice, Severity
from vb_laser_detect.camera.report import REPORTED, describe, describing_command
from vb_laser_detect.detector_params import CaptureParams

READY, FAULTS, NO_MASTER = 0, 1, 3
_STATES = {Severity.INFO: "ok", Severity.WARNING: "warning", Severity.ERROR: "error"}
_STYLES = {Severity.INFO: "green", Severity.WARNING: "yellow", Severity.ERROR: "bold red"}


def print_table(lines: List[Notice], language: str, console: Console) -> None:
    """Prints the lines as a table, with the faults last, where they are noticed."""
    table = Table(Column(overflow="fold"), Column(overflow="fold"), box=None, padding=(0, 2, 0, 0))
    for line in sorted(lines, key=lambda line: line.severity):
        table.add_row(f"[{_STYLES[line.severity]}]{_STATES[line.severity]}[/]", line.sentence(language))
    console.print(table)


def print_camera(camera: str) -> None:
    """Prints the report to send of a camera that its detector reads directly, or how to get it on that computer."""
    parameters = rospy.get_param(f"/spot_detector_{camera}", {})
    source = str(parameters.get("source", ""))
    if not source:
        return
    # a detector that has just ended has no address, and is taken for one of this computer
    service = rosservice.get_service_uri(f"/spot_detector_{camera}/capture/set_parameters")
    host = urlparse(service or "").hostname
    lines = [f"what this prints on {host}:", describing_command(source)]
    if is_local_address(host):
        lines = ["these:", *describe(source, CaptureParams.from_mapping(parameters.get("capture"), "capture"))]
    print(f"\nIf the camera {camera} still does not work, report the lines above, and", "\n".join(lines))


def to_json(lines: List[Notice], language: str) -> str:
    """Formats the lines for programs: for each, its state, code, camera, robot, values, and the sentence for people."""
    rows = [
        {
            "state": _STATES[line.severity],
            **{name: getattr(line, name) for name in ("code", "camera", "robot", "values")},
            "message": line.sentence(language),
        }
        for line in lines
    ]
    return json.dumps(rows, indent=1, ensure_ascii=False, default=str)


def run(arguments: Optional[List[str]] = None) -> int:
    """Checks the lab and prints the result.

    Returns:
        The exit status: 0 ready (warnings allowed), 1 faults, 3 no ROS master. (2 is argparse's, for a wrong call.)
    """
    parser = argparse.ArgumentParser(
        prog="check_lab",
        description=__doc__,
        epilog="Exit status: 0 ready, 1 something is wrong, 2 wrong call, 3 the ROS master does not answer.",
    )
    parser.add_argument("--json", action="store_true", help="for programs")
    parser.add_argument("--seconds", type=float, default=4.0, help="how long to listen to the nodes (4)")
    parser.add_argument("--language", default=sentences.ENGLISH, choices=sentences.languages())
    parser.add_argument("--camera", metavar="SOURCE", help="only describe a camera, given as to new_lab; without a lab")
    chosen = parser.parse_args(rospy.myargv(["check_lab", *(sys.argv[1:] if arguments is None else arguments)])[1:])
    if chosen.camera:
        print("\n".join(describe(parse_source(chosen.camera), CaptureParams())))
        return READY
    if not rosgraph.is_master_online():
        print(
            f"The ROS master does not answer at {rosgraph.get_master_uri()}: start lab.launch first, and set "
            "ROS_MASTER_URI if it runs on another computer.",
            file=sys.stderr,
        )
        return NO_MASTER
    rospy.init_node("check_lab", anonymous=True, disable_signals=True, log_level=rospy.ERROR)
    lines = observe_lab(chosen.seconds)
    if chosen.json:
        print(to_json(lines, chosen.language))
    else:
        print_table(lines, chosen.language, Console())
        for camera in sorted({line.camera for line in lines if line.code in REPORTED}):
            print_camera(camera)
    return FAULTS if any(line.severity is Severity.ERROR for line in lines) else READY


def main() -> None:
    """Runs the program."""
    sys.exit(run())
