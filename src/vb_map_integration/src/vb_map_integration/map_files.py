"""Maps as files that map_server reads: an image and a YAML file beside it.

Trinary files know free, occupied and unknown. Raw ones keep soft values: the pixel is the occupancy, 255 is
unknown. (A soft value written by map_saver comes back as 100, unknown or 0.)
"""
from __future__ import annotations

import math
import re
from pathlib import Path
from typing import List, Optional

import cv2
import numpy as np
import yaml

from vb_core.errors import CodedError
from vb_core.files import write_atomically
from vb_core.grid_map import UNKNOWN, GridMap

# what map_saver writes and map_server reads as thresholds
OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196
FREE_PIXEL, OCCUPIED_PIXEL, UNKNOWN_PIXEL = 254, 0, 205

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 _.-]{0,99}")


def safe_path(folder: Path, name: str) -> Path:
    """The path without ending that a file name from a request stands for; it cannot lie outside the folder.

    Raises:
        CodedError: "bad_name".
    """
    if not isinstance(name, str) or not _NAME.fullmatch(name) or ".." in name:
        raise CodedError(
            "bad_name", f"a file name has letters, digits, '_', '-', '.' and no path, got {name!r}: choose another one"
        )
    return folder / name


def write_map(stem: Path, grid: GridMap, raw: bool = False) -> List[Path]:
    """Writes `<stem>.pgm` and `<stem>.yaml`; inverse of `read_map`.

    Args:
        raw: False: trinary, as map_saver does; True: every occupancy is kept.

    Returns:
        The files.
    """
    cells = np.ascontiguousarray(grid.data).view(np.uint8)
    if raw:
        pixels = cells
    else:
        table = np.full(256, UNKNOWN_PIXEL, np.uint8)
        table[: int(math.ceil(100 * FREE_THRESH))] = FREE_PIXEL
        table[int(round(100 * OCCUPIED_THRESH)) : 101] = OCCUPIED_PIXEL
        pixels = cv2.LUT(cells, table)
    _, image = cv2.imencode(".pgm", np.ascontiguousarray(pixels[::-1]))
    image_path, yaml_path = Path(f"{stem}.pgm"), Path(f"{stem}.yaml")
    description = {
        "image": image_path.name,
        "resolution": grid.resolution,
        "origin": [float(value) for value in grid.origin],
        "negate": 0,
        "occupied_thresh": OCCUPIED_THRESH,
        "free_thresh": FREE_THRESH,
    }
    if raw:
        description["mode"] = "raw"
    write_atomically(image_path, image.tobytes())
    write_atomically(yaml_path, yaml.safe_dump(description, sort_keys=False, default_flow_style=None).encode())
    return [image_path, yaml_path]


def read_map(path: Path) -> GridMap:
    """Reads a map as map_server does (modes trinary, scale and raw); inverse of `write_map`.

    Args:
        path: the YAML file.

    Raises:
        CodedError: "bad_map_file" naming the file and the key.
    """
    try:
        description = yaml.safe_load(Path(path).read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise CodedError("bad_map_file", f"cannot read {path}: {error}") from None
    if not isinstance(description, dict):
        raise CodedError("bad_map_file", f"{path}: expected keys and values")

    def value(key: str, kind, default=None):
        found = description.get(key, default)
        try:
            return kind(found)
        except (TypeError, ValueError):
            text = f"{path}: {key}: expected a value of type {kind.__name__}, got {found!r}"
            raise CodedError("bad_map_file", text) from None

    mode = value("mode", str, "trinary")
    if mode not in ("trinary", "scale", "raw"):
        raise CodedError("bad_map_file", f"{path}: mode: must be trinary, scale or raw, got {mode!r}")
    if "image" not in description:
        raise CodedError("bad_map_file", f"{path}: image: this key is missing")
    image_path = Path(path).parent / value("image", str)
    image = _read_image(image_path)
    if mode == "raw":
        cells = image.astype(np.uint8).view(np.int8)
        cells = np.where((cells < 0) | (cells > 100), UNKNOWN, cells).astype(np.int8)
    else:
        occupancy = image.astype(float) / 255.0
        if not value("negate", int, 0):
            occupancy = 1.0 - occupancy
        high, low = value("occupied_thresh", float, OCCUPIED_THRESH), value("free_thresh", float, FREE_THRESH)
        between = np.full(image.shape, UNKNOWN)
        if mode == "scale":
            between = 1 + 98 * (occupancy - low) / max(high - low, 1e-9)
        cells = np.where(occupancy > high, 100, np.where(occupancy < low, 0, between)).astype(np.int8)
    origin = value("origin", list)
    return GridMap(np.ascontiguousarray(cells[::-1]), value("resolution", float), tuple(origin))


def _read_image(path: Path) -> np.ndarray:
    """(H, W) grey values 0 .. 255 of an image file; colours are averaged."""
    try:
        content = np.fromfile(str(path), np.uint8)
    except OSError as error:
        raise CodedError("bad_map_file", f"cannot read {path}: {error.strerror}") from None
    image: Optional[np.ndarray] = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if content.size else None
    if image is None:
        raise CodedError("bad_map_file", f"{path} is no image, or a damaged one")
    if image.ndim == 3:
        image = image.mean(axis=2)
    return image
