"""The pure modules need no ROS."""
import subprocess
import sys
from pathlib import Path

SOURCE = Path(__file__).resolve().parent.parent / "src" / "vb_fusion"
PURE = sorted(path.stem for path in SOURCE.glob("*.py") if not path.stem.startswith("__") and "node" not in path.stem)


def test_pure_modules_import_without_ros():
    assert "extraction" in PURE
    program = f"""
import importlib, sys

class Blocked:
    def find_spec(self, name, path=None, target=None):
        top = name.split(".")[0]
        if top in ("rospy", "tf2_ros", "cv_bridge", "roslib") or top.endswith("_msgs"):
            raise ImportError("blocked: " + name)

sys.meta_path.insert(0, Blocked())
for module in {PURE!r}:
    importlib.import_module("vb_fusion." + module)
"""
    done = subprocess.run([sys.executable, "-c", program], stderr=subprocess.PIPE, text=True)
    assert done.returncode == 0, done.stderr
