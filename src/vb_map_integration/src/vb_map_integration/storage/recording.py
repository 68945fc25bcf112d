"""Every map with borders on disk, for evaluation (paper, Sect. "Implementation")."""

from __future__ import annotations

import contextlib
import json
import os
import re
from pathlib import Path
from typing import List, Mapping, Optional, Sequence

import numpy as np

from vb_core.errors import CodedError
from vb_core.files import write_atomically
from vb_core.grid_map import OCCUPIED_THRESHOLD, GridMap
from vb_core.map_files import write_map
from vb_map_integration.border import VirtualBorder
from vb_map_integration.borders.geojson import borders_to_geojson

INDEX = "index.jsonl"
# of all maps of a recording: days with a map that changes now and then, a few hours of SLAM
MAX_BYTES = 500_000_000


class MapRecording:
    """A folder of numbered maps; an existing recording is continued.

    Each record is `NNNN.pgm`, `NNNN.yaml`, `NNNN.borders.geojson` and one line of JSON in `index.jsonl`. Maps with
    soft values are written raw, so that these survive. Beyond a size the oldest records are deleted.

    Args:
        max_bytes: that size.

    Raises:
        CodedError: "cannot_write" if the folder cannot be made.
    """

    def __init__(self, folder: Path, max_bytes: int = MAX_BYTES) -> None:
        self.folder = folder
        self._max_bytes = max_bytes
        try:
            folder.mkdir(parents=True, exist_ok=True)
            numbers = [int(path.stem) for path in folder.iterdir() if re.fullmatch(r"\d+\.(yaml|pgm)", path.name)]
        except OSError as error:
            raise CodedError("cannot_write", what=str(folder), reason=error.strerror) from None
        self.number = max(numbers, default=0)
        self._sizes = {number: self._size(number) for number in sorted(set(numbers))}
        self._borders: Optional[Sequence[VirtualBorder]] = None

    def record(
        self, grid: GridMap, borders: Sequence[VirtualBorder], stamp: float, extra: Mapping[str, object]
    ) -> Path:
        """Writes one map.

        Args:
            stamp: [s] ROS time of the map.
            extra: more for the index line.

        Returns:
            The map's YAML file.

        Raises:
            CodedError: "cannot_write".
        """
        stem = self.folder / f"{self.number + 1:04d}"
        soft = bool(((grid.data > 0) & (grid.data < 100)).any())
        _, path = write_map(stem, grid, raw=soft)
        beside = Path(f"{stem}.borders.geojson")
        write_atomically(beside, borders_to_geojson(borders).encode())
        line = {
            "number": self.number + 1,
            "stamp_s": stamp,
            "trigger": describe_trigger(self._borders, borders),
            "map": path.name,
            "borders": beside.name,
            "occupied_cells": int(np.count_nonzero(grid.data >= OCCUPIED_THRESHOLD)),
            **extra,
        }
        try:
            with open(str(self.folder / INDEX), "a") as index:
                index.write(json.dumps(line) + "\n")
                index.flush()
                os.fsync(index.fileno())
        except OSError as error:
            raise CodedError("cannot_write", what=str(self.folder / INDEX), reason=error.strerror) from None
        self.number += 1
        self._borders = tuple(borders)
        self._sizes[self.number] = self._size(self.number)
        if sum(self._sizes.values()) > self._max_bytes:
            self._forget()
        return path

    def _files(self, number: int) -> List[Path]:
        return [self.folder / f"{number:04d}{end}" for end in (".pgm", ".yaml", ".borders.geojson")]

    def _size(self, number: int) -> int:
        return sum(path.stat().st_size for path in self._files(number) if path.exists())

    def _forget(self) -> None:
        """Deletes the oldest records until a tenth is free again, so that it is not due with each map."""
        gone = set()
        while len(self._sizes) > 1 and sum(self._sizes.values()) > 0.9 * self._max_bytes:
            number = min(self._sizes)
            del self._sizes[number]
            gone.add(number)
            for path in self._files(number):
                with contextlib.suppress(FileNotFoundError):
                    path.unlink()
        lines = (self.folder / INDEX).read_text().splitlines(keepends=True)
        kept = [line for line in lines if json.loads(line)["number"] not in gone]
        write_atomically(self.folder / INDEX, "".join(kept).encode())


def describe_trigger(before: Optional[Sequence[VirtualBorder]], after: Sequence[VirtualBorder]) -> str:
    """Describes in words what made a new map: "start", "added b2", "removed b1, b2", "changed b1", or "map"."""
    if before is None:
        return "start"
    old, new = {border.id: border for border in before}, {border.id: border for border in after}
    words: List[str] = []
    for verb, keys in (
        ("added", [key for key in new if key not in old]),
        ("removed", [key for key in old if key not in new]),
        ("changed", [key for key in new if key in old and not _alike(new[key], old[key])]),
    ):
        if keys:
            words.append(f"{verb} {', '.join(keys)}")
    return "; ".join(words) or "map"


def _alike(a: VirtualBorder, b: VirtualBorder) -> bool:
    return a.replace(modified=0.0) == b.replace(modified=0.0)
