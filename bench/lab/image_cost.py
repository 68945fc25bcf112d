#!/usr/bin/env python3
"""What an image of a 1080p camera costs its detector, beside decoding it to grey and searching it, and beside a driver and a topic.

python3 bench/lab/image_cost.py                             images as of camera_clip.py; --spans 0: one thread alone
"""

from __future__ import annotations

import signal
import sys
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List

import cv2
import numpy as np
import rospy
import simplejpeg
from sensor_msgs.msg import CameraInfo, Image

from bench.frame import arguments
from bench.lab.camera_clip import FRAMES, RATE, clip, read, scene, serving, write
from bench.lab.cameras import Running, in_processes
from bench.lab.page_lab import node_process
from vb_core.image_format import Picture
from vb_core.ros.cameras import info_from_camera
from vb_core.ros.images import message_from_image
from vb_evaluation.processes import Child
from vb_laser_detect.camera.source import CameraSource, CaptureParams, Shot
from vb_laser_detect.detection.projection import ImageGeometry
from vb_laser_detect.detection.projection import FloorProjection
from vb_laser_detect.detector import SpotDetector


def drive(address: str, topic: str) -> None:
    """A driver as many are: reads a camera, decodes each image and publishes it with its camera_info."""
    rospy.init_node("driver", disable_signals=True)
    images, infos = (
        rospy.Publisher(f"/{topic}/{name}", kind, queue_size=1)
        for name, kind in (("image_raw", Image), ("camera_info", CameraInfo))
    )

    def take(shot: Shot) -> None:
        stamp, frame = rospy.Time.from_sec(shot.taken), f"{topic}_optical_frame"
        images.publish(
            message_from_image(cv2.imdecode(np.frombuffer(shot.jpeg, np.uint8), cv2.IMREAD_COLOR), "bgr8", stamp, frame)
        )
        infos.publish(info_from_camera(scene().model, stamp, frame))

    scene()
    CameraSource(address, CaptureParams(), take, lambda error: None).start()
    signal.pause()


class Search:
    """Decodes and searches images as a detector does, and adds up the thread's time."""

    def __init__(self, decode: Callable[[bytes], Picture]) -> None:
        self._decode, self._detector, self._projector = (decode, SpotDetector(), FloorProjection())
        self._model: Any = None
        self.times: List[float] = []

    def look(self, jpeg: bytes, stamp: float) -> None:
        began = time.thread_time()
        picture = self._decode(jpeg)
        if self._model is None:  # a node too keeps the lens of its images' size
            self._model = scene().model.scaled_to(*picture.pixels.shape[1::-1])
        self._detector.detect(picture, stamp, ImageGeometry(self._model, lambda: scene().pose, self._projector))
        self.times.append(1e3 * (time.thread_time() - began))


def gray(jpeg: bytes) -> Picture:
    return Picture(simplejpeg.decode_jpeg(jpeg, "GRAY")[..., 0], "mono")


def cost(spans: int, seconds: float, path: Path, half_size: bool) -> Iterator[Dict[str, Any]]:
    """Measures an image's cost in one thread, then as nodes, each beside decoding to grey and searching."""
    jpegs, ours, alone = read(path), Search(lambda jpeg: Shot(0.0, jpeg).searched(half_size)[0]), Search(gray)
    for number in range(2 * FRAMES):
        for one in (ours, alone) if number % 2 else (alone, ours):
            one.look(jpegs[number % FRAMES], number / RATE)
    # each second of images by itself, the first lap is for learning
    blocks = np.array([np.array(one.times[FRAMES:]).reshape(-1, int(RATE)).sum(axis=1) for one in (ours, alone)])
    draws = np.random.default_rng(1).integers(blocks.shape[1], size=(2000, blocks.shape[1]))
    low, high = np.percentile(blocks[0][draws].sum(axis=1) / blocks[1][draws].sum(axis=1), [2.5, 97.5])
    yield {
        "what": "one thread", "ours_ms": blocks[0].sum() / FRAMES, "gray_ms": blocks[1].sum() / FRAMES,
        "ours_over_gray": blocks[0].sum() / blocks[1].sum(), "low": float(low), "high": float(high),
    }  # fmt: skip
    if not spans:
        return
    with ExitStack() as stack:
        address, _ = serving(stack, path)
        running = Running(stack, {"own": address, "topic": ""}, half_size)
        driver = Child(
            [sys.executable, "-c", f"from bench.lab import image_cost; image_cost.drive({address!r}, 'topic')"],
            running.folder / "driver.txt",
        )
        stack.callback(driver.stop)
        alone, ended = Search(gray), threading.Event()
        stack.callback(ended.set)
        threading.Thread(target=play, args=(alone, jpegs, ended), daemon=True).start()
        for _ in range(spans):
            del alone.times[:]
            found, shares = running.watch(seconds, {"driver": node_process("/driver")})
            own, topic = (found[name]["ms_per_image"] for name in ("own", "topic"))
            driven = 1e3 * shares["driver"] / RATE
            yield {
                "what": "nodes", "own_ms": own, "driver_ms": driven, "topic_ms": topic, "gray_ms": float(np.mean(alone.times)),
                "own_over_gray": own / float(np.mean(alone.times)), "own_over_driver_and_topic": own / (driven + topic),
                "searched_share": min(one["searched_share"] for one in found.values()),
            }  # fmt: skip


def play(search: Search, jpegs: List[bytes], ended: threading.Event) -> None:
    """Searches images at their rate."""
    began, number = time.monotonic(), 0
    while not ended.wait(max(0.0, began + number / RATE - time.monotonic())):
        search.look(jpegs[number % len(jpegs)], number / RATE)
        number += 1


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each span; 20 is the whole clip")
    parser.add_argument("--spans", type=int, default=5, help="of the nodes")
    parser.add_argument("--half-size", action="store_true", help="search images at half their size")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="bench_cameras_") as folder:
        path = Path(folder) / "clip.avi"
        write(clip(), path)
        return in_processes([path], lambda one: cost(given.spans, given.seconds, one, given.half_size), given.csv)


if __name__ == "__main__":
    sys.exit(main())
