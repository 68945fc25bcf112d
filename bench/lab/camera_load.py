#!/usr/bin/env python3
"""Measures how many 1080p motion JPEG cameras, whose streams the detectors read themselves, this computer can handle.

    python3 bench/lab/camera_load.py --cameras 1 6 12 24            from a local HTTP server

Fusion and page run too. Each camera begins elsewhere in the clip of camera_clip.py, so that at any time a quarter of
them see the spot: there is one pointer, and of 24 cameras no more than that see one place. Images are stamped on
arrival: a real camera's exposure, readout and network come on top.
"""

from __future__ import annotations

import multiprocessing
import signal
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Dict, List, Optional, Tuple

import cv2
import numpy as np
import psutil
import rospy
import tf2_ros
import yaml

from bench.harness import TOP, Table, arguments, quantiles
from bench.lab.camera_clip import FRAMES, RATE, clip, scene, serving
from bench.lab.page_nodes import node_process, start, wait
from vb_core import names
from vb_core.ros.messages import message_from_transform
from vb_evaluation.child_processes import Child
from vb_laser_detect.camera.camera_files import save_lens
from vb_msgs.msg import DetectorStatus, LaserSpot

WARM_S = 6.0  # detectors learn the floor


class Running:
    """Fusion, page and the detectors of some cameras: their processor time, and how late spots come.

    Args:
        address: the URL that each detector reads.
    """

    def __init__(self, stack: ExitStack, count: int, address: str) -> None:
        _, folder = start(stack)
        self.cameras, self.status = [f"c{number}" for number in range(count)], {}
        self._children: List[Child] = []
        self.delays: Dict[str, List[float]] = {name: [] for name in self.cameras}
        rospy.Subscriber(names.SPOTS, LaserSpot, self._on_spot, queue_size=1000)
        rospy.Subscriber(names.DETECTORS, DetectorStatus, lambda m: self.status.update({m.camera: m}), queue_size=200)
        self._poses = tf2_ros.StaticTransformBroadcaster()
        self._poses.sendTransform(
            [
                message_from_transform(scene().pose, names.MAP_FRAME, f"{name}_optical_frame", rospy.Time.now())
                for name in self.cameras
            ]
        )
        for number, name in enumerate(self.cameras):
            save_lens(folder / "lenses" / f"{name}.yaml", name, scene().model)
            (folder / "detectors").mkdir(exist_ok=True)
            (folder / "detectors" / f"{name}.yaml").write_text(
                yaml.safe_dump({"source": f"{address}?{FRAMES * number // count}"})
            )
        configs = " ".join(f"{name}={folder}/detectors/{name}.yaml" for name in self.cameras)
        for number, command in enumerate(
            (
                ["rosrun", "vb_fusion", "border_fusion"],
                ["roslaunch", str(TOP / "launch/parts/detectors.launch"), f"cameras:={' '.join(self.cameras)}", f"configs:={configs}",
                 f"config:={TOP}/src/vb_laser_detect/config/stationary.yaml", "image_transport:=raw"],
            )
        ):  # fmt: skip
            self._children.append(Child(command, folder / f"{number}.txt"))
            stack.callback(self._children[-1].stop, 30.0)

    def _on_spot(self, message: LaserSpot) -> None:
        self.delays[message.camera].append(time.time() - message.header.stamp.to_sec())

    def watch(
        self, seconds: float, others: Dict[str, psutil.Process]
    ) -> Tuple[Dict[str, Dict[str, float]], Dict[str, float]]:
        """Watches for some seconds; returns each camera's figures, and the cores that other processes took."""
        wait(
            lambda: len(self.status) == len(self.cameras) and all(one.processed for one in self.status.values()),
            lambda: "images" + "".join(f"\n\n{child.tail(20)}" for child in self._children),
            180.0,
        )
        time.sleep(WARM_S)
        nodes = {name: node_process(f"/spot_detector_{name}") for name in self.cameras}
        before, began, status = self._used({**nodes, **others}), time.monotonic(), dict(self.status)
        for delays in self.delays.values():
            delays.clear()
        time.sleep(seconds)
        wait(lambda: all(self.status[one].header.stamp > status[one].header.stamp for one in status), "news of each")
        lasted, used = time.monotonic() - began, self._used({**nodes, **others})
        found = {}
        for name in self.cameras:
            # a detector reports its counts once a second: the span is that between two reports
            span = (self.status[name].header.stamp - status[name].header.stamp).to_sec()
            searched = self.status[name].processed - status[name].processed
            found[name] = {
                "searched_share": searched / (RATE * span),
                "ms_per_image": 1e3 * (used[name] - before[name]) / lasted * span / max(searched, 1),
            }
        return found, {name: (used[name] - before[name]) / lasted for name in others}

    @staticmethod
    def _used(processes: Dict[str, psutil.Process]) -> Dict[str, float]:
        return {name: sum(process.cpu_times()[:2]) for name, process in processes.items()}


def measure(csv: Optional[Path], count: int, seconds: float, jpegs: List[bytes]) -> None:
    """Measures one number of cameras, and adds to a table a row for each camera and one for all."""
    table = Table(csv)
    with ExitStack() as stack:
        address, server = serving(stack, jpegs)
        running = Running(stack, count, address)
        others = {"fusion": node_process("/border_fusion"), "page": node_process(), "server": server}
        found, shares = running.watch(seconds, others)
        # now: while the detectors shut down, their spots are late
        rows = [{"camera": name, **figures, **quantiles(running.delays[name])} for name, figures in found.items()]
        everything = quantiles([delay for delays in running.delays.values() for delay in delays])
    means = {key: float(np.mean([row[key] for row in rows])) for key in ("searched_share", "ms_per_image")}
    for row in (*rows, {"camera": f"all {count}", **means, **everything}):
        table.add(**row, **{f"{name}_cores": share for name, share in shares.items()})


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--cameras", type=int, nargs="+", default=[1, 6, 12, 24])
    parser.add_argument("--seconds", type=float, default=20.0, help="that are measured; 20 is the whole clip")
    given = parser.parse_args()
    # a shell starts background jobs with interrupts ignored, and the nodes would ignore them too
    signal.signal(signal.SIGINT, signal.default_int_handler)
    cv2.setNumThreads(1)
    jpegs, failed = clip(), 0
    for count in given.cameras:  # each in a separate process: a node cannot be started twice in one
        work = (given.csv, count, given.seconds, jpegs)
        child = multiprocessing.get_context("fork").Process(target=measure, args=work)
        child.start()
        child.join()
        failed += child.exitcode != 0
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
