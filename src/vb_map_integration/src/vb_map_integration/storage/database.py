"""The borders of all maps in one SQLite file, protected against loss.

The idea: a change is made once it is committed, and everything that is kept is kept twice. Each change goes into the
database and then into a replica beside it, row by row, so that a damaged file never costs what was acknowledged. Every
row carries a checksum, and a checksum over all rows and the revision tells whether rows are missing, or are those of an
older state (SQLite itself finds damaged pages, not changed values). At start both files are checked; the better one
replaces the other, and `notices` says what was done. If both are damaged, the newest sound daily copy is taken.

    borders.db          maps, borders, changes (history), requests, facts; write-ahead log, synchronous
    borders.twin.db     the same
    copies/borders-YYYY-MM-DD.db    of each of the last days, as of its first change or its last start
    damaged/...         files that were set aside

One process writes at a time: it holds a lock for as long as it runs.
"""

from __future__ import annotations

import contextlib
import datetime
import fcntl
import hashlib
import itertools
import json
import os
import shutil
import sqlite3
import tempfile
import time
import zlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Dict, Iterable, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.notices import Notice, Severity
from vb_map_integration.border import VirtualBorder
from vb_map_integration.borders.border_files import border_from_mapping, border_to_mapping
from vb_map_integration.places.registration import IDENTITY, Transform

FILE = "borders.db"
FORMAT = 1
# what is kept of each: changes that can be undone, requests, daily copies, damaged files, maps of a place
MAX_CHANGES, MAX_REQUESTS, MAX_COPIES, MAX_DAMAGED, MAX_MAPS = 1000, 1000, 14, 3, 6
# [s] how long a new process waits for the one before to end
LOCK_TIMEOUT = 5.0

_SCHEMA = """
CREATE TABLE maps (
    id INTEGER PRIMARY KEY, place INTEGER NOT NULL, name TEXT NOT NULL, fingerprint TEXT NOT NULL UNIQUE,
    x REAL NOT NULL, y REAL NOT NULL, yaw REAL NOT NULL,
    resolution REAL NOT NULL, origin_x REAL NOT NULL, origin_y REAL NOT NULL, origin_yaw REAL NOT NULL,
    rows INTEGER NOT NULL, columns INTEGER NOT NULL, cells BLOB, digest TEXT NOT NULL);
CREATE TABLE borders (id TEXT PRIMARY KEY, place INTEGER NOT NULL, body TEXT NOT NULL, digest TEXT NOT NULL);
CREATE INDEX borders_of_place ON borders (place);
CREATE TABLE changes (
    number INTEGER PRIMARY KEY, place INTEGER NOT NULL, undone INTEGER NOT NULL, body TEXT NOT NULL,
    digest TEXT NOT NULL);
CREATE INDEX changes_of_place ON changes (place, undone, number);
CREATE TABLE requests (number INTEGER PRIMARY KEY, id TEXT NOT NULL UNIQUE, border TEXT NOT NULL);
CREATE TABLE facts (key TEXT PRIMARY KEY, value TEXT NOT NULL);
"""
_MAP_COLUMNS = (
    "id, place, name, fingerprint, x, y, yaw, resolution, origin_x, origin_y, origin_yaw, rows, columns, cells"
)
_PUT_MAP = f"INSERT OR REPLACE INTO maps ({_MAP_COLUMNS}, digest) VALUES ({', '.join('?' * 15)})"
_PUT_BORDER = "INSERT OR REPLACE INTO borders VALUES (?, ?, ?, ?)"
_PUT_FACT = "INSERT OR REPLACE INTO facts VALUES (?, ?)"

# the replica need not be on the disk before the answer: after a power failure it is outdated, and is written again
_OF_REPLICA = "NORMAL"
# of the files that belong to one database
_ENDS = ("", "-wal", "-shm", "-journal")
_EMPTY = "empty"
# more than SQLite needs to open a file: its shared memory has 32 kB
_PROBE_BYTES = 200_000
_MEMORY = "/dev/shm"  # a file system that needs no disk
Statement = Tuple[str, Sequence[Any]]


