"""Linters find no unused code, unclear names, missing docstrings, misspelt words, or packages catkin cannot install."""

import os
import sys

import pytest

from vb_testing import TOP, run_command

LINTERS = {
    "ruff": ["ruff", "check", "--no-cache", "--quiet", "--output-format", "concise"],
    "format": ["ruff", "format", "--check", "--no-cache", "--quiet"],
    "codespell": ["codespell_lib"],
    # offline: rosdep keys are not checked, since their list would have to be fetched
    "catkin_lint": ["catkin_lint", "--offline", "--strict", "src"],
}


@pytest.mark.parametrize("name", LINTERS)
def test_lint(name):
    module, *options = LINTERS[name]
    done = run_command(sys.executable, "-m", module, *options, cwd=TOP, env={**os.environ, "ROS_DISTRO": "noetic"})
    assert done.returncode == 0, done.stdout
