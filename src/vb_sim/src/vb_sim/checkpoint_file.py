"""A small file that lets a killed process continue where it was."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import Any, Dict, Optional


class CheckpointFile:
    """One JSON document, written whole or not at all.

    Args:
        folder: of such files; it is made if needed.
        name: what for, for instance "lab".
        tag: names one run of the system, for instance /run_id; files of other runs are not read.
    """

    def __init__(self, folder: str, name: str, tag: str) -> None:
        self._path = Path(folder) / f"{name}-{''.join(c if c.isalnum() or c == '-' else '_' for c in tag)}.json"
        self._tag = tag

    def write(self, document: Dict[str, Any]) -> None:
        """Replaces the document.

        Raises:
            OSError: if it cannot be written.
        """
        self._path.parent.mkdir(parents=True, exist_ok=True)
        fresh = self._path.with_name(f"{self._path.name}.{os.getpid()}")
        fresh.write_text(json.dumps({"tag": self._tag, "document": document}), encoding="utf-8")
        os.replace(str(fresh), str(self._path))

    def read(self) -> Optional[Dict[str, Any]]:
        """Reads the document; None if there is none of this run."""
        try:
            found = json.loads(self._path.read_text(encoding="utf-8"))
            if found["tag"] == self._tag and isinstance(found["document"], dict):
                return found["document"]
        except (OSError, ValueError, KeyError, TypeError):
            pass
        return None

    def forget_others(self) -> None:
        """Removes files of runs that ended more than a day ago: each leaves one behind."""
        prefix = self._path.name.split("-", 1)[0]
        for path in self._path.parent.glob(f"{prefix}-*"):
            try:
                if path != self._path and time.time() - path.stat().st_mtime > 86400.0:
                    path.unlink()
            except OSError:
                pass  # another process was quicker
