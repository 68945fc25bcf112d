"""What the interaction manager keeps in files: where they are, and a line for each interaction that ended."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Sequence

from vb_core.errors import ParameterError
from vb_voice_wizard.session import Record


def file_path(key: str, path: str) -> Path:
    """Returns the path with ~ expanded. Whether it can be written shows when it is: a disk may be full or read-only for
    a while.

    Raises:
        ParameterError: names the key if it is a folder.
    """
    full = Path(path).expanduser().absolute()
    if full.is_dir():
        raise ParameterError(key, f"{full} is a folder")
    return full


def record_line(record: Record, method: str, cameras: Sequence[str]) -> str:
    """Writes one interaction as one line of JSON, without the line's end; times in seconds."""
    fields = dataclasses.asdict(record)
    fields["sources"] = list(record.sources)
    for key, value in fields.items():
        if isinstance(value, float):
            fields[key] = round(value, 3)
    return json.dumps({**fields, "method": method, "cameras": list(cameras)})
