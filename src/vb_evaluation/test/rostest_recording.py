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
import rosbag
import rosgraph
import rospy
import rostest
from sensor_msgs.msg import Image

from rostest_same_outputs import ROOM, Session, recorded_spots
from vb_testing import TIMEOUT, wait_until

from vb_core import names
from vb_core.errors import CodedError
from vb_core.map_files import write_map
from vb_evaluation.study_kit import measure
from vb_evaluation.study_kit.recording import Recording


class RecordingTest(unittest.TestCase):
    def test_one_interaction(self):
        rospy.init_node("rostest_recording")
        self.folder, session = Path(rospy.get_param("~folder")), Session()
        self.spots = session.spots
        image = rospy.Publisher("/green/image_raw", Image, queue_size=1, latch=True)
        image.publish(Image())
        rospy.wait_for_service(names.COMMAND, TIMEOUT)
        wait_until(self.is_subscribed, "the connection of fusion and recorder")
        session.run()
        recording = wait_until(self.recorded, "a record of the map with the border")
        (interaction,) = recording.interactions
        self.assertEqual((interaction.outcome, interaction.method), ("saved", "nrs"))
        self.assertEqual(recording.cameras, set())
        counts: Counter = Counter()
        for path in (self.folder / "bags").glob("*.bag"):
            with rosbag.Bag(str(path)) as bag:
                for topic, held in bag.get_type_and_topic_info().topics.items():
                    counts[topic] += held.message_count
        self.assertGreaterEqual(counts[names.SPOTS], len(recorded_spots()) + 25)
        self.assertTrue({names.STATE, names.PHYSICAL_MAP, names.BORDERS, "/rosout"} <= set(counts))
        self.assertNotIn("/green/image_raw", counts)

        study = self.folder.parent
        write_map(study / "map", ROOM)
        truth = cv2.imread(str(study / "map.pgm"))
        truth[::-1][20:50, 20:60] = (0, 215, 247)
        (study / "truth").mkdir()
        cv2.imwrite(str(study / "truth" / "carpet.png"), truth)
        (study / "protocol.csv").write_text(
            f"participant,method,scenario,recording\np1,nrs,carpet,{self.folder.name}\n"
        )
        self.assertEqual(measure.measure(study / "protocol.csv", study / "truth", study / "out"), [])
        with open(str(study / "out" / "runs.csv"), newline="") as stream:
            (row,) = csv.DictReader(stream)
        self.assertEqual(row["completed"], "1")
        self.assertGreater(float(row["jaccard"]), 0.9)
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


if __name__ == "__main__":
    rostest.rosrun("vb_evaluation", "recording", RecordingTest)
