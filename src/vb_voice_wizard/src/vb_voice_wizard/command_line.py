"""Sends one command to the interaction from a shell."""

from __future__ import annotations

import argparse
import os
import sys
from typing import List, Optional

import rosgraph
import rospy
from vb_core import names, sentences
from vb_core.errors import CodedError
from vb_core.ros import commands
from vb_core.ros.messages import BorderPreviewArray, mapping_from_values
from vb_core.vocabulary import COMMANDS, RESUME, normalize
from vb_msgs.msg import BorderIssue


DONE, REFUSED, UNREACHABLE = 0, 1, 3
_PREVIEW_TIMEOUT = 10.0  # [s] the preview is there: only the connection may take its time


def run(arguments: Optional[List[str]] = None) -> int:
    """Sends a command and prints the answer.

    Returns:
        The exit status: 0 done, 1 refused, 3 no answer. (2 is argparse's, for wrong arguments.)
    """
    parser = argparse.ArgumentParser(
        prog="command",
        description="Gives a command to the interaction and prints the answer.",
        epilog="Exit status: 0 done, 1 refused, 2 wrong call, 3 the interaction manager or the ROS master is away.",
    )
    parser.add_argument("command", type=normalize, choices=COMMANDS)
    parser.add_argument("--source", default="shell", help="who says so, for the record (default: shell)")
    parser.add_argument("--language", default=sentences.ENGLISH, choices=sentences.languages(), help="of the answer")
    parser.add_argument("--wait", type=float, default=2.0, help="[s] how long to wait for the interaction manager")
    chosen = parser.parse_args(rospy.myargv(["command", *(sys.argv[1:] if arguments is None else arguments)])[1:])
    if not rosgraph.is_master_online():
        print(f"the ROS master does not answer at {rosgraph.get_master_uri()}", file=sys.stderr)
        return UNREACHABLE
    # for the time by which a command that arrives late is refused
    rospy.init_node("command", anonymous=True, disable_signals=True, log_level=rospy.FATAL)
    waited = 0.0
    while rospy.get_rostime().is_zero() and waited < 1.0:
        rospy.rostime.wallsleep(0.02)
        waited += 0.02
    service_timeout = max(0.1, chosen.wait)
    try:
        seen = commands.read_stop_number(service_timeout) if chosen.command == RESUME else ""
        request = commands.make_request(
            chosen.command, chosen.source, service_timeout + commands.VALIDITY, seen_stop=seen
        )
        answer = commands.send(request, service_timeout)
    except CodedError as error:
        print(f"{sentences.translate(error.code, error.values, chosen.language)} [{error.code}]", file=sys.stderr)
        return UNREACHABLE
    said = sentences.translate(answer.code, mapping_from_values(answer.values), chosen.language, answer.message)
    print(f"{said} [{answer.code}]")
    for issue in _issues() if answer.code == "confirm_save" else []:
        print(
            f"- {sentences.translate(issue.code, mapping_from_values(issue.values), chosen.language, issue.message)} [{issue.code}]"
        )
    return DONE if answer.success else REFUSED


def _issues() -> List[BorderIssue]:
    """Lists the issues to note before saving, from the preview."""
    try:
        return rospy.wait_for_message(names.PREVIEW, BorderPreviewArray, timeout=_PREVIEW_TIMEOUT).issues
    except rospy.ROSException:
        return []


def main() -> None:
    """Runs the program."""
    status = run()
    sys.stdout.flush()
    # rospy's threads may wait for a master that is gone: leave without them
    os._exit(status)
