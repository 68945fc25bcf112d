#!/usr/bin/env python3
"""Borders from files, and records of all maps, over a real roscore, map_integrator and map_recorder."""

from __future__ import annotations

import json
import shutil
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
from vb_core.map_files import read_map
from vb_core.ros.messages import OccupancyGridArray
from vb_map_integration.borders.geojson import borders_from_geojson
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
        cls.recording = Path(rospy.get_param("~folder")) / "recording"
        wait_until((cls.recording / "index.jsonl").exists, "the record of the first map")

    def stored(self, count):
        wait_until(lambda: len(self.borders.message.borders) == count, f"{count} border(s)")
        return self.borders.message.borders

    def restricted(self):
        cells = np.asarray(self.maps.message.data).reshape(self.grid.shape)
        return int((cells != self.grid.data).sum())

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

    def check_recording(self):
        """Checks that every map with borders was stored, with its borders."""
        folder = self.recording
        self.addCleanup(shutil.rmtree, str(folder.parent), ignore_errors=True)

        def recorded():
            found = [json.loads(line) for line in (folder / "index.jsonl").read_text().splitlines()]
            return found if len(found) == self.maps.count else None

        found = wait_until(recorded, "a record of each map")
        stored = [borders_from_geojson((folder / line["borders"]).read_text()) for line in found]
        self.assertEqual([[border.enabled for border in borders] for borders in stored], [[], [True], [True, False]])
        self.assertEqual([line["number"] for line in found], [1, 2, 3])
        self.assertEqual([line["stamp_s"] for line in found], sorted(line["stamp_s"] for line in found))
        first, soft = (read_map(folder / found[index]["map"]).data for index in (0, 1))
        self.assertTrue((first == self.grid.data).all())
        self.assertEqual((int((soft == 75).sum()), int((soft != first).sum())), (400, 400))

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
            self.assertEqual(self.restricted(), 400)
            self.check_recording()
            copy.write_text('{"type": "FeatureCollection", "features": 3}')
            status, output = self.run_command("import_borders", copy)
            self.assertEqual(status, 2)
            self.assertIn("bad_border_file", output)
            self.assertNotIn("Traceback", output)


if __name__ == "__main__":
    rostest.rosrun("vb_map_integration", "border_files", BorderFilesTest)
