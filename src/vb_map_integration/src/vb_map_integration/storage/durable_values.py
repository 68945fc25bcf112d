"""Stores values on disk so that neither a crash nor a damaged file loses anything acknowledged.

There is so little data that each change writes all of it to a new file, which then replaces the old one. A file is
therefore complete or absent. Its first line is a checksum of the rest. The copy of the day is replaced in the same way.
At start, the file is read. If it is damaged or missing, the copy with the highest revision is read instead.

    borders.jsonl                     checksum; format and revision; then one line per value: key, tab, value
    borders.jsonl.damaged             a file that was found damaged at start
    copies/borders-YYYY-MM-DD.jsonl   borders.jsonl as it was at the end of each of the last days with a change or start

While the program runs, the values in memory are authoritative: if files are deleted or damaged, the next change writes
them again. Only one process may use the folder: it holds a lock for as long as it runs.
"""

from __future__ import annotations

import contextlib
import datetime
import fcntl
import functools
import hashlib
import json
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Mapping, NamedTuple, Optional

from vb_core import files
from vb_core.errors import CodedError
from vb_core.notices import Notice, Severity

FORMAT = 1
FILE = "borders.jsonl"
MAX_COPIES = 14  # days
LOCK_TIMEOUT = 5.0  # [s] how long a new process waits for the previous one to end


@dataclass(frozen=True)
class _Value:
    """A value and its JSON. Each is computed only once, because each change writes all values."""

    json: str

    @functools.cached_property
    def parsed(self) -> Any:
        return json.loads(self.json)


class _Content(NamedTuple):
    """The content of an undamaged file: the revision, and the values by their keys."""

    revision: int
    values: Dict[str, _Value]


