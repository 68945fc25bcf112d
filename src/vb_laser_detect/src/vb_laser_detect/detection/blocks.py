"""Blocks of BLOCK x BLOCK pixels, by which whole images are compared: their largest rise, samples, positions and masks."""

from __future__ import annotations

from functools import reduce
from typing import Tuple

import cv2
import numpy as np

from vb_laser_detect.detection.stage_results import BLOCK, Part

_BAND_BYTES = 240_000  # [bytes] of one pixel row of all blocks in a band: small enough for a core's cache
# half of a block's rows are read, in half the time, because a spot covers several rows
_COLOR_ROWS = (1, 3, 5, 7)
_MOSAIC_ROWS = (1, 2, 5, 6)  # in pairs, because two Bayer rows hold all colours


def block_maxima(image: np.ndarray, background: np.ndarray) -> np.ndarray:
    """Computes each block's largest rise above the background, of any channel, in half of its rows.

    Works in bands, so that each step finds the previous one's result in the processor's cache: over twice as fast.

    Args:
        image, background: (H, W) or (H, W, C) uint8, contiguous. The difference is never stored at full size.

    Returns:
        (H // BLOCK, W // BLOCK) uint8.
    """
    height = BLOCK * max(1, _BAND_BYTES // image[0].nbytes)  # of a band
    bands = []
    for top in range(0, image.shape[0] - BLOCK + 1, height):
        rows = slice(top, top + height)
        bands.append(_band_maxima(image[rows], background[rows]))
    if image.shape[0] % BLOCK:  # in half of 1080 rows, for example, the rows left over belong to the last blocks
        last = bands[-1][-1:]
        cv2.max(last, _band_maxima(image[-BLOCK:], background[-BLOCK:]), last)
    maxima = cv2.vconcat(bands)
    if image.shape[1] % BLOCK:  # half of 2028 columns, for example
        strip = np.ascontiguousarray(image[:, -BLOCK:])
        background_strip = np.ascontiguousarray(background[:, -BLOCK:])
        maxima[:, -1:] = cv2.max(maxima[:, -1:], block_maxima(strip, background_strip))
    return maxima


def _band_maxima(image: np.ndarray, background: np.ndarray) -> np.ndarray:
    """Computes `block_maxima` of a band whose height is a multiple of BLOCK; columns left over are ignored."""
    rows, columns = image.shape[0] // BLOCK, image.shape[1] // BLOCK
    # rows are reduced first, where memory is contiguous; the small rest is then transposed and reduced the same way
    now = image[: rows * BLOCK].reshape(rows, -1)
    before = background[: rows * BLOCK].reshape(rows, -1)
    length = now.shape[1] // BLOCK
    read_rows = _MOSAIC_ROWS if image.ndim == 2 else _COLOR_ROWS
    first, *parts = [slice(row * length, (row + 1) * length) for row in read_rows]
    best = cv2.subtract(now[:, first], before[:, first])
    rise = np.empty_like(best)
    for part in parts:
        cv2.subtract(now[:, part], before[:, part], rise)
        cv2.max(best, rise, best)
    best = max_channel(best.reshape((rows,) + image.shape[1:]))
    turned = cv2.transpose(best[:, : columns * BLOCK]).reshape(columns, -1)
    best = np.ascontiguousarray(turned[:, :rows])
    for column in range(1, BLOCK):
        cv2.max(best, turned[:, column * rows : (column + 1) * rows], best)
    return cv2.transpose(best)


def sample_blocks(image: np.ndarray) -> np.ndarray:
    """Samples one pixel of each block, always the same one: (H // BLOCK, W // BLOCK) or (H // BLOCK, W // BLOCK, C)."""
    rows, columns = image.shape[0] // BLOCK, image.shape[1] // BLOCK
    # numpy copies three bytes no faster than thirty
    return cv2.resize(image[: rows * BLOCK, : columns * BLOCK], (columns, rows), interpolation=cv2.INTER_NEAREST)


def blocks_around(shape: Tuple[int, ...], u: float, v: float, reach: float, scale: int) -> Part:
    """Returns the rows and columns of the blocks within `reach` of (u, v), all in pixels of full resolution.

    One searched pixel is `scale` of them wide.
    """
    block = BLOCK * scale
    top = int(max(0.0, v - reach)) // block
    left = int(max(0.0, u - reach)) // block
    bottom = int(max(-1.0, v + reach)) // block + 1
    right = int(max(-1.0, u + reach)) // block + 1
    rows = slice(top, min(shape[0], bottom))
    columns = slice(left, min(shape[1], right))
    return rows, columns


def pixels_of(rows: slice, columns: slice) -> Part:
    """Returns the pixels of these rows and columns of blocks."""
    return slice(BLOCK * rows.start, BLOCK * rows.stop), slice(BLOCK * columns.start, BLOCK * columns.stop)


def max_channel(image: np.ndarray) -> np.ndarray:
    """Returns the largest channel (H, W) of each pixel; cv2 does this fifty times faster than numpy's max."""
    return image if image.ndim == 2 else reduce(cv2.max, cv2.split(image))


def mask_of_blocks(blocks: np.ndarray, height: int, width: int) -> np.ndarray:
    """Returns a mask (height, width) uint8 of the pixels whose block is set."""
    rows, columns = blocks.shape
    mask = cv2.resize(blocks.view(np.uint8), (columns * BLOCK, rows * BLOCK), interpolation=cv2.INTER_NEAREST)
    rest = height - rows * BLOCK, width - columns * BLOCK
    if not any(rest):
        return mask
    # pixels left over at the edges belong to the last blocks
    return cv2.copyMakeBorder(mask, 0, rest[0], 0, rest[1], cv2.BORDER_REPLICATE)