class BorderChange(NamedTuple):
    """One border's state before or after a change; None where it did not exist."""

    id: str
    before: Optional[VirtualBorder]
    after: Optional[VirtualBorder]


# what one command changed
Change = Tuple[BorderChange, ...]


@dataclass(frozen=True)
class KnownMap:
    """A map that the database knows.

    Attributes:
        id: its number.
        place: the number of the map on which the place's first border was drawn; the borders are in its frame.
        name: for people; only of that first map.
        fingerprint: see `fingerprint`.
        transform: from the place's frame to this map's.
    """

    id: int
    place: int
    name: str
    fingerprint: str
    transform: Transform
    _resolution: float
    _origin: Tuple[float, float, float]
    _shape: Tuple[int, int]
    _cells: Optional[bytes]

    @cached_property
    def grid(self) -> Optional[GridMap]:
        """Returns the map; None if its cells could not be imported."""
        if self._cells is None:
            return None
        data = np.frombuffer(zlib.decompress(self._cells), np.int8).reshape(self._shape)
        return GridMap(data, self._resolution, self._origin)


class DatabaseSummary(NamedTuple):
    """Facts about a readable database file, besides its rows."""

    revision: int
    next_number: int
    sum: int
    borders: int = 0


def fingerprint(grid: GridMap) -> str:
    """Computes a map's identity: 64 hexadecimal digits that depend on every cell, on size, resolution and origin."""
    digest = hashlib.sha256()
    digest.update(np.array(grid.shape, np.int64).tobytes())
    # map_server and bags carry the resolution as float32
    digest.update(np.array([grid.resolution], np.float32).tobytes())
    digest.update(np.array(grid.origin, np.float32).tobytes())
    digest.update(np.ascontiguousarray(grid.data).data)
    return digest.hexdigest()


