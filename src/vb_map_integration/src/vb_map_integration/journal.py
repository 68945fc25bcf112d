"""The journal of a store: one line of JSON for each change, appended, so that a change costs the same however many
borders there are. It is also the history that undo and redo go back in.

A line that is there whole is a change that was made. One that was cut off, by a kill or a full disk, was not.
"""
from __future__ import annotations

import contextlib
import json
import os
from pathlib import Path
from typing import Any, List, NamedTuple, Optional, Tuple

from vb_core.errors import CodedError
from vb_map_integration.border import VirtualBorder
from vb_map_integration.border_files import border_from_mapping, border_to_mapping
from vb_map_integration.map_files import write_atomically
from vb_map_integration.store import BorderStore, Change, Entry

# beyond it the older half of what can be undone is forgotten: some thousand changes
LIMIT_BYTES = 8_000_000
# kinds of a line beside those of `BorderStore.changed`: what a shortened journal begins with
_UNDOABLE, _REDOABLE = "undoable", "redoable"


class _Line(NamedTuple):
    revision: int
    kind: str
    change: Change


class Journal:
    """The file; see above.

    Args:
        limit_bytes: size beyond which `shorten` forgets.
    """

    def __init__(self, path: Path, limit_bytes: int = LIMIT_BYTES) -> None:
        self.path = path
        self._limit = limit_bytes

    @property
    def too_long(self) -> bool:
        """Whether it is time to `shorten` it."""
        return self.path.exists() and self.path.stat().st_size > self._limit

    @property
    def cut_off(self) -> bool:
        """Whether it ends in a change that was under way, to which nothing can be appended."""
        try:
            with open(str(self.path), "rb") as stream:
                stream.seek(-1, os.SEEK_END)
                return stream.read() != b"\n"
        except OSError:
            return False  # none, or an empty one

    def replay(self, snapshot: BorderStore) -> Tuple[BorderStore, bool]:
        """The store after all changes that were made since a snapshot, with its history; inverse of `append`.

        Returns:
            The store, and whether the journal fits: no line is damaged or missing where it matters.
        """
        try:
            raw_lines = self.path.read_bytes().splitlines(keepends=True)
        except OSError:
            return snapshot, True
        store, sound = snapshot, True
        undoable: List[Change] = []
        redoable: List[Change] = []
        last: Optional[int] = None
        for raw in raw_lines:
            line = _parse(raw)
            if line is None and not raw.endswith(b"\n"):
                break  # a change that was under way
            if line is None:
                sound, last = False, None
                undoable, redoable = [], []
            elif line.revision <= snapshot.revision:
                sound = True  # what was damaged is older than the snapshot
                if last is not None and line.revision not in (last, last + 1):
                    undoable, redoable = [], []
                last = line.revision
                _follow(line, undoable, redoable)
            else:
                if store is snapshot:
                    if last != snapshot.revision:
                        undoable, redoable = [], []
                    store = snapshot.with_history(undoable, redoable)
                if line.revision != store.revision + 1 or line.kind in (_UNDOABLE, _REDOABLE):
                    return store, False
                store, sound = store.changed(line.change, line.kind), True  # none is missing in between
        if store is snapshot and last == snapshot.revision:
            store = snapshot.with_history(undoable, redoable)
        return store, sound

    def append(self, revision: int, kind: str, change: Change) -> None:
        """Appends a change that leads to a revision; after that it is made.

        Raises:
            CodedError: "cannot_write"; then the journal is as it was.
        """
        # a line that was cut off, and could not be taken back, must not spoil the next one
        text = (b"\n" if self.cut_off else b"") + _text(revision, kind, change)
        size: Optional[int] = None
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with open(str(self.path), "ab") as stream:
                size = stream.tell()
                stream.write(text)
                stream.flush()
                os.fsync(stream.fileno())
        except OSError as error:
            if size is not None:
                with contextlib.suppress(OSError):
                    os.truncate(str(self.path), size)
            raise CodedError("cannot_write", f"cannot write {self.path}: {error.strerror or error}") from None

    def shorten(self, store: BorderStore) -> None:
        """Makes the journal anew of what a store can undo and redo, as far as it fits into half of the limit.

        Raises:
            CodedError: "cannot_write".
        """
        lines = [_text(store.revision, _REDOABLE, change) for change in reversed(store.redoable)]
        room = self._limit // 2 - sum(map(len, lines))
        for change in reversed(store.undoable):
            text = _text(store.revision, _UNDOABLE, change)
            room -= len(text)
            if room < 0:
                break
            lines.append(text)
        write_atomically(self.path, b"".join(reversed(lines)))


def _follow(line: _Line, undoable: List[Change], redoable: List[Change]) -> None:
    """What a change that a snapshot holds already did to the history."""
    if line.kind == "undo" and undoable:
        redoable.append(undoable.pop())
    elif line.kind == "redo" and redoable:
        undoable.append(redoable.pop())
    elif line.kind == "new":
        undoable.append(line.change)
        redoable.clear()
    elif line.kind == _UNDOABLE:
        undoable.append(line.change)
    elif line.kind == _REDOABLE:
        redoable.append(line.change)


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
        if not raw.endswith(b"\n"):
            return None
        values = json.loads(raw.decode())
        change = tuple(Entry(str(key), _border(before), _border(after)) for key, before, after in values["change"])
        return _Line(int(values["revision"]), str(values["kind"]), change)
    except (ValueError, KeyError, TypeError, CodedError):
        return None
