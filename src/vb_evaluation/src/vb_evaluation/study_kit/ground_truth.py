"""Ground-truth maps: what a scenario asks to restrict, drawn over the map's image in any image editor."""

from __future__ import annotations

from pathlib import Path
import cv2
import numpy as np

from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_evaluation import metrics

MIN_COLOR = 40  # [grey levels] between the largest and the smallest channel; less is grey


def read_ground_truth(path: Path, physical: GridMap) -> np.ndarray:
    """Reads which free cells of the physical map a ground truth marks: (H, W) bool.

    Args:
        path: a PNG as large as the map's image, in which an area has any strong colour.
        physical: the map that it was drawn over.

    Raises:
        CodedError: "bad_ground_truth" naming the file and what is wrong with it.
    """
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise CodedError("bad_ground_truth", f"{path}: there is no such picture, or a damaged one")
    if image.shape[:2] != physical.shape:
        rows, columns = physical.shape
        raise CodedError(
            "bad_ground_truth",
            f"{path}: the picture has {image.shape[1]} x {image.shape[0]} pixels, the map {columns} x {rows}: "
            "draw over the map's own picture and do not scale it",
        )
    chroma = np.ptp(image.astype(int), axis=2)[::-1]
    # half of the strongest colour: cuts the soft edge that an editor gives an area in its middle
    marked = (chroma >= max(MIN_COLOR, chroma.max() / 2.0)) & metrics.free_cells(physical)
    if not marked.any():
        raise CodedError("bad_ground_truth", f"{path}: no free floor is marked: fill the area with a strong colour")
    return marked
