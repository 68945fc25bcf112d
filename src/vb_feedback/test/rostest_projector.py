#!/usr/bin/env python3
"""floor_projector, calibrated by clicks, and started again with the file that it wrote."""

from __future__ import annotations

import os
import subprocess
import tempfile
import unittest
from pathlib import Path

import numpy as np
import rospy
import rostest
from geometry_msgs.msg import Point, PointStamped
from sensor_msgs.msg import Image

from vb_testing import assert_ends_with_one_line, wait_until
from vb_core.grid_map import GridMap
from vb_core.ros.images import array_from_image
from vb_core.ros.messages import BorderPreviewArray, message_from_grid
from vb_feedback.projector import projector_calibration
from vb_msgs.msg import BorderProgress, InteractionState, LaserSpot, VirtualBorder, VirtualBorderArray

SIZE = (320, 200)
# a picture of 3.2 m x 2.0 m with its lower left corner at (1, 1), upright on the map
SCALE = 100.0


def floor_of(column, row):
    return 1.0 + column / SCALE, 1.0 + (SIZE[1] - 1 - row) / SCALE


def start(*arguments):
    return subprocess.Popen(
        ["rosrun", "vb_feedback", "floor_projector", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        universal_newlines=True,
    )


class ProjectorTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("rostest_projector")
        cls.pictures = []
        cls.subscriber = rospy.Subscriber("/virtual_borders/projector", Image, cls.pictures.append)
        cls.folder = tempfile.TemporaryDirectory()
        cls.file = os.path.join(cls.folder.name, "new", "projector.yaml")

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    def shown(self):
        return array_from_image(self.pictures[-1]) if self.pictures else np.zeros((SIZE[1], SIZE[0], 3), np.uint8)

    def at(self, x, y):
        return (
            self.shown()[int(round(SIZE[1] - 1 - (y - 1.0) * SCALE)), int(round((x - 1.0) * SCALE))].astype(int).max()
        )

    def test_1_calibration_by_clicks(self):
        node = start(f"_calibration:={self.file}", f"_width:={SIZE[0]}", f"_height:={SIZE[1]}")
        clicks = rospy.Publisher("/clicked_point", PointStamped, queue_size=5)
        wait_until(lambda: clicks.get_num_connections() and self.pictures, "the first marker")
        markers = projector_calibration.markers(*SIZE)

        def bright(number):
            column, row = np.rint(markers[number]).astype(int)
            return self.shown()[row, column].max() == 255

        def click(x, y, frame="map"):
            message = PointStamped(point=Point(x, y, 0.0))
            message.header.frame_id = frame
            clicks.publish(message)

        # in another frame; then all on one line: the marker stays, or comes again
        click(0.0, 0.0, "odom")
        for number in range(4):
            wait_until(lambda: bright(number), f"marker {number}")
            click(float(number), 0.0)
        for number in range(4):
            wait_until(lambda: bright(number), f"marker {number} of the second try")
            click(*floor_of(*markers[number]))
        wait_until(lambda: os.path.exists(self.file) and not self.shown().any(), "a dark picture")
        node.terminate()
        said, _ = node.communicate()
        self.assertIn("not in the frame map", said)
        self.assertIn("order of the markers", said)
        found = projector_calibration.load(Path(self.file))
        np.testing.assert_allclose(found.footprint()[0], floor_of(0, 0), atol=1e-3)

    def test_2_borders_drawing_and_preview(self):
        node = start(f"_calibration:={self.file}", "_max_rate:=20.0")
        try:
            latched = {"queue_size": 1, "latch": True}
            state = rospy.Publisher("/virtual_borders/state", InteractionState, **latched)
            progress = rospy.Publisher("/virtual_borders/progress", BorderProgress, **latched)
            borders = rospy.Publisher("/virtual_borders/borders", VirtualBorderArray, **latched)
            preview = rospy.Publisher("/virtual_borders/preview", BorderPreviewArray, **latched)
            spots = rospy.Publisher("/virtual_borders/spots", LaserSpot, queue_size=5)
            wait_until(lambda: spots.get_num_connections() and not self.shown().any(), "a dark picture")
            borders.publish(
                borders=[
                    VirtualBorder(
                        name="b",
                        points=[Point(1.5, 1.5, 0), Point(2.0, 1.5, 0)],
                        kind=VirtualBorder.SEPARATING_CURVE,
                        occupancy=1.0,
                        enabled=True,
                    )
                ]
            )
            wait_until(lambda: self.at(1.75, 1.5) > 100, "the border")
            state.publish(InteractionState(name="border", interaction_id="i"))
            drawing = BorderProgress(interaction_id="i", chain=[Point(3.0, 1.4, 0), Point(3.0, 2.6, 0)])
            progress.publish(drawing)
            wait_until(
                lambda: self.at(3.0, 2.0) > 100 and self.shown()[0, 0].max() > 100, "the drawing and the state's frame"
            )

            def dark():
                spot = LaserSpot(camera="red", position=Point(3.0, 2.5, 0))
                spot.header.stamp = rospy.Time.now()
                spots.publish(spot)
                return self.at(3.0, 2.4) == 0 and self.at(3.0, 1.6) > 100

            wait_until(dark, "the dark place about the spot")
            count = len(self.pictures)

            def fades():
                progress.publish(drawing)  # the same again draws nothing new
                return self.at(3.0, 2.4) > 100

            wait_until(fades, "the spot's end")
            self.assertLess(len(self.pictures) - count, 4)
            cells = np.zeros((60, 80), np.int8)
            cells[30:50, 40:60] = 100
            region = message_from_grid(GridMap(cells, 0.05), rospy.Time.now())
            preview.publish(BorderPreviewArray(interaction_id="i", available=True, success=True, region=region))
            wait_until(lambda: self.shown()[75:120, 105:195].any(), "what save would restrict")
            state.publish(InteractionState(name="default"))
            wait_until(lambda: self.at(3.0, 1.6) == 0 and self.at(1.75, 1.5) > 100, "the borders alone")
        finally:
            node.terminate()
            node.wait()
            node.stdout.close()

    def test_3_without_a_calibration_it_says_so(self):
        cases = [([], "calibration"), (["_calibration:=/"], "cannot read")]
        assert_ends_with_one_line("vb_feedback", "floor_projector", cases)


if __name__ == "__main__":
    rostest.rosrun("vb_feedback", "projector", ProjectorTest)
