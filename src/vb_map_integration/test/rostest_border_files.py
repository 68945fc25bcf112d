#!/usr/bin/env python3
"""Borders from files, over a real roscore and map_integrator."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import numpy as np
import rospy
import rostest

from map_server import MapServer, lab
from vb_testing import Newest, wait_until
from vb_core.ros.messages import OccupancyGridArray
from vb_msgs.msg import VirtualBorderArray
from vb_msgs.srv import SaveMap

SCRIPTS = Path(__file__).resolve().parent.parent / "scripts"


class BorderFilesTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("rostest_border_files")
        cls.grid = lab()
        cls.maps = Newest("/virtual_borders/map", OccupancyGridArray)
        cls.borders = Newest("/virtual_borders/borders", VirtualBorderArray)
        cls.server = MapServer(cls.grid)
        assert cls.maps.message and cls.borders.message

    def stored(self, count):
        wait_until(lambda: len(self.borders.message.borders) == count, f"{count} border(s)")
        return self.borders.message.borders

    def restricted(self):
        """The values of the cells that differ from the physical map."""
        cells = np.asarray(self.maps.message.data).reshape(self.grid.shape)
        return cells[cells != self.grid.data].tolist()

    def run_command(self, name, *arguments):
        done = subprocess.run(
            [sys.executable, str(SCRIPTS / name), *map(str, arguments)],
            universal_newlines=True,
            timeout=240,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
        )
        return done.returncode, done.stdout

    def test_files_go_in_and_out(self):
        with tempfile.TemporaryDirectory() as folder:
            source, copy = Path(folder) / "in.geojson", Path(folder) / "out.geojson"
            square = [[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]
            features = [
                {
                    "type": "Feature",
                    "geometry": {"type": "Polygon", "coordinates": [square]},
                    "properties": {"name": "rug", "occupancy": 0.75},
                },
                {
                    "type": "Feature",
                    "geometry": {"type": "LineString", "coordinates": [[60, 0], [60, 1]]},
                    "properties": {"name": "far", "seed": [0, 0]},
                },
            ]
            source.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
            status, output = self.run_command("import_borders", source)
            self.assertEqual(status, 1, output)
            for words in ("rug: added as b1", "far: refused", "error [outside_map]", "1 of 2 added"):
                self.assertIn(words, output)
            self.assertEqual(self.stored(1)[0].name, "rug")
            wait_until(lambda: self.restricted() == [75] * 400, "the map with a soft border")
            saved = rospy.ServiceProxy("/virtual_borders/save_map", SaveMap)("", False)
            copy.write_text(Path(saved.files[-1]).read_text())
            # one that was exported and edited comes beside it, and stays switched off
            edited = copy.read_text().replace('"rug"', '"carpet"').replace('"enabled": true', '"enabled": false')
            copy.write_text(edited)
            count = self.maps.count
            status, output = self.run_command("import_borders", copy)
            self.assertEqual(status, 0, output)
            self.assertEqual([(one.name, one.in_force) for one in self.stored(2)], [("rug", True), ("carpet", False)])
            wait_until(lambda: self.maps.count > count, "the map with it")
            self.assertEqual(self.restricted(), [75] * 400)
            copy.write_text('{"type": "FeatureCollection", "features": 3}')
            status, output = self.run_command("import_borders", copy)
            self.assertEqual(status, 2)
            self.assertIn("bad_border_file", output)
            self.assertNotIn("Traceback", output)


if __name__ == "__main__":
    rostest.rosrun("vb_map_integration", "border_files", BorderFilesTest)
