"""Finds the repository, and which version of the program made something."""

from __future__ import annotations

import subprocess
from pathlib import Path


def repository_top() -> Path:
    """Finds the repository's top folder."""
    return Path(__file__).resolve().parents[4]


def revision() -> str:
    """Returns the repository's revision, with "-dirty" where files differ from it; "unknown" outside of one."""
    try:
        found = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=12"],
            cwd=str(repository_top()),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            universal_newlines=True,
            check=True,
        )
        return found.stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
