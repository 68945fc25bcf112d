#!/usr/bin/env python3
"""How many cameras a lab can have: spots per second, latency and processor shares for 1 to 24 cameras on 1 to 4 hosts.

    sudo python3 bench/lab/scale.py --cameras 1 3 6 12 24 --hosts 1 2 4       # adds to docs/results/lab/scale.csv
    python3 bench/lab/scale.py --plot                                         # the table's picture, and the model

1080p Bayer images at 25 per second, rendered beforehand, are played to the real spot detectors; hosts are network
namespaces on a switch, each with its cameras' player and detectors, and share this computer's cores. So the table shows
what the network costs and where the cores end, not what more computers would bring; the model says that.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Dict, Iterator, List

import psutil

from vb_evaluation.processes import Child

TOP = Path(__file__).resolve().parents[2]
TABLE = TOP / "docs" / "results" / "lab" / "scale.csv"
PICTURE = TOP / "docs" / "images" / "lab_scale.png"
RATE = 25.0  # [1/s] images of each camera
FRAMES = 25  # of each view, played back and forth
LEARN_S = 4.0  # without a laser before, for the background
WARM_S = 3.0  # of drawing before anything is counted
PORT = 12871
FIELDS = (
    "cameras hosts cores searched_share spots_per_s latency_ms latency_p95_ms detector_core_share "
    "detector_ms_per_image fusion_core_share player_core_share others_core_share cable_kB_per_s revision"
).split()


def address(host: int) -> str:
    """Returns the address of a host; host 0 has the ROS master."""
    return f"10.254.80.{host + 1}"


# ---------------------------------------------------------------------- images
def render(path: Path) -> None:
    """Writes FRAMES images of each of the lab's cameras, with a laser and two people, and each camera's empty view first."""
    import numpy as np
    from hard_scenes import Rooms, draw_round_carpet, lab

    from vb_sim.room.camera_models import CameraModels

    np.save(str(path), np.array(draw_round_carpet(lab(), Rooms(CameraModels(), 1), FRAMES)))


def play(cameras: List[str], path: Path) -> None:
    """Sends the images of some cameras, evenly spread over the time between two frames, until it is ended."""
    import numpy as np
    import rospy
    import tf2_ros
    from hard_scenes import Rooms, lab
    from sensor_msgs.msg import CameraInfo, Image

    from vb_core import names
    from vb_core.ros import cameras as conversions
    from vb_core.ros import images, messages
    from vb_sim.room.camera_models import CameraModels

    room, rooms = lab(), Rooms(CameraModels(), 1)
    views = [rooms.view(room, camera.name) for camera in room.cameras]
    pictures = np.load(str(path), mmap_mode="r")
    rospy.init_node("player_" + cameras[0], disable_signals=True)
    signal.signal(signal.SIGTERM, lambda *_: rospy.signal_shutdown("ended"))
    now = rospy.Time.now()
    which = [(int(name[1:]) + 1) % len(views) for name in cameras]
    poses = tf2_ros.StaticTransformBroadcaster()
    poses.sendTransform(
        [
            messages.message_from_transform(views[view].pose, names.MAP_FRAME, f"{name}_optical_frame", now)
            for name, view in zip(cameras, which)
        ]
    )
    sent = [rospy.Publisher(f"/{name}/image_raw", Image, queue_size=1) for name in cameras]
    infos = [rospy.Publisher(f"/{name}/camera_info", CameraInfo, queue_size=1) for name in cameras]
    order = [*range(1, FRAMES + 1), *range(FRAMES, 0, -1)]
    while not rospy.is_shutdown() and not rospy.get_param("/go", False):
        rospy.rostime.wallsleep(0.1)
    began, number = time.monotonic(), 0
    while not rospy.is_shutdown():
        turn, camera = divmod(number, len(cameras))
        due = began + turn / RATE + camera / RATE / len(cameras)
        behind = time.monotonic() - due
        if behind < 0.0:
            rospy.rostime.wallsleep(-behind)
        number += 1
        if behind > 1.0 / RATE:
            continue  # a camera does not send later what it could not send in time
        frame = 0 if turn / RATE < LEARN_S else order[turn % len(order)]
        stamp, frame_id = rospy.Time.now(), f"{cameras[camera]}_optical_frame"
        encoding = room.cameras[which[camera]].encoding
        sent[camera].publish(images.message_from_image(pictures[which[camera], frame], encoding, stamp, frame_id))
        infos[camera].publish(conversions.info_from_camera(views[which[camera]].model, stamp, frame_id))


# ---------------------------------------------------------------------- measuring
def used(processes: List[int]) -> float:
    """Returns the processor time [s] that some processes have taken so far."""
    return sum(sum(psutil.Process(process).cpu_times()[:2]) for process in processes)


def busy() -> float:
    """Returns the processor time [s] that all processes of the computer have taken so far."""
    times = psutil.cpu_times()
    return sum(times) - times.idle - times.iowait


def called(word: str, space: str) -> List[int]:
    """Finds the processes of this namespace of mounts, so of this run, whose command line holds a word."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if word in (folder / "cmdline").read_text() and os.readlink(str(folder / "ns" / "mnt")) == space:
                found.append(int(folder.name))
        except OSError:
            continue
    return found


