"""The borders of all maps in one SQLite file, protected against loss.

The idea: a change is made once it is committed, and everything that is kept is kept twice. Each change goes into the
database and then into a replica beside it, so that a damaged file never costs what was acknowledged. At start both files
are checked; the one with the higher revision replaces the other, and `notices` says what was done. If both are damaged,
the sound copy with the highest revision is taken.

    borders.db          maps, borders, changes (history), requests, facts; write-ahead log, synchronous
    borders.twin.db     the same
    copies/REVISION-YYYY-MM-DD.db   of each of the last days, as of its first change or its last start
    damaged/...         files that were set aside

One process writes at a time: it holds a lock for as long as it runs. Each commit makes sure that lock and database are
still the files that were opened. After any failure the files are opened, checked and repaired again by `reopen`.
"""

from __future__ import annotations

import contextlib
import datetime
import fcntl
import os
import shutil
import sqlite3
import tempfile
import time
from pathlib import Path
from typing import Any, Dict, List, Optional, Tuple

from vb_core.errors import CodedError
from vb_core.notices import Notice, Severity
from vb_map_integration.storage import sqlite_files as files
from vb_map_integration.storage.sqlite_files import DatabaseSummary, Statement

FILE = "borders.db"
MAX_COPIES = 14  # daily copies that are kept
# [s] how long a new process waits for the one before to end
LOCK_TIMEOUT = 5.0
# the replica need not be on the disk before the answer: after a power failure it is outdated, and is written again
_OF_REPLICA = "NORMAL"
_MEMORY = "/dev/shm"  # a file system that needs no disk