class Database:
    """Borders by place, with their history; every method that changes something is a transaction.

    Args:
        folder: where the files are; None keeps everything in memory.
        today: returns the date, for daily copies.

    Attributes:
        revision: grows with every change, across restarts.
        notices: what was wrong at start, for people.

    Raises:
        CodedError: "database_in_use".
    """

    def __init__(self, folder: Optional[Path], today: Any = datetime.date.today) -> None:
        self.folder = folder
        self.notices: List[Notice] = []
        self._today = today
        self._lock: Optional[int] = None
        self._replica: Optional[sqlite3.Connection] = None
        self._replica_is_good = True
        self._read_only = ""
        self._loaded: Dict[int, Dict[str, VirtualBorder]] = {}
        if folder is None:
            self._main = _connect(":memory:")
            _create(self._main)
            self._state = DatabaseSummary(0, 1, 0)
            return
        self._path, self._replica_path = folder / FILE, folder / FILE.replace(".db", ".twin.db")
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._take_lock()
            _try_to_write(folder)
            self._main, self._state = self._open_best_copy()
        except (OSError, sqlite3.Error) as error:
            self._main, self._state = self._open_for_reading(error)

    def can_reopen(self) -> bool:
        """Returns whether the disk could not be written at the start, and now can be: then a new start finds what is there."""
        if not self._read_only or self.folder is None:
            return False
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            _try_to_write(self.folder)
        except OSError:
            return False
        return True

    def close(self) -> None:
        """Closes the files."""
        for connection in (self._main, self._replica):
            if connection is not None:
                with contextlib.suppress(sqlite3.Error):
                    connection.close()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    # ------------------------------------------------------------- start, check, repair
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
                    os.close(self._lock)
                    self._lock = None
                    raise CodedError("database_in_use", what=str(self._path)) from None
                time.sleep(0.05)

    def _open_best_copy(self) -> Tuple[sqlite3.Connection, DatabaseSummary]:
        main, why_main = check_file(self._path)
        replica, why_replica = check_file(self._replica_path)
        if {why_main, why_replica} <= {"", _EMPTY} and main is None and replica is None and not self.copies():
            _delete(self._path)  # none yet, or the very first start was cut off
            connection = _connect(self._path)
            _create(connection)
            main = DatabaseSummary(0, 1, 0)
            connection.close()
        elif main is None or (replica is not None and replica.revision > main.revision):
            if main is not None and replica is not None:
                why_main = f"revision {main.revision} instead of {replica.revision}"
            main = self._repair(why_main, replica)
        elif replica is None and why_replica:
            self._report("replica_repaired", Severity.INFO, reason=why_replica)
        connection = _connect(self._path)
        try:
            if replica is None or replica != main:
                if replica is None:
                    _set_aside(self._replica_path)
                else:
                    _delete(self._replica_path)
                _copy(connection, self._replica_path)
            self._replica = _connect(self._replica_path, _OF_REPLICA)
            if main.revision:
                self._copy_of_the_day(connection, renew=True)
        except (sqlite3.Error, OSError) as error:
            self._lose_replica(error)
        return connection, main

    def _repair(self, why: str, replica: Optional[DatabaseSummary]) -> DatabaseSummary:
        """Replaces the database by its replica, by the newest sound copy, or by an empty one."""
        _set_aside(self._path)
        for source in [self._replica_path] if replica is not None else self.copies():
            found, _ = check_file(source)
            if found is None:
                continue
            connection = _connect(source)
            _copy(connection, self._path)
            connection.close()
            if replica is not None:
                self._report("database_repaired", Severity.WARNING, reason=why)
            else:
                self._report(
                    "borders_lost_since", Severity.ERROR, reason=why, date=source.stem[-10:], count=found.borders
                )
            return found
        connection = _connect(self._path)
        _create(connection)
        connection.close()
        self._report("borders_lost", Severity.ERROR, reason=why, what=str(self._path.parent / "damaged"))
        return DatabaseSummary(0, 1, 0)

    def _open_for_reading(self, error: Exception) -> Tuple[sqlite3.Connection, DatabaseSummary]:
        """Reads what it can from a disk that is full or read-only: borders act, and no change is accepted."""
        self._read_only = str(error)
        self._report("database_read_only", Severity.ERROR, what=str(self.folder), reason=self._read_only)
        best, state = _connect(":memory:"), DatabaseSummary(0, 1, 0)
        _create(best)
        for path in (self._path, self._replica_path):
            with tempfile.TemporaryDirectory(dir=_MEMORY if os.path.isdir(_MEMORY) else None) as folder:
                copy = Path(folder) / "copy.db"
                try:
                    for end in _ENDS:  # with its log, which may hold the latest changes
                        if Path(f"{path}{end}").exists():
                            shutil.copyfile(f"{path}{end}", f"{copy}{end}")
                    found, _ = check_file(copy)
                except OSError:
                    copy = path
                    found, _ = check_file(path, "?immutable=1")
                if found is not None and found.revision > state.revision:
                    source = sqlite3.connect(f"file:{copy}{'?immutable=1' if copy == path else ''}", uri=True)
                    best, state = sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False), found
                    source.backup(best)
                    source.close()
        return best, state

    def copies(self) -> List[Path]:
        """Lists the daily copies, the newest first."""
        assert self.folder is not None
        return sorted((self.folder / "copies").glob("borders-????-??-??.db"), reverse=True)

    def _report(self, code: str, severity: Severity, **values: Any) -> None:
        self.notices.append(Notice.from_values(code, severity, values))

    def _lose_replica(self, error: Exception) -> None:
        self._replica_is_good = False
        self.notices = [notice for notice in self.notices if notice.code != "replica_outdated"]
        self._report("replica_outdated", Severity.WARNING, reason=str(error))

    # ------------------------------------------------------------- writing
    @property
    def revision(self) -> int:
        """Grows with every change."""
        return self._state.revision

    def _write(
        self, statements: List[Statement], out: Sequence[str] = (), into: Sequence[str] = (), ids: int = 0
    ) -> None:
        """Makes a transaction in the database, and then in its replica; digests that leave and enter the sum come along.

        Raises:
            CodedError: "cannot_write"; then nothing was changed.
        """
        if self._read_only:
            raise CodedError("cannot_write", what=FILE, reason=self._read_only)
        total = self._state.sum
        for digest in (*out, *into):
            total ^= int(digest, 16)
        state = DatabaseSummary(self._state.revision + 1, self._state.next_number + ids, total)
        statements = statements + [(_PUT_FACT, (key, value)) for key, value in _facts(state)]
        try:
            _run(self._main, statements)
        except sqlite3.Error as error:
            raise CodedError("cannot_write", what=FILE, reason=str(error)) from None
        self._state = state
        if self.folder is None:
            return
        try:
            if not self._replica_is_good or self._replica is None:
                if self._replica is not None:
                    self._replica.close()
                    self._replica = None
                _delete(self._replica_path)
                _copy(self._main, self._replica_path)
                self._replica = _connect(self._replica_path, _OF_REPLICA)
                self._replica_is_good = True
                self.notices = [notice for notice in self.notices if notice.code != "replica_outdated"]
            else:
                _run(self._replica, statements)
            self._copy_of_the_day(self._main)
        except (sqlite3.Error, OSError) as error:  # the change is made: only its second place is missing
            self._lose_replica(error)

    def _copy_of_the_day(self, connection: sqlite3.Connection, renew: bool = False) -> None:
        assert self.folder is not None
        path = self.folder / "copies" / f"borders-{self._today().isoformat()}.db"
        if path.exists() and not renew:
            return
        path.parent.mkdir(exist_ok=True)
        temporary = path.with_suffix(".new")
        _delete(temporary)
        _copy(connection, temporary)
        os.replace(str(temporary), str(path))
        for old in self.copies()[MAX_COPIES:]:
            old.unlink()

    def _digests(self, table: str, where: str, arguments: Sequence[Any]) -> List[str]:
        return [row[0] for row in self._main.execute(f"SELECT digest FROM {table} WHERE {where}", arguments)]

    # ------------------------------------------------------------- maps
    def maps(self) -> List[KnownMap]:
        """Reads all maps, the oldest first."""
        rows = self._main.execute(f"SELECT {_MAP_COLUMNS} FROM maps ORDER BY id")
        return [_map_from_row(row) for row in rows]

    def find_map(self, map_id: str) -> Optional[KnownMap]:
        """Reads the map of a fingerprint; None if it is not known."""
        row = self._main.execute(f"SELECT {_MAP_COLUMNS} FROM maps WHERE fingerprint = ?", (map_id,)).fetchone()
        return None if row is None else _map_from_row(row)

    def add_map(
        self, grid: Optional[GridMap], map_id: str, place: int = 0, transform: Transform = IDENTITY, name: str = ""
    ) -> int:
        """Keeps a map, as a new place (place 0) or as another map of one; returns the place's number."""
        known = self.find_map(map_id)
        last = self._main.execute("SELECT coalesce(max(id), 0) FROM maps").fetchone()[0]
        number = known.id if known else int(last) + 1
        place = place or number
        geometry = (0.05, (0.0, 0.0, 0.0), (0, 0), None)
        if grid is not None:
            geometry = (grid.resolution, grid.origin, grid.shape, zlib.compress(np.ascontiguousarray(grid.data), 1))
        resolution, origin, shape, cells = geometry
        row = (number, place, name, map_id, *transform, resolution, *origin, *shape, cells)
        digest = _digest(*row)
        out = self._digests("maps", "id = ?", (number,))
        statements: List[Statement] = [(_PUT_MAP, (*row, digest))]
        others = "SELECT id FROM maps WHERE place = ? AND id NOT IN (?, ?) ORDER BY id DESC LIMIT -1 OFFSET ?"
        for (old,) in self._main.execute(others, (place, place, number, MAX_MAPS)).fetchall():
            out += self._digests("maps", "id = ?", (old,))
            statements.append(("DELETE FROM maps WHERE id = ?", (old,)))
        self._write(statements, out, [digest])
        return place

    def get_name(self, place: int) -> str:
        """Returns a place's name; "" if it has none."""
        row = self._main.execute("SELECT name FROM maps WHERE id = ?", (place,)).fetchone()
        return "" if row is None else str(row[0])

    def find_place(self, name: str) -> int:
        """Returns the place of a name; 0 if there is none."""
        row = self._main.execute("SELECT id FROM maps WHERE name = ? AND name <> '' AND id = place", (name,)).fetchone()
        return 0 if row is None else int(row[0])

    def rename_place(self, place: int, name: str) -> None:
        """Names a place; raises CodedError "name_taken"."""
        row = self._main.execute(f"SELECT {_MAP_COLUMNS} FROM maps WHERE id = ?", (place,)).fetchone()
        if row is None or row[2] == name:
            return
        if self.find_place(name) not in (0, place):
            raise CodedError("name_taken", name=name)
        new = (*row[:2], name, *row[3:])
        digest = _digest(*new)
        self._write([(_PUT_MAP, (*new, digest))], self._digests("maps", "id = ?", (place,)), [digest])

    def remember_place(self, place: int) -> None:
        """Records the last place in force."""
        if self.get_value("last_place") != str(place):
            self._write([(_PUT_FACT, ("last_place", str(place)))])

    def get_value(self, key: str) -> str:
        """Returns the text stored under a key; "" if there is none."""
        row = self._main.execute("SELECT value FROM facts WHERE key = ?", (key,)).fetchone()
        return "" if row is None else str(row[0])

    def set_value(self, key: str, value: str) -> None:
        """Stores a text under a key."""
        self._write([(_PUT_FACT, (key, value))])

    # ------------------------------------------------------------- borders
    def borders(self, place: int) -> Tuple[VirtualBorder, ...]:
        """Returns the borders of a place in its frame, the oldest first."""
        known = self._of_place(place)
        return tuple(known[key] for key in sorted(known, key=_number_of))

    def _of_place(self, place: int) -> Dict[str, VirtualBorder]:
        if place not in self._loaded:
            rows = self._main.execute("SELECT body FROM borders WHERE place = ?", (place,))
            found = [border_from_mapping(json.loads(body)) for (body,) in rows]
            self._loaded[place] = {border.id: border for border in found}
        return self._loaded[place]

    def count(self, place: int) -> int:
        """Counts the borders of a place."""
        return int(self._main.execute("SELECT count(*) FROM borders WHERE place = ?", (place,)).fetchone()[0])

    def find(self, border_id: str) -> Tuple[int, VirtualBorder]:
        """Finds (place, border) of an id, whichever map it belongs to.

        Raises:
            CodedError: "unknown_border".
        """
        row = self._main.execute("SELECT place, body FROM borders WHERE id = ?", (border_id,)).fetchone()
        if row is None:
            raise CodedError("unknown_border", id=border_id)
        return int(row[0]), border_from_mapping(json.loads(row[1]))

    def new_border(self, border: VirtualBorder, now: float, place: int) -> VirtualBorder:
        """Gives a border of a place an id, which is spent once committed, a name that no other there has, and its times.

        Raises:
            CodedError: "id_not_empty".
        """
        if border.id:
            raise CodedError("id_not_empty", id=border.id)
        number = self._state.next_number
        taken = {other.name for other in self.borders(place)}
        unnamed = (f"{'wall' if border.wall else 'border'} {i}" for i in itertools.count(1))
        name = border.name or next(one for one in unnamed if one not in taken)
        return border.replace(id=f"b{number}", name=name, created=now, modified=now)

    def commit(self, place: int, change: Change, kind: str = "new", request_id: str = "") -> None:
        """Makes a change of borders of one place.

        Args:
            kind: "new" (what was undone is forgotten), "undo", "redo", or "quiet" (no place in the history).
            request_id: a repetition of the request finds its border with `find_border_of_request`.

        Raises:
            CodedError: "cannot_write"; then nothing was changed.
        """
        statements: List[Statement] = []
        out: List[str] = []
        into: List[str] = []
        for entry in change:
            out += self._digests("borders", "id = ?", (entry.id,))
            if entry.after is None:
                statements.append(("DELETE FROM borders WHERE id = ?", (entry.id,)))
                continue
            body = _text(border_to_mapping(entry.after))
            digest = _digest(entry.id, place, body)
            into.append(digest)
            statements.append((_PUT_BORDER, (entry.id, place, body, digest)))
        statements += self._history(place, change, kind)
        if request_id:
            statements.append(("INSERT INTO requests (id, border) VALUES (?, ?)", (request_id, change[0].id)))
            last = f"(SELECT max(number) FROM requests) - {MAX_REQUESTS}"
            statements.append((f"DELETE FROM requests WHERE number <= {last}", ()))
        numbers = [_number_of(entry.id) + 1 - self._state.next_number for entry in change]
        self._write(statements, out, into, max(0, *numbers))
        known = self._of_place(place)
        for entry in change:
            if entry.after is None:
                known.pop(entry.id, None)
            else:
                known[entry.id] = entry.after

    def _history(self, place: int, change: Change, kind: str) -> List[Statement]:
        if kind == "quiet":
            return []
        if kind in ("undo", "redo"):
            number = self._newest(place, kind)[0]
            return [("UPDATE changes SET undone = ? WHERE number = ?", (int(kind == "undo"), number))]
        body = _text([[entry.id, _to_dict(entry.before), _to_dict(entry.after)] for entry in change])
        return [
            ("DELETE FROM changes WHERE place = ? AND undone = 1", (place,)),
            (
                "INSERT INTO changes (place, undone, body, digest) VALUES (?, 0, ?, ?)",
                (place, body, _digest(place, body)),
            ),
            (f"DELETE FROM changes WHERE number <= (SELECT max(number) FROM changes) - {MAX_CHANGES}", ()),
        ]

    def available_commands(self, place: int) -> List[str]:
        """Lists "undo" and "redo", each if there is something to undo or redo."""
        found = self._main.execute("SELECT DISTINCT undone FROM changes WHERE place = ? ORDER BY undone", (place,))
        return [("undo", "redo")[undone] for (undone,) in found]

    def _newest(self, place: int, kind: str) -> Tuple[int, Change]:
        """Returns the change that undo reverts, or redo repeats: its number, and what it did."""
        undone, order = (0, "DESC") if kind == "undo" else (1, "ASC")
        row = self._main.execute(
            f"SELECT number, body FROM changes WHERE place = ? AND undone = ? ORDER BY number {order} LIMIT 1",
            (place, undone),
        ).fetchone()
        if row is None:
            raise CodedError(f"nothing_to_{kind}")
        entries = json.loads(row[1])
        return int(row[0]), tuple(
            BorderChange(key, _from_dict(before), _from_dict(after)) for key, before, after in entries
        )

    def prepare_undo(self, place: int) -> Change:
        """Prepares the change that reverts the last one; raises CodedError "nothing_to_undo"."""
        _, change = self._newest(place, "undo")
        return tuple(BorderChange(entry.id, entry.after, entry.before) for entry in reversed(change))

    def prepare_redo(self, place: int) -> Change:
        """Prepares the change that repeats what was undone last; raises CodedError "nothing_to_redo"."""
        return self._newest(place, "redo")[1]

    def find_border_of_request(self, request_id: str) -> str:
        """Returns the id of the border that a request made; "" if it is new."""
        row = self._main.execute("SELECT border FROM requests WHERE id = ?", (request_id,)).fetchone()
        return "" if row is None or not request_id else str(row[0])

    def import_legacy(self, place: int, borders: Iterable[VirtualBorder], note: str) -> Dict[str, str]:
        """Adds borders of an older version, with their ids if these are free; returns the ids that had to change."""
        change: List[BorderChange] = []
        renamed: Dict[str, str] = {}
        number = max([self._state.next_number, *(_number_of(border.id) + 1 for border in borders)])
        for border in borders:
            taken = self._main.execute("SELECT 1 FROM borders WHERE id = ?", (border.id,)).fetchone()
            if taken or not _number_of(border.id):
                renamed[border.id] = f"b{number}"
                border = border.replace(id=f"b{number}")
                number += 1
            change.append(BorderChange(border.id, None, border))
        if change:
            self.commit(place, tuple(change), "quiet")
        self.set_value(note, "done")
        return renamed


