"""Finds the repository and its revision, with which results are labelled."""

from __future__ import annotations

import subprocess
from pathlib import Path


def repository_root() -> Path:
    """Finds the repository's top folder."""
    return Path(__file__).resolve().parents[4]


def revision() -> str:
    """Returns the repository's revision, with "-dirty" if files outside docs differ from it; "unknown" if there is none.

    A bench that runs for hours appends to its table in docs in the meantime, which does not affect what it measures.
    """
    git = ["git", "-C", str(repository_root())]
    describe = [*git, "describe", "--always", "--abbrev=12"]
    try:
        output = subprocess.check_output(describe, stderr=subprocess.DEVNULL, universal_newlines=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    differs = subprocess.call([*git, "diff", "--quiet", "HEAD", "--", ".", ":!docs"], stderr=subprocess.DEVNULL)
    return f"{output.strip()}-dirty" if differs else output.strip()
