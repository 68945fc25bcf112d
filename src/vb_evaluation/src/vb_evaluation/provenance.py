"""Finds the repository, and which version of the program made something."""

from __future__ import annotations

import subprocess
from pathlib import Path


def repository_top() -> Path:
    """Finds the repository's top folder."""
    return Path(__file__).resolve().parents[4]


def revision() -> str:
    """Returns the repository's revision, with "-dirty" where files differ from it outside of docs; "unknown" outside of one.

    A bench that runs for hours adds to its table in docs meanwhile, which changes nothing of what it measures.
    """
    git = ["git", "-C", str(repository_top())]
    try:
        found = subprocess.check_output(
            [*git, "describe", "--always", "--abbrev=12"], stderr=subprocess.DEVNULL, universal_newlines=True
        ).strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    differs = subprocess.call([*git, "diff", "--quiet", "HEAD", "--", ".", ":!docs"], stderr=subprocess.DEVNULL)
    return found + ("-dirty" if differs else "")
