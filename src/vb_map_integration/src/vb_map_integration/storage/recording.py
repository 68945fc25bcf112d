"""Every map with borders on disk, for evaluation (paper, Sect. "Implementation")."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Sequence

from vb_core.errors import CodedError
from vb_core.files import append_line, write_atomically
from vb_core.grid_map import GridMap
from vb_core.map_files import write_map
from vb_map_integration.border import VirtualBorder
from vb_map_integration.borders.geojson import borders_to_geojson

INDEX = "index.jsonl"


class MapRecording:
    """A folder of numbered maps; an existing recording is continued.

    Each record is `NNNN.pgm`, `NNNN.yaml`, `NNNN.borders.geojson` and one line of JSON in `index.jsonl`. Maps with
    soft values are written raw, so that these survive.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def record(self, grid: GridMap, borders: Sequence[VirtualBorder], stamp: float) -> Path:
        """Writes one map of a ROS time [s]; returns its YAML file. Raises CodedError "cannot_write"."""
        number = 1 + max((int(path.stem) for path in self.folder.glob("[0-9]*.yaml")), default=0)
        stem = self.folder / f"{number:04d}"
        soft = bool(((grid.data > 0) & (grid.data < 100)).any())
        _, path = write_map(stem, grid, raw=soft)
        beside = Path(f"{stem}.borders.geojson")
        write_atomically(beside, borders_to_geojson(borders).encode())
        line = {"number": number, "stamp_s": stamp, "map": path.name, "borders": beside.name}
        try:
            append_line(self.folder / INDEX, json.dumps(line))
        except OSError as error:
            raise CodedError("cannot_write", what=str(self.folder / INDEX), reason=error.strerror) from None
        return path
