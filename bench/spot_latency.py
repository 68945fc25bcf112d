#!/usr/bin/env python3
"""How soon the detectors publish what the ceiling cameras see, without the rest of the lab's load.

    python3 bench/spot_latency.py [--seconds 30] [--rate 25]

Renders some seconds of the lab's three ceiling cameras beforehand (1080p, a border is drawn, two people walk), then
plays them in a process of its own to three spot_detector nodes, as camera drivers would: no simulator, RViz or robot
runs beside them. So it tells whether a computer can carry its cameras. Writes out/bench/spot_latency.json: for each
camera from image stamp to spot as another process receives it, median and 95th percentile; images sent and searched;
the cores that detectors and player took. The first spots of a stroke, which wait for their confirmation, are in it.

The stamp is the moment of sending: exposure and readout of a real camera come on top.
"""
from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any, Dict, List

import numpy as np
import rosgraph
import rospy
import tf2_ros

TOP = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(TOP / "bench"))

from spot_scenes import CARPET, DARK, RATE, WHITE, Rooms, Walk, along, lab, walking  # noqa: E402
from sensor_msgs.msg import CameraInfo, Image  # noqa: E402
from vb_core import names  # noqa: E402
from vb_core.ros import messages  # noqa: E402
from vb_evaluation.observer import wait_until  # noqa: E402
from vb_evaluation.processes import Child, free_port  # noqa: E402
from vb_msgs.msg import DetectorStatus, LaserSpot  # noqa: E402
from vb_sim.lab_history import Snapshot  # noqa: E402
from vb_sim.models_cameras import CameraModels  # noqa: E402

FRAMES = 50  # of each camera, played to and fro
LEARN_S = 4.0  # without a laser before, for the background


def play(seconds: float, rate: float) -> None:
    """Renders, then sends the images of all cameras, evenly spread over the time between two frames."""
    room, rooms = lab(), Rooms(CameraModels(), 1)
    border, people = along(CARPET, 0.4), walking(Walk(room, 3, WHITE, DARK), Walk(room, 4, (150, 40, 40), WHITE))
    cameras = []
    for camera in room.cameras:
        view = rooms.view(room, camera.name)
        empty = view.frame(Snapshot(0.0, {})).copy()
        drawn = []
        for k in range(FRAMES):
            t = k / RATE
            (x, y), (x1, y1) = border(t), border(t + 0.01)
            person = (4.6, 2.9, math.atan2(y - 2.9, x - 4.6))
            snapshot = Snapshot(t, {}, (x, y), "red", ((x1 - x) / 0.01, (y1 - y) / 0.01), person, people(t))
            drawn.append(view.frame(snapshot).copy())
        cameras.append((camera, view, empty, drawn + drawn[::-1]))
    rospy.init_node("player", disable_signals=True)
    signal.signal(signal.SIGINT, lambda *_: rospy.signal_shutdown("ended"))
    poses = tf2_ros.StaticTransformBroadcaster()
    frame = lambda camera: f"{camera.name}_optical_frame"  # noqa: E731
    now = rospy.Time.now()
    poses.sendTransform(
        [messages.transform_message(view.pose, names.MAP_FRAME, frame(camera), now) for camera, view, *_ in cameras]
    )
    images = [rospy.Publisher(f"/{camera.name}/image_raw", Image, queue_size=1) for camera, *_ in cameras]
    infos = [rospy.Publisher(f"/{camera.name}/camera_info", CameraInfo, queue_size=1) for camera, *_ in cameras]
    wait_until(lambda: all(image.get_num_connections() for image in images), 60.0)
    rospy.set_param("/player/began", True)
    started, number = time.monotonic(), 0
    while not rospy.is_shutdown() and time.monotonic() - started < LEARN_S + seconds:
        turn, which = divmod(number, len(cameras))
        camera, view, empty, drawn = cameras[which]
        due = started + turn / rate + which / rate / len(cameras)
        if due > time.monotonic():
            rospy.rostime.wallsleep(due - time.monotonic())
        picture = empty if turn / rate < LEARN_S else drawn[turn % len(drawn)]
        stamp = rospy.Time.now()
        images[which].publish(messages.image_message(picture, camera.encoding, stamp, frame(camera)))
        infos[which].publish(messages.info_from_camera(view.model, stamp, frame(camera)))
        number += 1
    rospy.set_param("/player/sent", number // len(cameras))


def cpu_seconds(pid: int) -> float:
    """[s] of CPU time that a process and its children have taken until now."""
    total = 0.0
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError, IndexError, ValueError):
            fields = stat.read_text().rsplit(")", 1)[1].split()
            if pid in (int(stat.parent.name), int(fields[1])):
                total += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return total


