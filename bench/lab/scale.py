#!/usr/bin/env python3
"""How many cameras this computer carries: spots per second, latency and processor shares.

    python3 bench/lab/scale.py --cameras 3
    python3 bench/lab/scale.py --cameras 1 3 6 12 24

1080p Bayer images at 25 per second, rendered beforehand, are played to the real spot detectors. Stamps are the moment of
sending: exposure and readout of a real camera come on top.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List

import numpy as np
import psutil
import rosgraph
import rospy

from bench.detection.rooms import Rooms, lab
from bench.detection.scene_list import draw_round_carpet
from bench.frame import TOP, Table, arguments, quantiles
from bench.lab.player import FRAMES, LEARN_S, RATE
from vb_core import names
from vb_evaluation.processes import Child, free_port
from vb_msgs.msg import DetectorStatus, LaserSpot

PLAYER = Path(__file__).with_name("player.py")
WARM_S = 3.0  # of drawing before anything is counted
GROUPS = {"detector": "__name:=spot_detector_", "fusion": "border_fusion", "player": "player.py"}


def wait(condition: Callable[[], Any], what: str, seconds: float = 120.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            raise SystemExit(f"waited {seconds:g} s in vain for {what}")
        time.sleep(0.1)


@contextlib.contextmanager
def lab_of(cameras: List[str], pictures: Path, folder: Path) -> Iterator[None]:
    """Runs a master, the fusion, and the cameras' player and detectors."""
    children: List[Child] = []

    def start(*words: str) -> None:
        children.append(Child(list(words), folder / f"{len(cameras)}_{len(children)}.txt", dict(os.environ)))

    try:
        start("roscore", "-p", os.environ["ROS_MASTER_URI"].rpartition(":")[2])
        wait(rosgraph.is_master_online, "the master")
        rospy.set_param("/border_fusion/spot_log_file", str(folder / "fusion.jsonl"))
        start("rosrun", "vb_fusion", "border_fusion")
        start(sys.executable, str(PLAYER), str(pictures), *cameras)
        config = f"config:={TOP}/src/vb_laser_detect/config/stationary.yaml"
        file = str(TOP / "launch/parts/detectors.launch")
        start("roslaunch", file, f"cameras:={' '.join(cameras)}", config, "image_transport:=raw")
        yield
    finally:
        for child in reversed(children):
            child.stop(30.0)


def used(word: str) -> float:
    """Returns the processor time [s] that the processes below this one whose command line has a word have taken."""
    found = [one for one in psutil.Process().children(recursive=True) if any(word in part for part in one.cmdline())]
    return sum(sum(one.cpu_times()[:2]) for one in found)


def measure(count: int, seconds: float, pictures: Path, folder: Path) -> Dict[str, Any]:
    """Measures one row of the table."""
    cameras = [f"c{number}" for number in range(count)]
    delays: List[float] = []
    statuses: Dict[str, Any] = {}
    with lab_of(cameras, pictures, folder):
        rospy.init_node("lab_scale", disable_signals=True)
        rospy.Subscriber(names.SPOTS, LaserSpot, lambda m: delays.append(time.time() - m.header.stamp.to_sec()))
        rospy.Subscriber(names.DETECTORS, DetectorStatus, lambda m: statuses.update({m.camera: m}), queue_size=100)
        wait(lambda: len(statuses) == count, f"the detectors, see {folder}")
        wait(lambda: rospy.has_param("/ready"), f"the player, see {folder}")
        rospy.set_param("/go", True)
        time.sleep(LEARN_S + WARM_S)
        before, began = {name: used(word) for name, word in GROUPS.items()}, time.monotonic()
        searched = sum(one.processed for one in statuses.values())
        del delays[:]
        time.sleep(seconds)
        lasted, found = time.monotonic() - began, list(delays)
        shares = {name: (used(word) - before[name]) / lasted for name, word in GROUPS.items()}
        searched = sum(one.processed for one in statuses.values()) - searched
        return {
            "cameras": count,
            "cores": os.cpu_count(),
            "searched_share": searched / (RATE * count * lasted),
            "spots_per_s": len(found) / lasted,
            **quantiles(found),
            "detector_ms_per_image": 1e3 * shares["detector"] * lasted / max(searched, 1),
            **{f"{name}_cores": share for name, share in shares.items()},
        }


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--cameras", type=int, nargs="+", default=[1, 3, 6, 12, 24])
    parser.add_argument("--seconds", type=float, default=15.0, help="of drawing that are measured")
    given = parser.parse_args()
    # a shell that starts it in the background has interrupts ignored, and the nodes would ignore them too
    signal.signal(signal.SIGINT, signal.default_int_handler)
    folder, failed = Path(tempfile.mkdtemp(prefix="lab_scale_")), 0
    uri = f"http://127.0.0.1:{free_port()}"
    os.environ.update({"ROS_MASTER_URI": uri, "ROS_IP": "127.0.0.1", "ROS_LOG_DIR": str(folder)})
    np.save(str(folder / "images.npy"), np.array(draw_round_carpet(lab(), Rooms(1), FRAMES)))
    for count in given.cameras:
        # in a process of its own each: a node cannot be started twice in one
        child = os.fork()
        if not child:
            status = 1
            try:
                Table(given.csv).add(**measure(count, given.seconds, folder / "images.npy", folder))
                status = 0
            finally:
                os._exit(status)
        if os.waitpid(child, 0)[1]:
            failed += 1
            print(f"{count} cameras: failed, see {folder}", flush=True)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
