#!/usr/bin/env python3
"""map_recorder over a real roscore, behind a real map_integrator."""

from __future__ import annotations

import json
import shutil
import unittest
from pathlib import Path

import rospy
import rostest
from std_srvs.srv import Trigger

from map_server import MapServer, lab, polygon
from vb_testing import wait_until
from vb_core.map_files import read_map
from vb_map_integration.borders.geojson import borders_from_geojson
from vb_msgs.srv import AddBorder


class MapRecorderTest(unittest.TestCase):
    def test_each_new_map_is_stored(self):
        rospy.init_node("rostest_map_recorder")
        folder = Path(rospy.get_param("~folder")) / "recording"
        self.addCleanup(shutil.rmtree, str(folder.parent), ignore_errors=True)
        grid = lab()
        server = MapServer(grid)

        def lines(count):
            path = folder / "index.jsonl"
            found = path.read_text().splitlines() if path.exists() else []
            return [json.loads(line) for line in found] if len(found) >= count else None

        wait_until(lambda: lines(1), "the first record")
        add = rospy.ServiceProxy("/virtual_borders/add_border", AddBorder)
        self.assertTrue(add(border=polygon()).success)
        wait_until(lambda: lines(2), "the second record")
        self.assertTrue(add(border=polygon(x=2.0, occupancy=0.75)).success)
        wait_until(lambda: lines(3), "the third record")
        self.assertTrue(rospy.ServiceProxy("/virtual_borders/undo", Trigger)().success)
        found = wait_until(lambda: lines(4), "the fourth record")
        counts = [len(borders_from_geojson((folder / line["borders"]).read_text())) for line in found]
        self.assertEqual(counts, [0, 1, 2, 1])
        self.assertEqual([line["number"] for line in found], [1, 2, 3, 4])
        stamps = [line["stamp_s"] for line in found]
        self.assertEqual(stamps, sorted(stamps))
        self.assertTrue((read_map(folder / "0001.yaml").data == server.grid.data).all())
        soft = read_map(folder / "0003.yaml").data
        walls = int((grid.data == 100).sum())
        self.assertEqual([int((soft == value).sum()) for value in (75, 100)], [400, 400 + walls])


if __name__ == "__main__":
    rostest.rosrun("vb_map_integration", "map_recorder", MapRecorderTest)
