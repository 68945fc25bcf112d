"""Masks of images and grids, (H, W) uint8 with 0 and 255, as OpenCV uses them."""

from __future__ import annotations

from typing import Optional

import cv2
import numpy as np

_OPERATIONS = {
    cv2.CMP_LT: np.less,
    cv2.CMP_LE: np.less_equal,
    cv2.CMP_GT: np.greater,
    cv2.CMP_GE: np.greater_equal,
    cv2.CMP_EQ: np.equal,
    cv2.CMP_NE: np.not_equal,
}


def threshold_mask(values: np.ndarray, limit: float, operation: int, dst: Optional[np.ndarray] = None) -> np.ndarray:
    """Marks where a comparison with a number holds, (H, W) uint8 with 255 there; `cv2.compare` for every size.

    OpenCV treats an array of one element as a number too, and cannot compare two numbers.

    Args:
        values: (H, W) of any type in OpenCV.
        operation: cv2.CMP_LT and the like.
        dst: where to write the mask.
    """
    if values.size != 1:
        return cv2.compare(values, limit, operation, dst)
    mask = np.where(_OPERATIONS[operation](values, limit), np.uint8(255), np.uint8(0))
    if dst is None:
        return mask
    dst[:] = mask
    return dst
