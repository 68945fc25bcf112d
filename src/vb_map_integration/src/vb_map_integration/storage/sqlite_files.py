"""SQLite files of borders: opened, checked, copied and set aside.

SQLite's own integrity check finds damaged pages, missing rows and broken indices, but not a value that changed. So each
row that matters carries a checksum, which SQLite computes by `checksum` when a row is written and when a file is checked.
"""

from __future__ import annotations

import contextlib
import datetime
import hashlib
import os
import shutil
import sqlite3
import tempfile
from pathlib import Path
from typing import Any, Iterable, List, NamedTuple, Optional, Sequence, Tuple

FORMAT = 1
MAX_DAMAGED = 3  # damaged databases that are kept
# of the files that belong to one database
ENDS = ("", "-wal", "-shm", "-journal")
EMPTY, NEWER = "empty", "of a newer version"
# more than SQLite needs to open a file: its shared memory has 32 kB
_PROBE_BYTES = 200_000

_SCHEMA = """
CREATE TABLE maps (
    id INTEGER PRIMARY KEY, place INTEGER NOT NULL, name TEXT NOT NULL, fingerprint TEXT NOT NULL UNIQUE,
    x REAL NOT NULL, y REAL NOT NULL, yaw REAL NOT NULL,
    resolution REAL NOT NULL, origin_x REAL NOT NULL, origin_y REAL NOT NULL, origin_yaw REAL NOT NULL,
    rows INTEGER NOT NULL, columns INTEGER NOT NULL, cells BLOB NOT NULL, digest TEXT NOT NULL);
CREATE TABLE borders (id TEXT PRIMARY KEY, place INTEGER NOT NULL, body TEXT NOT NULL, digest TEXT NOT NULL);
CREATE INDEX borders_of_place ON borders (place);
CREATE TABLE changes (
    number INTEGER PRIMARY KEY, place INTEGER NOT NULL, body TEXT NOT NULL, digest TEXT NOT NULL,
    undone INTEGER NOT NULL DEFAULT 0);
CREATE INDEX changes_of_place ON changes (place, undone, number);
CREATE TABLE requests (number INTEGER PRIMARY KEY, id TEXT NOT NULL UNIQUE, border TEXT NOT NULL);
CREATE TABLE facts (key TEXT PRIMARY KEY, value TEXT NOT NULL, digest TEXT NOT NULL);
"""
# what the checksum of each table's rows is of
CHECKED = {
    "maps": "id, place, name, fingerprint, x, y, yaw, resolution, origin_x, origin_y, origin_yaw, rows, columns, cells",
    "borders": "id, place, body",
    "changes": "number, place, body",
    "facts": "key, value",
}
Statement = Tuple[str, Sequence[Any]]


class DatabaseSummary(NamedTuple):
    """Facts about a readable database file, besides its rows."""

    revision: int = 0
    next_number: int = 1
    borders: int = 0


def put(table: str, *values: Any) -> Statement:
    """Makes the statement that writes a row, with its checksum."""
    numbers = ", ".join(f"?{number + 1}" for number in range(len(values)))
    columns = CHECKED[table]
    return f"INSERT OR REPLACE INTO {table} ({columns}, digest) VALUES ({numbers}, checksum({numbers}))", values


def connect(path: Any, synchronous: str = "FULL", options: str = "") -> sqlite3.Connection:
    """Opens a database with a write-ahead log; with options, such as "?immutable=1", as it is."""
    connection = sqlite3.connect(
        f"file:{path}{options}" if options else str(path),
        isolation_level=None,
        check_same_thread=False,
        timeout=2.0,
        uri=bool(options),
    )
    try:
        connection.create_function("checksum", -1, _checksum, deterministic=True)
        for pragma in () if options else ("journal_mode = WAL", f"synchronous = {synchronous}", "cell_size_check = ON"):
            connection.execute(f"PRAGMA {pragma}")
    except sqlite3.Error:
        connection.close()
        raise
    return connection


def _checksum(*values: Any) -> str:
    """Returns 16 hexadecimal digits of a row's values."""
    digest = hashlib.blake2b(digest_size=8)
    for value in values:
        digest.update(value if isinstance(value, bytes) else repr(value).encode())
        digest.update(b"\0")
    return digest.hexdigest()


def create(connection: sqlite3.Connection) -> None:
    """Makes the tables of an empty database."""
    tables = [(statement, ()) for statement in _SCHEMA.split(";") if statement.strip()]
    run(connection, [*tables, *facts_of(DatabaseSummary()), (f"PRAGMA user_version = {FORMAT}", ())])


