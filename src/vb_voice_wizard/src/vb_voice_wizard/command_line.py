"""One command to the interaction as one shell call."""
from __future__ import annotations

import argparse
import sys
from typing import List, Optional

import rosgraph
import rospy
from vb_core import names
from vb_core.errors import CodedError
from vb_core.ros import services
from vb_msgs.srv import Command, CommandRequest

from vb_voice_wizard.interaction import COMMANDS, normalise

DONE, REFUSED, UNREACHABLE = 0, 1, 3


def run(arguments: Optional[List[str]] = None) -> int:
    """Gives a command and prints the answer.

    Returns:
        The exit status: 0 done, 1 refused, 3 nobody answers. (2 is argparse's, for a wrong call.)
    """
    parser = argparse.ArgumentParser(
        prog="command",
        description="Gives a command to the interaction and prints the answer.",
        epilog="Exit status: 0 done, 1 refused, 2 wrong call, 3 the interaction manager or the ROS master is away.",
    )
    parser.add_argument("command", type=normalise, choices=COMMANDS)
    parser.add_argument("--source", default="wizard", help="who says so, for the record (default: wizard)")
    parser.add_argument("--wait", type=float, default=2.0, help="[s] how long to wait for the interaction manager")
    chosen = parser.parse_args(rospy.myargv(["command", *(sys.argv[1:] if arguments is None else arguments)])[1:])
    if not rosgraph.is_master_online():
        print(f"the ROS master does not answer at {rosgraph.get_master_uri()}", file=sys.stderr)
        return UNREACHABLE
    request = CommandRequest(command=chosen.command, source=chosen.source)
    try:
        # longer than the manager's own waits for its neighbours, so that its answer arrives
        answer = services.call(
            names.COMMAND, Command, request, "the interaction manager", wait_s=max(0.1, chosen.wait), answer_s=15.0
        )
    except CodedError as error:
        print(error, file=sys.stderr)
        return UNREACHABLE
    print(f"{answer.message} [{answer.code}]")
    return DONE if answer.success else REFUSED


def main() -> None:
    """Runs the program."""
    sys.exit(run())