def summary(delays: List[float]) -> Dict[str, Any]:
    """How many, and how long in ms."""
    if not delays:
        return {"spots": 0}
    median, most = (1e3 * np.percentile(delays, (50, 95))).round(1).tolist()
    return {"spots": len(delays), "median_ms": median, "p95_ms": most}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0, help="of drawing")
    parser.add_argument("--rate", type=float, default=25.0, help="[1/s] images of each camera")
    parser.add_argument("--out", type=Path, default=TOP / "out/bench/spot_latency.json")
    parser.add_argument("--play", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.play:
        play(given.seconds, given.rate)
        return 0
    folder, port = given.out.parent / "spot_latency", free_port()
    folder.mkdir(parents=True, exist_ok=True)
    os.environ.update({"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_LOG_DIR": str(folder / "log")})
    cameras = [camera.name for camera in lab().cameras]
    with contextlib.ExitStack() as stack:
        launch = Child(["roslaunch", "-p", str(port), str(TOP / "launch/parts/perception.launch"),
                        f"cameras:={' '.join(cameras)}"], folder / "roslaunch.txt")
        stack.callback(launch.stop)
        if not wait_until(rosgraph.is_master_online, 60.0):
            print("the master did not come up", file=sys.stderr)
            return 1
        player = Child([sys.executable, __file__, "--play", "--seconds", str(given.seconds), "--rate", str(given.rate)],
                       folder / "player.txt")
        stack.callback(player.stop)
        rospy.init_node("spot_latency", disable_signals=True)
        stack.callback(rospy.signal_shutdown, "measured")
        delays, status = {name: [] for name in cameras}, {}

        def on_spot(message: LaserSpot) -> None:
            delays[message.camera].append((rospy.Time.now() - message.header.stamp).to_sec())

        rospy.Subscriber(names.SPOTS, LaserSpot, on_spot, queue_size=100, tcp_nodelay=True)
        rospy.Subscriber(names.DETECTORS, DetectorStatus, lambda message: status.update({message.camera: message}))
        if not wait_until(lambda: rospy.has_param("/player/began"), 180.0, 0.5):
            print(f"the player did not begin:\n{player.tail()}", file=sys.stderr)
            return 1
        children = (launch, player)
        before, began = [cpu_seconds(child.pid) for child in children], time.monotonic()
        wait_until(lambda: rospy.has_param("/player/sent"), LEARN_S + given.seconds + 30.0, 0.5)
        took = time.monotonic() - began
        cores = [(cpu_seconds(child.pid) - old) / took for child, old in zip(children, before)]
        sent = rospy.get_param("/player/sent", 0)
        wait_until(lambda: False, 1.5)  # the last counts come
        result = {"rate_hz": given.rate, "cores_detectors": round(cores[0], 3), "cores_player": round(cores[1], 3),
                  "load": os.getloadavg()[0], "cameras": {}}
        for name in cameras:
            searched = int(status[name].processed) if name in status else 0
            result["cameras"][name] = {"sent": sent, "searched": searched, **summary(delays[name])}
        result["all"] = summary([delay for values in delays.values() for delay in values])
    given.out.write_text(json.dumps(result, indent=2) + "\n")
    print(json.dumps(result, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
