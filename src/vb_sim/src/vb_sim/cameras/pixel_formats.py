"""Converts rgb to the simulated cameras' pixel formats."""

from __future__ import annotations

import cv2
import numpy as np


def encode(rgb: np.ndarray, encoding: str) -> np.ndarray:
    """Encodes rgb (H, W, 3), H and W even for Bayer, in a sensor_msgs encoding: (H, W) or (H, W, 3), same type."""
    if encoding == "bgr8":
        return np.ascontiguousarray(rgb[..., ::-1])
    if encoding == "mono8":
        return cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    return _mosaic(rgb[0::2, 0::2, 0], rgb[0::2, 1::2, 1], rgb[1::2, 0::2, 1], rgb[1::2, 1::2, 2])


def encode_doubled(rgb: np.ndarray, encoding: str) -> np.ndarray:
    """Encodes an image (h, w, 3) at twice its size: (2h, 2w) or (2h, 2w, 3)."""
    if encoding == "bayer_rggb8":
        red, green, blue = cv2.split(rgb)
        return _mosaic(red, green, green, blue)
    return encode(cv2.resize(rgb, None, fx=2, fy=2, interpolation=cv2.INTER_LINEAR), encoding)


def _mosaic(red: np.ndarray, right: np.ndarray, below: np.ndarray, blue: np.ndarray) -> np.ndarray:
    """Builds a Bayer pattern (2h, 2w) from its four pixels (h, w): red, green to its right and below it, and blue."""
    mosaic = np.empty((2 * red.shape[0], 2 * red.shape[1]), red.dtype)
    mosaic[0::2, 0::2], mosaic[0::2, 1::2] = red, right
    mosaic[1::2, 0::2], mosaic[1::2, 1::2] = below, blue
    return mosaic


def apply_color_filters(values: np.ndarray, weights: np.ndarray, encoding: str, column: int, row: int) -> np.ndarray:
    """Spreads light (h, w) over the filters of a sensor: (h, w) or (h, w, 3).

    Args:
        weights: (3,) shares for red, green, blue.
        column, row: where the patch is in the image (a Bayer pattern's phase depends on it).
    """
    red, green, blue = (np.float32(weight) for weight in weights)
    if encoding == "rgb8":
        return values[..., None] * np.array([red, green, blue])
    if encoding == "bgr8":
        return values[..., None] * np.array([blue, green, red])
    if encoding == "mono8":
        return values * np.float32(0.299 * red + 0.587 * green + 0.114 * blue)
    result = values * green
    even_row, even_column, odd_row, odd_column = row % 2, column % 2, 1 - row % 2, 1 - column % 2
    result[even_row::2, even_column::2] = values[even_row::2, even_column::2] * red
    result[odd_row::2, odd_column::2] = values[odd_row::2, odd_column::2] * blue
    return result
