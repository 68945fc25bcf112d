"""The borders of all maps, with their history and their maps, in a store of `DurableValues`.

Keys: maps/FINGERPRINT, names/PLACE, borders/PLACE/ID, changes/NUMBER (history), requests/ID; `_PLACE`, `_NEXT`.
"""

from __future__ import annotations

import base64
import functools
import hashlib
import zlib
from dataclasses import dataclass, field
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Tuple

import numpy as np

from vb_core.errors import CodedError
from vb_core.grid_map import GridMap, Transform
from vb_map_integration.border import MAX_NAME, VirtualBorder, border_from_feature, border_to_feature
from vb_map_integration.storage.durable_values import DurableValues

MAX_CHANGES = 100  # changes that are kept and can be undone
MAX_REQUESTS = 100  # requests that are kept
MAX_MAPS = 6  # maps of a place that are kept besides its first and current ones
_PLACE, _NEXT = "facts/last_place", "facts/next_number"


class BorderChange(NamedTuple):
    """One border's states before and after a change; None where it did not exist."""

    id: str
    before: Optional[VirtualBorder]
    after: Optional[VirtualBorder]


# all that one command changed
Change = Tuple[BorderChange, ...]


@dataclass(frozen=True)
class StoredMap:
    """A map that the database knows.

    Attributes:
        number: number of the map.
        place: the number of the map on which the place's first border was drawn; its borders are in that map's frame.
        fingerprint: see `fingerprint`.
        transform: transform from the place's frame to this map's.
    """

    number: int
    place: int
    fingerprint: str
    transform: Transform
    _values: Mapping[str, Any] = field(compare=False, repr=False)

    @functools.cached_property
    def grid(self) -> GridMap:
        """Returns the map."""
        cells = zlib.decompress(base64.b64decode(self._values["cells"]))
        data = np.frombuffer(cells, np.int8).reshape(self._values["shape"])
        return GridMap(data, self._values["resolution"], tuple(self._values["origin"]))


def fingerprint(grid: GridMap) -> str:
    """Computes a map's identity: 64 hexadecimal digits, a hash of its cells, size, resolution and origin."""
    digest = hashlib.sha256()
    digest.update(np.array(grid.shape, np.int64).tobytes())
    # map_server and bags carry the resolution as float32
    digest.update(np.array([grid.resolution], np.float32).tobytes())
    digest.update(np.array(grid.origin, np.float32).tobytes())
    digest.update(np.ascontiguousarray(grid.data).data)
    return digest.hexdigest()


