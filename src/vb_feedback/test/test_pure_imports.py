"""The pure modules import where there is no ROS."""
from __future__ import annotations

import subprocess
import sys
from pathlib import Path

FILES = (Path(__file__).resolve().parents[1] / "src" / "vb_feedback").glob("*.py")
# nodes, and what converts messages for them
ROS = {"display_messages", "__init__"}
PURE = sorted(path.stem for path in FILES if path.stem not in ROS and not path.stem.endswith("_node"))

BLOCK = """
import sys

class Block:
    def find_spec(self, name, path=None, target=None):
        top = name.split(".")[0]
        if top in ("rospy", "tf2_ros", "cv_bridge", "rosgraph", "tkinter") or top.endswith("_msgs"):
            raise ImportError(name + " is blocked")

sys.meta_path.insert(0, Block())
import importlib
for name in sys.argv[1:]:
    importlib.import_module(name)
"""


def test_pure_modules_import_without_ros():
    assert len(PURE) > 10
    subprocess.run([sys.executable, "-c", BLOCK, *[f"vb_feedback.{module}" for module in PURE]], check=True)
