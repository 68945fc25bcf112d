#!/usr/bin/env python3
"""Record and measure: one interaction through real nodes into bags and a log, and back out of them."""

from __future__ import annotations

import contextlib
import csv
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
from vb_testing import TIMEOUT, Newest, wait_until
from geometry_msgs.msg import Point
from sensor_msgs.msg import Image

from vb_core import names
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.map_files import write_map
from vb_core.ros import messages
from vb_evaluation.study_kit import measure
from vb_evaluation.study_kit.recording import Recording
from vb_msgs.msg import InteractionState, LaserSpot
from vb_msgs.srv import Command

SQUARE = np.array([[1.0, 1.0], [2.5, 1.0], [2.5, 2.0], [1.0, 2.0]])


def lab() -> GridMap:
    cells = np.full((80, 100), 100, np.int8)
    cells[2:-2, 2:-2] = 0
    return GridMap(cells, 0.05)


class RecordingTest(unittest.TestCase):
    def setUp(self) -> None:
        rospy.init_node("rostest_recording")
        self.folder = Path(rospy.get_param("~folder"))
        self.state = Newest(names.STATE, InteractionState)
        self.map = rospy.Publisher(names.PHYSICAL_MAP, messages.OccupancyGridArray, queue_size=1, latch=True)
        self.map.publish(messages.message_from_grid(lab(), rospy.Time.now()))
        self.image = rospy.Publisher("/green/image_raw", Image, queue_size=1, latch=True)
        self.image.publish(Image())
        self.spots = rospy.Publisher(names.SPOTS, LaserSpot, queue_size=1000)
        self.command = rospy.ServiceProxy(names.COMMAND, Command)

    def give_command(self, command: str) -> None:
        reply = self.command(command=command, source="test")
        self.assertTrue(reply.success, reply.message)

    def draw(self, points: np.ndarray) -> None:
        begin = rospy.Time.now()
        for number, (x, y) in enumerate(points):
            spot = LaserSpot(camera="green", position=Point(x, y, 0.0), confidence=0.9)
            # the stamps of a hand that draws, though it is published faster
            spot.header.stamp, spot.header.frame_id = begin + rospy.Duration(0.04 * number), names.MAP_FRAME
            self.spots.publish(spot)
            rospy.rostime.wallsleep(0.002)

    def test_one_interaction(self):
        rospy.wait_for_service(names.COMMAND, TIMEOUT)
        rospy.wait_for_service(names.ADD_BORDER, TIMEOUT)
        wait_until(self.is_subscribed, "the connection of fusion and recorder")
        corners = np.vstack([SQUARE, SQUARE[:1]])
        outline = np.vstack(
            [np.linspace(a, b, 60, endpoint=False) for a, b in zip(corners[:-1], corners[1:])] + [corners[:1]]
        )
        self.give_command("define_border")
        self.state.wait(lambda message: message.name == "border", "the state Border")
        self.draw(outline)
        self.give_command("define_seed")
        self.state.wait(lambda message: message.name == "seed", "the state Seed")
        self.draw(np.tile(SQUARE.mean(axis=0), (20, 1)))
        wait_until(self.saved, "the save")
        recording = wait_until(self.recorded, "a record of the map with the border")
        (interaction,) = recording.interactions
        self.assertEqual((interaction.outcome, interaction.method), ("saved", "nrs"))
        self.assertEqual(recording.cameras, set())
        counts: Counter = Counter()
        for path in (self.folder / "bags").glob("*.bag"):
            with rosbag.Bag(str(path)) as bag:
                for topic, held in bag.get_type_and_topic_info().topics.items():
                    counts[topic] += held.message_count
        self.assertGreaterEqual(counts[names.SPOTS], len(outline) + 20)
        self.assertTrue({names.STATE, names.PHYSICAL_MAP, names.BORDERS, "/rosout"} <= set(counts))
        self.assertNotIn("/green/image_raw", counts)

        study = self.folder.parent
        write_map(study / "map", lab())
        truth = cv2.imread(str(study / "map.pgm"))
        truth[::-1][20:40, 20:50] = (0, 215, 247)
        (study / "truth").mkdir()
        cv2.imwrite(str(study / "truth" / "carpet.png"), truth)
        (study / "protocol.csv").write_text(
            f"participant,method,scenario,recording\np1,nrs,carpet,{self.folder.name}\n"
        )
        self.assertEqual(measure.measure(study / "protocol.csv", study / "truth", study / "out"), [])
        with open(str(study / "out" / "runs.csv"), newline="") as stream:
            (row,) = csv.DictReader(stream)
        self.assertEqual(row["completed"], "1")
        self.assertGreater(float(row["jaccard"]), 0.93)
        self.assertGreater(float(row["time_border_s"]), 0.0)

    def is_subscribed(self) -> bool:
        listeners = dict(rosgraph.Master("/test").getSystemState()[1]).get(names.SPOTS, [])
        return {"/border_fusion", "/recorder"} <= set(listeners) and self.spots.get_num_connections() >= len(listeners)

    def recorded(self) -> Optional[Recording]:
        """Returns the recording if it has the border's map. rosbag gives a bag its name when it closes it; roslaunch starts
        the recorder again, into the next bag, which gets what is latched."""
        recording = Recording(self.folder)
        with contextlib.suppress(CodedError):
            if [recording.result(one) for one in recording.interactions]:
                return recording
        with contextlib.suppress(OSError, rosgraph.MasterException):
            if self.is_subscribed():
                ServerProxy(rosgraph.Master("/test").lookupNode("/recorder")).shutdown("/test", "the next bag")
        return None

    def saved(self) -> bool:
        """Spots travel beside the command: the first saves may come before the last spots."""
        return self.command(command="save", source="test").success


if __name__ == "__main__":
    rostest.rosrun("vb_evaluation", "recording", RecordingTest)
