#!/usr/bin/env python3
"""How soon the detectors publish what the ceiling cameras see, without the rest of the lab's load.

    python3 bench/lab/spot_latency.py [--seconds 30] [--rate 25]

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
import os
import signal
import sys
import time
from pathlib import Path

import rosgraph
import rospy
import tf2_ros

TOP = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(TOP / "bench" / "detection"))

from display_latency import cpu_seconds, summary  # noqa: E402
from hard_scenes import Rooms, draw_round_carpet, lab  # noqa: E402
from sensor_msgs.msg import CameraInfo, Image  # noqa: E402

from vb_core import names  # noqa: E402
from vb_core.ros import messages  # noqa: E402
from vb_core.ros.cameras import info_from_camera  # noqa: E402
from vb_core.ros.images import message_from_image  # noqa: E402
from vb_evaluation.observer import wait_until  # noqa: E402
from vb_evaluation.processes import Child, free_port, roslaunch  # noqa: E402
from vb_msgs.msg import DetectorStatus, LaserSpot  # noqa: E402
from vb_sim.room.camera_models import CameraModels  # noqa: E402

FRAMES = 50  # of each camera, played to and fro
LEARN_S = 4.0  # without a laser before, for the background


def play(seconds: float, rate: float) -> None:
    """Renders, then sends the images of all cameras, evenly spread over the time between two frames."""
    room, rooms = lab(), Rooms(CameraModels(), 1)
    cameras = [
        (camera, rooms.view(room, camera.name), empty, drawn + drawn[::-1])
        for camera, (empty, *drawn) in zip(room.cameras, draw_round_carpet(room, rooms, FRAMES))
    ]
    rospy.init_node("player", disable_signals=True)
    signal.signal(signal.SIGINT, lambda *_: rospy.signal_shutdown("ended"))
    poses = tf2_ros.StaticTransformBroadcaster()
    frame = lambda camera: f"{camera.name}_optical_frame"  # noqa: E731
    now = rospy.Time.now()
    poses.sendTransform(
        [
            messages.message_from_transform(view.pose, names.MAP_FRAME, frame(camera), now)
            for camera, view, *_ in cameras
        ]
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
        images[which].publish(message_from_image(picture, camera.encoding, stamp, frame(camera)))
        infos[which].publish(info_from_camera(view.model, stamp, frame(camera)))
        number += 1
    rospy.set_param("/player/sent", number // len(cameras))
    rospy.spin()  # its share of a core is still to be asked for


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
        file = TOP / "launch/parts/perception.launch"
        launch = roslaunch([file], folder / "roslaunch.txt", port, cameras=" ".join(cameras))
        stack.callback(launch.stop)
        if not wait_until(rosgraph.is_master_online, 60.0):
            print("the master did not come up", file=sys.stderr)
            return 1
        player = Child(
            [sys.executable, __file__, "--play", "--seconds", str(given.seconds), "--rate", str(given.rate)],
            folder / "player.txt",
        )
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
        detectors = [f"/spot_detector_{name}" for name in cameras]
        before, began = {node: cpu_seconds(node) for node in [*detectors, "/player"]}, time.monotonic()
        wait_until(lambda: rospy.has_param("/player/sent"), LEARN_S + given.seconds + 30.0, 0.5)
        took = time.monotonic() - began
        cores = {node: (cpu_seconds(node) - old) / took for node, old in before.items()}
        sent = rospy.get_param("/player/sent", 0)
        wait_until(lambda: False, 1.5)  # the last counts come
        result = {
            "rate_hz": given.rate,
            "cores_detectors": round(sum(cores[node] for node in detectors), 3),
            "cores_player": round(cores["/player"], 3),
            "load": os.getloadavg()[0],
            "cameras": {},
        }
        for name in cameras:
            searched = int(status[name].processed) if name in status else 0
            result["cameras"][name] = {"sent": sent, "searched": searched, **summary(delays[name])}
        result["all"] = summary([delay for values in delays.values() for delay in values])
    given.out.write_text(json.dumps(result, indent=2) + "\n")
    print(json.dumps(result, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
