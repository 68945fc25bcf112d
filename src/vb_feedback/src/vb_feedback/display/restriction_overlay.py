"""The overlay of restricted areas on the smart display."""

from __future__ import annotations

from typing import Optional

import cv2
import numpy as np

# In RViz's colour scheme "costmap", 0 is transparent, 98 is red, and 128 .. 254 (negative as int8) go from red to yellow.
CLEAR = 0
STRIPE = 98
PREVIEW = 200 - 256


def draw_restrictions(
    physical: np.ndarray, map_with_borders: np.ndarray, stripe: int = 4, preview: Optional[np.ndarray] = None
) -> np.ndarray:
    """Draws stripes where borders restrict the map. With any colour vision, a pattern can be distinguished from walls.

    The stripes of hard borders are as wide as the gaps between them, those of soft borders are narrower. The area that
    saving would restrict is orange, and its stripes run in the other direction, so that it does not look saved.

    Args:
        physical, map_with_borders: (H, W) int8, the map without and with the virtual borders.
        stripe: [cells] width of a stripe.
        preview: (H, W), above 0 where saving would restrict the map; None if nowhere.

    Returns:
        (H, W) int8 for RViz's colour scheme "costmap".
    """
    rows, columns = np.indices(map_with_borders.shape)
    restricted = (map_with_borders != physical) & (map_with_borders > 0)
    widths = np.where(map_with_borders >= 100, stripe, max(1, stripe // 3))
    is_stripe = (rows + columns) % (2 * stripe) < widths
    result = np.where(restricted & is_stripe, STRIPE, CLEAR).astype(np.int8)
    result[_outline(restricted)] = STRIPE
    if preview is not None:
        planned = preview > 0
        is_stripe = (rows - columns) % (2 * stripe) < stripe
        result[planned & is_stripe] = PREVIEW
        result[_outline(planned)] = PREVIEW
    return result


def _outline(area: np.ndarray) -> np.ndarray:
    """Returns the outermost cells of an area. The outline makes small areas visible too."""
    cross = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)
    return area & (cv2.erode(area.astype(np.uint8), cross) == 0)