def facts_of(state: DatabaseSummary) -> List[Statement]:
    """Makes the statements that write a database's facts."""
    return [put("facts", "revision", str(state.revision)), put("facts", "next_number", str(state.next_number))]


def run(connection: sqlite3.Connection, statements: Iterable[Statement], before_commit: Any = None) -> None:
    """Runs a transaction, all or nothing; also nothing if `before_commit` raises."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        for statement, arguments in statements:
            connection.execute(statement, arguments)
        if before_commit is not None:
            before_commit()
        connection.execute("COMMIT")
    except BaseException:
        if connection.in_transaction:
            with contextlib.suppress(sqlite3.Error):
                connection.execute("ROLLBACK")
        raise


def copy(connection: sqlite3.Connection, path: Path) -> None:
    """Copies the whole database by SQLite's backup, in place of what is there; it is on the disk when this returns."""
    temporary = path.with_name(path.name + ".new")
    delete(temporary)
    target = sqlite3.connect(str(temporary), isolation_level=None)
    try:
        connection.backup(target)
    finally:
        target.close()
    with open(str(temporary), "rb") as stream:
        os.fsync(stream.fileno())
    delete(path)
    os.replace(str(temporary), str(path))


def check_file(path: Path, options: str = "") -> Tuple[Optional[DatabaseSummary], str]:
    """Checks a database; returns what it holds if it is sound, else None, and why ("" if there is no file)."""
    if not path.exists():
        return None, ""
    connection: Optional[sqlite3.Connection] = None
    try:
        connection = connect(path, options=options)
        if connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0] == 0:
            return None, EMPTY
        found = connection.execute("PRAGMA integrity_check(1)").fetchone()[0]
        if found != "ok":
            return None, str(found)
        version = connection.execute("PRAGMA user_version").fetchone()[0]
        if version != FORMAT:
            return None, NEWER if version > FORMAT else "unknown format"
        for table, columns in CHECKED.items():
            if connection.execute(f"SELECT 1 FROM {table} WHERE digest IS NOT checksum({columns})").fetchone():
                return None, f"a value in the table {table} is damaged"
        facts = dict(connection.execute("SELECT key, value FROM facts"))
        count = connection.execute("SELECT count(*) FROM borders").fetchone()[0]
        return DatabaseSummary(int(facts["revision"]), int(facts["next_number"]), int(count)), ""
    except Exception as error:  # whatever a damaged file causes, it must not end the program
        return None, str(error) or type(error).__name__
    finally:
        if connection is not None:
            with contextlib.suppress(sqlite3.Error):
                connection.close()


def read_revision(path: Path) -> int:
    """Reads a file's revision without checking it; -1 if that cannot be read."""
    try:
        connection = connect(path, options="?immutable=1")
        rows = connection.execute("SELECT value FROM facts WHERE key = 'revision'").fetchall()
        connection.close()
        return int(rows[0][0])
    except (sqlite3.Error, ValueError, IndexError):
        return -1


def file_id(path: Any) -> Optional[Tuple[int, int]]:
    """Identifies the file that a path, or an open descriptor, leads to; None if there is none."""
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_dev, found.st_ino


def try_to_write(folder: Path) -> None:
    """Raises OSError on a disk that is full: there a sound file looks damaged, and must not be set aside."""
    with tempfile.NamedTemporaryFile(dir=str(folder)) as stream:
        stream.write(bytes(_PROBE_BYTES))
        stream.flush()
        os.fsync(stream.fileno())


def set_aside(path: Path) -> None:
    """Moves a database's files into the folder of damaged ones, of which the last few are kept."""
    folder = path.parent / "damaged"
    found = [end for end in ENDS if Path(f"{path}{end}").exists()]
    if not found:
        return
    folder.mkdir(exist_ok=True)
    stamp = datetime.datetime.now().strftime("%Y-%m-%d-%H%M%S-%f")
    for end in found:
        shutil.move(f"{path}{end}", str(folder / f"{stamp}-{path.name}{end}"))
    kept = sorted({old.name[:24] for old in folder.iterdir()}, reverse=True)[:MAX_DAMAGED]
    for old in folder.iterdir():
        if old.name[:24] not in kept:
            old.unlink()


def delete(path: Path) -> None:
    """Deletes a database's files."""
    for end in ENDS:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(f"{path}{end}")
