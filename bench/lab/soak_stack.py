"""The stack that lives through a soak test: real nodes, whose clock and cameras this program is; for soak.py."""

from __future__ import annotations

import collections
import os
import time
from pathlib import Path
from typing import Any, Callable, Dict, List

import numpy as np
import rosgraph
import rospy
import rosservice
from rosgraph_msgs.msg import Clock
from tf2_msgs.msg import TFMessage

from bench.frame import TOP
from vb_core import names
from vb_core.ros.messages import OccupancyGridArray, message_from_transform
from vb_evaluation.processes import Child, free_port, roslaunch
from vb_msgs.msg import BorderProgress, DetectorStatus, InteractionState, LaserSpot, NoticeArray, VirtualBorderArray

SPEED = 0.4  # [m/s] of the pointer, within what people do (0.2 to 0.7)
RATE = 12.5  # [1/s] spots of each camera
RESOLUTION = 0.05
CAMERAS = ("red", "green")
TIMEOUT = 40.0  # [s] of wall time for an answer on a busy machine; a killed node needs some seconds to come back
NOTICED_S = 5.0  # [s] of simulated time within which a fault must be told
NODES = ("interaction_manager", "border_fusion", "map_integrator", "camera_poses")

PARTS = TOP / "launch" / "parts"
MONITOR = """<launch><node pkg="vb_laser_detect" type="camera_poses" name="camera_poses" respawn="true" respawn_delay="1">
  <param name="cameras" value="{cameras}"/></node></launch>"""


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


class Stack:
    """The nodes over a roscore of their own, whose clock and cameras this is, and what they say."""

    def __init__(self, seed: int, folder: Path) -> None:
        self.rng, self.folder, self.port = np.random.default_rng(seed), folder, free_port()
        self.maps, self.floor = rooms(seed), "ground floor"
        self.ledger: Dict[str, Dict[str, Any]] = {name: {} for name in self.maps}
        self.counts: collections.Counter = collections.Counter()
        self.codes: collections.Counter = collections.Counter()
        self.faults: List[str] = []
        self.notice_delays: List[float] = []
        self.localized = True  # the robot is
        self.received, self.plugged = dict.fromkeys(CAMERAS, 0), dict.fromkeys(CAMERAS, True)
        self.now, self.lived = 1_000_000.0, 0.0
        self.newest: Dict[str, Any] = {}
        self.notices: Dict[str, Any] = {}
        self.children: List[Child] = []

    # ------------------------------------------------------------ starting and ending
    def start(self) -> None:
        """Starts roscore and the stack, then this program's own node."""
        os.environ["ROS_MASTER_URI"] = f"http://127.0.0.1:{self.port}"
        os.environ["ROS_LOG_DIR"] = str(self.folder / "log")
        self.children = [Child(["roscore", "-p", str(self.port)], self.folder / "core.txt")]
        self.wait(rosgraph.is_master_online, "the ROS master")
        rospy.set_param("/use_sim_time", True)
        self.up()
        rospy.init_node("soak", disable_signals=True)
        self._connect()

    def up(self) -> None:
        """Starts the stack."""
        path = self.folder / "monitor.launch"
        path.write_text(MONITOR.format(cameras=" ".join(CAMERAS)))
        files, log = [PARTS / "borders.launch", path], self.folder / f"stack_{self.lived:.0f}.txt"
        self.children.append(roslaunch(files, log, self.port, state=self.folder / "state", record=False))

    def down(self) -> None:
        """Ends the stack, as an evening does."""
        self.children.pop().stop(60.0)

    def close(self) -> None:
        """Ends everything that was started."""
        while self.children:
            self.down()

    def _connect(self) -> None:
        def keep(key: str) -> Callable[[Any], None]:
            return lambda message: self.newest.__setitem__(key, message)

        self.clock = rospy.Publisher("/clock", Clock, queue_size=1, latch=True)
        self.map = rospy.Publisher(names.PHYSICAL_MAP, OccupancyGridArray, queue_size=1, latch=True)
        self.spots = rospy.Publisher(names.SPOTS, LaserSpot, queue_size=2000)
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
            self.received[camera] += 25 if self.plugged[camera] else 0
            status = DetectorStatus(camera=camera, received=self.received[camera], rate_hz=25.0)
            status.header.stamp = stamp
            if self.plugged[camera]:
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
