"""The pure modules import where there is no ROS."""
from __future__ import annotations

import subprocess
import sys

import pytest

PURE = ["interaction", "memory", "buttons", "console_keys", "console_view", "preview_pace", "wording", "recognizer", "endpointing",
        "audio_sources", "phone_scoring", "phone_network", "acoustic_model", "speech_features"]

BLOCK = """
import sys

class Block:
    def find_spec(self, name, path=None, target=None):
        top = name.split(".")[0]
        if top in ("rospy", "tf2_ros", "cv_bridge", "rosgraph") or top.endswith("_msgs"):
            raise ImportError(name + " is blocked")

sys.meta_path.insert(0, Block())
import importlib
importlib.import_module(sys.argv[1])
"""


@pytest.mark.parametrize("module", PURE)
def test_imports_without_ros(module):
    subprocess.run([sys.executable, "-c", BLOCK, f"vb_voice_wizard.{module}"], check=True)
