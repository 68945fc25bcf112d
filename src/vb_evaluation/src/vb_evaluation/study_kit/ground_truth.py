"""Ground-truth maps: what a scenario asks to restrict, drawn over the map's image in any image editor."""

from __future__ import annotations

from pathlib import Path
from typing import Dict, Sequence

import cv2
import numpy as np

from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.map_files import read_map
from vb_evaluation import metrics

# [grey levels] between the largest and the smallest channel; less is grey
MIN_COLOR = 40
# [grey levels] darker is black: map_server's occupied_thresh of 0.65
BLACK = 89
ENDINGS = (".png", ".pgm", ".bmp", ".yaml")


def read_ground_truth(path: Path, physical: GridMap) -> np.ndarray:
    """Reads which free cells of the physical map a ground truth marks: (H, W) bool.

    Args:
        path: an image as large as the map's, in which an area has any strong colour or is black; transparent
            pixels mark nothing. Or a map_server YAML file whose map has the area occupied.
        physical: the map that it was drawn over.

    Raises:
        CodedError: "bad_ground_truth" naming the file and what is wrong with it.
    """
    path = Path(path)
    try:
        if path.suffix == ".yaml":
            marked = metrics.restricted_cells(physical, read_map(path))
        else:
            marked = _marked(path, physical) & (physical.data >= 0) & (physical.data < metrics.RESTRICTED)
    except CodedError as error:
        raise CodedError("bad_ground_truth", f"{path}: {error.message}") from None
    if not marked.any():
        raise CodedError(
            "bad_ground_truth", f"{path}: no free floor is marked: fill the area with a strong colour or black"
        )
    return marked


def find_ground_truths(folder: Path, scenarios: Sequence[str], physical: GridMap) -> Dict[str, np.ndarray]:
    """Finds ground truths by scenario: files <scenario>.png, .pgm, .bmp or .yaml.

    Raises:
        CodedError: "bad_ground_truth" if one is missing or wrong.
    """
    found = {}
    for scenario in scenarios:
        paths = [folder / f"{scenario}{ending}" for ending in ENDINGS if (folder / f"{scenario}{ending}").is_file()]
        if not paths:
            raise CodedError(
                "bad_ground_truth", f"{folder}: there is no {scenario}.png: draw it over the map's picture"
            )
        found[scenario] = read_ground_truth(paths[0], physical)
    return found


def _marked(path: Path, physical: GridMap) -> np.ndarray:
    """Returns (H, W) bool: coloured or black pixels, in the map's order of rows."""
    try:
        content = np.fromfile(str(path), np.uint8)
    except OSError as error:
        raise CodedError("bad_ground_truth", str(error.strerror)) from None
    image = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if content.size else None
    if image is None:
        raise CodedError("bad_ground_truth", "this is no picture, or a damaged one")
    if image.dtype != np.uint8:
        image = (image // 257).astype(np.uint8)  # 16 bits per channel
    if image.shape[:2] != physical.shape:
        rows, columns = physical.shape
        raise CodedError(
            "bad_ground_truth",
            f"the picture has {image.shape[1]} x {image.shape[0]} pixels, the map {columns} x {rows}: "
            "draw over the map's own picture and do not scale it",
        )
    opaque = np.ones(image.shape[:2], bool)
    if image.ndim == 3 and image.shape[2] == 4:
        opaque = image[..., 3] >= 128
        image = image[..., :3]
    channels = image.reshape(*image.shape[:2], -1).astype(int)
    chroma = channels.max(axis=2) - channels.min(axis=2)
    # half of the strongest colour: cuts the soft edge that an editor gives an area in its middle
    colored = chroma >= max(MIN_COLOR, chroma.max() / 2.0)
    black = channels.max(axis=2) <= BLACK
    return ((colored | black) & opaque)[::-1]