# ----------------------------------------------------------------- files
def restore(folder: Path, source: Path) -> None:
    """Restores a copy; the current files are set aside.

    Raises:
        CodedError: "database_in_use", "damaged_copy", "cannot_write".
    """
    if check_file(source)[0] is None:
        raise CodedError("damaged_copy", what=str(source))
    database = Database(folder)  # no other process writes while it is open
    copy = folder / "restore.new"
    try:
        _delete(copy)
        _copy(_connect(source), copy)
        for connection in (database._main, database._replica):
            if connection is not None:
                connection.close()
        _set_aside(database._path)
        _set_aside(database._replica_path)
        os.replace(str(copy), str(database._path))
    except (sqlite3.Error, OSError) as error:
        raise CodedError("cannot_write", what=str(folder), reason=str(error)) from None
    finally:
        database.close()


def _try_to_write(folder: Path) -> None:
    """Raises OSError on a disk that is full: there a sound file looks damaged, and must not be set aside."""
    with tempfile.NamedTemporaryFile(dir=str(folder)) as stream:
        stream.write(bytes(_PROBE_BYTES))
        stream.flush()
        os.fsync(stream.fileno())


def _connect(path: Any, synchronous: str = "FULL") -> sqlite3.Connection:
    connection = sqlite3.connect(str(path), isolation_level=None, check_same_thread=False, timeout=2.0)
    for pragma in ("journal_mode = WAL", f"synchronous = {synchronous}", "cell_size_check = ON"):
        connection.execute(f"PRAGMA {pragma}")
    return connection


