#!/usr/bin/env python3
"""`make try` without a camera: the video's line becomes a border in metres, where the rendering says it is."""

import os
import sys
import tempfile
import unittest
from pathlib import Path

import rospkg
import rostest
import shapely
import yaml
from scipy.spatial.distance import directed_hausdorff
from vb_testing import run_command
from vb_map_integration.geojson import borders_from_geojson


class TestTryCamera(unittest.TestCase):
    def test_the_video_becomes_a_border_in_metres(self):
        with tempfile.TemporaryDirectory() as folder:
            command = (sys.executable, "-m", "vb_bringup.try_camera", "--out", folder, "--once")
            done = run_command(*command, timeout=200, env={**os.environ, "DISPLAY": ""})
            self.assertEqual(done.returncode, 0, done.stdout)
            (border,) = borders_from_geojson((Path(folder) / "borders.geojson").read_text())
        truth = yaml.safe_load((Path(rospkg.RosPack().get_path("vb_bringup")) / "try/room.yaml").read_text())
        self.assertTrue(border.closed)
        self.assertLess(directed_hausdorff(truth["border"], border.points)[0], 0.02)
        sides = shapely.LinearRing(truth["border"])  # no point lies off these
        self.assertLess(shapely.distance(sides, shapely.points(border.points)).max(), 0.02)


if __name__ == "__main__":
    rostest.rosrun("vb_bringup", "try_camera", TestTryCamera)
