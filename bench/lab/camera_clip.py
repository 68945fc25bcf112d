"""What the simulated cameras of cameras.py and image_cost.py send: 20 s of 1080p motion JPEG, from a server or a file.

The simulated lab with tiles as its floor and a camera's denoising: an image has about 51 kB. A person stands there all
the time; in a quarter of the images they draw.
"""

from __future__ import annotations

import signal
import subprocess
import sys
from contextlib import ExitStack
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any, List, Tuple

import av
import cv2
import psutil
import simplejpeg

from bench.detection.disturbances import DisturbedSnapshot
from bench.detection.motions import along, place_and_velocity
from bench.detection.rooms import Rooms, lab, tiles
from bench.detection.scene_list import CARPET
from bench.frame import TOP
from vb_evaluation.processes import free_port

sys.path.append(str(TOP / "src/vb_laser_detect/test"))
from mjpeg_server import MjpegServer  # noqa: E402

RATE, FRAMES, DRAWN = 25.0, 500, range(125, 250)
QUALITY, DENOISED_PX = 60, 0.8
LAPS = 15  # of the clip as H.264, which is played once


@lru_cache(maxsize=1)
def scene() -> Any:
    """Returns the view of the camera above the carpet."""
    room = lab()
    return Rooms(1).view(tiles(room, (150, 145, 138)), "green")


def clip() -> List[bytes]:
    """Renders 20 s of images, of which a quarter show a spot."""
    border, view, jpegs = along(CARPET, 0.4), scene(), []
    for number in range(FRAMES):
        t, laser, velocity = number / RATE, None, (0.0, 0.0)
        if number in DRAWN:
            laser, velocity = place_and_velocity(border, t)
        image = view.frame(DisturbedSnapshot(t, {}, laser, "red", velocity, (4.6, 2.9, -1.5)))
        bgr = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_BayerRGGB2BGR), (0, 0), DENOISED_PX)
        jpegs.append(simplejpeg.encode_jpeg(bgr, quality=QUALITY, colorspace="BGR", colorsubsampling="420"))
    return jpegs


def write(jpegs: List[bytes], path: Path) -> None:
    """Writes a video file of motion JPEG."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mjpeg", rate=int(RATE))
        stream.width, stream.height, stream.pix_fmt = scene().model.width, scene().model.height, "yuvj420p"
        for number, jpeg in enumerate(jpegs):
            packet = av.Packet(jpeg)
            packet.stream, packet.time_base = stream, Fraction(1, int(RATE))
            packet.pts = packet.dts = number
            container.mux(packet)


def read(path: Path) -> List[bytes]:
    """Reads the images of a file; inverse of `write`."""
    with av.open(str(path)) as container:
        return [bytes(packet) for packet in container.demux(video=0) if packet.size]


def serve(path: str, port: str) -> None:
    """Serves a clip to any number of cameras, until it is ended."""
    MjpegServer(read(Path(path)), RATE, int(port))
    signal.pause()


def write_h264(jpegs: List[bytes], path: Path) -> None:
    """Writes H.264 whose images stand by themselves once a second: the clip as often as it takes to measure."""
    with av.open(str(path.with_suffix(".h264")), "w", format="h264") as container:
        options = {"preset": "ultrafast", "tune": "zerolatency", "g": str(int(RATE))}
        stream = container.add_stream("libx264", rate=int(RATE), options=options)
        stream.width, stream.height, stream.pix_fmt = scene().model.width, scene().model.height, "yuv420p"
        for jpeg in jpegs:
            picture = simplejpeg.decode_jpeg(jpeg, "BGR")
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="bgr24")))
        container.mux(stream.encode())
    with av.open(str(path.with_suffix(".h264"))) as encoded, av.open(str(path), "w") as container:
        found = [(bytes(packet), packet.is_keyframe) for packet in encoded.demux(video=0) if packet.size]
        stream = container.add_stream_from_template(encoded.streams.video[0])
        for number in range(LAPS * len(found)):
            content, whole = found[number % len(found)]
            packet = av.Packet(content)
            packet.stream, packet.time_base, packet.is_keyframe = stream, Fraction(1, int(RATE)), whole
            packet.pts = packet.dts = number
            container.mux(packet)


# run by Debian's Python, with gir1.2-gst-rtsp-server-1.0 and gstreamer1.0-plugins-good
RTSP = """
import sys, gi
gi.require_version("Gst", "1.0"); gi.require_version("GstRtspServer", "1.0")
from gi.repository import GLib, Gst, GstRtspServer
Gst.init(None)
server, factory = GstRtspServer.RTSPServer(service=sys.argv[2]), GstRtspServer.RTSPMediaFactory(shared=True)
factory.set_launch(f"( filesrc location={sys.argv[1]} ! qtdemux ! h264parse ! rtph264pay name=pay0 pt=96 config-interval=1 )")
server.get_mount_points().add_factory("/video", factory)
server.attach(None)
GLib.MainLoop().run()
"""


def serving_rtsp(stack: ExitStack, path: Path) -> Tuple[str, psutil.Process]:
    """Starts GStreamer's RTSP server; returns its address, and its process."""
    port = free_port()
    child = subprocess.Popen(["/usr/bin/python3", "-c", RTSP, str(path), str(port)], env={"PATH": "/usr/bin:/bin"})
    stack.callback(child.wait)
    stack.callback(child.terminate)
    return f"rtsp://127.0.0.1:{port}/video", psutil.Process(child.pid)


def serving(stack: ExitStack, path: Path) -> Tuple[str, psutil.Process]:
    """Starts the HTTP server; returns its address, and its process."""
    port = free_port()
    child = subprocess.Popen(
        [sys.executable, "-c", f"from bench.lab import camera_clip; camera_clip.serve({str(path)!r}, {port})"]
    )
    stack.callback(child.wait)
    stack.callback(child.terminate)
    return f"http://127.0.0.1:{port}/video", psutil.Process(child.pid)
