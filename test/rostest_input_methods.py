#!/usr/bin/env python3
"""The same drawing makes the same border, no matter who gives the commands, or how."""

import json
import shutil
import unittest

import numpy as np
import rospy
import rostest
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Joy
from std_srvs.srv import Trigger

from vb_testing import Newest, assert_fields, wait_until
from speech import pieces, say
from terminal import Terminal
from vb_core import names
from vb_core.geometry import resample_chain
from vb_core.grid_map import GridMap
from vb_core.ros.messages import NumpyOccupancyGrid, array_from_points, message_from_grid
from vb_msgs.msg import Audio, BorderPreview, BorderProgress, InteractionState, LaserSpot, SpeechCommand
from vb_msgs.msg import VirtualBorderArray
from vb_msgs.srv import Command

COMMANDS = ("define_border", "define_seed", "save")
FRAME_S = 0.04  # 25 images a second
STROKE = [(1.0, 1.0), (3.0, 1.0), (3.0, 2.25), (1.0, 2.25), (1.0, 1.0)]  # [m] a carpet
SEED = (2.0, 1.6)


def room():
    """Makes a room of 8 m x 5 m with walls."""
    return GridMap(np.pad(np.zeros((96, 156), np.int8), 2, constant_values=100), 0.05)


def drawn():
    """Draws (N, 2) [m], one spot per image, at 0.5 m/s with a trembling hand."""
    path = resample_chain(np.array(STROKE), 0.5 * FRAME_S)
    return path + np.random.default_rng(1).normal(0.0, 0.005, path.shape)


