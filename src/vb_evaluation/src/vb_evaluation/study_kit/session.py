"""Records a session with rosbag: all messages but images and point clouds, which are a thousand times as large."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import roslib.packages

from vb_evaluation.study_kit.recording import BAGS

WITHOUT = ".*(image|compressed|points|projector).*"


def main() -> None:
    """Becomes rosbag's recorder, into the folder that is the first argument; a restarted one goes on in another file."""
    bags = Path(sys.argv[1]).expanduser() / BAGS
    bags.mkdir(parents=True, exist_ok=True)
    recorder = roslib.packages.find_node("rosbag", "record")[0]
    # what roslaunch appended (__name:=, __log:=) is for the recorder
    options = ["--all", "--exclude", WITHOUT, "--output-prefix", str(bags / "session"), "--lz4", "--buffsize", "512"]
    os.execv(recorder, [recorder, *options, *sys.argv[2:]])
