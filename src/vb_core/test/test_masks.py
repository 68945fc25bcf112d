"""Masks."""

import cv2
import numpy as np
import pytest

from vb_core import masks

OPERATIONS = {
    cv2.CMP_LT: np.less,
    cv2.CMP_LE: np.less_equal,
    cv2.CMP_GT: np.greater,
    cv2.CMP_GE: np.greater_equal,
    cv2.CMP_EQ: np.equal,
    cv2.CMP_NE: np.not_equal,
}


@pytest.mark.parametrize("kind", [np.uint8, np.int8, np.float32])
@pytest.mark.parametrize("operation", list(OPERATIONS))
def test_arrays_of_every_size_are_compared_with_a_number(kind, operation):
    rng = np.random.default_rng(1)
    for height in range(1, 6):
        for width in range(1, 6):
            values = rng.integers(0, 5, (height, width)).astype(kind)
            expected = np.where(OPERATIONS[operation](values, 2), 255, 0)
            mask = masks.threshold_mask(values, 2, operation)
            assert mask.dtype == np.uint8 and (mask == expected).all(), (height, width)
            framed = np.full((height + 2, width + 2), 7, np.uint8)
            masks.threshold_mask(values, 2, operation, dst=framed[1:-1, 1:-1])
            assert (framed[1:-1, 1:-1] == expected).all(), (height, width)
            assert (framed[0] == 7).all() and (framed[:, 0] == 7).all()