class InputMethods(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("input_methods")
        cls.now = 1000.0
        cls.clock = rospy.Publisher("/clock", Clock, queue_size=1, latch=True)
        cls.map = rospy.Publisher(names.PHYSICAL_MAP, NumpyOccupancyGrid, queue_size=1, latch=True)
        cls.spots = rospy.Publisher(names.SPOTS, LaserSpot, queue_size=500)
        cls.joy = rospy.Publisher("/joy", Joy, queue_size=10)
        cls.audio = rospy.Publisher("/virtual_borders/voice/audio", Audio, queue_size=200)
        cls.state = Newest(names.STATE, InteractionState)
        cls.heard = Newest(names.SPEECH_COMMANDS, SpeechCommand)
        cls.progress = Newest(names.PROGRESS, BorderProgress)
        cls.preview = Newest(names.PREVIEW, BorderPreview)
        cls.borders = Newest(names.BORDERS, VirtualBorderArray)
        cls.maps = Newest(names.MAP_WITH_BORDERS, NumpyOccupancyGrid)
        cls.set_time(cls.now)
        cls.map.publish(message_from_grid(room(), rospy.Time.from_sec(cls.now)))
        cls.maps.wait(lambda message: True, "the first map")
        for name in (names.COMMAND, names.GET_DRAWN_BORDER, names.PREVIEW_BORDER):
            rospy.wait_for_service(name, 60)
        for publisher in (cls.spots, cls.joy, cls.audio):
            wait_until(publisher.get_num_connections, f"somebody who listens to {publisher.name}")
        cls.results = {}

    @classmethod
    def set_time(cls, seconds):
        """Sets simulated time, so that every interaction takes equally long."""
        cls.now = seconds
        cls.clock.publish(rospy.Time.from_sec(seconds))
        wait_until(lambda: abs(rospy.get_time() - seconds) < 1e-6, "the clock")

    def point(self, points):
        """Points the laser at (N, 2) [m], each half of the room seen by one camera; time advances accordingly."""
        begin = self.now + 1.0
        for number, (x, y) in enumerate(points):
            spot = LaserSpot(camera="red" if x < 2.0 else "green", confidence=1.0, projection=LaserSpot.GROUND_PLANE)
            spot.header.frame_id = names.MAP_FRAME
            spot.header.stamp = rospy.Time.from_sec(begin + number * FRAME_S)
            spot.position.x, spot.position.y = x, y
            self.spots.publish(spot)
        self.set_time(begin + len(points) * FRAME_S)
        self.wait_for_manager()

    def wait_for_manager(self):
        """Waits until the manager has the time: each node gets it separately, and the next command is dated by it."""
        self.state.wait(lambda message: abs(message.header.stamp.to_sec() - self.now) < 1e-6, "the manager's clock")

    def interact(self, way, give):
        """Draws the carpet with commands given by `give`; keeps border and map, and undoes the border."""
        self.set_time(1000.0 * (2 + len(self.results)))
        self.wait_for_manager()
        give(COMMANDS[0])
        identity = self.state.wait(lambda message: message.name == "border", f"{way}: the border state").interaction_id
        # spots count only once the border fusion knows the state too
        self.progress.wait(lambda message: message.interaction_id == identity, f"{way}: the fusion in border")
        stroke = drawn()
        self.point(stroke)
        self.progress.wait(
            lambda message: message.interaction_id == identity and message.border_spots == len(stroke),
            f"{way}: the stroke",
        )
        give(COMMANDS[1])
        self.state.wait(lambda message: message.name == "seed", f"{way}: the seed state")
        # a chain, but no seed yet. On a busy computer the chain itself comes later than its spots
        self.progress.wait(lambda message: message.chain and message.code != "ok", f"{way}: the fusion in seed")
        self.point(np.tile(SEED, (30, 1)))
        self.progress.wait(lambda message: message.seed_spots == 30 and message.has_seed, f"{way}: the seed")
        preview = self.preview.wait(lambda message: message.interaction_id == identity and message.available, "preview")
        give(COMMANDS[2])
        state = self.state.wait(lambda state: state.last_outcome == "saved" and state.name == "default", f"{way}: save")
        stored = self.borders.wait(lambda message: len(message.borders) == 1, f"{way}: the border").borders[0]
        empty = room().data.ravel()
        cells = np.array(self.maps.wait(lambda message: (message.data != empty).any(), f"{way}: the map").data)
        self.assertEqual(stored.id, state.last_border_id)
        # the result is as previewed
        self.assertTrue(preview.success, preview.message)
        self.assertEqual(np.array(preview.region.data).sum() / 100, (cells != room().data.ravel()).sum())
        self.results[way] = (stored.kind, array_from_points([*stored.points, stored.seed]), cells)
        rospy.ServiceProxy(names.UNDO, Trigger)()
        self.borders.wait(lambda message: not message.borders, f"{way}: the undone border")
        self.maps.wait(lambda message: (message.data == room().data.ravel()).all(), f"{way}: the map as it was")
        record = wait_until(lambda: self.record_of(identity), f"{way}: the record")
        expected = {"outcome": "saved", "border_id": stored.id, "sources": [way], "cameras": ["red", "green"]}
        assert_fields(record, **expected, guide_s=0.0)
        self.assertAlmostEqual(record["border_s"], 1.0 + len(stroke) * FRAME_S, places=3)
        self.assertAlmostEqual(record["seed_s"], 1.0 + 30 * FRAME_S, places=3)

    @staticmethod
    def record_of(identity):
        """Returns an interaction's record once it is on disk, else None; people are told of the save before that."""
        with open(rospy.get_param("~log")) as file:
            records = [json.loads(line) for line in file if line.endswith("\n")]
        return next((record for record in records if record["interaction_id"] == identity), None)

    def test_all_ways_end_in_the_same_border(self):
        service = rospy.ServiceProxy(names.COMMAND, Command)
        self.interact("service", lambda command: service(command=command, source="service"))
        self.interact("buttons", self.press)
        terminal = Terminal()
        terminal.shows("READY")
        self.interact("wizard", lambda command: self.type(terminal, command))
        self.assertEqual(terminal.leave(), (0, True), terminal.text[-2000:])
        if shutil.which("espeak-ng"):
            self.interact("voice", self.speak)
        kind, points, cells = self.results["service"]
        for way, (other_kind, other_points, other_cells) in self.results.items():
            self.assertEqual(kind, other_kind, way)
            self.assertEqual(points.shape, other_points.shape, way)
            # the stamps of the interactions differ, and so does their rounding
            self.assertLess(np.abs(points - other_points).max(), 1e-6, way)
            self.assertTrue((cells == other_cells).all(), way)
        self.assertGreater(len(points), 4)
        if "voice" not in self.results:
            self.skipTest("nothing was spoken: espeak-ng is not installed (apt-get install espeak-ng)")

    def type(self, terminal, command):
        """Presses a command's key, again if the console says it was too late: each node gets the clock separately."""
        keys = {"define_border": ("b", "draw_border"), "define_seed": ("d", "point_seed"), "save": ("s", "saved")}
        key, code = keys[command]
        late = None
        while late is None or terminal.text.count("Too late") > late:
            late = terminal.text.count("Too late")
            terminal.press(key)
            wait_until(lambda: self.state.message.last_code == code or terminal.text.count("Too late") > late, command)

    def press(self, command):
        buttons = [0] * 5
        for pressed in (1, 0):
            buttons[("define_border", "define_seed", "guide_robot", "save", "cancel").index(command)] = pressed
            self.joy.publish(buttons=list(buttons))

    def speak(self, command):
        """Says a command as people do: again until it is understood, with "yes" if there is a question."""
        said = command.replace("_", " ")
        for seed in range(20):
            count = len(self.heard.all)
            for piece in pieces(say(said, seed=seed)):
                self.audio.publish(piece)
            heard = wait_until(lambda: self.heard.all[count:], "what was made of a command")[0]
            if heard.success:
                return
            if heard.code.startswith("confirm_"):
                said = f"yes, {said}"
        self.fail(f"{said} was not understood")


if __name__ == "__main__":
    rostest.rosrun("vb_bringup", "input_methods", InputMethods)