class DatabaseFiles:
    """The files of a database: opened, checked and repaired at a start, read and written in one place each.

    Args:
        folder: where the files are; None keeps everything in memory.
        today: returns the date, for daily copies.

    Attributes:
        revision: grows with every change, across restarts.
        notices: what was wrong at start, for people.

    Raises:
        CodedError: "database_in_use", "database_newer". Every method: "database_failed" if the files cannot be read.
    """

    def __init__(self, folder: Optional[Path], today: Any = datetime.date.today) -> None:
        self.folder = folder
        self.notices: List[Notice] = []
        self._today = today
        self._lock: Optional[int] = None
        self._replica: Optional[sqlite3.Connection] = None
        self._read_only = ""
        self._failed = False
        self._opened: Dict[str, Any] = {}
        if folder is None:
            self._main = files.connect(":memory:")
            files.create(self._main)
            self._state = DatabaseSummary()
            return
        self._path, self._replica_path = folder / FILE, folder / FILE.replace(".db", ".twin.db")
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._take_lock()
            files.try_to_write(folder)
            self._main, self._state = self._open_best_copy()
        except (OSError, sqlite3.Error) as error:
            self._main, self._state = self._open_for_reading(error)
        except CodedError:
            self._release_lock()
            raise

    def close(self) -> None:
        """Closes the files."""
        for connection in (self._main, self._replica):
            if connection is not None:
                with contextlib.suppress(sqlite3.Error):
                    connection.close()
        self._release_lock()

    # ------------------------------------------------------------- start, check, repair
    def can_reopen(self) -> bool:
        """Returns whether the files failed, and the disk can be written now: then `reopen` finds what is there."""
        if self.folder is None or not (self._read_only or self._failed):
            return False
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            files.try_to_write(self.folder)
        except OSError:
            return False
        return True

    def reopen(self) -> Any:
        """Opens the files again, as at a start; one that was deleted while it was open is written first.

        Raises:
            CodedError: as at a start; this database is closed then, too.
        """
        assert self.folder is not None
        try:
            self._release_lock()
            self._take_lock()  # if it was deleted, another process may have it by now
            if self._opened and not self._path.exists():
                with contextlib.suppress(sqlite3.Error, OSError):
                    files.copy(self._main, self._path)
        finally:
            self.close()
        return type(self)(self.folder, self._today)

    def _take_lock(self) -> None:
        assert self.folder is not None
        self._lock = os.open(str(self.folder / f"{FILE}.lock"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        end = time.monotonic() + LOCK_TIMEOUT
        while True:
            try:
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            except BlockingIOError:
                if time.monotonic() >= end:
                    self._release_lock()
                    raise CodedError("database_in_use", what=str(self._path)) from None
                time.sleep(0.05)

    def _release_lock(self) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def _open_best_copy(self) -> Tuple[sqlite3.Connection, DatabaseSummary]:
        main, why_main = files.check_file(self._path)
        replica, why_replica = files.check_file(self._replica_path)
        if files.NEWER in (why_main, why_replica) and main is None and replica is None:
            raise CodedError("database_newer", what=str(self._path))
        if {why_main, why_replica} <= {"", files.EMPTY} and main is None and replica is None and not self.copies():
            files.delete(self._path)  # none yet, or the very first start was cut off
            self._make_empty()
            main = DatabaseSummary()
        elif main is None or (replica is not None and replica.revision > main.revision):
            if main is not None and replica is not None:
                why_main = f"revision {main.revision} instead of {replica.revision}"
            main = self._repair(why_main, replica)
        elif replica is None and why_replica:
            self._report("replica_repaired", Severity.INFO, reason=why_replica)
        connection = files.connect(self._path)
        try:
            if replica is None:
                files.set_aside(self._replica_path)
            if replica != main:
                files.copy(connection, self._replica_path)
            self._replica = files.connect(self._replica_path, _OF_REPLICA)
            if main.revision:
                self._copy_of_the_day(connection, renew=True)
        except (sqlite3.Error, OSError) as error:
            self._lose_replica(error)
        connection.execute("SELECT count(*) FROM facts")  # the log exists from here on
        self._opened = {path: files.file_id(path) for path in (str(self._path), f"{self._path}-wal")}
        return connection, main

    def _make_empty(self) -> None:
        connection = files.connect(self._path)
        files.create(connection)
        connection.close()

    def _repair(self, why: str, replica: Optional[DatabaseSummary]) -> DatabaseSummary:
        """Replaces the database by its replica, by the sound copy of the highest revision, or by an empty one."""
        files.set_aside(self._path)
        for source in [self._replica_path] if replica is not None else self.copies():
            found, _ = files.check_file(source)
            if found is None:
                continue
            connection = files.connect(source)
            files.copy(connection, self._path)
            connection.close()
            if replica is not None:
                self._report("database_repaired", Severity.WARNING, reason=why)
            else:
                date = source.stem[-10:]
                self._report("borders_lost_since", Severity.ERROR, reason=why, date=date, count=found.borders)
            return found
        self._make_empty()
        self._report("borders_lost", Severity.ERROR, reason=why, what=str(self._path.parent / "damaged"))
        return DatabaseSummary()

    def _open_for_reading(self, error: Exception) -> Tuple[sqlite3.Connection, DatabaseSummary]:
        """Reads what it can from a disk that is full or read-only: borders act, and no change is accepted."""
        self._read_only = str(error)
        self._report("database_read_only", Severity.ERROR, what=str(self.folder), reason=self._read_only)
        best, state = files.connect(":memory:"), DatabaseSummary()
        files.create(best)
        for path in (self._path, self._replica_path):
            with tempfile.TemporaryDirectory(dir=_MEMORY if os.path.isdir(_MEMORY) else None) as folder:
                copy, options = Path(folder) / "copy.db", ""
                try:
                    for end in files.ENDS:  # with its log, which may hold the latest changes
                        if Path(f"{path}{end}").exists():
                            shutil.copyfile(f"{path}{end}", f"{copy}{end}")
                except OSError:
                    copy, options = path, "?immutable=1"
                found, _ = files.check_file(copy, options)
                if found is not None and found.revision > state.revision:
                    source = files.connect(copy, options=options)
                    best, state = files.connect(":memory:"), found
                    source.backup(best)
                    source.close()
        return best, state

    def copies(self) -> List[Path]:
        """Lists the daily copies, the highest revision first: dates are only for people, and clocks go wrong."""
        assert self.folder is not None
        return sorted((self.folder / "copies").glob("*.db"), key=files.read_revision, reverse=True)

    def _report(self, code: str, severity: Severity, **values: Any) -> None:
        self.notices.append(Notice.from_error(CodedError(code, **values), severity))

    def _lose_replica(self, error: Exception) -> None:
        if self._replica is not None:
            self._replica.close()
            self._replica = None
        self.notices = [notice for notice in self.notices if notice.code != "replica_outdated"]
        self._report("replica_outdated", Severity.WARNING, reason=str(error))

    # ------------------------------------------------------------- reading and writing
    @property
    def revision(self) -> int:
        """Grows with every change."""
        return self._state.revision

    def _rows(self, query: str, *arguments: Any) -> List[Any]:
        """Reads rows; the only place that does."""
        try:
            return self._main.execute(query, arguments).fetchall()
        except sqlite3.Error as error:
            self._failed = True
            raise CodedError("database_failed", what=FILE, reason=str(error)) from None

    def _write(self, statements: List[Statement], ids: int = 0) -> None:
        """Makes a transaction in the database, and then in its replica; the only place that does.

        Raises:
            CodedError: "cannot_write"; then nothing was changed.
        """
        if self._read_only:
            raise CodedError("cannot_write", what=FILE, reason=self._read_only)
        state = DatabaseSummary(self._state.revision + 1, self._state.next_number + ids)
        statements = [*statements, *files.facts_of(state)]
        try:
            files.run(self._main, statements, self._check_files)
        except (sqlite3.Error, OSError) as error:
            self._failed = True
            raise CodedError("cannot_write", what=FILE, reason=str(error)) from None
        self._state = state
        if self.folder is None:
            return
        try:
            if self._replica is None or not self._replica_path.exists():
                if self._replica is not None:
                    self._replica.close()
                files.copy(self._main, self._replica_path)
                self._replica = files.connect(self._replica_path, _OF_REPLICA)
                self.notices = [notice for notice in self.notices if notice.code != "replica_outdated"]
            else:
                files.run(self._replica, statements)
            self._copy_of_the_day(self._main)
        except (sqlite3.Error, OSError) as error:  # the change is made: only its second place is missing
            self._lose_replica(error)

    def _check_files(self) -> None:
        """Raises OSError if lock or database are not the files that were opened: what is written there would be lost."""
        opened = {**self._opened, f"{self._path}.lock": files.file_id(self._lock)} if self._opened else {}
        for path, identity in opened.items():
            if files.file_id(path) != identity:
                raise OSError(f"{path} was deleted or replaced")

    def _copy_of_the_day(self, connection: sqlite3.Connection, renew: bool = False) -> None:
        assert self.folder is not None
        path = self.folder / "copies" / f"borders-{self._today().isoformat()}.db"
        if path.exists() and not renew:
            return
        path.parent.mkdir(exist_ok=True)
        files.copy(connection, path)
        for old in self.copies()[MAX_COPIES:]:
            old.unlink()
