"""Writes files so that a reader never finds a partly written one."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path
from typing import Dict, Mapping, Union

from vb_core.errors import CodedError

PRIVATE = 0o600  # mode of a file that only its owner may read and write


def restrict_to_owner(path: Path) -> bool:
    """Makes a file with secrets or personal data readable by its owner only. Returns whether others could read it.

    Raises:
        CodedError: "file_not_private" if that is not possible.
    """
    try:
        if not path.is_file() or not stat.S_IMODE(path.stat().st_mode) & 0o077:
            return False
        path.chmod(PRIVATE)
        return True
    except OSError as error:
        raise CodedError("file_not_private", file=path, reason=error.strerror or error) from None


def write_atomically(path: Path, content: bytes, private: bool = False) -> None:
    """Writes a file so that it always holds either the complete old or the complete new content.

    Args:
        private: whether only its owner may read it.

    Raises:
        CodedError: "cannot_write"; the file keeps its old content.
    """
    write_together({path: content}, private)


def write_together(contents: Mapping[Path, bytes], private: bool = False) -> None:
    """Writes files as `write_atomically` does, and replaces none before all are on disk. A crash may replace only some."""
    temporary: Dict[Path, str] = {}
    path = Path()
    try:
        for path, content in contents.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            handle, temporary[path] = tempfile.mkstemp(prefix=f".{path.name}.", dir=str(path.parent))
            with os.fdopen(handle, "wb") as stream:
                stream.write(content)
                stream.flush()
                os.fsync(stream.fileno())
            os.chmod(temporary[path], PRIVATE if private else 0o644)
        for path in contents:
            os.replace(temporary[path], str(path))
        for parent in {path.parent for path in contents}:
            folder = os.open(str(parent), os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
    except OSError as error:
        raise CodedError("cannot_write", what=str(path), reason=error.strerror or str(error)) from None
    finally:
        for name in temporary.values():
            if os.path.exists(name):
                os.unlink(name)


def append_line(path: Union[str, Path], line: str) -> None:
    """Appends a line to a file in one write, so that lines of two writers never mix.

    Creates the file's folder, and the file so that only its owner may read it.

    Raises:
        OSError: if it cannot be written.
    """
    os.makedirs(os.path.dirname(str(path)), exist_ok=True)
    with open(str(path), "ab", buffering=0, opener=lambda name, flags: os.open(name, flags, PRIVATE)) as log:
        log.write((line + "\n").encode("utf-8"))
