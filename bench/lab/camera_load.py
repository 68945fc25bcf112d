#!/usr/bin/env python3
"""Measures how many 1080p motion JPEG cameras, whose streams the detectors read directly, this computer can process.

    python3 bench/lab/camera_load.py --cameras 1 6 12 24            from a local HTTP server
    python3 bench/lab/camera_load.py --cameras 24 --files           from video files, which wait for their detector

Fusion and page run too. Each camera starts at a different point of the clip of camera_clip.py, so that a quarter of
the cameras see the spot at any time, as many as would see a real pointer. Images are stamped on arrival, so the delays
do not include a real camera's exposure, readout and network.
"""

from __future__ import annotations

import multiprocessing
import signal
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Dict, List, Optional

import cv2
import numpy as np
import psutil
import rosnode
import rospy
import tf2_ros
import yaml

from bench.harness import TOP, ResultTable, arguments
from bench.lab.camera_clip import FRAMES, carpet_view, clip, start_server, write_files
from bench.lab.page_nodes import node_process, start_page
from vb_core import names
from vb_core.child_processes import ChildProcess
from vb_core.ros.messages import message_from_transform
from vb_laser_detect.camera.lens_and_settings_files import save_lens
from vb_msgs.msg import DetectorStatus, LaserSpot
from vb_testing import wait_until

WARM_S = 6.0  # [s] in which detectors learn the floor


class Running:
    """Fusion, page and detectors of some cameras, with their processor time and the spots' delays.

    Args:
        addresses: of the stream or file that each detector reads.
    """

    def __init__(self, stack: ExitStack, folder: Path, addresses: List[str]) -> None:
        self.cameras = [f"c{number}" for number in range(len(addresses))]
        self.status: Dict[str, DetectorStatus] = {}
        self._children: List[ChildProcess] = []
        self._delays: List[float] = []
        rospy.Subscriber(names.SPOTS, LaserSpot, self._on_spot, queue_size=1000)
        rospy.Subscriber(names.DETECTORS, DetectorStatus, self._on_status, queue_size=1000)
        self._poses = tf2_ros.StaticTransformBroadcaster()
        pose, stamp = carpet_view().pose, rospy.Time.now()
        frames = [f"{name}_optical_frame" for name in self.cameras]
        self._poses.sendTransform([message_from_transform(pose, names.MAP_FRAME, frame, stamp) for frame in frames])
        for number, name in enumerate(self.cameras):
            save_lens(folder / "lenses" / f"{name}.yaml", name, carpet_view().model)
            (folder / "detectors").mkdir(exist_ok=True)
            (folder / "detectors" / f"{name}.yaml").write_text(yaml.safe_dump({"source": addresses[number]}))
        configs = " ".join(f"{name}={folder}/detectors/{name}.yaml" for name in self.cameras)
        config = TOP / "src/vb_laser_detect/config/stationary.yaml"
        detectors = ["roslaunch", str(TOP / "launch/parts/detectors.launch"), f"cameras:={' '.join(self.cameras)}"]
        detectors += [f"configs:={configs}", f"config:={config}", "image_transport:=raw"]
        for number, command in enumerate((["rosrun", "vb_fusion", "border_fusion"], detectors)):
            self._children.append(ChildProcess(command, folder / f"{number}.txt"))
            stack.callback(self._children[-1].stop, 30.0)

    def _on_spot(self, message: LaserSpot) -> None:
        self._delays.append(time.time() - message.header.stamp.to_sec())

    def _on_status(self, message: DetectorStatus) -> None:
        self.status[message.camera] = message

    def watch(self, seconds: float, others: Dict[str, psutil.Process]) -> Dict[str, float]:
        """Measures for some seconds; returns a row of shares, processor time [ms, cores] and delays [ms]."""
        wait_until(
            lambda: len(self.status) == len(self.cameras) and all(c.processed for c in self.status.values()),
            lambda: "images" + "".join(f"\n\n{child.tail(20)}" for child in self._children),
            180.0,
        )
        time.sleep(WARM_S)
        nodes = [name for name in rosnode.get_node_names() if name.startswith("/spot_detectors")]
        processes = {**{name: node_process(name) for name in nodes}, **others}
        start_times, start = self._read_times(processes), time.monotonic()
        initial = dict(self.status)
        self._delays.clear()
        time.sleep(seconds)
        # detectors report their counts once a second
        wait_until(
            lambda: all(self.status[c].header.stamp > initial[c].header.stamp for c in initial), "detectors' status"
        )
        end_status, delays = dict(self.status), list(self._delays)
        duration = time.monotonic() - start
        cores = {name: (now - start_times[name]) / duration for name, now in self._read_times(processes).items()}
        searched, received, spans = (
            np.array([read(end_status[name]) - read(initial[name]) for name in self.cameras])
            for read in (lambda m: m.processed, lambda m: m.received, lambda m: m.header.stamp.to_sec())
        )
        median, p95 = 1e3 * np.quantile(delays, (0.5, 0.95)) if delays else ("", "")
        return {
            "images_per_s": float((searched / spans).sum()),
            "searched_share": float(searched.sum() / received.sum()),
            "worst_camera": float((searched / received).min()),
            "ms_per_image": 1e3 * sum(cores.pop(name) for name in nodes) / float((searched / spans).sum()),
            "n": len(delays),
            "median_ms": median,
            "p95_ms": p95,
            **{f"{name}_cores": cores_used for name, cores_used in cores.items()},
        }

    @staticmethod
    def _read_times(processes: Dict[str, psutil.Process]) -> Dict[str, float]:
        return {name: sum(process.cpu_times()[:2]) for name, process in processes.items()}


def measure_cameras(csv: Optional[Path], count: int, files: bool, seconds: float, jpegs: List[bytes]) -> None:
    """Measures one number of cameras, and adds a row to a table."""
    others: Dict[str, psutil.Process] = {}
    with ExitStack() as stack:
        _, folder = start_page(stack)
        if files:
            quarters = write_files(jpegs, folder)
            addresses = [quarters[4 * number // count] for number in range(count)]
        else:
            address, others["server"] = start_server(stack, jpegs)
            addresses = [f"{address}?{FRAMES * number // count}" for number in range(count)]
        running = Running(stack, folder, addresses)
        others.update({"fusion": node_process("/border_fusion"), "page": node_process()})
        ResultTable(csv).add(cameras=count, source="files" if files else "http", **running.watch(seconds, others))


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--cameras", type=int, nargs="+", default=[1, 6, 12, 24])
    parser.add_argument("--files", action="store_true", help="play video files instead of the server's streams")
    parser.add_argument("--seconds", type=float, default=20.0, help="measuring time; 20 is the whole clip")
    options = parser.parse_args()
    # restores interrupts, which shells' background jobs ignore, and which the nodes would then ignore too
    signal.signal(signal.SIGINT, signal.default_int_handler)
    cv2.setNumThreads(1)
    jpegs, failed = clip(), 0
    for count in options.cameras:  # each in a separate process, because a process can have only one node
        args = (options.csv, count, options.files, options.seconds, jpegs)
        child = multiprocessing.get_context("fork").Process(target=measure_cameras, args=args)
        child.start()
        child.join()
        failed += child.exitcode != 0
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
