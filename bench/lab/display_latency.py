#!/usr/bin/env python3
"""How soon the smart display shows what happens, in the simulated lab under its whole load.

    python3 bench/lab/display_latency.py [--projector]

Starts simulation.launch with RViz on a virtual screen, plays the participant itself (draws round the carpet, points
at it, says save), and writes out/bench/display_latency.json:

- from a spot's image stamp to its marker, as somebody else receives both, by camera and for all, and the part of it
  that is the display's own, from spot to marker: median, 95th percentile
- from `save` to the new map, to its stripes and to its label
- the share of a core that display_markers took meanwhile

Times of spots are simulated ones, which keep pace with the wall's unless the machine is too slow (real_time_factor).
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import sys
import threading
import time
import xmlrpc.client
from pathlib import Path

import numpy as np
import psutil
import rosgraph
import rospy
from geometry_msgs.msg import Point, Pose2D
from visualization_msgs.msg import MarkerArray

from vb_core import names
from vb_core.geometry import resample_chain
from vb_core.ros.messages import OccupancyGridArray
from vb_evaluation.observer import wait_until
from vb_evaluation.processes import free_port, roslaunch, start_screen
from vb_feedback.display_markers_node import RESTRICTED
from vb_msgs.msg import BorderPreview, DetectorStatus, LabState, LaserSpot, ParticipantState
from vb_msgs.srv import Command
from vb_sim.cameras.frame_clock import SmoothClock
from vb_sim.room.world import load_world

TOP = Path(__file__).resolve().parents[2]
SPEED = 0.4  # [m/s] of the spot, what a person draws with


class Observer:
    """Notes when spots, markers and maps come."""

    def __init__(self) -> None:
        self.clock = SmoothClock(rospy.get_time, time.monotonic)
        self.lock = threading.Lock()
        self.stamps = {}  # (camera, x, y) of a spot to its image's stamp and when it came
        self.spots, self.markers = {}, {}  # by camera: latencies [s] of spots and of markers
        self.own = []  # [s] from a spot to its marker: what the display itself adds
        self.maps, self.stripes, self.labels = [], [], []  # [s] steady time of each
        self.previews = []
        self.searched = {}  # by camera: images that its detector has searched
        self.factor = 0.0
        rospy.Subscriber(names.SPOTS, LaserSpot, self.on_spot, queue_size=100, tcp_nodelay=True)
        rospy.Subscriber(names.MARKERS, MarkerArray, self.on_markers, queue_size=100, tcp_nodelay=True)
        rospy.Subscriber(names.MAP_WITH_BORDERS, OccupancyGridArray, lambda _: self.maps.append(time.monotonic()))
        rospy.Subscriber(RESTRICTED, OccupancyGridArray, lambda _: self.stripes.append(time.monotonic()))
        rospy.Subscriber(names.PREVIEW, BorderPreview, self.previews.append)
        rospy.Subscriber(names.LAB_STATE, LabState, self.on_lab, queue_size=1)
        rospy.Subscriber(names.DETECTORS, DetectorStatus, self.on_detector, queue_size=10)

    def on_lab(self, message) -> None:
        self.factor = message.real_time_factor

    def on_detector(self, message) -> None:
        self.searched[message.camera] = message.processed

    def on_spot(self, message) -> None:
        with self.lock:
            now, stamp = self.clock.now(), message.header.stamp.to_sec()
            self.stamps[message.camera, message.position.x, message.position.y] = (stamp, now)
            self.spots.setdefault(message.camera, []).append(now - stamp)

    def on_markers(self, message) -> None:
        with self.lock:
            now = self.clock.now()
            for marker in message.markers:
                parts = marker.ns.split("/")
                if parts[0] == "spots" and len(parts) == 2 and marker.id == 1 and marker.action == 0:
                    key = (parts[1], marker.pose.position.x, marker.pose.position.y)
                    # each spot counts once, when its marker comes first
                    stamp, came = self.stamps.pop(key, (None, None))
                    if stamp is not None:
                        self.markers.setdefault(parts[1], []).append(now - stamp)
                        self.own.append(now - came)
                elif marker.ns == "borders/outline":
                    self.labels.append(time.monotonic())


def pid_of(node: str) -> int:
    """Returns the node's process; 0 while it is away."""
    try:
        return xmlrpc.client.ServerProxy(rosgraph.Master("/bench").lookupNode(node)).getPid("/bench")[2]
    except (OSError, rosgraph.MasterException):
        return 0


def cpu_seconds(node: str) -> float:
    """Returns the CPU time [s] that a node has taken."""
    return sum(psutil.Process(pid_of(node)).cpu_times()[:2])


def summary(values) -> dict:
    if not values:
        return {"count": 0}
    found = 1e3 * np.array(values)
    return {
        "count": len(found),
        "median_ms": round(float(np.median(found)), 1),
        "p95_ms": round(float(np.percentile(found, 95)), 1),
    }


