"""Draws two maps on top of each other, with the borders where they would be."""

from __future__ import annotations

from typing import Iterable, Optional

import cv2
import numpy as np

from vb_core.grid_map import OCCUPIED_THRESHOLD, GridMap
from vb_map_integration.border import VirtualBorder
from vb_map_integration.places.registration import Transform

# BGR
_FREE, _UNKNOWN, _WALL, _OLD, _BORDER = (255, 255, 255), (210, 210, 210), (60, 60, 60), (220, 140, 40), (40, 40, 220)
_MAX_PIXELS = 1000


def draw_map_overlay(
    old: Optional[GridMap], new: GridMap, transform: Transform, borders: Iterable[VirtualBorder]
) -> bytes:
    """Draws a PNG: the new map in grey, the old one's obstacles in blue, borders in red.

    Args:
        transform: from the old map's frame to the new one's.
        borders: in the new map's frame.
    """
    image = np.full((*new.shape, 3), _UNKNOWN, np.uint8)
    image[(new.data >= 0) & (new.data < OCCUPIED_THRESHOLD)] = _FREE
    image[new.data >= OCCUPIED_THRESHOLD] = _WALL
    scale = max(1, min(6, _MAX_PIXELS // max(new.shape)))
    image = np.repeat(np.repeat(image, scale, axis=0), scale, axis=1)

    def pixels(points: np.ndarray) -> np.ndarray:
        return np.rint((new.world_to_grid(points) + 0.5) * scale).astype(np.int32)

    if old is not None:
        rows_columns = np.argwhere(old.data >= OCCUPIED_THRESHOLD)
        where = pixels(transform.apply(old.cell_to_world(rows_columns)))
        inside = (where >= 0).all(axis=1) & (where < (image.shape[1], image.shape[0])).all(axis=1)
        where = where[inside]
        for row in range(-(scale // 3), scale // 3 + 1):
            for column in range(-(scale // 3), scale // 3 + 1):
                rows = np.clip(where[:, 1] + row, 0, len(image) - 1)
                image[rows, np.clip(where[:, 0] + column, 0, image.shape[1] - 1)] = _OLD
    for border in borders:
        cv2.polylines(image, [pixels(border.points)], bool(border.closed), _BORDER, max(2, scale // 2))
        if not border.wall:
            cv2.circle(image, tuple(int(value) for value in pixels(border.seed)[0]), max(3, scale), _BORDER, -1)
    return cv2.imencode(".png", np.ascontiguousarray(image[::-1]))[1].tobytes()
