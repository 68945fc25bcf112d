"""Blocks of pixels: the whole image is read only in them, which must stay cheap."""

from __future__ import annotations

from typing import List, Tuple

import cv2
import numpy as np

BLOCK = 8  # [px] edge of a block
_BAND = 160_000  # [bytes] of one row of all blocks in a band: it stays in the cache of the processor's core
_LARGE = 14  # [blocks] regions that are larger are cut down to their brightest parts
# half the rows must do, in half the time: spots cover several. In a Bayer image's pattern two neighbours hold all
# colours
_COLOR_ROWS, _MOSAIC_ROWS = (1, 3, 5, 7), (1, 2, 5, 6)

Region = Tuple[int, int, int, int]  # left, top, right, bottom [px]; right and bottom are excluded


def block_maxima(image: np.ndarray, background: np.ndarray) -> np.ndarray:
    """Computes each block's largest rise above the background, of any channel, in half of its rows.

    Band by band: what one step leaves is still in the processor's cache for the next, which saves more than half the
    time.

    Args:
        image, background: (H, W) or (H, W, C) uint8, contiguous. The difference is never stored at full size.

    Returns:
        (H // BLOCK, W // BLOCK) uint8.
    """
    high = BLOCK * max(1, _BAND // image[0].nbytes)
    bands = [
        _band_maxima(image[top : top + high], background[top : top + high])
        for top in range(0, image.shape[0] - BLOCK + 1, high)
    ]
    if image.shape[0] % BLOCK:  # as of half of 1080 rows: those that are left belong to the last blocks
        last = bands[-1][-1:]
        cv2.max(last, _band_maxima(image[-BLOCK:], background[-BLOCK:]), last)
    maxima = cv2.vconcat(bands)
    if image.shape[1] % BLOCK:  # as of half of 2028 columns
        strips = (np.ascontiguousarray(picture[:, -BLOCK:]) for picture in (image, background))
        maxima[:, -1:] = cv2.max(maxima[:, -1:], block_maxima(*strips))
    return maxima


def _band_maxima(image: np.ndarray, background: np.ndarray) -> np.ndarray:
    high, columns = image.shape[0] // BLOCK, image.shape[1] // BLOCK
    # first over rows, where memory is contiguous; then the small rest is turned and reduced the same way
    now, before = (picture[: high * BLOCK].reshape(high, -1) for picture in (image, background))
    length = now.shape[1] // BLOCK
    rows = _MOSAIC_ROWS if image.ndim == 2 else _COLOR_ROWS
    first, *parts = [slice(row * length, (row + 1) * length) for row in rows]
    best = cv2.subtract(now[:, first], before[:, first])
    rise = np.empty_like(best)
    for part in parts:
        cv2.subtract(now[:, part], before[:, part], rise)
        cv2.max(best, rise, best)
    best = max_channel(best.reshape((high,) + image.shape[1:]))
    turned = cv2.transpose(best[:, : columns * BLOCK]).reshape(columns, -1)
    best = np.ascontiguousarray(turned[:, :high])
    for column in range(1, BLOCK):
        cv2.max(best, turned[:, column * high : (column + 1) * high], best)
    return cv2.transpose(best)


def sample_blocks(image: np.ndarray) -> np.ndarray:
    """Samples one pixel of each block, always the same one: (H // BLOCK, W // BLOCK) or (H // BLOCK, W // BLOCK, C)."""
    rows, columns = image.shape[0] // BLOCK, image.shape[1] // BLOCK
    # numpy copies three bytes no faster than thirty
    return cv2.resize(image[: rows * BLOCK, : columns * BLOCK], (columns, rows), interpolation=cv2.INTER_NEAREST)


def max_channel(image: np.ndarray) -> np.ndarray:
    """Returns the largest channel (H, W) of each pixel; cv2 does this fifty times faster than numpy's max."""
    if image.ndim == 2:
        return image
    first, *others = cv2.split(image)
    for plane in others:
        first = cv2.max(first, plane)
    return first


def brightest(image: np.ndarray, region: Region) -> float:
    """Returns the brightest sample [grey levels] of a region."""
    left, top, right, bottom = region
    # columns and channels side by side
    return cv2.minMaxLoc(image[top:bottom, left:right].reshape(bottom - top, -1))[1]


def blocks_around(shape: Tuple[int, ...], u: float, v: float, reach: float, edge: int = BLOCK) -> Tuple[slice, slice]:
    """Returns the rows and columns of a grid (rows, columns) of blocks of an edge within `reach` of a place [px]."""
    top, bottom = int(max(0.0, v - reach)) // edge, int(max(-1.0, v + reach)) // edge + 1
    left, right = int(max(0.0, u - reach)) // edge, int(max(-1.0, u + reach)) // edge + 1
    return slice(top, min(shape[0], bottom)), slice(left, min(shape[1], right))


def mask_of_blocks(blocks: np.ndarray, height: int, width: int) -> np.ndarray:
    """Returns a mask (height, width) uint8 of the pixels whose block is set."""
    rows, columns = blocks.shape
    mask = cv2.resize(blocks.view(np.uint8), (columns * BLOCK, rows * BLOCK), interpolation=cv2.INTER_NEAREST)
    rest = height - rows * BLOCK, width - columns * BLOCK
    # what is left at the edges belongs to the last blocks
    return cv2.copyMakeBorder(mask, 0, rest[0], 0, rest[1], cv2.BORDER_REPLICATE) if any(rest) else mask


def find_regions(maxima: np.ndarray, hot: np.ndarray) -> List[Region]:
    """Finds regions [px] of connected hot blocks, those with the highest peaks first.

    A large region is cut down to the parts above 60 % of its peak: a spot beside a person must not be lost in the
    person's region.
    """
    # few blocks are hot, and they are close together: the rest is done only there
    x, y, wide, high = cv2.boundingRect(hot.view(np.uint8))
    if not wide:
        return []
    hot, maxima = (np.ascontiguousarray(blocks[y : y + high, x : x + wide]) for blocks in (hot, maxima))
    labels, stats, peaks = _components(hot, maxima)
    large = stats[:, 2:4].max(axis=1) > _LARGE
    large[0] = False
    if large.any():
        labels, stats, peaks = _components(hot & ~(large[labels] & (maxima <= 0.6 * peaks[labels])), maxima)
    result = []
    for label in np.argsort(-peaks[1:], kind="stable") + 1:
        left, top, width, height = ((stats[label, :4] + (x, y, 0, 0)) * BLOCK).tolist()
        result.append((left, top, left + width, top + height))
    return result


def _components(hot: np.ndarray, maxima: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Labels (rows, columns), OpenCV's statistics and the peak of each connected component."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(hot.view(np.uint8), connectivity=8)
    peaks = np.zeros(len(stats))
    np.maximum.at(peaks, labels[hot], maxima[hot])
    return labels, stats, peaks