class Database:
    """Borders by place, with their history, in a store. Each method makes its changes completely or not at all."""

    def __init__(self, store: DurableValues) -> None:
        self._store = store
        self._borders: Dict[int, Dict[str, VirtualBorder]] = {}  # by place and id
        for name, feature in store.values_of_kind("borders").items():
            place, border_id = name.split("/")
            self._borders.setdefault(int(place), {})[border_id] = border_from_feature(feature)

    # ------------------------------------------------------------- maps
    def maps(self) -> Dict[str, StoredMap]:
        """Returns all maps by fingerprint, the oldest first."""
        return {
            key: StoredMap(values["id"], values["place"], key, Transform(*values["transform"]), values)
            for key, values in self._store.values_of_kind("maps").items()
        }

    def maps_of(self, place: int) -> Dict[str, StoredMap]:
        """Returns the maps of a place by fingerprint, the oldest first."""
        return {key: stored_map for key, stored_map in self.maps().items() if stored_map.place == place}

    def add_map(self, grid: GridMap, map_id: str, place: int, transform: Transform, name: str) -> int:
        """Stores a map of a place (0: a new one), which becomes the last place; returns the place's number."""
        maps = self.maps()
        highest = max((stored_map.number for stored_map in maps.values()), default=0)
        number = maps[map_id].number if map_id in maps else highest + 1
        place = place or number
        needed = {border.map_id for border in self.borders(place)}  # the place's borders are compared with these maps
        others = [key for key, other in self.maps_of(place).items() if other.number not in (place, number)]
        dropped = [key for key in others[:-MAX_MAPS] if key not in needed]
        changes: Dict[str, Any] = {f"maps/{key}": None for key in dropped}
        changes[f"maps/{map_id}"] = {
            "id": number,
            "place": place,
            "transform": transform,
            "resolution": grid.resolution,
            "origin": grid.origin,
            "shape": grid.shape,
            "cells": base64.b64encode(zlib.compress(np.ascontiguousarray(grid.data), 1)).decode(),
        }
        changes[_PLACE] = place
        if name:
            changes.update(self._name_changes(place, name))
        self._store.write(changes)
        return place

    def place_name(self, place: int) -> str:
        """Returns a place's name; "" if it has none."""
        return str(self._store.get(f"names/{place}", ""))

    def find_place(self, name: str) -> int:
        """Returns the place that has a name and borders; 0 if there is none."""
        names = self._store.values_of_kind("names")
        places = (int(place) for place, other in names.items() if name == other)
        return next(filter(self.borders, places), 0)

    def rename_place(self, place: int, name: str) -> None:
        """Names a place; raises CodedError "name_taken" or "bad_name"."""
        if self.place_name(place) != name:
            self.check_name(name, place)
            self._store.write(self._name_changes(place, name))

    def _name_changes(self, place: int, name: str) -> Dict[str, Any]:
        """Returns the changes that name a place; a place without borders that has the name loses it."""
        names = self._store.values_of_kind("names")
        others = {f"names/{other}": None for other, taken in names.items() if taken == name}
        return {**others, f"names/{place}": name or None}

    def check_name(self, name: str, place: int = 0) -> None:
        """Checks whether a place can have a name; raises CodedError "bad_name", "name_taken"."""
        if len(name) > MAX_NAME or not name.isprintable():
            raise CodedError("bad_name", key="name")
        if self.find_place(name) not in (0, place):
            raise CodedError("name_taken", name=name)

    @property
    def last_place(self) -> int:
        """The last place in force; 0 if there was none yet."""
        return int(self._store.get(_PLACE, 0))

    def remember_place(self, place: int) -> None:
        """Records the last place in force."""
        if self.last_place != place:
            self._store.write({_PLACE: place})

    # ------------------------------------------------------------- borders
    def borders(self, place: int) -> Tuple[VirtualBorder, ...]:
        """Returns the borders of a place in its frame, the oldest first; an unchanged border stays the same object."""
        borders = self._borders.get(place, {})
        return tuple(borders[border_id] for border_id in sorted(borders, key=lambda border_id: int(border_id[1:])))

    def find_border(self, border_id: str) -> Tuple[int, VirtualBorder]:
        """Finds a border of any place by its id, and returns its place with it; raises CodedError "unknown_border"."""
        for place, borders in self._borders.items():
            if border_id in borders:
                return place, borders[border_id]
        raise CodedError("unknown_border", id=border_id)

    @property
    def next_id(self) -> str:
        """The id of the next new border; it is taken when `commit` succeeds."""
        return f"b{self._store.get(_NEXT, 1)}"

    def commit(self, place: int, change: Change, kind: str = "new", request_id: str = "") -> Tuple[VirtualBorder, ...]:
        """Makes a change of borders of one place; returns the place's borders, as `borders` does.

        Args:
            kind: "new" (undone changes are dropped), "undo" or "redo".
            request_id: recorded, so that `find_border_of_request` finds the border if the request is repeated.

        Raises:
            CodedError: "cannot_write"; then nothing was changed.
        """
        entries = []
        for entry in change:
            before = entry.before and border_to_feature(entry.before)
            after = entry.after and border_to_feature(entry.after)
            entries.append([entry.id, before, after])
        changes = self._history(place, entries, kind)
        for border_id, _, after in entries:
            changes[f"borders/{place}/{border_id}"] = after
        if request_id:
            changes[f"requests/{request_id}"] = change[0].id
            earlier = list(self._store.values_of_kind("requests"))
            changes.update({f"requests/{old}": None for old in earlier[:-MAX_REQUESTS]})
        next_number = max(int(entry.id[1:]) + 1 for entry in change)
        changes[_NEXT] = max(next_number, self._store.get(_NEXT, 1))
        self._store.write(changes)
        borders = {**self._borders.get(place, {}), **{entry.id: entry.after for entry in change}}
        self._borders[place] = {border_id: border for border_id, border in borders.items() if border is not None}
        return self.borders(place)

    def _history(self, place: int, entries: List[List[Any]], kind: str) -> Dict[str, Any]:
        """Returns the values that record a change, so that it can be undone or redone."""
        if kind in ("undo", "redo"):
            key = self._newest_key(place, kind)
            return {key: {**self._store.get(key), "undone": kind == "undo"}}
        records = self._store.values_of_kind("changes")
        dropped = [*self._numbers(place, "redo"), *list(records)[: 1 - MAX_CHANGES]]
        changes: Dict[str, Any] = {f"changes/{number}": None for number in dropped}
        number = 1 + max(map(int, records), default=0)
        changes[f"changes/{number}"] = {"place": place, "undone": False, "entries": entries}
        return changes

    def _numbers(self, place: int, kind: str) -> List[int]:
        """Lists the numbers of a place's changes that can be undone ("undo") or repeated ("redo")."""
        is_undone = kind == "redo"
        records = self._store.values_of_kind("changes").items()
        return [int(key) for key, record in records if record["place"] == place and record["undone"] == is_undone]

    def available_commands(self, place: int) -> List[str]:
        """Lists "undo" and "redo", each only if there is something to undo or redo."""
        return [kind for kind in ("undo", "redo") if self._numbers(place, kind)]

    def _newest_key(self, place: int, kind: str) -> str:
        """Returns the key of the change that undo would revert, or redo repeat."""
        numbers = self._numbers(place, kind)
        if not numbers:
            raise CodedError(f"nothing_to_{kind}")
        return f"changes/{max(numbers) if kind == 'undo' else min(numbers)}"

    def prepare_undo_or_redo(self, kind: str, place: int) -> Change:
        """Prepares the change that reverts the last one ("undo"), or repeats the last undone one ("redo").

        Raises:
            CodedError: "nothing_to_undo", "nothing_to_redo".
        """
        change = []
        for border_id, before, after in self._store.get(self._newest_key(place, kind))["entries"]:
            border_before = before and border_from_feature(before)
            border_after = after and border_from_feature(after)
            change.append(BorderChange(border_id, border_before, border_after))
        if kind == "redo":
            return tuple(change)
        return tuple(BorderChange(entry.id, entry.after, entry.before) for entry in reversed(change))

    def find_border_of_request(self, request_id: str) -> str:
        """Returns the id of the border that an earlier request changed; "" if the request is new."""
        return str(self._store.get(f"requests/{request_id}", "")) if request_id else ""
