"""Writing files atomically."""
from __future__ import annotations

import os
import tempfile
from pathlib import Path

from vb_core.errors import CodedError


def write_atomically(path: Path, content: bytes) -> None:
    """Writes a file so that it always has either the old or the new content, complete.

    Raises:
        CodedError: "cannot_write".
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=str(path.parent))
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(content)
                stream.flush()
                os.fsync(stream.fileno())
            os.chmod(temporary, 0o644)
            os.replace(temporary, str(path))
        except BaseException:
            if os.path.exists(temporary):
                os.unlink(temporary)
            raise
        folder = os.open(str(path.parent), os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    except OSError as error:
        raise CodedError("cannot_write", what=str(path), reason=error.strerror or str(error)) from None
