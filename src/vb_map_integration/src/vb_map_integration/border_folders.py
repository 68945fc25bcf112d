"""The folders that keep borders from one start to the next, one for each physical map.

    <store>/<id of the map>/borders.yaml       the borders
                            borders.yaml.bak   the state before
                            journal.jsonl      every change, one line each; also what undo and redo go back in
                            map.npz            the physical map that they belong to

A change is made once its line is in the journal. The borders are written after it; where there are hundreds, after a
few changes, so that a change costs the same however many there are.
"""
from __future__ import annotations

import contextlib
import hashlib
import io
import os
import shutil
import zipfile
from pathlib import Path
from typing import Dict, List, NamedTuple, Optional, Tuple

import numpy as np

from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_map_integration.border import VirtualBorder
from vb_map_integration.border_files import borders_from_yaml, borders_to_yaml
from vb_map_integration.journal import Journal
from vb_map_integration.map_binding import compatible, fingerprint
from vb_map_integration.map_files import write_atomically
from vb_map_integration.store import BorderStore, Change

FORMAT = 1
# so many borders may make the borders' file one change older than the journal
BORDERS_PER_CHANGE = 50


class Loaded(NamedTuple):
    """What a folder held.

    Attributes:
        store: the borders, with their history.
        notes: sentences about what was not as it should be.
    """

    store: BorderStore
    notes: Tuple[str, ...]


class BorderFolder:
    """The files of one physical map's borders."""

    def __init__(self, folder: Path, map_id: str) -> None:
        self.folder = folder
        self.map_id = map_id
        self._texts: Dict[int, Tuple[VirtualBorder, str]] = {}
        self._journal = Journal(folder / "journal.jsonl")
        # changes that are in the journal alone
        self._pending = 0

    @property
    def path(self) -> Path:
        """The YAML file."""
        return self.folder / "borders.yaml"

    def write(self, store: BorderStore, change: Change, kind: str) -> None:
        """Keeps a change, and the store that it led to.

        Raises:
            CodedError: "cannot_write"; then the change is not kept.
        """
        self._journal.append(store.revision, kind, change)
        self._pending += 1
        if self._pending > len(store) // BORDERS_PER_CHANGE:
            try:
                self._write_snapshot(store)
            except CodedError:
                self._pending += 1  # the journal has the change; the next one tries again

    def _write_snapshot(self, store: BorderStore) -> None:
        body = f"next_number: {store.next_number}\nrevision: {store.revision}\n"
        body += borders_to_yaml(store.borders, self._texts)
        digest = hashlib.sha256(body.encode()).hexdigest()
        # a file that was cut off may still be YAML: the sum tells
        head = f"format: {FORMAT}\nsha256: '{digest}'\nmap: '{self.map_id}'\n# below: what the sum is of\n"
        content = (head + body).encode()
        write_atomically(self.path, content, backup=True)
        self._pending = 0
        if self._journal.too_long:
            # the backup must not need what the journal forgets
            write_atomically(self.path, content, backup=True)
            self._journal.shorten(store)

    def load(self) -> Loaded:
        """Reads the borders, of the backup if the file is damaged, and what the journal says came after.

        Damaged files are set aside.
        """
        notes: List[str] = []
        snapshot = BorderStore()
        for path in (self.path, Path(f"{self.path}.bak")):
            if not path.exists():
                continue
            try:
                snapshot = BorderStore(*_checked(path))
            except (CodedError, OSError, ValueError, TypeError, KeyError) as error:
                aside = _free_name(path.with_name(f"{path.name}.damaged"))
                with contextlib.suppress(OSError):
                    os.replace(str(path), str(aside))
                reason = error.message if isinstance(error, CodedError) else str(error)
                notes.append(f"{path} is damaged ({reason}): set aside as {aside.name}, the backup is used")
                continue
            break
        store, sound = self._journal.replay(snapshot)
        if notes and not self.path.exists() and not store.revision:
            notes.append(f"there is no readable backup in {self.folder}: the borders of this map are lost")
        if not sound:
            aside = _free_name(self._journal.path.with_name(f"{self._journal.path.name}.damaged"))
            with contextlib.suppress(OSError):
                shutil.copyfile(str(self._journal.path), str(aside))
            notes.append(f"{self._journal.path} is damaged: kept as {aside.name}, changes after the damage are lost")
        try:
            if notes or store.revision != snapshot.revision:
                self._write_snapshot(store)
            if not sound or self._journal.cut_off:
                self._journal.shorten(store)
        except CodedError as error:
            notes.append(error.message)  # borders that can be read act, whatever the disk is like
        return Loaded(store, tuple(notes))

    def write_map(self, grid: GridMap) -> None:
        """Binds the folder to a map."""
        stream = io.BytesIO()
        # as numpy.savez_compressed, at a third of its time: maps are large, and nearly empty
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for key, value in (("data", grid.data), ("resolution", grid.resolution), ("origin", grid.origin)):
                with archive.open(f"{key}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, np.asarray(value), allow_pickle=False)
        write_atomically(self.folder / "map.npz", stream.getvalue())
        self.map_id = fingerprint(grid)

    def read_map(self) -> Optional[GridMap]:
        """The map that the folder is bound to; None if there is none that can be read."""
        try:
            with np.load(str(self.folder / "map.npz")) as found:
                return GridMap(found["data"], float(found["resolution"]), tuple(found["origin"].tolist()))
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, CodedError):
            return None


