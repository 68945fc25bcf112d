"""The borders of all maps, with their history, in one SQLite file; `database_files` protects it against loss."""

from __future__ import annotations

import datetime
import hashlib
import itertools
import json
import zlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_map_integration.border import MAX_NAME, VirtualBorder
from vb_map_integration.borders.border_values import border_from_mapping, border_to_mapping
from vb_map_integration.places.registration import IDENTITY, Transform
from vb_map_integration.storage import sqlite_files as files
from vb_map_integration.storage.database_files import DatabaseFiles
from vb_map_integration.storage.sqlite_files import Statement, put

# what is kept of each: changes that can be undone, requests, maps of a place
MAX_CHANGES, MAX_REQUESTS, MAX_MAPS = 1000, 1000, 6
_MAP_COLUMNS = files.CHECKED["maps"]


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
    _cells: bytes

    @cached_property
    def grid(self) -> GridMap:
        """Returns the map."""
        data = np.frombuffer(zlib.decompress(self._cells), np.int8).reshape(self._shape)
        return GridMap(data, self._resolution, self._origin)


def fingerprint(grid: GridMap) -> str:
    """Computes a map's identity: 64 hexadecimal digits that depend on every cell, on size, resolution and origin."""
    digest = hashlib.sha256()
    digest.update(np.array(grid.shape, np.int64).tobytes())
    # map_server and bags carry the resolution as float32
    digest.update(np.array([grid.resolution], np.float32).tobytes())
    digest.update(np.array(grid.origin, np.float32).tobytes())
    digest.update(np.ascontiguousarray(grid.data).data)
    return digest.hexdigest()


