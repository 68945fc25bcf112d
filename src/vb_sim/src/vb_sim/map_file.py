"""Reading maps in map_server's format."""
from __future__ import annotations

from pathlib import Path
from typing import Any, Mapping

import cv2
import numpy as np
import yaml

from vb_core.errors import CodedError, ParameterError
from vb_core.grid_map import FREE, OCCUPIED, UNKNOWN, GridMap


def load_map(path: str) -> GridMap:
    """A map of a YAML file and the image that it names (modes trinary, scale and raw).

    Raises:
        CodedError: "no_map" if a file is missing, "bad_map" if it cannot be read.
        ParameterError: names the key that is wrong.
    """
    file = Path(path)
    try:
        document = yaml.safe_load(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise CodedError("no_map", f"cannot read the map '{path}': {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError):
        raise CodedError("bad_map", f"the map '{path}' is not valid YAML") from None
    if not isinstance(document, Mapping):
        raise ParameterError("map_yaml", f"expected keys and values in '{path}'")
    resolution = _number(document, "resolution")
    try:
        origin = tuple(float(value) for value in document.get("origin", ()))
    except (TypeError, ValueError):
        origin = ()
    if len(origin) != 3:
        raise ParameterError("origin", f"expected [x, y, yaw] in '{path}'")
    if not isinstance(document.get("image"), str):
        raise ParameterError("image", f"expected a file's name in '{path}'")
    image_path = file.parent / document["image"]
    image = cv2.imread(str(image_path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise CodedError("no_map", f"cannot read the map's image '{image_path}'")
    mode = document.get("mode", "trinary")
    if mode not in ("trinary", "scale", "raw"):
        raise ParameterError("mode", f"must be trinary, scale or raw, got {mode!r}")
    alpha = image[..., 3] if image.ndim == 3 and image.shape[2] == 4 else None
    grey = image if image.ndim == 2 else image[..., :3].mean(axis=2)
    negate = bool(document.get("negate", 0))
    if mode == "raw":
        # negate is of no effect here, as in map_server
        data = np.where(grey <= OCCUPIED, grey, UNKNOWN)
    else:
        occupied = _number(document, "occupied_thresh", 0.65)
        free = _number(document, "free_thresh", 0.196)
        darkness = grey / 255.0 if negate else (255.0 - grey) / 255.0
        between = UNKNOWN * np.ones_like(darkness)
        if mode == "scale":
            between = 1 + 98 * (darkness - free) / max(occupied - free, 1e-9)
            if alpha is not None:
                between = np.where(alpha < 1, UNKNOWN, between)
        data = np.where(darkness > occupied, OCCUPIED, np.where(darkness < free, FREE, between))
    # an image's first row is its top, a grid's first row is its lowest y
    return GridMap(np.ascontiguousarray(data[::-1]).astype(np.int8), resolution, origin)


def _number(document: Mapping[str, Any], key: str, default: float = float("nan")) -> float:
    value = document.get(key, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
        raise ParameterError(key, f"expected a number in the map's YAML file, got {value!r}")
    return float(value)
