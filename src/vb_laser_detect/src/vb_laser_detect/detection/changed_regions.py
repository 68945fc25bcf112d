"""Finds the regions of an image to examine: connected blocks that became brighter than the background."""

from __future__ import annotations

from typing import List, Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_core.image_format import AnyPicture
from vb_laser_detect.detection.stage_results import BLOCK, Box, ChangedRegion, Comparison, ExpectedSpot

_HALF_LEVEL = 0.8  # a spot of few pixels keeps at least this share of its level in the halved image
_MAX_REGIONS = 24  # walking people cause fewer; to examine more would take longer than an image period
_LARGE = 14  # [blocks] side above which a region is cut down to its brightest parts


def find_regions(
    picture: AnyPicture, comparison: Comparison, min_level: float, expected: Sequence[ExpectedSpot]
) -> List[ChangedRegion]:
    """Finds an image's regions that became brighter, the brightest first; those darker than `min_level` have no boxes."""
    image = picture.search_pixels
    boxes = find_boxes(comparison.rise, comparison.brighter)
    # sorted by level, not by rise: on a bright floor, a person can rise more than the white spot
    boxes.sort(key=lambda box: -_max_in_box(image, box))
    return [_region(picture, box, min_level, expected) for box in boxes[:_MAX_REGIONS]]


def _region(picture: AnyPicture, box: Box, min_level: float, expected: Sequence[ExpectedSpot]) -> ChangedRegion:
    """Makes a region from a box of the searched pixels. The last blocks include the pixels left over at the edges."""
    left, top, right, bottom = box
    height, width = picture.search_pixels.shape[:2]
    if width - right < BLOCK:
        right = width
    if height - bottom < BLOCK:
        bottom = height
    box = picture.scale * left, picture.scale * top, picture.scale * right, picture.scale * bottom
    if picture.is_fully_decoded:
        level = _max_in_box(picture.pixels, box)
    else:  # the highest level that is possible
        level = _max_in_box(picture.search_pixels, (left, top, right, bottom)) / _HALF_LEVEL
    for spot in expected:
        part = _part_within_reach(box, spot)
        if part is not None:
            return ChangedRegion(box, [box, part] if level >= min_level else [], spot)
    return ChangedRegion(box, [box] if level >= min_level else [], None)


def _part_within_reach(box: Box, spot: ExpectedSpot) -> Optional[Box]:
    """Returns the part of a box in which a spot may be, or None if it is in no part."""
    left, top, right, bottom = box
    u, v = spot.position
    left = max(left, int(u - spot.reach))
    top = max(top, int(v - spot.reach))
    right = min(right, int(u + spot.reach) + 1)
    bottom = min(bottom, int(v + spot.reach) + 1)
    return (left, top, right, bottom) if left < right and top < bottom else None


def _max_in_box(image: np.ndarray, box: Box) -> int:
    """Returns the brightest sample [grey levels] of a box."""
    left, top, right, bottom = box
    return int(image[top:bottom, left:right].max())


def find_boxes(maxima: np.ndarray, hot: np.ndarray) -> List[Box]:
    """Finds the boxes [px] of connected hot blocks, those with the highest peaks first.

    A large region is cut down to the parts above 60 % of its peak, so that no spot is lost in a person's region.
    """
    # few blocks are hot, and they are close together: only their surroundings are processed
    x, y, wide, high = cv2.boundingRect(hot.view(np.uint8))
    if not wide:
        return []
    around = slice(y, y + high), slice(x, x + wide)
    hot = np.ascontiguousarray(hot[around])
    maxima = np.ascontiguousarray(maxima[around])
    labels, stats, peaks = _components(hot, maxima)
    is_large = stats[:, 2:4].max(axis=1) > _LARGE
    is_large[0] = False
    if is_large.any():
        is_dim_part = is_large[labels] & (maxima <= 0.6 * peaks[labels])
        labels, stats, peaks = _components(hot & ~is_dim_part, maxima)
    order = np.argsort(-peaks[1:], kind="stable")
    left, top, width, height = stats[1:][order, :4].T
    boxes = BLOCK * np.column_stack([x + left, y + top, x + left + width, y + top + height])
    return list(map(tuple, boxes.tolist()))


def _components(hot: np.ndarray, maxima: np.ndarray) -> Tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the connected components: labels (rows, columns), and the statistics of OpenCV and the peak of each."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(hot.view(np.uint8), connectivity=8)
    peaks = np.zeros(len(stats))
    np.maximum.at(peaks, labels[hot], maxima[hot])
    return labels, stats, peaks
