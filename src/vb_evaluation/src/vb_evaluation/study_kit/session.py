"""Records a session: notes how the system was started, then hands over to rosbag's recorder."""

from __future__ import annotations

import argparse
import datetime
import os
import re
import sys
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence

import roslib.packages
import rospy
import yaml

from vb_core import names
from vb_core.errors import CodedError
from vb_evaluation.study_kit.recording import BAGS, RUN, SESSION
from vb_evaluation.provenance import revision

# everything that tells what happened, but images, which are a thousand times as large
TOPICS = (
    names.PHYSICAL_MAP,
    names.MAP_WITH_BORDERS,
    names.SPOTS,
    names.STATE,
    names.PROGRESS,
    names.BORDERS,
    names.DETECTORS,
    names.NOTICES,
    names.DRIVERS,
    names.LED,
    names.SOUND,
    "/virtual_borders/voice/heard",
    "/tf",
    "/tf_static",
    "/rosout",
)
ROBOT_TOPICS = (
    "odom",
    "cmd_vel",
    "cmd_vel/navigation",
    "amcl_pose",
    "move_base/goal",
    "move_base/result",
    "camera/rgb/camera_info",
    "camera/depth_registered/camera_info",
)


def topics(cameras: Sequence[str], robots: Sequence[str]) -> List[str]:
    """Lists the topics to record.

    Args:
        cameras: names of the ceiling cameras.
        robots: namespaces; "" is the robot without one.
    """
    found = [*TOPICS, *(f"/{camera}/camera_info" for camera in cameras)]
    for robot in robots:
        prefix = f"/{robot.strip('/')}/" if robot.strip("/") else "/"
        found += [prefix + topic for topic in ROBOT_TOPICS]
    return found


def next_bag(folder: Path) -> Path:
    """Returns the first free path bags/NN.bag: a recorder that was restarted goes on in a new file."""
    bags = folder / BAGS
    bags.mkdir(parents=True, exist_ok=True)
    taken = [int(path.name[:2]) for path in bags.iterdir() if re.match(r"\d\d\.bag", path.name)]
    return bags / f"{max(taken, default=0) + 1:02d}.bag"


def main(arguments: Optional[List[str]] = None) -> None:
    """Becomes rosbag's recorder; ends with status 1 and one line if it cannot."""
    parser = argparse.ArgumentParser(prog="record_session", description=__doc__)
    parser.add_argument("--folder", required=True)
    parser.add_argument("--cameras", default="", help="names of the ceiling cameras, separated by spaces")
    parser.add_argument(
        "--robots", default="", help="namespaces of the robots, separated by spaces; empty: one without"
    )
    parser.add_argument("--method", default="", help="for the record")
    given = parser.parse_args(rospy.myargv(sys.argv)[1:] if arguments is None else arguments)
    folder = Path(given.folder).expanduser()
    try:
        bag = next_bag(folder)
        _describe(folder, given)
        recorder = roslib.packages.find_node("rosbag", "record")
        if not recorder:
            raise CodedError("no_recorder", "rosbag is not installed: run 'make setup'")
    except (OSError, CodedError) as error:
        print(f"record_session: cannot record into {folder}: {error}", file=sys.stderr)
        sys.exit(1)
    wanted = topics(given.cameras.split(), given.robots.split() or [""])
    print(f"recording into {bag}", flush=True)
    # what roslaunch appended (__name:=, __log:=) is for the recorder
    ros = [argument for argument in sys.argv[1:] if ":=" in argument]
    os.execv(recorder[0], [recorder[0], "--output-name", str(bag), "--lz4", "--buffsize", "512", *wanted, *ros])


def _describe(folder: Path, given: argparse.Namespace) -> None:
    """Writes session.yaml: how the system was started, with all parameters."""
    try:
        parameters: Dict[str, Any] = rospy.get_param("/")
    except Exception as error:  # the master's answer is not worth a lost recording
        parameters = {"unknown": str(error)}
    try:
        planned = yaml.safe_load((folder / RUN).read_text(encoding="utf-8")) or {}
    except FileNotFoundError:
        planned = {}  # not started by study_kit run
    content = {
        "run": planned,
        "revision": revision(),
        "method": given.method,
        "cameras": given.cameras.split(),
        "robots": given.robots.split() or [""],
        "started": datetime.datetime.now().astimezone().isoformat(timespec="seconds"),
        "parameters": parameters,
    }
    (folder / SESSION).write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


if __name__ == "__main__":
    main()