def _create(connection: sqlite3.Connection) -> None:
    facts = [(_PUT_FACT, (key, value)) for key, value in _facts(DatabaseSummary(0, 1, 0))]
    tables = [(statement, ()) for statement in _SCHEMA.split(";") if statement.strip()]
    _run(connection, [*tables, *facts, (f"PRAGMA user_version = {FORMAT}", ())])


def _run(connection: sqlite3.Connection, statements: Iterable[Statement]) -> None:
    """Runs a transaction, all or nothing."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        for statement, arguments in statements:
            connection.execute(statement, arguments)
        connection.execute("COMMIT")
    except BaseException:
        if connection.in_transaction:
            with contextlib.suppress(sqlite3.Error):
                connection.execute("ROLLBACK")
        raise


def _copy(connection: sqlite3.Connection, path: Path) -> None:
    """Copies the whole database by SQLite's backup; it is on the disk when this returns."""
    target = sqlite3.connect(str(path), isolation_level=None)
    try:
        connection.backup(target)
    finally:
        target.close()
    with open(str(path), "rb") as stream:
        os.fsync(stream.fileno())


def check_file(path: Path, options: str = "") -> Tuple[Optional[DatabaseSummary], str]:
    """Checks a database; returns what it holds if it is sound, else None, and why ("" if there is no file)."""
    if not path.exists():
        return None, ""
    connection: Optional[sqlite3.Connection] = None
    try:
        connection = sqlite3.connect(f"file:{path}{options}", uri=True) if options else _connect(path)
        if connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0] == 0:
            return None, _EMPTY
        found = connection.execute("PRAGMA integrity_check(1)").fetchone()[0]
        if found != "ok":
            return None, str(found)
        if connection.execute("PRAGMA user_version").fetchone()[0] != FORMAT:
            return None, "unknown format"
        total = 0
        for row in connection.execute(f"SELECT {_MAP_COLUMNS}, digest FROM maps"):
            if _digest(*row[:-1]) != row[-1]:
                return None, f"map {row[0]} is damaged"
            total ^= int(row[-1], 16)
        for key, place, body, digest in connection.execute("SELECT id, place, body, digest FROM borders"):
            if _digest(key, place, body) != digest:
                return None, f"border {key} is damaged"
            total ^= int(digest, 16)
        for number, place, body, digest in connection.execute("SELECT number, place, body, digest FROM changes"):
            if _digest(place, body) != digest:
                return None, f"change {number} is damaged"
        facts = dict(connection.execute("SELECT key, value FROM facts"))
        count = connection.execute("SELECT count(*) FROM borders").fetchone()[0]
        state = DatabaseSummary(int(facts["revision"]), int(facts["next_number"]), total, int(count))
        if dict(_facts(state))["content"] != facts["content"]:
            return None, "its rows do not belong to its revision"
        return state, ""
    except Exception as error:  # whatever a damaged file causes, it must not end the program
        return None, str(error) or type(error).__name__
    finally:
        if connection is not None:
            with contextlib.suppress(sqlite3.Error):
                connection.close()