class Database(DatabaseFiles):
    """Borders by place, with their history; every method that changes something is a transaction."""

    def __init__(self, folder: Optional[Path], today: Any = datetime.date.today) -> None:
        super().__init__(folder, today)
        self._loaded: Dict[int, Dict[str, VirtualBorder]] = {}

    # ------------------------------------------------------------- maps
    def maps(self) -> List[KnownMap]:
        """Reads all maps, the oldest first."""
        return [_map_from_row(row) for row in self._rows(f"SELECT {_MAP_COLUMNS} FROM maps ORDER BY id")]

    def find_map(self, map_id: str) -> Optional[KnownMap]:
        """Reads the map of a fingerprint; None if it is not known."""
        rows = self._rows(f"SELECT {_MAP_COLUMNS} FROM maps WHERE fingerprint = ?", map_id)
        return _map_from_row(rows[0]) if rows else None

    def add_map(
        self, grid: GridMap, map_id: str, place: int = 0, transform: Transform = IDENTITY, name: str = ""
    ) -> int:
        """Keeps a map, as a new place (place 0) or as another map of one; returns the place's number."""
        known = self._rows("SELECT id FROM maps WHERE fingerprint = ?", map_id)
        number = int((known or self._rows("SELECT coalesce(max(id), 0) + 1 FROM maps"))[0][0])
        place = place or number
        cells = zlib.compress(np.ascontiguousarray(grid.data), 1)
        geometry = (grid.resolution, *grid.origin, *grid.shape)
        statements = [put("maps", number, place, name, map_id, *transform, *geometry, cells)]
        others = (
            "SELECT id, fingerprint FROM maps WHERE place = ? AND id NOT IN (?, ?) ORDER BY id DESC LIMIT -1 OFFSET ?"
        )
        needed = {border.map_id for border in self.borders(place)}  # their borders are compared with these
        for old, old_id in self._rows(others, place, place, number, MAX_MAPS):
            if old_id in needed:
                continue
            statements.append(("DELETE FROM maps WHERE id = ?", (old,)))
        self._write(statements)
        return place

    def get_name(self, place: int) -> str:
        """Returns a place's name; "" if it has none."""
        rows = self._rows("SELECT name FROM maps WHERE id = ?", place)
        return str(rows[0][0]) if rows else ""

    def find_place(self, name: str) -> int:
        """Returns the place of a name; 0 if there is none."""
        rows = self._rows("SELECT id FROM maps WHERE name = ? AND name <> '' AND id = place", name)
        return int(rows[0][0]) if rows else 0

    def rename_place(self, place: int, name: str) -> None:
        """Names a place; raises CodedError "name_taken" or "bad_name"."""
        rows = self._rows(f"SELECT {_MAP_COLUMNS} FROM maps WHERE id = ?", place)
        if not rows or rows[0][2] == name:
            return
        self.check_name(name, place)
        self._write([put("maps", *rows[0][:2], name, *rows[0][3:])])

    def check_name(self, name: str, place: int = 0) -> None:
        """Refuses a name that a place cannot have; raises CodedError "bad_name", "name_taken"."""
        if len(name) > MAX_NAME or not (name.isprintable() or not name):
            raise CodedError("bad_name", key="name")
        if self.find_place(name) not in (0, place):
            raise CodedError("name_taken", name=name)

    def remember_place(self, place: int) -> None:
        """Records the last place in force."""
        if self.get_value("last_place") != str(place):
            self.set_value("last_place", str(place))

    def get_value(self, key: str) -> str:
        """Returns the text stored under a key; "" if there is none."""
        rows = self._rows("SELECT value FROM facts WHERE key = ?", key)
        return str(rows[0][0]) if rows else ""

    def set_value(self, key: str, value: str) -> None:
        """Stores a text under a key."""
        self._write([put("facts", key, value)])

    # ------------------------------------------------------------- borders
    def borders(self, place: int) -> Tuple[VirtualBorder, ...]:
        """Returns the borders of a place in its frame, the oldest first."""
        known = self._of_place(place)
        return tuple(known[key] for key in sorted(known, key=_number_of))

    def _of_place(self, place: int) -> Dict[str, VirtualBorder]:
        if place not in self._loaded:
            rows = self._rows("SELECT body FROM borders WHERE place = ?", place)
            found = [border_from_mapping(json.loads(body)) for (body,) in rows]
            self._loaded[place] = {border.id: border for border in found}
        return self._loaded[place]

    def count(self, place: int) -> int:
        """Counts the borders of a place."""
        return int(self._rows("SELECT count(*) FROM borders WHERE place = ?", place)[0][0])

    def find(self, border_id: str) -> Tuple[int, VirtualBorder]:
        """Finds (place, border) of an id, whichever map it belongs to.

        Raises:
            CodedError: "unknown_border".
        """
        rows = self._rows("SELECT place, body FROM borders WHERE id = ?", border_id)
        if not rows:
            raise CodedError("unknown_border", id=border_id)
        return int(rows[0][0]), border_from_mapping(json.loads(rows[0][1]))

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
            kind: "new" (what was undone is forgotten), "undo" or "redo".
            request_id: a repetition of the request finds its border with `find_border_of_request`.

        Raises:
            CodedError: "cannot_write"; then nothing was changed.
        """
        statements: List[Statement] = []
        for entry in change:
            if entry.after is None:
                statements.append(("DELETE FROM borders WHERE id = ?", (entry.id,)))
            else:
                statements.append(put("borders", entry.id, place, _text(border_to_mapping(entry.after))))
        statements += self._history(place, change, kind)
        if request_id:
            statements.append(("INSERT INTO requests (id, border) VALUES (?, ?)", (request_id, change[0].id)))
            last = f"(SELECT max(number) FROM requests) - {MAX_REQUESTS}"
            statements.append((f"DELETE FROM requests WHERE number <= {last}", ()))
        numbers = [_number_of(entry.id) + 1 - self._state.next_number for entry in change]
        self._write(statements, max(0, *numbers))
        known = self._of_place(place)
        for entry in change:
            if entry.after is None:
                known.pop(entry.id, None)
            else:
                known[entry.id] = entry.after

    def _history(self, place: int, change: Change, kind: str) -> List[Statement]:
        if kind in ("undo", "redo"):
            number = self._newest(place, kind)[0]
            return [("UPDATE changes SET undone = ? WHERE number = ?", (int(kind == "undo"), number))]
        number = int(self._rows("SELECT coalesce(max(number), 0) + 1 FROM changes")[0][0])
        body = _text([[entry.id, _to_dict(entry.before), _to_dict(entry.after)] for entry in change])
        return [
            ("DELETE FROM changes WHERE place = ? AND undone = 1", (place,)),
            put("changes", number, place, body),
            ("DELETE FROM changes WHERE number <= ?", (number - MAX_CHANGES,)),
        ]

    def available_commands(self, place: int) -> List[str]:
        """Lists "undo" and "redo", each if there is something to undo or redo."""
        found = self._rows("SELECT DISTINCT undone FROM changes WHERE place = ? ORDER BY undone", place)
        return [("undo", "redo")[undone] for (undone,) in found]

    def _newest(self, place: int, kind: str) -> Tuple[int, Change]:
        """Returns the change that undo reverts, or redo repeats: its number, and what it did."""
        undone, order = (0, "DESC") if kind == "undo" else (1, "ASC")
        query = f"SELECT number, body FROM changes WHERE place = ? AND undone = ? ORDER BY number {order} LIMIT 1"
        rows = self._rows(query, place, undone)
        if not rows:
            raise CodedError(f"nothing_to_{kind}")
        entries = json.loads(rows[0][1])
        return int(rows[0][0]), tuple(
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
        rows = self._rows("SELECT border FROM requests WHERE id = ?", request_id) if request_id else []
        return str(rows[0][0]) if rows else ""


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
