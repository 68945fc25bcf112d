#!/usr/bin/env python3
"""One interaction with real nodes: bit for bit the same as in one process, recorded in bags and a log, measured."""

import contextlib
import json
import tempfile
import unittest
from collections import Counter
from pathlib import Path
from typing import Optional
from xmlrpc.client import ServerProxy

import cv2
import numpy as np
import rosbag
import rosgraph
import rospy
import rostest
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image

from study_recordings import measure_study, write_protocol
from vb_testing import TIMEOUT, assert_fields, wait_until
from vb_core import names
from vb_core.errors import CodedError
from vb_core.geometry import resample_chain
from vb_core.grid_map import GridMap
from vb_core.map_files import write_map
from vb_core.ros import commands
from vb_core.ros.messages import NumpyOccupancyGrid, array_from_points, grid_from_message, message_from_grid
from vb_evaluation.repository_revision import repository_root
from vb_evaluation.user_study.recording import Recording
from vb_sim.in_process_ros.rospy_stand_in import Graph, Node
from vb_sim.in_process_ros.launch_file import start_launch
from vb_sim.in_process_ros.threading_stand_in import Scheduler
from vb_msgs.msg import BorderProgress, InteractionState, LaserSpot, VirtualBorderArray

RATE = 50.0
ROOM = GridMap(np.zeros((100, 120), np.int8), 0.05)


def drawn_spots():
    """Returns (N, 2) [m], one spot per image: a rectangle drawn with a trembling hand."""
    path = resample_chain(np.array([[1.0, 1.0], [3.0, 1.0], [3.0, 2.5], [1.0, 2.5], [1.0, 1.0]]), 0.05)
    return path + np.random.default_rng(3).normal(0.0, 0.01, path.shape)


def wait(holds, event):
    """Waits for a condition in ROS time."""
    wait_until(holds, event, clock=rospy.get_time, sleep=rospy.sleep)


class Session:
    """Sends commands and spots through whichever rospy is installed, and keeps the nodes' messages."""

    def __init__(self):
        self.state = self.progress = self.borders = self.grid = None
        self.answers = []
        self.spots = rospy.Publisher(names.SPOTS, LaserSpot, queue_size=500)
        self.map = rospy.Publisher(names.PHYSICAL_MAP, NumpyOccupancyGrid, queue_size=1, latch=True)
        rospy.Subscriber(names.STATE, InteractionState, lambda message: setattr(self, "state", message))
        rospy.Subscriber(names.PROGRESS, BorderProgress, lambda message: setattr(self, "progress", message))
        rospy.Subscriber(names.BORDERS, VirtualBorderArray, lambda message: setattr(self, "borders", message))
        rospy.Subscriber(names.MAP_WITH_BORDERS, NumpyOccupancyGrid, lambda message: setattr(self, "grid", message))

    def give_command(self, command):
        answer = commands.send(commands.make_request(command, "test", 10.0))
        self.answers.append((command, answer.success, answer.code))

    def show(self, points):
        """Publishes spots at these points, at a fixed rate from the moment the state was entered."""
        begin = self.state.entered.to_sec() + 0.1
        for count, point in enumerate(points):
            message = LaserSpot(camera="red", confidence=0.9)
            message.header.stamp = rospy.Time.from_sec(begin + count / RATE)
            message.header.frame_id = names.MAP_FRAME
            message.position.x, message.position.y = point
            wait(lambda: rospy.Time.now() >= message.header.stamp, "the time of a spot")
            self.spots.publish(message)

    def run(self):
        """Runs a whole interaction and returns its result."""
        wait(lambda: self.state is not None and self.spots.get_num_connections() >= 2, "the state, fusion and manager")
        self.map.publish(message_from_grid(ROOM, rospy.Time.now()))
        wait(lambda: self.grid is not None, "the map")
        border = drawn_spots()
        # the previewed seed is saved, which may be the mean of fewer spots, but that is exact for 2.0 and 1.75
        seed = np.tile([2.0, 1.75], (25, 1))
        self.give_command("define_border")
        wait(lambda: self.state.name == "border", "the state Border")
        # the fusion may hear of the state later than this test, and collects nothing until then
        wait(lambda: self.progress and self.progress.interaction_id == self.state.interaction_id, "the fusion's Border")
        self.show(border)
        wait(lambda: self.progress is not None and self.progress.border_spots == len(border), "the border's spots")
        self.give_command("define_seed")
        wait(lambda: self.state.name == "seed", "the state Seed")
        wait(lambda: self.progress.code == "no_spots", "the fusion's Seed")
        self.show(seed)
        wait(lambda: self.progress.seed_spots == len(seed), "the seed's spots")
        self.give_command("save")
        wait(lambda: self.borders is not None and self.borders.borders, "the saved border")
        wait(lambda: grid_from_message(self.grid).data.any(), "the map with the border")
        saved = self.borders.borders[0]
        return {
            "answers": self.answers,
            "points": array_from_points(saved.points).tolist(),
            "kind": saved.kind,
            "seed": (saved.seed.x, saved.seed.y),
            "area": saved.area_m2,
            "map": grid_from_message(self.grid).data.tobytes().hex(),
        }