def lay_cable(host: int, keeper: int) -> None:
    """Connects the namespace of a process, which is another host, to the switch."""
    within = ["nsenter", "-t", str(keeper), "-n"]
    for words in (
        ["ip", "link", "add", f"port{host}", "type", "veth", "peer", "name", "cable", "netns", str(keeper)],
        ["ip", "link", "set", f"port{host}", "master", "switch", "up"],
        [*within, "ip", "address", "add", f"{address(host)}/24", "dev", "cable"],
        [*within, "ip", "link", "set", "cable", "up"],
        [*within, "ip", "link", "set", "lo", "up"],
    ):
        subprocess.run(words, check=True)


@contextlib.contextmanager
def lab_of(cameras: List[str], hosts: int, images: Path, folder: Path) -> Iterator[None]:
    """Runs a master, the fusion, and on each host the players and detectors of its share of the cameras."""
    import rosgraph
    import rospy

    children: List[Child] = []
    spaces = [0]

    def start(host: int, *words: str) -> Child:
        environment = {**os.environ, "ROS_IP": address(host)}
        prefix = ["nsenter", "-t", str(spaces[host]), "-n"] if host else []
        log = folder / f"log_{len(cameras)}_{hosts}_{len(children)}.txt"
        children.append(Child([*prefix, *words], log, environment))
        return children[-1]

    try:
        for host in range(1, hosts):
            keeper = start(0, "unshare", "--net", "sleep", "1000")
            while os.readlink(f"/proc/{keeper.pid}/ns/net") == os.readlink("/proc/self/ns/net"):
                time.sleep(0.02)
            spaces.append(keeper.pid)
            lay_cable(host, keeper.pid)
        start(0, "roscore", "-p", str(PORT))
        while not rosgraph.is_master_online():
            time.sleep(0.1)
        rospy.set_param("/go", False)
        rospy.set_param("/border_fusion/spot_log_file", str(folder / "fusion.jsonl"))
        start(0, "rosrun", "vb_fusion", "border_fusion")
        for host in range(hosts):
            own = cameras[host::hosts]
            if own:
                start(host, sys.executable, __file__, "--play", str(images), "--cameras", *[name[1:] for name in own])
                config = f"config:={TOP}/src/vb_laser_detect/config/stationary.yaml"
                file = str(TOP / "launch/parts/detectors.launch")
                start(host, "roslaunch", file, f"cameras:={' '.join(own)}", config, "image_transport:=raw")
        yield
    finally:
        for child in reversed(children):  # the networks last
            child.stop(30.0)


