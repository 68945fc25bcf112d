"""Rules that hold across all packages (docs/architecture.md)."""
import ast
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

TOP = Path(__file__).resolve().parents[1]
FEATURES = ("vb_laser_detect", "vb_fusion", "vb_map_integration", "vb_voice_wizard", "vb_robot", "vb_feedback")
PACKAGES = sorted(path.parent.name for path in TOP.glob("src/*/package.xml"))


def python_files():
    files = list(TOP.glob("src/*/src/**/*.py")) + list(TOP.glob("src/*/test/*.py")) + list(TOP.glob("bench/*.py"))
    files += [path for path in TOP.glob("src/*/scripts/*")] + [TOP / "scripts" / "demo", TOP / "scripts" / "test"]
    return sorted(set(files))


def imported(path):
    """Names of the top-level packages that a file imports."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names.update(alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names.add(node.module.split(".")[0])
    return names


def test_all_packages_are_there():
    assert len(PACKAGES) == 11 and set(FEATURES) < set(PACKAGES)
    assert len(python_files()) > 100


@pytest.mark.parametrize("path", python_files(), ids=lambda path: str(path.relative_to(TOP)))
def test_syntax_is_that_of_python_3_8(path):
    # ROS Noetic's; the interpreter that runs the tests may be newer
    ast.parse(path.read_text(encoding="utf-8"), filename=str(path), feature_version=(3, 8))


@pytest.mark.parametrize("package", FEATURES + ("vb_core",))
def test_feature_packages_meet_at_vb_msgs_only(package):
    allowed = {package, "vb_core", "vb_msgs"}
    for path in TOP.glob(f"src/{package}/src/**/*.py"):
        others = {name for name in imported(path) if name.startswith("vb_")} - allowed
        assert not others, f"{path.relative_to(TOP)} imports {others}"


@pytest.mark.parametrize("package", FEATURES + ("vb_core", "vb_sim", "vb_evaluation"))
def test_manifests_name_what_is_imported(package):
    manifest = ElementTree.parse(str(TOP / "src" / package / "package.xml"))
    named = {element.text for element in manifest.getroot() if element.tag.endswith("depend")}
    for path in TOP.glob(f"src/{package}/src/**/*.py"):
        ours = {name for name in imported(path) if name.startswith("vb_") or name.endswith("_msgs")}
        missing = ours - named - {package}
        assert not missing, f"{path.relative_to(TOP)} imports {missing}, which package.xml does not name"


def test_no_manifest_at_the_top():
    # it would hide src/* from catkin
    assert not (TOP / "package.xml").exists()


def test_requirements_are_pinned():
    lines = (TOP / "requirements.txt").read_text().splitlines()
    wanted = [line for line in lines if line.strip() and not line.startswith("#")]
    assert wanted and all(re.fullmatch(r"[A-Za-z0-9_.-]+==[0-9][A-Za-z0-9.+]*", line.strip()) for line in wanted), wanted
