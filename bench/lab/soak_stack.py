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
from vb_core.grid_map import GridMap
from vb_core.ros.messages import OccupancyGridArray, message_from_grid, message_from_transform
from vb_evaluation.processes import Child, free_port, roslaunch
from vb_msgs.msg import BorderProgress, InteractionState, LaserSpot, VirtualBorderArray
from vb_msgs.srv import Command

SPEED = 0.4  # [m/s] of the pointer, within what people do (0.2 to 0.7)
RATE = 12.5  # [1/s] spots of each camera
RESOLUTION = 0.05
CAMERAS = ("red", "green")
TIMEOUT = 40.0  # [s] of wall time for an answer on a busy machine; a killed node needs some seconds to come back
NODES = ("interaction_manager", "border_fusion", "map_integrator")


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
        self.now, self.lived, self.clock = 1_000_000.0, 0.0, None
        self.newest: Dict[str, Any] = {}
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
        files, log = [TOP / "launch/parts/borders.launch"], self.folder / f"stack_{self.lived:.0f}.txt"
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
        for key, topic, kind in (
            ("state", names.STATE, InteractionState),
            ("progress", names.PROGRESS, BorderProgress),
            ("borders", names.BORDERS, VirtualBorderArray),
            ("posterior", names.MAP_WITH_BORDERS, OccupancyGridArray),
        ):
            rospy.Subscriber(topic, kind, keep(key), queue_size=5)

    # ------------------------------------------------------------ time
    def tick(self, seconds: float) -> None:
        """Lets simulated time go on; once a second, it says where the robot is."""
        before = int(self.now)
        self.now += seconds
        self.lived += max(seconds, 0.0)
        self.clock.publish(rospy.Time.from_sec(self.now))
        if int(self.now) != before:
            stamp = rospy.Time.from_sec(self.now)
            self.tf.publish(TFMessage([message_from_transform(np.eye(4), "map", "base_link", stamp)]))

    def idle(self, seconds: float) -> None:
        """Lets some time pass without any action."""
        end = self.now + seconds
        while self.now < end:
            self.tick(1.0)
            time.sleep(0.004)

    def wait(self, condition: Callable[[], Any], what: str, limit: float = TIMEOUT) -> Any:
        """Waits, in wall time, for something that a node is to do; simulated time goes on."""
        deadline = time.monotonic() + limit
        while time.monotonic() < deadline:
            value = condition()
            if value:
                return value
            if self.clock is not None:
                self.tick(0.1)
            time.sleep(0.01)
        raise Broken(f"hour {self.lived / 3600:.2f}: waited {limit:g} s in vain for: {what}")

    # ------------------------------------------------------------ what it is asked
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
        self.counts[f"{word}: {answer.code}"] += 1
        if not answer.success and not answer.code:
            raise Broken(f"{word} was refused without a code: {answer.message!r}")
        return answer

    def tell_map(self) -> None:
        """Publishes the floor's map, as map_server does."""
        grid = GridMap(self.maps[self.floor], RESOLUTION, (0.0, 0.0, 0.0))
        self.map.publish(message_from_grid(grid, rospy.Time.from_sec(self.now)))

    # ------------------------------------------------------------ what the stack says
    def heard(self, key: str, test: Callable[[Any], Any]) -> Any:
        """Returns what a test gives for a topic's newest message; None while there is none."""
        message = self.newest.get(key)
        return None if message is None else test(message)

    def settle(self) -> None:
        """Waits until every node is there and knows the time and the map."""
        for name in (names.COMMAND, names.GET_DRAWN_BORDER, names.ADD_BORDER, names.LIST_BORDERS):
            self.wait(lambda: self._answers(name), f"service {name}", limit=90.0)
        self.wait(self.spots.get_num_connections, "listeners")
        self.wait(self.posterior_is_of_this_floor, "the map with borders")

    @staticmethod
    def _answers(service: str) -> bool:
        try:
            return rosservice.get_service_uri(service) is not None
        except rosservice.ROSServiceIOException:
            return False

    def posterior_is_of_this_floor(self) -> bool:
        message = self.newest.get("posterior")
        if message is None:
            return False
        got, physical = np.asarray(message.data).reshape(100, 160), self.maps[self.floor]
        return bool((got[physical == 100] == 100).all())
