"""Changes single values in a camera's settings file, and leaves the rest of it, comments too, as a person wrote it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Mapping, Union

import yaml

from vb_core.errors import CodedError
from vb_core.files import write_atomically

_GROUP = "capture"


def set_capture(path: Path, values: Mapping[str, Union[int, float]]) -> None:
    """Sets values of the group `capture` in detectors/NAME.yaml.

    Raises:
        CodedError: "bad_file" if the file is none that can be changed this way, "cannot_write".
    """
    try:
        text = path.read_text(encoding="utf-8")
        before = yaml.safe_load(text) or {}
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise CodedError("bad_file", file=path, why=str(error)) from None
    text = re.sub(r"^\{\}\s*$", "", text, flags=re.MULTILINE).rstrip() + "\n"
    if not re.search(rf"^{_GROUP}:\s*$", text, re.MULTILINE):
        text += f"{_GROUP}:\n"
    for name, value in values.items():
        line = f"  {name}: {value}"
        text, count = re.subn(rf"^  {name}:[^#\n]*", line + " ", text, flags=re.MULTILINE)
        if not count:
            text = re.sub(rf"^{_GROUP}:[ \t]*$", f"{_GROUP}:\n{line}", text, count=1, flags=re.MULTILINE)
    text = re.sub(r"[ \t]+$", "", text, flags=re.MULTILINE)
    try:
        after = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise CodedError("bad_file", file=path, why=str(error)) from None
    if after != {**before, _GROUP: {**(before.get(_GROUP) or {}), **values}}:
        raise CodedError("bad_file", file=path, why="'capture' is not written in lines of its own")
    write_atomically(path, text.encode("utf-8"))