class BorderFolders:
    """All folders below the store's folder: finds the one that belongs to a map."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def open(self, grid: GridMap) -> Tuple[BorderFolder, Tuple[str, ...]]:
        """The folder of a map: of the very same one, else of one that it grew out of, else a new one.

        Returns:
            The folder, and sentences for the person.

        Raises:
            CodedError: "cannot_write".
        """
        map_id = fingerprint(grid)
        notes: List[str] = []
        others = 0
        for folder in sorted(self._folders(), key=lambda path: path.stat().st_mtime, reverse=True):
            candidate = BorderFolder(folder, map_id)
            bound = candidate.read_map()
            if bound is None:
                continue
            if fingerprint(bound) == map_id:
                return candidate, ()
            if compatible(bound, grid):
                notes.append(f"the map has changed since, but it is the same place: its borders in {folder} are kept")
                try:
                    candidate.write_map(grid)
                except CodedError as error:
                    notes.append(error.message)
                return candidate, tuple(notes)
            others += 1
        candidate = BorderFolder(_free_name(self.root / map_id[:12]), map_id)
        candidate.write_map(grid)
        if others:
            where = f"the borders in {self.root} belong to {others} other map(s)"
            notes.append(f"{where}: they are kept there, none acts on this map")
        return candidate, tuple(notes)

    def _folders(self) -> List[Path]:
        try:
            return [path for path in self.root.iterdir() if (path / "map.npz").is_file()]
        except OSError:
            return []


def _checked(path: Path) -> Tuple[List[VirtualBorder], int, int]:
    """(borders, next number, revision) of a file whose sum is right."""
    text = path.read_text(encoding="utf-8")
    borders, document = borders_from_yaml(text)
    if document.get("format") != FORMAT:
        raise CodedError("bad_border_file", f"format: expected {FORMAT}, got {document.get('format')!r}")
    start = text.find("next_number:")
    if hashlib.sha256(text[start:].encode()).hexdigest() != document.get("sha256"):
        raise CodedError("bad_border_file", "its sum does not fit: it was cut off, or changed by hand")
    return borders, int(document["next_number"]), int(document["revision"])


def _free_name(path: Path) -> Path:
    """The path, or the first of path-2, path-3 ... that does not exist."""
    number, result = 1, path
    while result.exists():
        number += 1
        result = path.with_name(f"{path.name}-{number}")
    return result
