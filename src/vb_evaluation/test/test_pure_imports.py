"""What computes measures, statistics and the report imports where there is no ROS."""
from __future__ import annotations

import subprocess
import sys

PURE = (
    "metrics",
    "statistics",
    "questionnaire",
    "report.page",
    "report.__main__",
    "kit.ground_truth",
    "kit.protocol",
    "kit.recording",
    "kit.measure",
    "kit.replay",
    "kit.__main__",
)

BLOCK = """
import importlib
import sys

class Block:
    def find_spec(self, name, path=None, target=None):
        top = name.split(".")[0]
        if top in ("rospy", "tf2_ros", "cv_bridge", "rosgraph", "rosbag", "roslib") or top.endswith("_msgs"):
            raise ImportError(name + " is blocked")

sys.meta_path.insert(0, Block())
for module in sys.argv[1:]:
    importlib.import_module("vb_evaluation." + module)
"""


def test_imports_without_ros():
    subprocess.run([sys.executable, "-c", BLOCK, *PURE], check=True)
