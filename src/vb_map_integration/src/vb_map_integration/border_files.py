"""Borders as YAML, and the folder that keeps them from one start to the next.

One folder per physical map:

    <store>/<id of the map>/borders.yaml       the borders
                            borders.yaml.bak   the state before the last change
                            map.npz            the physical map that they belong to
"""
from __future__ import annotations

import hashlib
import io
import os
import zipfile
from pathlib import Path
from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np
import yaml

from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_map_integration.border import VirtualBorder
from vb_map_integration.map_binding import compatible, fingerprint
from vb_map_integration.map_files import write_atomically

FORMAT = 1
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_Dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


def border_to_mapping(border: VirtualBorder) -> Dict[str, Any]:
    """A border as plain values; inverse of `border_from_mapping`."""
    return {
        "id": border.id,
        "name": border.name,
        "kind": "polygon" if border.closed else "separating_curve",
        "points": border.points.tolist(),
        "seed": border.seed.tolist(),
        "occupancy": border.occupancy,
        "enabled": border.enabled,
        "created": border.created,
        "modified": border.modified,
        "expires": border.expires,
        "robots": list(border.robots),
    }


def border_from_mapping(values: Any) -> VirtualBorder:
    """Plain values to a border; inverse of `border_to_mapping`.

    Raises:
        CodedError: what `VirtualBorder` raises, or "bad_border_file" for missing or unknown keys.
    """
    if not isinstance(values, dict):
        raise CodedError("bad_border_file", f"a border has keys and values, got {values!r}")
    values = dict(values)
    kind = values.pop("kind", None)
    if kind not in (None, "polygon", "separating_curve"):
        raise CodedError("bad_border_file", f"kind: must be polygon or separating_curve, got {kind!r}")
    try:
        return VirtualBorder(closed=None if kind is None else kind == "polygon", **values)
    except TypeError as error:
        raise CodedError("bad_border_file", f"a border's keys do not fit: {error}") from None


def borders_to_yaml(borders: Sequence[VirtualBorder], texts: Optional[Dict[int, Tuple[VirtualBorder, str]]] = None) -> str:
    """The YAML list "borders"; `texts` keeps each border's text by identity, so that only new ones cost."""
    if not borders:
        return "borders: []\n"
    parts = ["borders:\n"]
    fresh: Dict[int, Tuple[VirtualBorder, str]] = {}
    for border in borders:
        known = texts.get(id(border)) if texts is not None else None
        if known is None:
            text = yaml.dump([border_to_mapping(border)], Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=120)
            known = (border, text)
        fresh[id(border)] = known
        parts.append(known[1])
    if texts is not None:
        texts.clear()
        texts.update(fresh)
    return "".join(parts)


def borders_from_yaml(text: str) -> Tuple[List[VirtualBorder], Dict[str, Any]]:
    """(borders, other keys) of a YAML document; inverse of `borders_to_yaml`.

    Raises:
        CodedError: "bad_border_file" or what a border raises.
    """
    try:
        document = yaml.load(text, Loader=_Loader)
    except yaml.YAMLError as error:
        raise CodedError("bad_border_file", f"this is no YAML: {error}") from None
    if not isinstance(document, dict) or not isinstance(document.get("borders"), list):
        raise CodedError("bad_border_file", "the key 'borders' with a list is missing")
    borders = [border_from_mapping(values) for values in document.pop("borders")]
    return borders, document


class Loaded(NamedTuple):
    """What a folder held.

    Attributes:
        borders, next_number, revision: the store's state.
        notes: sentences about what was not as it should be.
    """

    borders: List[VirtualBorder]
    next_number: int
    revision: int
    notes: Tuple[str, ...]


class BorderFolder:
    """The files of one physical map's borders."""

    def __init__(self, folder: Path, map_id: str) -> None:
        self.folder = folder
        self.map_id = map_id
        self._texts: Dict[int, Tuple[VirtualBorder, str]] = {}

    @property
    def path(self) -> Path:
        """The YAML file."""
        return self.folder / "borders.yaml"

    def write(self, borders: Sequence[VirtualBorder], next_number: int, revision: int) -> None:
        """Writes the borders, atomically, the state before as backup.

        Raises:
            CodedError: "cannot_write".
        """
        body = f"next_number: {next_number}\nrevision: {revision}\n" + borders_to_yaml(borders, self._texts)
        digest = hashlib.sha256(body.encode()).hexdigest()
        # a file that was cut off may still be YAML: the sum tells
        head = f"format: {FORMAT}\nsha256: '{digest}'\nmap: '{self.map_id}'\n# below: what the sum is of\n"
        write_atomically(self.path, (head + body).encode(), backup=True)

    def load(self) -> Loaded:
        """Reads the borders, the backup if the file is damaged; damaged files are set aside."""
        notes: List[str] = []
        for path in (self.path, Path(f"{self.path}.bak")):
            if not path.exists():
                continue
            try:
                borders, document = _checked(path)
                return Loaded(borders, int(document.get("next_number", 1)), int(document.get("revision", 0)), tuple(notes))
            except (CodedError, OSError, ValueError, TypeError) as error:
                aside = _free_name(path.with_name(f"{path.name}.damaged"))
                os.replace(str(path), str(aside))
                reason = error.message if isinstance(error, CodedError) else str(error)
                notes.append(f"{path} is damaged ({reason}): set aside as {aside.name}, the backup is used")
        if notes:
            notes.append(f"there is no readable backup in {self.folder}: the borders of this map are lost")
        return Loaded([], 1, 0, tuple(notes))

    def write_map(self, grid: GridMap) -> None:
        """Binds the folder to a map."""
        stream = io.BytesIO()
        np.savez_compressed(stream, data=grid.data, resolution=grid.resolution, origin=grid.origin)
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
                candidate.write_map(grid)
                return candidate, (f"the map has changed since, but it is the same place: its borders in {folder} are kept",)
            others += 1
        candidate = BorderFolder(_free_name(self.root / map_id[:12]), map_id)
        candidate.write_map(grid)
        if others:
            notes.append(
                f"the borders in {self.root} belong to {others} other map(s): they are kept there, none acts on this map"
            )
        return candidate, tuple(notes)

    def _folders(self) -> List[Path]:
        try:
            return [path for path in self.root.iterdir() if (path / "map.npz").is_file()]
        except OSError:
            return []


def _checked(path: Path) -> Tuple[List[VirtualBorder], Dict[str, Any]]:
    text = path.read_text()
    borders, document = borders_from_yaml(text)
    if document.get("format") != FORMAT:
        raise CodedError("bad_border_file", f"format: expected {FORMAT}, got {document.get('format')!r}")
    start = text.find("next_number:")
    if hashlib.sha256(text[start:].encode()).hexdigest() != document.get("sha256"):
        raise CodedError("bad_border_file", "its sum does not fit: it was cut off, or changed by hand")
    return borders, document


def _free_name(path: Path) -> Path:
    """The path, or the first of path-2, path-3 ... that does not exist."""
    number, result = 1, path
    while result.exists():
        number += 1
        result = path.with_name(f"{path.name}-{number}")
    return result
