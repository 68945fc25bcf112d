#!/usr/bin/env python3
"""`make try` without a camera: the video's line becomes a border in metres, where the rendering says it is."""

import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import numpy as np
import rospkg
import rostest
import yaml
from vb_map_integration.borders.geojson import borders_from_geojson


class TestTryCamera(unittest.TestCase):
    def test_the_video_becomes_a_border_in_metres(self):
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, "-m", "vb_bringup.try_camera", "--out", folder, "--once"]
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=200, env={**os.environ, "DISPLAY": ""}
            )
            self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
            (border,) = borders_from_geojson((Path(folder) / "borders.geojson").read_text())
        truth = yaml.safe_load((Path(rospkg.RosPack().get_path("vb_bringup")) / "try/room.yaml").read_text())
        self.assertTrue(border.closed)
        for corner in truth["border"]:
            nearest = np.linalg.norm(border.points - corner, axis=1).min()
            self.assertLess(nearest, 0.02)
        low, high = np.min(truth["border"], axis=0), np.max(truth["border"], axis=0)
        for point in border.points:  # and none is elsewhere than on the rectangle's sides
            self.assertLess(np.abs(np.concatenate([point - low, high - point])).min(), 0.02)


if __name__ == "__main__":
    rostest.rosrun("vb_bringup", "try_camera", TestTryCamera)
