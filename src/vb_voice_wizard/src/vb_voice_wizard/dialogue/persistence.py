"""What the interaction manager keeps in files: the current interaction, and the record of those that ended."""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path
from typing import Any, Dict, Optional, Sequence

from vb_core.errors import CodedError, ParameterError
from vb_core.files import write_atomically
from vb_voice_wizard.session import Record


def file_path(key: str, path: str) -> str:
    """Returns the path with ~ expanded. Whether it can be written shows when it is: a disk may be full or read-only for
    a while.

    Raises:
        ParameterError: names the key if it is a folder.
    """
    full = os.path.abspath(os.path.expanduser(path))
    if os.path.isdir(full):
        raise ParameterError(key, f"{full} is a folder")
    return full


class StateFile:
    """A small JSON file, replaced as a whole and durably.

    Args:
        path: the file.
        run_id: names the run of the roscore; what another run left behind is no longer valid.
    """

    def __init__(self, path: str, run_id: str) -> None:
        self._path = Path(path)
        self._run_id = run_id

    def write(self, memory: Dict[str, Any]) -> None:
        """Replaces the file.

        Raises:
            CodedError: "cannot_write".
        """
        write_atomically(self._path, json.dumps({"run_id": self._run_id, **memory}).encode("utf-8"))

    def read(self) -> Optional[Dict[str, Any]]:
        """Reads what this run of the roscore has saved; None if nothing.

        Raises:
            CodedError: "bad_state_file" if the file is not valid.
        """
        try:
            memory = json.loads(self._path.read_bytes())
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            raise CodedError("bad_state_file", f"cannot read {self._path}: {error}") from None
        if not isinstance(memory, dict):
            raise CodedError("bad_state_file", f"{self._path} does not hold the saved state of an interaction")
        # without an id of the run (a bare rosmaster) nothing tells an old file from a new one
        return memory if self._run_id and memory.get("run_id") == self._run_id else None


def record_line(record: Record, method: str, cameras: Sequence[str]) -> str:
    """Writes one interaction as one line of JSON, without the line's end; times in seconds."""
    fields = dataclasses.asdict(record)
    fields["sources"] = list(record.sources)
    for key, value in fields.items():
        if isinstance(value, float):
            fields[key] = round(value, 3)
    return json.dumps({**fields, "method": method, "cameras": list(cameras)})
