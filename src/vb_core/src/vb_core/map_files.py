"""Map files as map_server reads them: an image with a YAML file next to it.

Trinary files distinguish free, occupied and unknown. Raw files keep soft values: a pixel is the occupancy, or 255 for
unknown. (A soft value that map_saver writes is read back as 100, unknown or 0.)
"""

from __future__ import annotations

import math
import os
import re
from pathlib import Path
from typing import Any, Callable, List, Optional

import cv2
import numpy as np
import yaml

from vb_core.errors import CodedError
from vb_core.files import write_atomically
from vb_core.grid_map import OCCUPIED_THRESHOLD, UNKNOWN, GridMap

# thresholds that map_saver writes and map_server reads
OCCUPIED_THRESH, FREE_THRESH = OCCUPIED_THRESHOLD / 100.0, 0.196
FREE_PIXEL, OCCUPIED_PIXEL, UNKNOWN_PIXEL = 254, 0, 205

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 _.-]{0,99}")


def safe_path(folder: Path, name: str) -> Path:
    """Returns the path, without extension, for a file name from a request. The path is never outside the folder.

    Raises:
        CodedError: "bad_file_name".
    """
    if not isinstance(name, str) or not _NAME.fullmatch(name) or ".." in name:
        raise CodedError("bad_file_name", name=repr(name))
    return folder / name


def write_map(stem: Path, grid: GridMap, raw: bool = False) -> List[Path]:
    """Writes `<stem>.pgm` and `<stem>.yaml`. Inverse of `read_map`.

    Args:
        raw: whether to keep every occupancy value; by default the file is trinary, like those of map_saver.

    Returns:
        The paths of both files.
    """
    cells = np.ascontiguousarray(grid.data).view(np.uint8)
    if raw:
        pixels = cells
    else:
        pixel_of_cell = np.full(256, UNKNOWN_PIXEL, np.uint8)
        pixel_of_cell[: int(math.ceil(100 * FREE_THRESH))] = FREE_PIXEL
        pixel_of_cell[int(round(100 * OCCUPIED_THRESH)) : 101] = OCCUPIED_PIXEL
        pixels = cv2.LUT(cells, pixel_of_cell)
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


def path_from_caller(name: str) -> Path:
    """Returns the path of a map that was named in a terminal, relative to the folder in which roslaunch was called.

    roslaunch starts nodes in another folder, but the environment variable PWD still names the folder of the call.
    """
    return Path(os.environ.get("PWD", ".")) / Path(name).expanduser()


def read_map(path: Path) -> GridMap:
    """Reads a map as map_server does (modes trinary, scale and raw). Inverse of `write_map`.

    Args:
        path: the YAML file.

    Raises:
        CodedError: "bad_map_file" naming the file and the key.
    """
    try:
        description = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise _bad(path, reason=error.strerror) from None
    except (UnicodeDecodeError, yaml.YAMLError, ValueError, RecursionError) as error:
        raise _bad(path, reason_code="file_format", format="YAML", detail=" ".join(str(error).split())) from None
    if not isinstance(description, dict):
        raise _bad(path, reason_code="file_no_keys")

    def read_key(key: str, example: str, is_right: Callable[[Any], bool], default: Any = None) -> Any:
        value = description.get(key, default)
        if not is_right(value):
            raise _bad(path, reason_code="file_value", key=key, expected=example, found=repr(value))
        return value

    def read_float(key: str, default: Optional[float] = None) -> float:
        return float(read_key(key, "0.05", _is_finite_number, default))

    mode = read_key("mode", "trinary | scale | raw", lambda value: value in ("trinary", "scale", "raw"), "trinary")
    origin = read_key("origin", "[x, y, yaw]", _is_pose)
    name = read_key("image", "map.pgm", lambda value: isinstance(value, str) and value != "" and "\0" not in value)
    negate = read_key("negate", "0 | 1", lambda value: isinstance(value, (int, float)), 0)
    image = _read_image(path.parent / name)
    resolution = read_float("resolution")
    if mode == "raw":
        gray = _gray(image, colors_only=False)
        cells = np.where(gray <= 100, gray, UNKNOWN)
    else:
        # map_server counts alpha as a fourth colour, except in scale mode
        gray = _gray(image, colors_only=mode == "scale")
        darkness = gray / 255.0 if negate else (255.0 - gray) / 255.0
        occupied, free = read_float("occupied_thresh", OCCUPIED_THRESH), read_float("free_thresh", FREE_THRESH)
        undecided = np.full(gray.shape, float(UNKNOWN))
        if mode == "scale":
            undecided = 1 + 98 * (darkness - free) / max(occupied - free, 1e-9)
            if image.ndim == 3 and image.shape[2] == 4:
                undecided = np.where(image[..., 3] < 1, UNKNOWN, undecided)
        cells = np.where(darkness > occupied, 100, np.where(darkness < free, 0, undecided))
    # an image's first row is its top, a grid's first row is its lowest y
    try:
        return GridMap(np.ascontiguousarray(cells[::-1]).astype(np.int8), resolution, tuple(origin))
    except (CodedError, OverflowError) as error:
        raise _bad(path, reason=str(error)) from None


def _bad(path: Path, **values: Any) -> CodedError:
    return CodedError("bad_map_file", file=str(path), **values)


def _is_finite_number(value: Any) -> bool:
    return type(value) in (int, float) and math.isfinite(value)


def _is_pose(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 3 and all(type(number) in (int, float) for number in value)


def _gray(image: np.ndarray, colors_only: bool) -> np.ndarray:
    """Returns the mean (H, W), 0 .. 255, of an image's channels."""
    return np.atleast_3d(image)[..., : 3 if colors_only else None].mean(axis=2)


def _read_image(path: Path) -> np.ndarray:
    """Reads an image file, (H, W) or (H, W, channels) uint8."""
    try:
        content = np.fromfile(str(path), np.uint8)
    except OSError as error:
        raise _bad(path, reason=error.strerror) from None
    try:
        image: Optional[np.ndarray] = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if content.size else None
    except cv2.error:  # an image may be too large for OpenCV
        image = None
    if image is None:
        raise _bad(path, reason_code="file_no_image")
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    if image.dtype != np.uint8:
        raise _bad(path, reason_code="file_pixels", found=image.dtype)
    return image
