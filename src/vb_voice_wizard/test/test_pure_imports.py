"""The pure modules import where there is no ROS."""
from __future__ import annotations

import subprocess
import sys

PURE = (
    "acoustic_model", "audio_sources", "buttons", "console_keys", "console_view", "endpointing", "interaction", "memory",
    "phone_network", "phone_scoring", "preview_pace", "recognizer", "speech_features", "wording",
)

BLOCK = """
import importlib
import sys

class Block:
    def find_spec(self, name, path=None, target=None):
        top = name.split(".")[0]
        if top in ("rospy", "tf2_ros", "cv_bridge", "rosgraph") or top.endswith("_msgs"):
            raise ImportError(name + " is blocked")

sys.meta_path.insert(0, Block())
for module in sys.argv[1:]:
    importlib.import_module("vb_voice_wizard." + module)
"""


def test_imports_without_ros():
    subprocess.run([sys.executable, "-c", BLOCK, *PURE], check=True)
