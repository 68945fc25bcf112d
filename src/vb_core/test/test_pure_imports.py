"""Every pure module loads on a machine without ROS."""
import subprocess
import sys

SCRIPT = """
import importlib, pkgutil, sys

class NoRos:
    def find_spec(self, name, path=None, target=None):
        top = name.split(".")[0]
        if top in ("rospy", "tf2_ros", "tf2_py", "cv_bridge", "actionlib") or top.endswith("_msgs"):
            raise ImportError(name + " is blocked")

sys.meta_path.insert(0, NoRos())
import vb_core
names = [module.name for module in pkgutil.iter_modules(vb_core.__path__) if not module.ispkg]
assert len(names) >= 5, names
for name in names:
    importlib.import_module("vb_core." + name)
"""


def test_pure_modules_need_no_ros():
    done = subprocess.run([sys.executable, "-c", SCRIPT], stderr=subprocess.PIPE, universal_newlines=True)
    assert done.returncode == 0, done.stderr
