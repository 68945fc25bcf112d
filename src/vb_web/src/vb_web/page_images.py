"""The images below the page's lines: the map, the restricted floor, and the floor as the ceiling cameras see it.

All images are transparent where there is nothing to show, so that a light and a dark page can use the same ones. Row 0
of an image is the map's highest y. A map with more than MAX_SIDE cells along a side is reduced, but no wall vanishes.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any, Dict, List, Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_core.camera_model import CameraModel
from vb_core.geometry import transform_points
from vb_core.grid_map import UNKNOWN, GridMap
from vb_web.page_view import json_number

MAX_SIDE = 2048  # [px] of an image; a larger one would not look better on a display, and would be slow on a phone
FLOOR_SIDE = 1400  # [px] of the floor's image
FLOOR_PIXEL = 0.01  # [m] edge of a pixel of the floor's image; ceiling cameras resolve no finer details
STRIPE_PERIOD = 0.2  # [m] period of the stripes
_INK = (40, 34, 30, 255)  # bgra of walls; the dark page inverts them
_UNKNOWN = (128, 128, 128, 70)
RESTRICTED_COLOR = (0, 94, 213)  # bgr, vermilion, as on the smart display
PREVIEW_COLOR = (0, 159, 230)  # bgr, orange: what saving now would restrict
PREVIEW_SIDE = 700  # [px] of a preview, which travels inside a message


@dataclass(frozen=True)
class EncodedImage:
    """A PNG or WebP image.

    Attributes:
        name: changes with the content, so that browsers may cache the image forever.
        cells_per_pixel: number of map cells along the side of a pixel; less than 1 if the image is finer than the map.
    """

    encoded: bytes
    name: str
    cells_per_pixel: float


class ImageCache:
    """Keeps the newest two images of each kind, because a browser may still be fetching the previous one."""

    def __init__(self) -> None:
        self._images: Dict[str, Tuple[EncodedImage, ...]] = {}

    def put(self, kind: str, image: EncodedImage) -> None:
        """Adds an image as the newest one of its kind."""
        previous = [earlier for earlier in self._images.get(kind, ()) if earlier.name != image.name]
        self._images[kind] = (image, *previous[:1])

    def get(self, kind: str, name: str) -> Optional[EncodedImage]:
        """Returns an image by its name, or None if it is not in the cache."""
        return next((image for image in self._images.get(kind, ()) if image.name == name), None)


def _reduce(data: np.ndarray, side: int) -> Tuple[np.ndarray, int]:
    """Reduces (H, W), padded by repeating its edge, to the maxima of blocks. Also returns a block's side [cells]."""
    cells = int(np.ceil(max(data.shape) / side))
    missing = [(0, -size % cells) for size in data.shape]
    padded = np.pad(data, missing, mode="edge")
    rows, columns = padded.shape
    blocks = padded.reshape(rows // cells, cells, columns // cells, cells)
    return blocks.max(axis=(1, 3)), cells


_PNG = (".png", [cv2.IMWRITE_PNG_COMPRESSION, 3])
_WEBP = (".webp", [cv2.IMWRITE_WEBP_QUALITY, 80])


def _encode(pixels: np.ndarray, cells: float, kind: Tuple[str, List[int]] = _PNG) -> EncodedImage:
    extension, options = kind
    # the map's last row is the image's first
    data = cv2.imencode(extension, np.ascontiguousarray(pixels[::-1]), options)[1].tobytes()
    return EncodedImage(data, hashlib.blake2b(data, digest_size=8).hexdigest(), cells)


def map_layer(grid: GridMap) -> EncodedImage:
    """Draws walls as ink, by their occupancy, and unknown floor as grey."""
    data, cells = _reduce(grid.data, MAX_SIDE)
    pixels = np.zeros((*data.shape, 4), np.uint8)
    pixels[data > 0] = _INK
    opacity = np.maximum(data, 0).astype(np.uint16) * 255 // 100
    pixels[..., 3] = opacity.clip(0, 255)
    pixels[data == UNKNOWN] = _UNKNOWN
    return _encode(pixels, cells)


def map_section(grid: GridMap, base: EncodedImage, restricted: Optional[EncodedImage], floor: bool) -> Dict[str, Any]:
    """Describes the map's images and geometry for the page. `floor` says whether there is an image of the floor."""
    rows, columns = grid.shape
    return {
        "picture": base.name,
        "restricted": restricted.name if restricted is not None else "",
        "rows": rows,
        "columns": columns,
        "resolution": json_number(grid.resolution, 6),
        "origin": [json_number(value, 5) for value in grid.origin],
        "cells_per_pixel": base.cells_per_pixel,
        "floor": floor_cells_per_pixel(grid) if floor else 0,
    }


def draw_restricted(prior: GridMap, posterior: GridMap) -> EncodedImage:
    """Draws stripes where borders have made the map more occupied. They are fainter for a lower occupancy."""
    region = np.where(posterior.data > prior.data, posterior.data, np.int8(0))
    return draw_region(region, posterior.resolution, RESTRICTED_COLOR, MAX_SIDE)


def draw_region(region: np.ndarray, resolution: float, tint: Tuple[int, int, int], side: int) -> EncodedImage:
    """Draws stripes over a region.

    Args:
        region: (H, W) int8, 0 (outside) to 100; row 0 is the lowest y.
        resolution: [m] edge of a cell.
        tint: bgr.
        side: [px] the largest side of the image.
    """
    data, cells = _reduce(region, side)
    rows, columns = np.indices(data.shape, dtype=np.float32)
    period = max(4.0, STRIPE_PERIOD / (resolution * cells))
    is_dark = ((rows + columns) % period) < period / 2.0
    strength = np.where(is_dark, 1.45, 0.75)
    pixels = np.zeros((*data.shape, 4), np.uint8)
    pixels[..., :3] = tint
    pixels[..., 3] = strength * np.maximum(data, 0)
    return _encode(pixels, cells)


@dataclass(frozen=True)
class CeilingImage:
    """The newest image of one ceiling camera."""

    pixels: np.ndarray  # (H, W, 3) bgr uint8
    camera: CameraModel
    T_camera_map: np.ndarray  # (4, 4) from the map frame to the camera's optical frame


def floor_cells_per_pixel(grid: GridMap) -> float:
    """Returns the number of map cells along the side of a pixel of the floor's image."""
    return max(max(grid.shape) / FLOOR_SIDE, FLOOR_PIXEL / grid.resolution)


def draw_floor(grid: GridMap, images: Sequence[CeilingImage]) -> EncodedImage:
    """Draws the floor as all cameras together see it, in the map's geometry. It is transparent where no camera sees it.

    Where several cameras see the same part of the floor, their images are averaged. The weight of an image decreases
    towards its edge, so that there are no hard seams.
    """
    cells = floor_cells_per_pixel(grid)
    rows, columns = (int(np.ceil(size / cells)) for size in grid.shape)
    center_x, center_y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    centers = np.column_stack([center_x.ravel(), center_y.ravel()])
    positions = grid.grid_to_world(centers * cells - 0.5)
    floor_points = np.column_stack([positions, np.zeros(len(positions))])
    total = np.zeros((rows, columns, 3), np.float32)
    weights = np.zeros((rows, columns), np.float32)
    for image in images:
        points = transform_points(image.T_camera_map, floor_points)
        in_front = points[:, 2] > 0.05
        points[~in_front] = (0.0, 0.0, 1.0)
        pixels = image.camera.project(points).astype(np.float32)
        size = np.array([image.camera.width, image.camera.height], np.float32)
        edge_distance = np.minimum(pixels, size - 1.0 - pixels).min(axis=1) / size.min()
        is_seen = in_front & (edge_distance > 0.0)
        weight = np.where(is_seen, edge_distance, 0.0).reshape(rows, columns).astype(np.float32)
        pixel_grid = pixels.reshape(rows, columns, 2)
        colors = cv2.remap(image.pixels, pixel_grid[..., 0], pixel_grid[..., 1], cv2.INTER_AREA)
        total += colors * weight[..., None]
        weights += weight
    is_visible = weights > 0
    mean_colors = total[is_visible] / weights[is_visible][:, None]
    pixels = np.zeros((rows, columns, 4), np.uint8)
    pixels[is_visible, :3] = mean_colors.clip(0, 255)
    pixels[is_visible, 3] = 255
    return _encode(pixels, cells, _WEBP)


def encode_jpeg(image: np.ndarray, width: int = 960) -> bytes:
    """Encodes a camera's image (H, W, 3) bgr or (H, W) as JPEG, not wider than `width` [px]."""
    scale = width / image.shape[1]
    if scale < 1.0:
        image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 78])[1].tobytes()
