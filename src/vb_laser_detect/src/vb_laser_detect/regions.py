"""Where in the image a closer look is worth it."""
from __future__ import annotations

from typing import List, Tuple

import cv2
import numpy as np

from vb_laser_detect.appearance import Region
from vb_laser_detect.blocks import BLOCK


def regions(maxima: np.ndarray, hot: np.ndarray, most: int, large: float) -> List[Tuple[Region, float]]:
    """Regions of connected hot blocks, the brightest first: pixels (left, top, right, bottom) and the peak.

    A region larger than `large` [blocks] is cut down to the parts above 60 % of its peak: a spot beside a person
    must not be lost in the person's region.
    """
    # few blocks are hot, and they lie together: all that follows is done where they are
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