def measure(count: int, hosts: int, seconds: float, images: Path, folder: Path) -> Dict[str, Any]:
    """Measures one row of the table."""
    import numpy as np
    import rospy

    from vb_core import names
    from vb_msgs.msg import DetectorStatus, LaserSpot

    cameras = [f"c{number}" for number in range(count)]
    space = os.readlink("/proc/self/ns/mnt")
    delays: List[float] = []
    statuses: Dict[str, Any] = {}

    def on_spot(message: LaserSpot) -> None:
        delays.append(time.time() - message.header.stamp.to_sec())

    with lab_of(cameras, hosts, images, folder):
        if not rospy.core.is_initialized():
            rospy.init_node("lab_scale", disable_signals=True)
        rospy.Subscriber(names.SPOTS, LaserSpot, on_spot, queue_size=1000)
        rospy.Subscriber(names.DETECTORS, DetectorStatus, lambda m: statuses.update({m.camera: m}), queue_size=100)
        deadline = time.monotonic() + 120.0
        while len(statuses) < count:
            if time.monotonic() > deadline:
                raise RuntimeError(f"only {len(statuses)} of {count} detectors came up; see {folder}")
            time.sleep(0.1)
        rospy.set_param("/go", True)
        time.sleep(LEARN_S + WARM_S)
        groups = {word: called(word, space) for word in ("__name:=spot_detector_", "border_fusion", "--play")}
        before, began = {word: used(processes) for word, processes in groups.items()}, time.monotonic()
        before_all = busy()
        searched, sent = {name: statuses[name].processed for name in cameras}, cable()
        del delays[:]
        time.sleep(seconds)
        lasted = time.monotonic() - began
        shares = {word: (used(processes) - before[word]) / lasted for word, processes in groups.items()}
        everybody = (busy() - before_all) / lasted
        found = np.array(delays) * 1e3
        images_searched = sum(statuses[name].processed - searched[name] for name in cameras)
        detectors = shares["__name:=spot_detector_"]
        return {
            "cameras": count,
            "hosts": hosts,
            "cores": os.cpu_count(),
            "searched_share": round(images_searched / (RATE * count * lasted), 3),
            "spots_per_s": round(len(found) / lasted, 1),
            "latency_ms": round(float(np.median(found)), 1) if len(found) else None,
            "latency_p95_ms": round(float(np.percentile(found, 95)), 1) if len(found) else None,
            "detector_core_share": round(detectors / count, 3),
            "detector_ms_per_image": round(1e3 * detectors * lasted / max(images_searched, 1), 2),
            "others_core_share": round(everybody - sum(shares.values()), 2),
            "fusion_core_share": round(shares["border_fusion"], 3),
            "player_core_share": round(shares["--play"] / count, 3),
            "cable_kB_per_s": round((cable() - sent) / lasted / 1e3, 1) if hosts > 1 else 0.0,
        }


def cable() -> int:
    """Bytes that have passed the switch's ports to the other hosts."""
    # not /sys/class/net, which shows the namespace that it was mounted in
    ports = [
        line.split(":") for line in Path("/proc/net/dev").read_text().splitlines() if line.lstrip().startswith("port")
    ]
    return sum(int(counts.split()[column]) for _, counts in ports for column in (0, 8))


def live_apart() -> bool:
    """Starts this program again in namespaces of its own; False without the right to."""
    if os.environ.get("SCALE_APART") == "1":
        return True
    words = ["unshare", "--net", "--mount"]
    if os.getuid() or subprocess.run([*words, "true"], stderr=subprocess.DEVNULL).returncode:
        return False
    os.environ["SCALE_APART"] = "1"
    os.execvp(words[0], [*words, sys.executable, *sys.argv])
    return True


# ---------------------------------------------------------------------- table, picture, model
def read_table() -> List[Dict[str, Any]]:
    """Reads the table: figures, and the revision at which each row was measured."""
    with open(str(TABLE)) as stream:
        rows = csv.DictReader(line for line in stream if not line.startswith("#"))
        return [{key: _value(key, text) for key, text in row.items()} for row in rows]


def _value(key: str, text: str) -> Any:
    if key == "revision":
        return text
    value = float(text or "nan")
    return int(value) if value.is_integer() else value