def draw(observer: Observer, world) -> dict:
    """Plays the participant; gives the times of save."""
    scenario = world.scenarios["carpet"]
    hand = rospy.Publisher(names.PARTICIPANT, ParticipantState, queue_size=1)
    command = rospy.ServiceProxy(names.COMMAND, Command)

    def point(x, y, on=True) -> None:
        state = ParticipantState(
            laser_on=on,
            laser=Point(x, y, 0.0),
            laser_color="red",
            person_present=True,
            doing="draws",
            person=Pose2D(*scenario.stand, -2.0),
        )
        state.header.stamp, state.header.frame_id = rospy.Time.now(), names.MAP_FRAME
        hand.publish(state)

    def say(word: str):
        return command(command=word, source="bench")

    rospy.wait_for_service(names.COMMAND, 60.0)
    say("define_border")
    line = resample_chain(np.vstack([scenario.border, scenario.border[:1]]), 0.005)
    started = rospy.get_time()
    while not rospy.is_shutdown():
        place = int((rospy.get_time() - started) * SPEED / 0.005)
        if place >= len(line):
            break
        point(*line[place])
        time.sleep(0.02)
    say("define_seed")
    started = rospy.get_time()
    while rospy.get_time() - started < 2.5 and not rospy.is_shutdown():
        point(*scenario.seed)
        time.sleep(0.02)
    point(*scenario.seed, on=False)
    time.sleep(1.5)
    counts = [len(times) for times in (observer.maps, observer.stripes, observer.labels)]
    asked = time.monotonic()
    answer = say("save")
    answered = time.monotonic()
    wait_until(lambda: len(observer.maps) > counts[0] and len(observer.labels) > counts[2], 10.0)
    # the preview's stripes go and the border's come: the last ones of the next moment show the new map
    time.sleep(1.0)
    after = [
        [t for t in times[count:]] for times, count in zip((observer.maps, observer.stripes, observer.labels), counts)
    ]
    result = {"answer": answer.message, "success": answer.success, "to_answer_ms": round(1e3 * (answered - asked))}
    for name, times in zip(("map", "stripes", "label"), after):
        # of several the last one that belongs to it: earlier ones may still show the preview
        result[f"to_{name}_ms"] = round(1e3 * (max(t for t in times if t < asked + 1.0) - asked)) if times else None
    return result


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--projector", action="store_true", help="with the floor projector")
    parser.add_argument("--cameras", default="red green blue", help="ceiling cameras; fewer for a slower machine")
    parser.add_argument("--no-rviz", action="store_true", help="without RViz's load")
    parser.add_argument("--out", default=str(TOP / "out/bench/display_latency.json"))
    given = parser.parse_args()
    out = Path(given.out)
    folder = out.parent / "display_latency"
    folder.mkdir(parents=True, exist_ok=True)
    port = free_port()
    os.environ.update({"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_LOG_DIR": str(folder / "log")})
    os.environ.update({"LIBGL_ALWAYS_SOFTWARE": "1", "QT_X11_NO_MITSHM": "1"})
    world = load_world(str(TOP / "src/vb_sim/worlds/lab.yaml"))
    with contextlib.ExitStack() as stack:
        screen, os.environ["DISPLAY"] = start_screen(folder / "xvfb.txt", 1280, 720)
        stack.callback(screen.stop)
        arguments = {
            "state": folder / f"state_{port}",
            "page": False,
            "cameras": given.cameras,
            "rviz": not given.no_rviz,
        }
        if given.projector:
            arguments["projector"] = TOP / "src/vb_sim/config/lab_projector.yaml"
        launch = roslaunch([TOP / "launch/simulation.launch"], folder / "roslaunch.txt", port, **arguments)
        stack.callback(launch.stop)
        if not wait_until(rosgraph.is_master_online, 60.0):
            print("the master did not come up", file=sys.stderr)
            return 1
        rospy.init_node("display_latency", disable_signals=True)
        stack.callback(rospy.signal_shutdown, "measured")
        observer = Observer()
        cameras = [*given.cameras.split(), "robot"]
        # until detectors know their backgrounds
        if not wait_until(
            lambda: observer.maps and all(observer.searched.get(name, 0) > 100 for name in cameras), 120.0
        ):
            print(f"the lab did not come up:\n{launch.tail()}", file=sys.stderr)
            return 1
        before, started = cpu_seconds("/display_markers"), time.monotonic()
        saved = draw(observer, world)
        used = (cpu_seconds("/display_markers") - before) / (time.monotonic() - started)
        everything = [value for values in observer.markers.values() for value in values]
        result = {
            "projector": given.projector,
            "cameras": given.cameras,
            "rviz": not given.no_rviz,
            "real_time_factor": round(observer.factor, 3),
            "stamp_to_marker": summary(everything),
            "spot_to_marker": summary(observer.own),
            "stamp_to_marker_by_camera": {
                camera: summary(values) for camera, values in sorted(observer.markers.items())
            },
            "stamp_to_spot_by_camera": {camera: summary(values) for camera, values in sorted(observer.spots.items())},
            "save": saved,
            "display_markers_cores": round(used, 3),
            "previews": len(observer.previews),
            "load": os.getloadavg()[0],
        }
    out.write_text(json.dumps(result, indent=2) + "\n")
    print(json.dumps(result, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
