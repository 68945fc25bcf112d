"""The overlay of restricted areas on the smart display."""

from __future__ import annotations

from typing import Optional

import cv2
import numpy as np

# In RViz's colour scheme "costmap" 0 is clear, 98 red, and 128 .. 254 (negative as int8) run from red to yellow.
CLEAR = 0
STRIPE = 98
PREVIEW = 200 - 256


def draw_restrictions(
    physical: np.ndarray, map_with_borders: np.ndarray, stripe: int = 4, preview: Optional[np.ndarray] = None
) -> np.ndarray:
    """Draws stripes where borders restrict the map: a pattern differs from walls with any colour vision.

    Hard borders get stripes as wide as the gaps between them, soft ones narrower stripes. The area that saving would
    restrict is orange, with stripes in the other direction, so that it is not mistaken for saved borders.

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
    result = np.where(restricted & ((rows + columns) % (2 * stripe) < widths), STRIPE, CLEAR).astype(np.int8)
    result[_outline(restricted)] = STRIPE
    if preview is not None:
        planned = preview > 0
        result[planned & ((rows - columns) % (2 * stripe) < stripe)] = PREVIEW
        result[_outline(planned)] = PREVIEW
    return result


def _outline(area: np.ndarray) -> np.ndarray:
    """Returns the outermost cells of an area. With this outline, small areas are visible too."""
    cross = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)
    return area & (cv2.erode(area.astype(np.uint8), cross) == 0)