def _set_aside(path: Path) -> None:
    """Moves a database's files into the folder of damaged ones, of which the last few are kept."""
    folder = path.parent / "damaged"
    folder.mkdir(exist_ok=True)
    stamp = datetime.datetime.now().strftime("%Y-%m-%d-%H%M%S-%f")
    for end in _ENDS:
        if Path(f"{path}{end}").exists():
            shutil.move(f"{path}{end}", str(folder / f"{stamp}-{path.name}{end}"))
    kept = sorted({found.name[:24] for found in folder.iterdir()}, reverse=True)[:MAX_DAMAGED]
    for found in folder.iterdir():
        if found.name[:24] not in kept:
            found.unlink()


def _delete(path: Path) -> None:
    for end in _ENDS:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(f"{path}{end}")


# ----------------------------------------------------------------- rows
def _facts(state: DatabaseSummary) -> List[Tuple[str, str]]:
    content = _digest(state.revision, state.next_number, state.sum)
    return [("revision", str(state.revision)), ("next_number", str(state.next_number)), ("content", content)]


def _digest(*values: Any) -> str:
    """Returns 16 hexadecimal digits of a row's values."""
    digest = hashlib.blake2b(digest_size=8)
    for value in values:
        digest.update(value if isinstance(value, bytes) else repr(value).encode())
        digest.update(b"\0")
    return digest.hexdigest()


def _text(values: Any) -> str:
    return json.dumps(values, ensure_ascii=False, separators=(",", ":"))


def _to_dict(border: Optional[VirtualBorder]) -> Any:
    return None if border is None else border_to_mapping(border)


def _from_dict(values: Any) -> Optional[VirtualBorder]:
    return None if values is None else border_from_mapping(values)


def _map_from_row(row: Sequence[Any]) -> KnownMap:
    number, place, name, map_id, x, y, yaw, resolution, origin_x, origin_y, origin_yaw, rows, columns, cells = row
    origin = (origin_x, origin_y, origin_yaw)
    return KnownMap(number, place, name, map_id, Transform(x, y, yaw), resolution, origin, (rows, columns), cells)


def _number_of(border_id: str) -> int:
    """Returns the number in an id that the database gave; the higher, the younger."""
    digits = border_id[1:]
    return int(digits) if border_id[:1] == "b" and digits.isdigit() and len(digits) < 10 else 0
