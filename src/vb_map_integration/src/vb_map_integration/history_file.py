"""The history of undo and redo on the disk: one line of JSON for each change, appended.

It is no copy of the borders, these have a file of their own; a history that is damaged, or does not end at the
state that the borders are in, is left out as far as it is in doubt.
"""
from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, List, NamedTuple, Optional, Tuple

from vb_core.errors import CodedError
from vb_map_integration.border import VirtualBorder
from vb_map_integration.border_files import border_from_mapping, border_to_mapping
from vb_map_integration.map_files import write_atomically
from vb_map_integration.store import Change, Entry

# beyond it the older half is forgotten: some thousand changes
LIMIT_BYTES = 8_000_000
# kinds of a line beside those of `BorderStore.changed`: what a shortened history begins with
_UNDOABLE, _REDOABLE = "undoable", "redoable"


class _Line(NamedTuple):
    revision: int
    kind: str
    change: Change


class HistoryFile:
    """The file; see above.

    Args:
        limit_bytes: size beyond which the older half is forgotten.
    """

    def __init__(self, path: Path, limit_bytes: int = LIMIT_BYTES) -> None:
        self.path = path
        self._limit = limit_bytes

    def read(self, revision: int) -> Tuple[List[Change], List[Change]]:
        """What can be undone and redone at a revision, the next one last; shortens the file where that is wanted.

        Raises:
            CodedError: "cannot_write".
        """
        try:
            content = self.path.read_bytes()
        except OSError:
            return [], []
        undoable: List[Change] = []
        redoable: List[Change] = []
        last: Optional[int] = None
        rewrite = len(content) > self._limit or not content.endswith(b"\n")
        for raw in content.splitlines():
            line = _parse(raw)
            if line is None or (last is not None and line.revision not in (last, last + 1)):
                undoable, redoable, rewrite = [], [], True
            if line is None:
                continue
            if line.revision > revision:  # killed before the borders were written
                rewrite = True
                break
            last = line.revision
            if line.kind == "undo" and undoable:
                redoable.append(undoable.pop())
            elif line.kind == "redo" and redoable:
                undoable.append(redoable.pop())
            elif line.kind in ("new", _UNDOABLE):
                undoable.append(line.change)
                if line.kind == "new":
                    redoable = []
            elif line.kind == _REDOABLE:
                redoable.append(line.change)
        if last != revision:
            undoable, redoable, rewrite = [], [], True
        if rewrite:
            self._rewrite(revision, undoable, redoable)
        return undoable, redoable

    def append(self, revision: int, kind: str, change: Change) -> int:
        """Appends a change that leads to a revision; gives the file's size before, for `truncate`.

        Raises:
            CodedError: "cannot_write".
        """
        text = _text(revision, kind, change)
        size = 0
        try:
            with open(str(self.path), "ab") as stream:
                size = stream.tell()
                stream.write(text)
        except OSError as error:
            self.truncate(size)
            raise CodedError("cannot_write", f"cannot write {self.path}: {error.strerror or error}") from None
        return size

    def truncate(self, size: int) -> None:
        """Takes back what was appended."""
        try:
            os.truncate(str(self.path), size)
        except OSError:
            pass  # then the next start finds a line too many, and leaves it out

    def _rewrite(self, revision: int, undoable: List[Change], redoable: List[Change]) -> None:
        lines = [_text(revision, _REDOABLE, change) for change in redoable]
        room = self._limit // 2 - sum(map(len, lines))
        kept = 0
        for change in reversed(undoable):
            text = _text(revision, _UNDOABLE, change)
            room -= len(text)
            if room < 0:
                break
            lines.append(text)
            kept += 1
        del undoable[: len(undoable) - kept]
        write_atomically(self.path, b"".join(reversed(lines)))


def _text(revision: int, kind: str, change: Change) -> bytes:
    entries = [[entry.id, _plain(entry.before), _plain(entry.after)] for entry in change]
    return json.dumps({"revision": revision, "kind": kind, "change": entries}).encode() + b"\n"


def _plain(border: Optional[VirtualBorder]) -> Any:
    return None if border is None else border_to_mapping(border)


def _border(values: Any) -> Optional[VirtualBorder]:
    return None if values is None else border_from_mapping(values)


def _parse(raw: bytes) -> Optional[_Line]:
    """A line; None for a damaged one."""
    try:
        values = json.loads(raw.decode())
        change = tuple(Entry(str(key), _border(before), _border(after)) for key, before, after in values["change"])
        return _Line(int(values["revision"]), str(values["kind"]), change)
    except (ValueError, KeyError, TypeError, CodedError):
        return None
