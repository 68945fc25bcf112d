#!/usr/bin/env python3
"""Lives with the stack for simulated days: people draw, nodes die, cameras fail, clocks step, maps change, disks fill.

    make soak HOURS=24            # simulated hours, as fast as the machine goes
    bench/lab/soak.py --hours 2 --seed 7

Real nodes (point set, interaction, map integrator, lab monitor) run over a roscore of their own; this program is the
clock, the cameras, the people and the trouble. After each event it compares the stack with a ledger of what was
acknowledged, and the map with an oracle of its own (shapely). It writes out/bench/soak.json,
and the same as a page to read beside it.

As root it lives in namespaces of its own: the camera "green" is on a second computer whose cable is
pulled now and then, and the state folder is a small disk that fills up. Without root these two faults are
left out, and the result says so.

Exit status: 0 if every invariant held, 1 if one did not.
"""

from __future__ import annotations

import argparse
import collections
import json
import os
import platform
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import xmlrpc.client
from datetime import date
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional

import numpy as np
import rosgraph
import rospy
import rosservice
import shapely
from rosgraph_msgs.msg import Clock
from shapely.geometry import Polygon
from shapely.ops import unary_union
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from vb_core import geometry, names
from vb_core.grid_map import GridMap
from vb_core.ros.messages import OccupancyGridArray, message_from_grid, message_from_transform
from vb_evaluation.processes import spawn
from vb_evaluation.provenance import revision
from vb_msgs.msg import (
    BorderProgress,
    DetectorStatus,
    InteractionState,
    LaserSpot,
    NoticeArray,
    VirtualBorder,
    VirtualBorderArray,
)
from vb_msgs.srv import Command, ConfirmMap, ConfirmMapRequest, RemoveBorder

TOP = Path(__file__).resolve().parents[2]
SPEED = 0.4  # [m/s] of the pointer, within what people do (0.2 to 0.7)
RATE = 12.5  # [1/s] spots of each camera
RESOLUTION = 0.05
CAMERAS = ("red", "green")
TIMEOUT = 40.0  # [s] of wall time for an answer on a busy machine; a killed node needs some seconds to come back
NOTICED_S = 5.0  # [s] of simulated time within which a fault must be told
DISK_MIB = 48  # of the state folder, as root
HERE, THERE = "10.254.79.1", "10.254.79.2"  # the two computers' addresses; they exist within the namespaces only
REMOTE = "green"  # the camera on the second computer
NODES = ("interaction_manager", "border_fusion", "map_integrator", "lab_monitor")

LAUNCH = """<launch>
  <param name="/use_sim_time" value="true"/>
  <include file="{top}/launch/parts/borders.launch">
    <arg name="state" value="{state}"/>
    <arg name="robot_frame" value="base_link"/>
    <arg name="record" value="false"/>
  </include>
  <node pkg="vb_bringup" type="lab_monitor" name="lab_monitor" respawn="true" respawn_delay="1">
    <param name="cameras" value="{cameras}"/>
  </node>
</launch>
"""


class Broken(Exception):
    """An invariant that did not hold."""


def rooms(seed: int) -> Dict[str, np.ndarray]:
    """Makes two floors of a home, each an occupancy grid with walls and furniture, as map name to cells."""

    found = {}
    for number, name in enumerate(("ground floor", "upper floor")):
        rng = np.random.default_rng([seed, number])
        data = np.zeros((100, 160), np.int8)
        data[:2], data[-2:], data[:, :2], data[:, -2:] = 100, 100, 100, 100
        column = int(rng.integers(50, 110))
        data[:60, column : column + 2] = 100
        for _ in range(5):
            row, col = rng.integers(5, 90), rng.integers(5, 150)
            data[row : row + rng.integers(4, 10), col : col + rng.integers(4, 12)] = 100
        found[name] = data
    return found


