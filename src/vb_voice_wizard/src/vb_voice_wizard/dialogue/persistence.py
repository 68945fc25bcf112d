"""What the interaction manager keeps in files: the current interaction, and the record of those that ended."""

from __future__ import annotations

import dataclasses
import json
import os
from typing import Any, Dict, Optional, Sequence

from vb_core.errors import CodedError, ParameterError
from vb_voice_wizard.interaction import Record


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
    """A small JSON file, replaced as a whole so that a reader never sees half of it.

    Args:
        path: the file.
        run_id: names the run of the roscore; what another run left behind is no longer valid.
    """

    def __init__(self, path: str, run_id: str) -> None:
        self._path = path
        self._run_id = run_id

    def write(self, memory: Dict[str, Any]) -> None:
        """Replaces the file.

        Raises:
            OSError: if it cannot be written.
        """
        os.makedirs(os.path.dirname(self._path), exist_ok=True)
        temporary = f"{self._path}.{os.getpid()}.new"
        with open(temporary, "w", encoding="utf-8") as file:
            json.dump({"run_id": self._run_id, **memory}, file)
        os.replace(temporary, self._path)

    def read(self) -> Optional[Dict[str, Any]]:
        """Reads what this run of the roscore has saved; None if nothing. Raises as `read_any`."""
        memory = self.read_any()
        # without an id of the run (a bare rosmaster) nothing tells an old file from a new one
        if memory is None or not self._run_id or memory.get("run_id") != self._run_id:
            return None
        return memory

    def read_any(self) -> Optional[Dict[str, Any]]:
        """Reads what was saved last, by any run; None if there is no file.

        Raises:
            CodedError: "bad_state_file" if the file is not valid.
        """
        try:
            with open(self._path, encoding="utf-8") as file:
                memory = json.load(file)
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            raise CodedError("bad_state_file", f"cannot read {self._path}: {error}") from None
        if not isinstance(memory, dict):
            raise CodedError("bad_state_file", f"{self._path} does not hold the saved state of an interaction")
        return memory


def record_line(record: Record, method: str, cameras: Sequence[str]) -> str:
    """Writes one interaction as one line of JSON, without the line's end; times in seconds."""
    fields = dataclasses.asdict(record)
    fields["sources"] = list(record.sources)
    for key, value in fields.items():
        if isinstance(value, float):
            fields[key] = round(value, 3)
    return json.dumps({**fields, "method": method, "cameras": list(cameras)})
