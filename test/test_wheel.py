"""The algorithms as one package without ROS: what `pip install .` installs is complete, and its examples run."""

import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

TOP = Path(__file__).resolve().parent.parent
PACKAGES = re.findall(r"src/(vb_\w+)/src", (TOP / "pyproject.toml").read_text(encoding="utf-8"))
OFFERED = re.findall(
    r"^\| \[`(vb_[\w.]+)`\]", (TOP / "docs/explanation/architecture.md").read_text(encoding="utf-8"), re.M
)
PROMISED = [name for name in OFFERED if name.split(".")[0] in PACKAGES]
RUN = """
import doctest, importlib, sys
for name in ("rospy", "roslib", "tf2_ros", "vb_msgs", "std_msgs"):
    sys.modules[name] = None
for name in sys.argv[2:]:
    module = importlib.import_module(name)
    assert module.__file__.startswith(sys.argv[1]), module.__file__
    done = doctest.testmod(module)
    assert done.attempted and not done.failed, name
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The wheel of the committed and changed files, unpacked; nothing is downloaded."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard", "pyproject.toml", "README.md", "src"],
        cwd=str(TOP),
        stdout=subprocess.PIPE,
        universal_newlines=True,
        check=True,
    ).stdout.split("\n")
    for name in filter(None, listed):
        if (TOP / name).is_file() and not (TOP / name).is_symlink():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            (source / name).write_bytes((TOP / name).read_bytes())
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*command, "--wheel-dir", str(folder), str(source)], check=True)
    (wheel,) = folder.glob("*.whl")
    target = folder / "installed"
    zipfile.ZipFile(str(wheel)).extractall(str(target))
    return target


def test_the_promised_modules_run_without_ros(installed):
    assert {name.split(".")[0] for name in PROMISED} == set(PACKAGES)
    environment = {**os.environ, "PYTHONPATH": str(installed)}
    command = [sys.executable, "-c", RUN, str(installed), *PROMISED]
    done = subprocess.run(command, env=environment, cwd=str(installed), stderr=subprocess.PIPE, universal_newlines=True)
    assert done.returncode == 0, done.stderr


def test_no_file_of_the_packages_is_left_out(installed):
    for package in PACKAGES:
        inside = TOP / "src" / package / "src"
        kinds = (".py", ".yaml", ".json")
        wanted = {
            path.relative_to(inside) for path in inside.rglob("*") if path.suffix in kinds and "ros" not in path.parts
        }
        assert wanted and all((installed / path).is_file() for path in wanted), package