class Soak:
    """One life of a lab."""

    def __init__(self, hours: float, seed: int, folder: Path, port: int, apart: bool) -> None:
        self.rng = np.random.default_rng(seed)
        self.folder, self.port = folder, port
        self.apart = apart
        self.remote: Optional[subprocess.Popen] = None
        self.localized = True
        self.lost_pose = {camera: 0 for camera in CAMERAS}
        self.hours = hours
        self.maps = rooms(seed)
        self.floor = "ground floor"
        self.ledger: Dict[str, Dict[str, Any]] = {name: {} for name in self.maps}
        self.counts: collections.Counter = collections.Counter()
        self.codes: collections.Counter = collections.Counter()
        self.faults: List[str] = []
        self.notice_delays: List[float] = []
        self.samples: List[Dict[str, Any]] = []
        self.received = {camera: 0 for camera in CAMERAS}
        self.plugged = {camera: True for camera in CAMERAS}
        self.launch: Optional[subprocess.Popen] = None
        self.core: Optional[subprocess.Popen] = None
        self.now = 1_000_000.0
        self.lived = 0.0

    # ------------------------------------------------------------ starting and ending
    def start(self) -> None:
        """Starts roscore and the stack, then this program's own node."""
        if self.apart:
            self._build_network()
        os.environ["ROS_MASTER_URI"] = f"http://{HERE if self.apart else '127.0.0.1'}:{self.port}"
        os.environ["ROS_LOG_DIR"] = str(self.folder / "log")
        self.core = spawn(
            ["roscore", "-p", str(self.port)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

        self.wait(rosgraph.is_master_online, "the ROS master")

        rospy.set_param("/use_sim_time", True)
        if self.remote is not None:
            self.remote.stdin.write("go\n")
            self.remote.stdin.flush()
        self.up()
        rospy.init_node("soak", disable_signals=True)
        self._connect()
        self.tell_map()
        self.settle()

    def _build_network(self) -> None:
        """A second computer with the camera `REMOTE`, a cable to it, and a small disk for the state folder."""
        (self.folder / "state").mkdir()
        self._system("mount", "-t", "tmpfs", "-o", f"size={DISK_MIB}m", "soak", str(self.folder / "state"))
        os.environ["ROS_IP"] = HERE
        environment = {
            **os.environ,
            "ROS_IP": THERE,
            "ROS_MASTER_URI": f"http://{HERE}:{self.port}",
            "ROS_LOG_DIR": str(self.folder / "log_there"),
        }
        self.remote = spawn(
            ["unshare", "--net", sys.executable, __file__, "--camera-host"],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=open(str(self.folder / "camera_host.txt"), "w"),
            stderr=subprocess.STDOUT,
            universal_newlines=True,
        )
        pid = self.remote.pid
        own = os.readlink("/proc/self/ns/net")
        self.wait(lambda: os.readlink(f"/proc/{pid}/ns/net") != own, "the second computer")
        self._system("ip", "link", "set", "lo", "up")
        self._system("ip", "link", "add", "cable", "type", "veth", "peer", "name", "cable", "netns", str(pid))
        self._system("ip", "address", "add", f"{HERE}/30", "dev", "cable")
        self._system("ip", "link", "set", "cable", "up")
        for words in (
            ("address", "add", f"{THERE}/30", "dev", "cable"),
            ("link", "set", "cable", "up"),
            ("link", "set", "lo", "up"),
        ):
            self._system("nsenter", "-t", str(pid), "-n", "ip", *words)

    @staticmethod
    def _system(*words: str) -> None:
        subprocess.run(words, check=True)

    def up(self) -> None:
        """Starts the stack."""
        path = self.folder / "soak.launch"
        path.write_text(LAUNCH.format(top=TOP, state=self.folder / "state", cameras=" ".join(CAMERAS)))
        with open(str(self.folder / "roslaunch.txt"), "a") as output:
            self.launch = spawn(
                ["roslaunch", "-p", str(self.port), str(path)],
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def down(self) -> None:
        """Ends the stack, as an evening does."""
        if self.launch is not None and self.launch.poll() is None:
            os.killpg(self.launch.pid, signal.SIGINT)
            self.launch.wait(timeout=60)

    def close(self) -> None:
        """Ends everything that was started."""
        self.down()
        if self.remote is not None:
            self.remote.kill()
            self.remote.wait(timeout=30)
        if self.core is not None:
            os.killpg(self.core.pid, signal.SIGINT)
            self.core.wait(timeout=30)

    def _connect(self) -> None:
        self.newest: Dict[str, Any] = {}

        def keep(key: str) -> Callable[[Any], None]:
            return lambda message: self.newest.__setitem__(key, message)

        self.clock = rospy.Publisher("/clock", Clock, queue_size=1, latch=True)
        self.map = rospy.Publisher(names.PHYSICAL_MAP, OccupancyGridArray, queue_size=1, latch=True)
        self.spots = rospy.Publisher(names.SPOTS, LaserSpot, queue_size=2000)
        self.far_spots = rospy.Publisher("/soak/far_spots", LaserSpot, queue_size=2000) if self.apart else self.spots
        self.far_plug = rospy.Publisher("/soak/far_plugged", Bool, queue_size=1, latch=True)
        self.tf = rospy.Publisher("/tf", TFMessage, queue_size=10)
        self.statuses = rospy.Publisher(names.DETECTORS, DetectorStatus, queue_size=10)
        for key, topic, kind in (
            ("state", names.STATE, InteractionState),
            ("progress", names.PROGRESS, BorderProgress),
            ("borders", names.BORDERS, VirtualBorderArray),
            ("posterior", names.MAP_WITH_BORDERS, OccupancyGridArray),
        ):
            rospy.Subscriber(topic, kind, keep(key), queue_size=5)
        rospy.Subscriber(names.NOTICES, NoticeArray, self._on_notices, queue_size=50)
        self.notices: Dict[str, Any] = {}

    def _on_notices(self, message: Any) -> None:
        self.notices[message.source] = {(notice.code, notice.camera) for notice in message.notices}

    # ------------------------------------------------------------ time
    def tick(self, seconds: float) -> None:
        """Lets simulated time go on; detectors report once a second."""
        before = int(self.now)
        self.now += seconds
        self.lived += max(seconds, 0.0)
        self.clock.publish(rospy.Time.from_sec(self.now))
        if int(self.now) != before:
            self.report()

    def report(self) -> None:
        """Publishes the detectors' reports, and where the robot is."""
        stamp = rospy.Time.from_sec(self.now)
        for camera in CAMERAS:
            if self.apart and camera == REMOTE:
                continue  # the second computer reports by itself
            self.received[camera] += 25 if self.plugged[camera] else 0
            status = DetectorStatus(
                camera=camera,
                received=self.received[camera],
                rate_hz=25.0 * self.plugged[camera],
                rejections=["no_transform"],
                rejection_counts=[self.lost_pose[camera]],
            )
            status.header.stamp = stamp
            self.statuses.publish(status)
        if self.localized:
            self.tf.publish(TFMessage([message_from_transform(np.eye(4), "map", "base_link", stamp)]))

    def idle(self, seconds: float) -> None:
        """Lets some time pass without any action."""
        end = self.now + seconds
        while self.now < end:
            self.tick(1.0)
            time.sleep(0.004)

    def wait(self, condition: Callable[[], Any], what: str, ticking: bool = False, limit: float = TIMEOUT) -> Any:
        """Waits, in wall time, for something that a node is to do."""
        deadline = time.monotonic() + limit
        while time.monotonic() < deadline:
            value = condition()
            if value:
                return value
            if ticking:
                self.tick(0.1)
            time.sleep(0.01)
        raise Broken(f"waited {limit:g} s in vain for: {what}")

    # ------------------------------------------------------------ what the stack says
    def heard(self, key: str, test: Callable[[Any], Any]) -> Any:
        """Returns what a test gives for a topic's newest message; None while there is none."""
        message = self.newest.get(key)
        return None if message is None else test(message)

    def settle(self) -> None:
        """Waits until every node is there and knows the time and the map."""
        for name in (names.COMMAND, names.GET_DRAWN_BORDER, names.ADD_BORDER, names.LIST_BORDERS):
            self.wait(lambda: self._answers(name), f"service {name}", ticking=True, limit=90.0)
        self.wait(
            lambda: self.spots.get_num_connections() > 0 and self.statuses.get_num_connections() > 0,
            "listeners",
            ticking=True,
        )
        self.wait(self._posterior_is_of_this_floor, "the map with borders", ticking=True)

    @staticmethod
    def _answers(service: str) -> bool:
        try:
            return rosservice.get_service_uri(service) is not None
        except rosservice.ROSServiceIOException:
            return False

    def _posterior_is_of_this_floor(self) -> bool:
        message = self.newest.get("posterior")
        if message is None:
            return False
        got, physical = np.asarray(message.data).reshape(100, 160), self.maps[self.floor]
        return bool((got[physical == 100] == 100).all())

    def call(self, service: str, kind: Any, **fields: Any) -> Any:
        """Calls a service; while its node comes back from the dead, again."""
        deadline = time.monotonic() + TIMEOUT
        while True:
            try:
                return rospy.ServiceProxy(service, kind)(**fields)
            except (rospy.ServiceException, rospy.ROSException, OSError) as error:
                if time.monotonic() > deadline:
                    raise Broken(f"{service} does not answer: {error}") from None
                self.tick(0.1)
                time.sleep(0.1)

    def command(self, word: str) -> Any:
        """Gives one command of a person and returns its answer."""
        answer = self.call(names.COMMAND, Command, command=word, source="soak")
        self.codes[f"{word}: {answer.code}"] += 1
        if not answer.success and not answer.code:
            raise Broken(f"{word} was refused without a code: {answer.message!r}")
        return answer

    # ------------------------------------------------------------ people
    def draw(self, points: np.ndarray) -> None:
        """Points the laser along (N, 2) [m]."""
        for point in points:
            for camera in CAMERAS:
                if not self.plugged[camera] or self.rng.random() < 0.2:
                    continue
                x, y = point + self.rng.normal(0.0, 0.01, 2)
                spot = LaserSpot(camera=camera, confidence=1.0, projection=LaserSpot.GROUND_PLANE)
                spot.header.frame_id = names.MAP_FRAME
                spot.header.stamp = rospy.Time.from_sec(self.now)
                spot.position.x, spot.position.y = float(x), float(y)
                (self.far_spots if camera == REMOTE else self.spots).publish(spot)
            self.tick(1.0 / RATE)
            time.sleep(0.002)

    def shape(self) -> Any:
        """Returns the corners of a rectangle somewhere on the floor, (4, 2) [m]."""
        center = self.rng.uniform([1.2, 1.0], [6.8, 4.0])
        half = self.rng.uniform(0.35, 0.8, 2)
        angle = self.rng.uniform(0, np.pi)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        return center + (np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half) @ turn.T

    def interaction(self, meanwhile: Optional[Callable[[], None]] = None) -> None:
        """Draws an area as a person; now and then somebody kills a node meanwhile, or the person gives up.

        Args:
            meanwhile: what happens in the middle of the border; left out: mostly nothing.
        """
        corners = self.shape()
        begun = self.command("define_border")
        if not begun.success:
            if self.disk_is_full:
                self.counts[f"disk full, define_border: {begun.code}"] += 1
                return
            raise Broken(f"define_border was refused: {begun.message} [{begun.code}]")
        identity = self.wait(
            lambda: self.heard("state", lambda state: state.interaction_id), "the interaction", ticking=True
        )
        self.wait(
            lambda: self.heard("progress", lambda progress: progress.interaction_id == identity),
            "the point set in Border",
            ticking=True,
        )
        path = geometry.resample_chain(np.vstack([corners, corners[:1]]), SPEED / RATE)
        trouble = meanwhile is None and self.rng.random() < 0.25
        half = len(path) // 2
        self.draw(path[:half])
        killed = str(self.rng.choice(NODES)) if trouble else ""
        if killed:
            self.kill(killed)
        if meanwhile is not None:
            meanwhile()
        self.draw(path[half:])
        if self.rng.random() < 0.1:
            self.command("cancel")
            self.counts["given up"] += 1
            return
        self.command("define_seed")
        self.draw(np.tile(corners.mean(axis=0), (25, 1)))
        self.wait(
            lambda: self.heard("progress", lambda progress: progress.has_seed or progress.code not in ("", "ok")),
            "the seed",
            ticking=True,
        )
        answer = self.command("save")
        for _ in range(3):
            # what the console tells a person to do then
            if answer.code not in ("no_response", "no_service"):
                break
            answer = self.command("save")
        if not answer.success:
            self.counts["disk full, save: " + answer.code if self.disk_is_full else "refused"] += 1
            self.command("cancel")
            return
        self.counts["saved"] += 1
        identity = self.wait(
            lambda: self.heard("state", lambda state: state.name == "default" and state.last_border_id),
            "the border's id",
            ticking=True,
        )
        border = self.wait(
            lambda: self.heard("borders", lambda array: next((b for b in array.borders if b.id == identity), None)),
            f"border {identity} among the borders",
            ticking=True,
        )
        if border.kind != VirtualBorder.POLYGON:
            if killed != "border_fusion" and meanwhile is None:
                raise Broken(f"border {identity} was drawn closed and is open, though no spot was lost")
            # spots were lost with their node or cable: the person sees on the display that the line was not closed
            if not self.call(names.UNDO, Trigger).success:
                raise Broken("the newest border cannot be taken back")
            self.counts["not closed, taken back"] += 1
            return
        self.ledger[self.floor][identity] = _points(border)

    def edit(self) -> None:
        """Removes a border, or takes back the newest change and makes it again."""
        known = self.ledger[self.floor]
        if not known:
            return
        if self.rng.random() < 0.5 or len(known) > 6:
            identity = str(self.rng.choice(sorted(known)))
            answer = self.call(names.REMOVE_BORDER, RemoveBorder, id=identity)
            if answer.success:
                self.removed = (identity, known.pop(identity))
                self.counts["removed"] += 1
                if len(known) < 10 and self.rng.random() < 0.5 and self.call(names.UNDO, Trigger).success:
                    known[self.removed[0]] = self.removed[1]
                    self.counts["undone"] += 1

    # ------------------------------------------------------------ trouble
    def kill(self, name: str) -> None:
        """Kills a node as a crash does."""
        try:
            uri = rosgraph.Master("/soak").lookupNode(f"/{name}")
            pid = xmlrpc.client.ServerProxy(uri).getPid("/soak")[2]
            os.kill(pid, signal.SIGKILL)
        except (rosgraph.MasterException, OSError, xmlrpc.client.Error):
            return  # it is just being restarted
        self.counts[f"killed {name}"] += 1
        self.wait(lambda: self._pid(name) not in (None, pid), f"{name} back from the dead", ticking=True)
        self.settle()

    @staticmethod
    def _pid(name: str) -> Optional[int]:
        try:
            uri = rosgraph.Master("/soak").lookupNode(f"/{name}")
            return xmlrpc.client.ServerProxy(uri).getPid("/soak")[2]
        except (rosgraph.MasterException, OSError, xmlrpc.client.Error):
            return None

    def unplug(self) -> None:
        """Unplugs a camera for a while: people must be told, and told again when it is back."""
        camera = str(self.rng.choice(CAMERAS))
        self.plug(camera, False)
        self.notice_delays.append(self._told(camera, "camera_silent"))
        self.plug(camera, True)
        self._taken_back(camera, "camera_silent")
        self.counts["unplugged"] += 1

    def plug(self, camera: str, plugged: bool) -> None:
        """Plugs a camera in or out."""
        self.plugged[camera] = plugged
        if camera == REMOTE:
            self.far_plug.publish(Bool(plugged))

    def _told(self, camera: str, code: str, pace: float = 0.01) -> float:
        """Waits until people are told of a fault; gives after how long [s] of simulated time.

        Args:
            pace: [s] of wall time for 0.1 s of simulated time.
        """
        began = self.now
        while (code, camera) not in self.notices.get("/lab_monitor", ()):
            self.tick(0.1)
            time.sleep(pace)
            if self.now - began > 3 * NOTICED_S:
                raise Broken(f"no notice {code} about camera {camera}")
        return self.now - began

    def _taken_back(self, camera: str, code: str, pace: float = 0.01, limit: float = 3 * NOTICED_S) -> None:
        """Waits until people are told that a fault is over."""
        began = self.now
        while (code, camera) in self.notices.get("/lab_monitor", ()):
            self.tick(0.1)
            time.sleep(pace)
            if self.now - began > limit:
                raise Broken(f"notice {code} about camera {camera} was not withdrawn")

    def lights(self) -> None:
        """Switches the lights while a person draws: for a second and a half both cameras see spots everywhere."""

        def flicker() -> None:
            for _ in range(6):
                self.draw(self.rng.uniform([0.3, 0.3], [7.7, 4.7], (3, 2)))

        before = self.counts["saved"]
        self.interaction(flicker)
        self.counts["lights: saved" if self.counts["saved"] > before else "lights: not saved"] += 1

    def lose_poses(self) -> None:
        """Transforms stop: the robot's, and one camera's. The next interaction must not wait for them."""
        camera = next(name for name in CAMERAS if name != REMOTE or not self.apart)
        self.localized = False
        self.kill("map_integrator")  # which now knows no place of the robot
        began = self.now
        while ("camera_no_pose", camera) not in self.notices.get("/lab_monitor", ()):
            self.lost_pose[camera] += 1
            self.tick(0.5)
            time.sleep(0.05)
            if self.now - began > 3 * NOTICED_S:
                raise Broken(f"no notice that camera {camera} has no pose")
        self.notice_delays.append(self.now - began)
        self._taken_back(camera, "camera_no_pose")
        self.interaction()
        self.localized = True
        self.counts["transforms lost"] += 1

    def cut_network(self) -> None:
        """Pulls the cable to the second computer while a person draws, for some seconds of wall time."""
        if not self.apart:
            return

        def pull() -> None:
            self._system("ip", "link", "set", "cable", "down")
            try:
                self.notice_delays.append(self._told(REMOTE, "detector_missing", pace=0.05))
                time.sleep(float(self.rng.uniform(0.5, 5.0)))
            finally:
                self._system("ip", "link", "set", "cable", "up")

        self.interaction(pull)
        # TCP sends again after as long as the cut took, twice at most
        self._taken_back(REMOTE, "detector_missing", pace=0.05, limit=120.0)
        self.counts["network cut"] += 1

    @property
    def disk_is_full(self) -> bool:
        """Whether this program has filled the disk."""
        return (self.folder / "state" / "filler").exists()

    def fill_disk(self) -> None:
        """Fills the disk: whatever is refused is refused with a code, and once there is room again all goes on."""
        if not self.apart:
            return
        filler = self.folder / "state" / "filler"
        with open(str(filler), "wb", buffering=0) as file:
            for size in (1 << 20, 1 << 12, 1):
                try:
                    while True:
                        file.write(b"\0" * size)
                except OSError:
                    continue
        try:
            self.interaction()
            if self.rng.random() < 0.5:
                self.kill(str(self.rng.choice(NODES)))
            self.edit()
            self.check()
        finally:
            filler.unlink()
        self.counts["disk full"] += 1
        before = self.counts["refused"]
        self.interaction()
        if self.counts["refused"] > before:
            raise Broken("a save was refused although there is room again")

    def step_clock(self) -> None:
        """Sets the clock, forwards or a little back."""
        jump = float(self.rng.choice([-5.0, -1.0, 30.0, 3600.0]))
        self.tick(jump)
        self.counts[f"clock {jump:+g} s"] += 1
        self.idle(3.0)

    def change_floor(self) -> None:
        """Moves the robot to the other floor; the borders of this one must be there when it comes back."""
        self.floor = next(name for name in self.maps if name != self.floor)
        self.newest.pop("posterior", None)
        self.tell_map()
        self.wait(self._posterior_is_of_this_floor, f"the map of the {self.floor}", ticking=True)
        self.counts["floor changed"] += 1
        if self.heard("borders", lambda array: array.needs_confirmation):
            # both floors have the same outer walls: until somebody says which one it is, the other's borders stay in
            # force
            self.call(
                names.CONFIRM_MAP, ConfirmMap, answer=ConfirmMapRequest.OTHER_PLACE, name=self.floor, source="soak"
            )
            self.counts["floor told"] += 1

    def tell_map(self) -> None:
        """Publishes the floor's map, as map_server does."""
        grid = GridMap(self.maps[self.floor], RESOLUTION, (0.0, 0.0, 0.0))
        self.map.publish(message_from_grid(grid, rospy.Time.from_sec(self.now)))

    def night(self) -> None:
        """Switches everything off and on again."""
        self.down()
        self.newest.clear()
        self.up()
        self.settle()
        self.counts["restarted"] += 1

    # ------------------------------------------------------------ invariants
    def check(self) -> None:
        """Checks that nothing acknowledged is lost or moved, and that the map is what the borders say."""
        wanted = self.ledger[self.floor]

        def same() -> bool:
            message = self.newest.get("borders")
            if message is None:
                return False
            found = {border.id: _points(border) for border in message.borders}
            return set(found) == set(wanted) and all(
                found[key].shape == wanted[key].shape and np.allclose(found[key], wanted[key], atol=1e-9)
                for key in wanted
            )

        try:
            self.wait(same, "the borders that were acknowledged", ticking=True, limit=15.0)
        except Broken:
            message = self.newest.get("borders")
            found = sorted(border.id for border in message.borders) if message is not None else None
            raise Broken(f"borders are {found}, acknowledged were {sorted(wanted)}") from None
        sure_inside, sure_outside = self._oracle(list(wanted.values()))
        self.wait(
            lambda: self._map_agrees(sure_inside, sure_outside),
            "a map that agrees with the oracle",
            ticking=True,
            limit=15.0,
        )
        self.counts["checked"] += 1

    def _oracle(self, polygons: List[Any]) -> Any:
        """(rows, columns) cells that are surely inside some polygon, and surely outside all; the edge may go either way."""
        rows, columns = np.mgrid[:100, :160]
        centers = shapely.points((columns.ravel() + 0.5) * RESOLUTION, (rows.ravel() + 0.5) * RESOLUTION)
        area = unary_union([Polygon(points).buffer(0) for points in polygons])
        inside = shapely.contains(area.buffer(-1.5 * RESOLUTION), centers).reshape(100, 160)
        outside = ~shapely.intersects(area.buffer(1.5 * RESOLUTION), centers).reshape(100, 160)
        return inside, outside

    def _map_agrees(self, inside: Any, outside: Any) -> bool:
        message = self.newest.get("posterior")
        if message is None:
            return False
        got, physical = np.asarray(message.data).reshape(100, 160), self.maps[self.floor]
        # floor that lies inside of a border but cannot be reached from its seed may stay as it was
        free = physical == 0
        restricted_share = (got[inside & free] == 100).mean() if (inside & free).any() else 1.0
        return bool(
            (got[outside] == physical[outside]).all()
            and (got[~free] == physical[~free]).all()
            and restricted_share > 0.5
        )

    def sample(self) -> None:
        """Measures the memory of each node and the size of the state folder."""
        memory = {}
        for name in NODES:
            pid = self._pid(name)
            try:
                status = Path(f"/proc/{pid}/status").read_text()
                memory[name] = int(status.split("VmRSS:")[1].split()[0]) / 1024
            except (OSError, IndexError):
                continue
        size = sum(path.stat().st_size for path in (self.folder / "state").rglob("*") if path.is_file())
        self.samples.append(
            {
                "hour": self.lived / 3600,
                "memory_mib": memory,
                "state_kib": size / 1024,
                "restarts": self.counts["restarted"],
                "interactions": self.counts["saved"],
            }
        )

    # ------------------------------------------------------------ life
    def live(self) -> None:
        """Hours of events, each followed by a look at all invariants."""
        events = [
            (self.interaction, 0.45),
            (self.edit, 0.12),
            (self.unplug, 0.07),
            (self.step_clock, 0.06),
            (self.change_floor, 0.08),
            (lambda: self.kill(str(self.rng.choice(NODES))), 0.08),
            (self.lights, 0.04),
            (self.lose_poses, 0.03),
            (self.cut_network, 0.04),
            (self.fill_disk, 0.03),
        ]
        weights = [weight for _, weight in events]
        assert abs(sum(weights) - 1.0) < 1e-9
        nights, sampled = 0, -1.0
        # each once, so that no life goes by without a rare fault; then as chance has it
        first = [events[int(number)][0] for number in self.rng.permutation(len(events))]
        while self.lived < 3600.0 * self.hours:
            event = first.pop() if first else events[int(self.rng.choice(len(events), p=weights))][0]
            try:
                event()
                self.check()
            except Broken as error:
                self.faults.append(f"hour {self.lived / 3600:.2f}, {getattr(event, '__name__', 'kill')}: {error}")
                print(self.faults[-1], flush=True)
                self.recover()
            if self.lived / 3600 - sampled >= 0.5:
                self.sample()
                sampled = self.lived / 3600
            if self.lived // 86400 > nights:
                nights += 1
                self.night()
                self.check()
            # a household of some dozen interactions a day
            self.idle(float(self.rng.exponential(600.0)))

    def recover(self) -> None:
        """Starts from what the stack has now, after a broken invariant, so that one fault counts once."""
        (self.folder / "state" / "filler").unlink(missing_ok=True)
        self.localized = True
        for camera in CAMERAS:
            self.plug(camera, True)
        self.command("cancel")
        self.idle(5.0)
        message = self.newest.get("borders")
        if message is not None:
            self.ledger[self.floor] = {border.id: _points(border) for border in message.borders}

    def result(self, seconds: float) -> Dict[str, Any]:
        """Returns what was measured."""
        slopes = {}
        for name in NODES:
            rows = [(s["hour"], s["memory_mib"][name]) for s in self.samples if name in s["memory_mib"]]
            rows = rows[len(rows) // 3 :]
            if len(rows) > 3:
                slopes[name] = round(float(np.polyfit(*zip(*rows), 1)[0]), 3)
        rows = [(sample["hour"], sample["state_kib"]) for sample in self.samples][len(self.samples) // 3 :]
        growth = round(float(np.polyfit(*zip(*rows), 1)[0]), 2) if len(rows) > 3 else None
        return {
            "two computers and a small disk": self.apart,
            "hours": round(self.lived / 3600, 2),
            "wall_s": round(seconds),
            "machine": platform.processor() or platform.machine(),
            "faults": self.faults,
            "events": dict(self.counts),
            "answers": dict(self.codes),
            "camera_notice_s": {
                "n": len(self.notice_delays),
                "largest": round(max(self.notice_delays, default=0.0), 1),
            },
            "memory_slope_mib_per_hour": slopes,
            "state_slope_kib_per_hour": growth,
            "state_kib": [round(sample["state_kib"]) for sample in self.samples[:: max(1, len(self.samples) // 12)]],
            "last_sample": self.samples[-1] if self.samples else None,
        }


def page(result: Dict[str, Any]) -> str:
    """Writes the result as Markdown."""

    def table(counts: Dict[str, Any], first: str, second: str) -> List[str]:
        return [
            "",
            f"| {first} | {second} |",
            "|---|---|",
            *(f"| {key} | {value} |" for key, value in sorted(counts.items())),
        ]

    lines = [
        f"# A simulated life of {result['hours']:g} hours",
        "",
        f"`{result['command']}`, {date.today()}, revision {revision()}; {result['wall_s'] / 60:.0f} minutes of wall time; two "
        f"computers and a small disk: {'yes' if result['two computers and a small disk'] else 'no'}.",
        "",
        f"Invariants that did not hold: {len(result['faults'])}.",
        *(f"- {fault}" for fault in result["faults"]),
        "",
        f"A fault was told after {result['camera_notice_s']['largest']} s at most (n = {result['camera_notice_s']['n']}; 5 s are "
        f"wanted). The state folder grows by {result['state_slope_kib_per_hour']} KiB per hour.",
        *table(result["memory_slope_mib_per_hour"], "node", "memory, MiB per hour"),
        *table(result["events"], "event", "how often"),
        *table(result["answers"], "command: answer", "how often"),
    ]
    return "\n".join(lines) + "\n"


def _points(border: Any) -> Any:
    return np.array([(point.x, point.y) for point in border.points])


def camera_host() -> int:
    """Runs the second computer: a camera whose spots and reports come from there."""
    if sys.stdin.readline() != "go\n":
        return 1

    rospy.init_node("camera_host", disable_signals=True)
    spots = rospy.Publisher(names.SPOTS, LaserSpot, queue_size=2000)
    statuses = rospy.Publisher(names.DETECTORS, DetectorStatus, queue_size=10)
    known = {"second": 0, "received": 0, "plugged": True}

    def report(message: Clock) -> None:
        if message.clock.secs == known["second"]:
            return
        known["second"] = message.clock.secs
        known["received"] += 25 if known["plugged"] else 0
        status = DetectorStatus(camera=REMOTE, received=known["received"], rate_hz=25.0 * known["plugged"])
        status.header.stamp = message.clock
        statuses.publish(status)

    rospy.Subscriber("/soak/far_spots", LaserSpot, spots.publish, queue_size=2000)
    rospy.Subscriber("/soak/far_plugged", Bool, lambda message: known.update(plugged=message.data), queue_size=1)
    rospy.Subscriber("/clock", Clock, report, queue_size=100)
    rospy.spin()
    return 0


def live_apart() -> bool:
    """Returns whether this process has namespaces of its own; as root it starts itself again within such."""
    if os.environ.get("SOAK_APART") == "1":
        return True
    if os.getuid() != 0 or any(shutil.which(tool) is None for tool in ("unshare", "ip", "mount", "nsenter")):
        return False
    words = ["unshare", "--net", "--mount"]
    if subprocess.run([*words, "true"], stderr=subprocess.DEVNULL).returncode:
        return False  # a container without the right to
    os.environ["SOAK_APART"] = "1"
    os.execvp(words[0], [*words, sys.executable, *sys.argv])
    return True


def main() -> int:
    """Runs the soak and writes its result."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=24.0, help="simulated")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--port", type=int, default=11399, help="of its own ROS master")
    parser.add_argument("--out", type=Path, default=TOP / "out" / "bench" / "soak.json")
    parser.add_argument("--camera-host", action="store_true", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.camera_host:
        return camera_host()
    apart = live_apart()
    folder = Path(tempfile.mkdtemp(prefix="soak_"))
    soak = Soak(chosen.hours, chosen.seed, folder, chosen.port, apart)
    began = time.monotonic()
    # also where a shell that starts it in the background has them ignored; a life that is ended
    # early counts as far as it went
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        soak.start()
        soak.live()
    except KeyboardInterrupt:
        pass
    finally:
        soak.close()
    result = {
        **soak.result(time.monotonic() - began),
        "command": f"bench/lab/soak.py --hours {chosen.hours:g} --seed {chosen.seed}",
    }
    chosen.out.parent.mkdir(parents=True, exist_ok=True)
    chosen.out.write_text(json.dumps(result, indent=1))
    chosen.out.with_suffix(".md").write_text(page(result))
    print(json.dumps(result, indent=1))
    if result["faults"]:
        print(f"the logs are in {folder}")
        return 1
    shutil.rmtree(str(folder), ignore_errors=True)
    return 0


if __name__ == "__main__":
    status = main()
    sys.stdout.flush()
    # rospy would say goodbye to the second computer, which is gone together with its cable, and wait for an answer for
    # ever
    os._exit(status)
