"""Whole-image work that must stay cheap: maxima over blocks of pixels, masks back to pixels."""
from __future__ import annotations

from typing import List, Optional, Tuple

import cv2
import numpy as np

BLOCK = 8  # [px] edge of a block

Region = Tuple[int, int, int, int]  # left, top, right, bottom [px]; right and bottom are excluded


def block_maxima(
    image: np.ndarray, background: Optional[np.ndarray] = None, row_step: int = 1, brightest: bool = False
) -> np.ndarray:
    """The largest value of each block of 8 x 8 pixels, of each channel.

    Args:
        image: (H, W) or (H, W, C) uint8, contiguous. Pixels right of and below the last whole block are left out.
        background: of the same shape; then the largest rise over it, which is never stored at full size.
        row_step: 2 reads only every second row, in half the time; rows of a Bayer image differ in colour.
        brightest: the largest channel alone, which is cheaper to find here than afterwards.

    Returns:
        (H // 8, W // 8), or (H // 8, W // 8, C) of a colour image unless `brightest`, uint8.
    """
    height, width = image.shape[:2]
    channels = 1 if image.ndim == 2 else image.shape[2]
    rows, columns = height // BLOCK, width // BLOCK
    # first over rows, where memory is contiguous; then the small rest is turned and reduced the same way
    stacked = image[: rows * BLOCK].reshape(rows, -1)
    before = None if background is None else background[: rows * BLOCK].reshape(rows, -1)
    reduced = _reduce(stacked, before, row_step).reshape(rows, width, channels)[:, : columns * BLOCK]
    if brightest or channels == 1:
        reduced, channels = max_channel(reduced).reshape(rows, -1, 1), 1
    turned = cv2.transpose(np.ascontiguousarray(reduced)).reshape(columns, -1)
    maxima = cv2.transpose(_reduce(turned).reshape(columns, rows, channels))
    return maxima.reshape(rows, columns) if channels == 1 else maxima


def _reduce(stacked: np.ndarray, before: Optional[np.ndarray] = None, step: int = 1) -> np.ndarray:
    """(N, 8 * M) holding eight rows of M one after the other, to the maxima (N, M) of every `step`-th row."""
    length = stacked.shape[1] // BLOCK
    parts = [slice(row * length, (row + 1) * length) for row in range(step - 1, BLOCK, step)]
    if before is None:
        result = cv2.max(stacked[:, parts[0]], stacked[:, parts[1]])
        for part in parts[2:]:
            cv2.max(result, stacked[:, part], result)
        return result
    result = cv2.subtract(stacked[:, parts[0]], before[:, parts[0]])
    rise = np.empty_like(result)
    for part in parts[1:]:
        cv2.subtract(stacked[:, part], before[:, part], rise)
        cv2.max(result, rise, result)
    return result


def sample_blocks(image: np.ndarray) -> np.ndarray:
    """One pixel of each block, always the same one: (H // 8, W // 8) or (H // 8, W // 8, C)."""
    rows, columns = image.shape[0] // BLOCK, image.shape[1] // BLOCK
    if image.ndim == 2:
        return np.ascontiguousarray(image[: rows * BLOCK : BLOCK, : columns * BLOCK : BLOCK])
    # numpy copies three bytes no faster than thirty
    return cv2.resize(image[: rows * BLOCK, : columns * BLOCK], (columns, rows), interpolation=cv2.INTER_NEAREST)


def max_channel(image: np.ndarray) -> np.ndarray:
    """(H, W) the largest channel of each pixel; cv2 does this fifty times faster than numpy's max."""
    if image.ndim == 2:
        return image
    planes = cv2.split(image)
    result = planes[0]
    for plane in planes[1:]:
        result = cv2.max(result, plane)
    return result


def blocks_around(shape: Tuple[int, ...], u: float, v: float, reach: float) -> Tuple[slice, slice]:
    """The rows and columns of a grid (rows, columns) of blocks within `reach` of a place [px]."""
    top, bottom = int(max(0.0, v - reach)) // BLOCK, int(v + reach) // BLOCK + 1
    left, right = int(max(0.0, u - reach)) // BLOCK, int(u + reach) // BLOCK + 1
    return slice(top, min(shape[0], bottom)), slice(left, min(shape[1], right))


def mask_of_blocks(blocks: np.ndarray, height: int, width: int) -> np.ndarray:
    """(height, width) uint8 mask of the pixels whose block is set; the rest right and below takes the last block's."""
    rows, columns = min(blocks.shape[0], -(-height // BLOCK)), min(blocks.shape[1], -(-width // BLOCK))
    small = np.ascontiguousarray(blocks[:rows, :columns]).view(np.uint8)
    big = cv2.resize(small, (columns * BLOCK, rows * BLOCK), interpolation=cv2.INTER_NEAREST)
    if big.shape == (height, width):
        return big
    mask = np.zeros((height, width), np.uint8)
    h, w = min(height, big.shape[0]), min(width, big.shape[1])
    mask[:h, :w] = big[:h, :w]
    return mask


def regions(maxima: np.ndarray, hot: np.ndarray, most: int, large: float) -> List[Tuple[Region, float]]:
    """Regions of connected hot blocks, the brightest first: pixels (left, top, right, bottom) and the peak.

    A region larger than `large` [blocks] is cut down to the parts above 60 % of its peak: a spot beside a person
    must not be lost in the person's region.
    """
    # few blocks are hot, and they are close together: the rest is done only there
    x, y, wide, high = cv2.boundingRect(hot.view(np.uint8))
    hot, maxima = (np.ascontiguousarray(blocks[y : y + high, x : x + wide]) for blocks in (hot, maxima))
    if not hot.size:
        return []
    _, labels, stats, _ = cv2.connectedComponentsWithStats(hot.view(np.uint8), connectivity=8)
    rows, columns = np.nonzero(hot)
    peaks = np.zeros(len(stats), np.int64)
    np.maximum.at(peaks, labels[rows, columns], maxima[rows, columns])
    result: List[Tuple[Region, float]] = []
    for label in np.argsort(-peaks[1:], kind="stable")[:most] + 1:
        left, top, width, height, _ = (int(value) for value in stats[label])
        if max(width, height) > large:
            cut = (slice(top, top + height), slice(left, left + width))
            part = (labels[cut] == label) & (maxima[cut] > 0.6 * peaks[label])
            if not part.all():
                parts = regions(maxima[cut], part, 6, np.inf)
                result += [(_shifted(region, x + left, y + top), peak) for region, peak in parts]
                continue
        region = (left * BLOCK, top * BLOCK, (left + width) * BLOCK, (top + height) * BLOCK)
        result.append((_shifted(region, x, y), float(peaks[label])))
    return result[: 2 * most]


def _shifted(region: Region, columns: int, rows: int) -> Region:
    """A region moved by whole blocks."""
    left, top, right, bottom = region
    return left + columns * BLOCK, top + rows * BLOCK, right + columns * BLOCK, bottom + rows * BLOCK