class DurableValues:
    """Values that JSON can hold, by keys "kind/name" in the order of their addition. Never change a value in place.

    Args:
        folder: the files' folder; None keeps everything in memory.
        today: returns the date, for the copies.

    Attributes:
        revision: grows with every change, also across restarts.
        notices: problems with the files, for people.

    Raises:
        CodedError: "database_in_use", "database_newer", "cannot_read".
    """

    def __init__(self, folder: Optional[Path], today: Any = datetime.date.today) -> None:
        self.revision = 0
        self.notices: List[Notice] = []
        self._folder = folder
        self._today = today
        self._values: Dict[str, _Value] = {}
        self._lock: Optional[int] = None
        if folder is None:
            return
        try:
            self._take_folder(folder, LOCK_TIMEOUT)
        except OSError as error:
            self._report("database_read_only", Severity.ERROR, what=str(folder), reason=error)
        try:
            self._load(folder)
        except CodedError:
            self.close()
            raise

    def close(self) -> None:
        """Releases the folder to other processes."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def get(self, key: str, default: Any = None) -> Any:
        """Returns the value of a key, or the default."""
        return self._values[key].parsed if key in self._values else default

    def values_of_kind(self, kind: str) -> Dict[str, Any]:
        """Returns the values of one kind by their names, the oldest first."""
        start = f"{kind}/"
        return {key[len(start) :]: value.parsed for key, value in self._values.items() if key.startswith(start)}

    def write(self, changes: Mapping[str, Any]) -> None:
        """Sets values, all or none of them; None removes a value.

        Raises:
            CodedError: "cannot_write", "database_in_use"; then nothing was changed.
        """
        values = dict(self._values)
        for key, value in changes.items():
            if value is None:
                values.pop(key, None)
            else:
                values[key] = _Value(json.dumps(value, separators=(",", ":")))
        content = _Content(self.revision + 1, values)
        if self._folder is not None:
            try:
                self._take_folder(self._folder, 0.0)
            except OSError as error:
                raise CodedError("cannot_write", what=FILE, reason=error.strerror or error) from None
            try:
                self._write_files(self._folder, content)
            except CodedError:
                with contextlib.suppress(CodedError):  # one of the files may already have the new content
                    self._write_files(self._folder, _Content(self.revision, self._values))
                raise
        self.revision, self._values = content

    def _load(self, folder: Path) -> None:
        path = folder / FILE
        content, read_error = None, None
        try:
            content = _read(path)
        except OSError as error:  # it may be undamaged, and readable later
            read_error = error
        is_damaged = content is None and read_error is None and path.exists()
        copies = {path: _read_or_none(path) for path in (folder / "copies").glob("*.jsonl")}
        newest = max((copy.revision for copy in copies.values() if copy is not None), default=0)
        if content is None:
            content = self._choose_copy(folder, copies)
        elif content.revision < newest:  # a person restored an old copy: it counts from now on
            content = content._replace(revision=newest + 1)
        if content is None and read_error is not None:
            raise CodedError("cannot_read", file=read_error.filename, reason=read_error.strerror) from None
        if content is None and is_damaged:
            self._report("borders_lost", Severity.ERROR, what=str(folder))
        try:
            if is_damaged:
                os.replace(str(path), f"{path}.damaged")
            for path in folder.rglob(".borders*"):  # left by an interrupted write
                path.unlink()
            if content is not None:
                self.revision, self._values = content
                if not (content == _read_or_none(folder / FILE) == _read_or_none(self._copy_path(folder))):
                    self._write_files(folder, content)
        except (OSError, CodedError) as error:
            self._report("database_read_only", Severity.ERROR, what=str(folder), reason=error)

    def _choose_copy(self, folder: Path, copies: Mapping[Path, Optional[_Content]]) -> Optional[_Content]:
        """Returns the content of the copy with the highest revision. Dates decide nothing, because clocks go wrong."""
        intact = {path: content for path, content in copies.items() if content is not None}
        if not intact:
            return None
        path, content = max(intact.items(), key=lambda item: item[1].revision)
        if len(intact) == len(copies):
            self._report("database_repaired", Severity.WARNING, what=str(folder), date=path.stem[-10:])
        else:
            self._report("borders_lost_since", Severity.ERROR, date=path.stem[-10:])
        return content

    def _copy_path(self, folder: Path) -> Path:
        return folder / "copies" / f"borders-{self._today().isoformat()}.jsonl"

    def _write_files(self, folder: Path, content: _Content) -> None:
        lines = [json.dumps([FORMAT, content.revision])]
        lines += [f"{json.dumps(key)}\t{value.json}" for key, value in content.values.items()]
        rest = "\n".join([*lines, ""]).encode()
        whole = _checksum(rest) + b"\n" + rest
        copy = self._copy_path(folder)
        files.write_together({folder / FILE: whole, copy: whole})
        other_copies = sorted(path for path in copy.parent.glob("*.jsonl") if path != copy)
        for old in other_copies[: 1 - MAX_COPIES]:
            with contextlib.suppress(OSError):
                old.unlink()
        self.notices = [notice for notice in self.notices if notice.code != "database_read_only"]

    def _take_folder(self, folder: Path, timeout: float) -> None:
        """Locks the folder within `timeout` [s]. Does so again if the lock file was deleted, as another may hold it."""
        path = folder / "borders.lock"
        if self._lock is not None and path.exists() and os.path.samestat(os.fstat(self._lock), path.stat()):
            return
        self.close()
        folder.mkdir(parents=True, exist_ok=True)
        self._lock = os.open(str(path), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        end = time.monotonic() + timeout
        while True:
            try:
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            except BlockingIOError:
                if time.monotonic() >= end:
                    self.close()
                    raise CodedError("database_in_use", what=str(folder)) from None
                time.sleep(0.05)
            except OSError:
                self.close()
                raise

    def _report(self, code: str, severity: Severity, **values: Any) -> None:
        self.notices.append(Notice.from_error(CodedError(code, **values), severity))


def _read(path: Path) -> Optional[_Content]:
    """Reads a file. Returns None if it is missing or damaged. Raises CodedError "database_newer"."""
    try:
        checksum, _, rest = path.read_bytes().partition(b"\n")
    except (FileNotFoundError, NotADirectoryError):
        return None
    if checksum != _checksum(rest):
        return None
    head, *lines = rest.decode().rstrip("\n").split("\n")
    version, revision = json.loads(head)[:2]
    if version != FORMAT:
        raise CodedError("database_newer", what=str(path))
    pairs = (line.split("\t", 1) for line in lines)
    return _Content(revision, {json.loads(key): _Value(value) for key, value in pairs})


def _read_or_none(path: Path) -> Optional[_Content]:
    try:
        return _read(path)
    except OSError:
        return None


def _checksum(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=16).hexdigest().encode()
