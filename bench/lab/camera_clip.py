"""Renders and serves the clip for camera_load.py: 20 s of 1080p motion JPEG.

The clip shows the simulated lab with a tiled floor, denoised as by a camera; an image has about 51 kB. A person is
always present, and draws in a quarter of the images.
"""

from __future__ import annotations

import multiprocessing
import signal
import sys
from contextlib import ExitStack
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any, List, Tuple

import av
import cv2
import numpy as np
import psutil
import simplejpeg

from bench.detection.scene_disturbances import DisturbedSnapshot
from bench.detection.scene_motions import motion_along, place_and_velocity
from bench.detection.scene_rendering import Rooms, lab, tiles
from bench.detection.scene_list import CARPET
from bench.harness import TOP
from vb_core.child_processes import free_port
from vb_core.image_format import PixelReader

sys.path.append(str(TOP / "src/vb_laser_detect/test"))
from mjpeg_server import MjpegServer  # noqa: E402

RATE, FRAMES = 25.0, 500
DRAWN = range(125, 250)  # the frames with a spot
QUALITY = 60  # of the JPEG
DENOISED_PX = 0.8  # [px] standard deviation of the blur


@lru_cache(maxsize=1)
def carpet_view() -> Any:
    """Returns the view of the camera above the carpet."""
    return Rooms(1).view(tiles(lab(), (150, 145, 138)), "green")


def clip() -> List[bytes]:
    """Returns 20 s of JPEG images, of which a quarter show a spot."""
    border, view = motion_along(CARPET, 0.4), carpet_view()
    jpegs = []
    for number in range(FRAMES):
        t, laser, velocity = number / RATE, None, (0.0, 0.0)
        if number in DRAWN:
            laser, velocity = place_and_velocity(border, t)
        image = view.image(DisturbedSnapshot(t, {}, laser, "red", velocity, (4.6, 2.9, -1.5)))
        jpegs.append(webcam_jpeg(image, view.encoding))
    return jpegs


def webcam_jpeg(image: np.ndarray, encoding: str) -> bytes:
    """Returns an image as a webcam sends it: denoised and compressed."""
    bgr = cv2.GaussianBlur(PixelReader().read(image, encoding).bgr(), (0, 0), DENOISED_PX)
    return simplejpeg.encode_jpeg(bgr, quality=QUALITY, colorspace="BGR", colorsubsampling="420")


def write_files(jpegs: List[bytes], folder: Path) -> List[str]:
    """Writes four video files, each of which starts in another quarter of the clip; returns their paths."""
    paths = [str(folder / f"quarter{number}.mkv") for number in range(4)]
    for number, path in enumerate(paths):
        with av.open(path, "w") as container:
            stream = container.add_stream("mjpeg", rate=int(RATE))
            camera = carpet_view().model
            stream.width, stream.height, stream.pix_fmt = camera.width, camera.height, "yuvj420p"
            for index in range(FRAMES):
                packet = av.Packet(jpegs[(index + number * FRAMES // 4) % FRAMES])
                packet.stream, packet.time_base, packet.pts, packet.dts = stream, Fraction(1, int(RATE)), index, index
                container.mux(packet)
    return paths


def serve(jpegs: List[bytes], port: int) -> None:
    """Serves a clip to any number of cameras, until the process is ended."""
    MjpegServer(jpegs, RATE, port)
    signal.pause()


def start_server(stack: ExitStack, jpegs: List[bytes]) -> Tuple[str, psutil.Process]:
    """Starts the HTTP server; returns its address and process."""
    port = free_port()
    child = multiprocessing.get_context("fork").Process(target=serve, args=(jpegs, port))
    child.start()
    stack.callback(child.join)
    stack.callback(child.terminate)
    return f"http://127.0.0.1:{port}/video", psutil.Process(child.pid)
