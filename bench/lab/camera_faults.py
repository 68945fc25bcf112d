#!/usr/bin/env python3
"""What becomes of a camera that its detector reads when it fails: how soon people are told, and how soon it is back.

    python3 bench/lab/camera_faults.py                          each fault 20 times

"Told" is from the fault until the detector says it, "back" from its end until images are searched again and nothing is said.
"Twice" is a second detector of the same camera, under another node's name. A second camera runs beside it all the time.
"""

from __future__ import annotations

import signal
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List

import cv2
import numpy as np
import rospy
import simplejpeg

from bench.frame import TOP, arguments
from bench.lab.camera_clip import RATE, MjpegServer, clip, read, write
from bench.lab.cameras import Running, in_processes
from bench.lab.page_lab import wait
from vb_core.ros.notices import NoticeListener
from vb_evaluation.processes import Child


class Failing:
    """A camera that can fail in each way, and what is said of it."""

    def __init__(self, stack: ExitStack, path: Path) -> None:
        self._jpegs = read(path)
        self._servers = {name: MjpegServer(self._jpegs, RATE) for name in ("c0", "c1")}
        self._running = Running(stack, {name: server.address() for name, server in self._servers.items()})
        self._notices = NoticeListener()
        wait(lambda: all(self._processed(name) > 50 for name in ("c0", "c1")), "images", 180.0)
        image = cv2.resize(simplejpeg.decode_jpeg(self._jpegs[200], "BGR"), (1280, 720))
        self._other_size = [simplejpeg.encode_jpeg(image, colorspace="BGR")]

    def fail(self, how: str) -> Callable[[], Any]:
        """Lets the camera fail; returns what ends that."""
        server = self._servers["c0"]
        if how == "stalled":
            server.stalled.set()
            return server.stalled.clear
        if how == "pulled":
            server.close()
            return lambda: self._servers.update(c0=MjpegServer(self._jpegs, RATE, server.port))
        if how == "resized":
            server.jpegs = self._other_size
            return lambda: setattr(server, "jpegs", self._jpegs)
        params = [f"_{key}:={value}" for key, value in (("camera", "c0"), ("source", self._servers["c1"].address()))]
        return Child(
            ["rosrun", "vb_laser_detect", "spot_detector", "__name:=second", *params], TOP / "out/second.txt"
        ).stop

    def told(self) -> bool:
        """Returns whether something is said of the camera."""
        return any(one.camera == "c0" for one in self._notices.current())

    def measure(self, how: str) -> Dict[str, float]:
        """Measures one fault [s]."""
        began, other = time.monotonic(), self._processed("c1")
        end = self.fail(how)
        wait(self.told, f"a word on {how}")
        told, lasted = time.monotonic() - began, rospy.Time.now()
        rospy.sleep(2.0)
        end()
        ended, processed = time.monotonic(), self._processed("c0")
        wait(lambda: self._processed("c0") > processed + RATE and not self.told(), f"the end of {how}")
        assert (
            self._processed("c1") > other + 0.5 * RATE * (rospy.Time.now() - lasted).to_sec()
        ), "the other camera stopped"
        return {"told": told, "back": time.monotonic() - ended}

    def _processed(self, name: str) -> float:
        status = self._running.status.get(name)
        return status.processed if status is not None else 0.0


def faults(times: int, kinds: List[str], path: Path) -> Iterator[Dict[str, Any]]:
    """Measures each fault so many times."""
    with ExitStack() as stack:
        camera = Failing(stack, path)
        for how in kinds:
            found = [camera.measure(how) for _ in range(times)]
            row: Dict[str, Any] = {"fault": how, "times": len(found)}
            for what in ("told", "back"):
                values = [one[what] for one in found]
                row.update({f"{what}_median_s": float(np.median(values)), f"{what}_longest_s": max(values)})
            yield row


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument("--only", nargs="+", default=["pulled", "stalled", "resized", "twice"])
    given = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with tempfile.TemporaryDirectory(prefix="bench_cameras_") as folder:
        write(clip(), Path(folder) / "clip.avi")
        return in_processes([Path(folder) / "clip.avi"], lambda one: faults(given.times, given.only, one), given.csv)


if __name__ == "__main__":
    sys.exit(main())
