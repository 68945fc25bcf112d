"""The pure modules must work without ROS."""
import subprocess
import sys

PURE = ["view", "terrain", "keep_out", "viewpoint", "sightings", "dispatch", "safety", "drive",
        "servoing", "workspace", "leaving"]
BLOCK = """
import sys
class Block:
    def find_spec(self, name, path=None, target=None):
        top = name.split(".")[0]
        if top in ("rospy", "tf2_ros", "cv_bridge", "actionlib") or top.endswith("_msgs"):
            raise ImportError("blocked: " + name)
sys.meta_path.insert(0, Block())
import importlib
for module in sys.argv[1:]:
    importlib.import_module("vb_robot." + module)
"""


def test_pure_modules_import_without_ros():
    run = subprocess.run([sys.executable, "-c", BLOCK, *PURE], stderr=subprocess.PIPE, universal_newlines=True)
    assert run.returncode == 0, run.stderr