def in_one_process():
    """Runs the session with the same launch file, without a ROS master, and returns its result."""
    scheduler, results = Scheduler(1_000_000_000_000), []
    graph = Graph(scheduler, {})

    def clock():
        publisher = rospy.Publisher("/clock", Clock, queue_size=1)
        while True:
            publisher.publish(Clock(rospy.Time(scheduler.now_ns // 10**9, scheduler.now_ns % 10**9)))
            scheduler.wait(10_000_000)

    with tempfile.TemporaryDirectory() as state, graph.installed():
        graph.start(Node("/clock", {}), clock)
        start_launch(graph, repository_root() / "launch/parts/borders.launch", {"state": state, "robot_frames": ""})
        graph.start(Node("/test", {}), lambda: results.append(Session().run()))
        scheduler.run(lambda: bool(results), scheduler.now_ns + 600 * 10**9)
    return results[0]


class RecordingTest(unittest.TestCase):
    def test_an_interaction_with_real_nodes_is_that_in_one_process_and_is_recorded(self):
        alone = in_one_process()
        rospy.init_node("rostest_recording")
        self.folder = Path(rospy.get_param("~folder"))
        session = Session()
        self.spots = session.spots
        image = rospy.Publisher("/green/image_raw", Image, queue_size=1, latch=True)
        image.publish(Image())
        rospy.wait_for_service(names.COMMAND, TIMEOUT)
        wait_until(self.is_subscribed, "the connection of fusion and recorder")
        live = session.run()
        self.assertEqual([code for _, _, code in live["answers"]], ["draw_border", "point_seed", "saved"])
        self.assertGreater(len(live["points"]), 3)
        self.assertEqual(json.dumps(live), json.dumps(alone))
        recording = wait_until(self.recorded, "a record of the map with the border")
        (interaction,) = recording.interactions
        assert_fields(interaction, outcome="saved", method="nrs")
        self.assertEqual(recording.cameras, set())
        counts: Counter = Counter()
        for path in (self.folder / "bags").glob("*.bag"):
            with rosbag.Bag(str(path)) as bag:
                for topic, contents in bag.get_type_and_topic_info().topics.items():
                    counts[topic] += contents.message_count
        self.assertGreaterEqual(counts[names.SPOTS], len(drawn_spots()) + 25)
        self.assertTrue({names.STATE, names.PHYSICAL_MAP, names.BORDERS, "/rosout"} <= set(counts))
        self.assertNotIn("/green/image_raw", counts)

        study = self.folder.parent
        write_map(study / "map", ROOM)
        truth = cv2.imread(str(study / "map.pgm"))
        truth[::-1][20:50, 20:60] = (0, 215, 247)
        (study / "ground_truth").mkdir()
        cv2.imwrite(str(study / "ground_truth" / "carpet.png"), truth)
        write_protocol(study, f"p1,1,nrs,carpet,{self.folder.name},,")
        rows, notes = measure_study(study)
        self.assertEqual(notes, [])
        (row,) = rows.values()
        self.assertEqual(row["completed"], "1")
        self.assertGreater(float(row["jaccard"]), 0.9)
        self.assertGreater(float(row["time_border_s"]), 0.0)

    def is_subscribed(self) -> bool:
        listeners = dict(rosgraph.Master("/test").getSystemState()[1]).get(names.SPOTS, [])
        return {"/border_fusion", "/recorder"} <= set(listeners) and self.spots.get_num_connections() >= len(listeners)

    def recorded(self) -> Optional[Recording]:
        """Returns the recording if it has the border's map; else shuts the recorder down. rosbag names a bag on closing
        it; roslaunch restarts the recorder with the next bag, which gets the latched messages."""
        recording = Recording(self.folder)
        with contextlib.suppress(CodedError):
            if [recording.result(interaction) for interaction in recording.interactions]:
                return recording
        with contextlib.suppress(OSError, rosgraph.MasterException):
            if self.is_subscribed():
                ServerProxy(rosgraph.Master("/test").lookupNode("/recorder")).shutdown("/test", "the next bag")
        return None


if __name__ == "__main__":
    rostest.rosrun("vb_evaluation", "recording", RecordingTest)