def add_rows(rows: List[Dict[str, Any]]) -> None:
    """Adds rows to the table; a row of the same cameras and hosts is replaced."""
    from vb_evaluation.provenance import revision

    made_by = revision()
    table = {(row["cameras"], row["hosts"]): row for row in read_table()} if TABLE.exists() else {}
    table.update({(row["cameras"], row["hosts"]): {**row, "revision": made_by} for row in rows})
    with open(str(TABLE), "w", newline="") as stream:
        stream.write("# python3 bench/lab/scale.py --cameras ... --hosts ...; each row with its own revision\n")
        writer = csv.DictWriter(stream, FIELDS, extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        writer.writerows(sorted(table.values(), key=lambda row: (row["hosts"], row["cameras"])))


def model(rows: List[Dict[str, float]]) -> Dict[str, float]:
    """Measures what an image and what the fusion of a spot cost: processor time, which others' load changes little."""
    import numpy as np

    good = [row for row in rows if row["spots_per_s"] > 0]
    fusion = np.polyfit([row["spots_per_s"] for row in good], [row["fusion_core_share"] for row in good], 1)
    return {
        "detector": float(np.median([row["detector_ms_per_image"] for row in good])) * RATE / 1e3,
        "fusion_fixed": float(fusion[1]),
        "fusion_per_spot": float(fusion[0]),
        "kB_per_spot": float(
            np.median(
                [
                    row["cable_kB_per_s"] / row["spots_per_s"] / (1 - 1 / row["hosts"])
                    for row in good
                    if row["hosts"] > 1
                ]
                or [float("nan")]
            )
        ),
        # as if every image were searched
        "spots_per_camera": float(
            np.median([row["spots_per_s"] / row["cameras"] / row["searched_share"] for row in good])
        ),
    }


def plot() -> None:
    """Draws the table, and what the model says of 50 cameras."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    rows = read_table()
    figure, axes = pyplot.subplots(1, 3, figsize=(11, 3.4), constrained_layout=True)
    for hosts in sorted({row["hosts"] for row in rows}):
        own = [row for row in rows if row["hosts"] == hosts]
        cameras = [row["cameras"] for row in own]
        label = f"{hosts:g} host{'s' if hosts > 1 else ''}"
        axes[0].plot(cameras, [row["spots_per_s"] for row in own], "o-", label=label)
        axes[1].plot(cameras, [row["latency_p95_ms"] for row in own], "o-", label=label)
        axes[2].plot(cameras, [row["searched_share"] for row in own], "o-", label=label)
    axes[1].set_yscale("log")
    for axis, name in zip(axes, ("spots per second", "latency, 95 % [ms]", "share of the images that is searched")):
        axis.set_xlabel("cameras")
        axis.set_title(name, fontsize=10)
        axis.grid(alpha=0.3)
    axes[0].legend(frameon=False)
    figure.savefig(str(PICTURE), dpi=110)
    print(PICTURE)
    found = model(rows)
    print({key: round(value, 4) for key, value in found.items()})
    spots = 50 * found["spots_per_camera"]
    print(
        f"50 cameras, if every one sees the spot: detectors {50 * found['detector']:.1f} cores on the cameras' computers, fusion"
        f" {found['fusion_fixed'] + found['fusion_per_spot'] * spots:.2f} of one, network {spots * found['kB_per_spot']:.0f} kB/s"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cameras", type=int, nargs="+", default=[1, 3, 6, 12, 24])
    parser.add_argument("--hosts", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--seconds", type=float, default=15.0, help="of drawing that are measured")
    parser.add_argument("--images", type=Path, default=Path(tempfile.gettempdir()) / "lab_scale_images.npy")
    parser.add_argument("--plot", action="store_true")
    parser.add_argument("--play", type=Path, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.play:
        play([f"c{number}" for number in chosen.cameras], chosen.play)
        return 0
    if chosen.plot:
        plot()
        return 0
    if not chosen.images.exists():
        render(chosen.images)
    apart = live_apart()
    if not apart:
        if max(chosen.hosts) > 1:
            print("lab_scale: several hosts need root and the right to make network namespaces", file=sys.stderr)
            return 2
    else:
        for words in (
            ("link", "set", "lo", "up"),
            ("link", "add", "switch", "type", "bridge"),
            ("address", "add", f"{address(0)}/24", "dev", "switch"),
            ("link", "set", "switch", "up"),
        ):
            subprocess.run(["ip", *words], check=True)
    # a shell that starts it in the background has interrupts ignored, and the nodes would ignore them too
    signal.signal(signal.SIGINT, signal.default_int_handler)
    folder = Path(tempfile.mkdtemp(prefix="lab_scale_"))
    here = address(0) if apart else "127.0.0.1"
    os.environ.update({"ROS_MASTER_URI": f"http://{here}:{PORT}", "ROS_IP": here, "ROS_LOG_DIR": str(folder)})
    for hosts in chosen.hosts:
        for count in chosen.cameras:
            if hosts > count:
                continue
            # in a process of its own each: a node cannot be started twice in one
            child = os.fork()
            if not child:
                status = 1
                try:
                    row = measure(count, hosts, chosen.seconds, chosen.images, folder)
                    print(row, flush=True)
                    add_rows([row])
                    status = 0
                finally:
                    os._exit(status)
            if os.waitpid(child, 0)[1]:
                print(f"{count} cameras on {hosts} hosts: failed, see {folder}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
