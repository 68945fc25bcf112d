"""Borders as older versions kept them: one folder per map, with borders.yaml, its backup, a journal and map.npz."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, Dict, List, NamedTuple, Optional, Tuple

import numpy as np

from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_map_integration.border import VirtualBorder
from vb_map_integration.borders.border_files import border_from_mapping, borders_from_yaml
from vb_map_integration.storage.database import fingerprint

# whatever a damaged file raises
_DAMAGE = (CodedError, OSError, ValueError, TypeError, KeyError)


class LegacyFolder(NamedTuple):
    """Contents of a folder.

    Attributes:
        name: of the folder.
        map_id: the fingerprint of its map; "" if no file tells.
        grid: its map; None if that cannot be read.
        borders: in the map's frame.
        whole: whether every file was sound.
    """

    name: str
    map_id: str
    grid: Optional[GridMap]
    borders: Tuple[VirtualBorder, ...]
    whole: bool


def read_folders(root: Path) -> List[LegacyFolder]:
    """Reads all folders of borders below the store's folder, the one used last at the end."""
    found = [path for path in root.glob("*/") if (path / "borders.yaml").exists() or (path / "journal.jsonl").exists()]
    return [_read(path) for path in sorted(found, key=lambda path: path.stat().st_mtime)]


def _read(folder: Path) -> LegacyFolder:
    whole, map_id = True, ""
    borders: Dict[str, VirtualBorder] = {}
    revision = -1
    for path in (folder / "borders.yaml", folder / "borders.yaml.bak"):
        try:
            text = path.read_text(encoding="utf-8")
            listed, document = borders_from_yaml(text)
            map_id = str(document.get("map") or map_id)
            start = text.find("next_number:")
            if hashlib.sha256(text[start:].encode()).hexdigest() != document.get("sha256"):
                raise ValueError("the checksum does not match")
            revision = int(document["revision"])
            borders = {border.id: border for border in listed}
            break
        except FileNotFoundError:
            continue
        except _DAMAGE:
            whole = False
    last = max(revision, 0)
    for line in _lines(folder / "journal.jsonl"):
        try:
            values: Dict[str, Any] = json.loads(line.decode())
            if int(values["revision"]) <= last or values["kind"] in ("undoable", "redoable"):
                continue
            if int(values["revision"]) != last + 1:
                whole = False  # a line is missing; what came later still happened
            for key, _, after in values["change"]:
                borders.pop(key, None)
                if after is not None:
                    borders[key] = border_from_mapping(after)
            last = int(values["revision"])
        except _DAMAGE:
            whole = whole and not line.endswith(b"\n")  # a change that was under way was not made
    grid = _grid(folder / "map.npz")
    map_id = fingerprint(grid) if grid is not None else map_id
    return LegacyFolder(folder.name, map_id, grid, tuple(borders.values()), whole and grid is not None)


def _lines(path: Path) -> List[bytes]:
    try:
        return path.read_bytes().splitlines(keepends=True)
    except OSError:
        return []


def _grid(path: Path) -> Optional[GridMap]:
    try:
        with np.load(str(path)) as found:
            return GridMap(found["data"], float(found["resolution"]), tuple(found["origin"].tolist()))
    except Exception:  # zlib and numpy raise many kinds for a damaged archive
        return None
