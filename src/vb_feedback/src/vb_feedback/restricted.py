"""The overlay of restricted areas on the smart display."""
from __future__ import annotations

import numpy as np

# In RViz's colour scheme "costmap" 0 is clear, 98 red, 1 blue; walls of the physical map are black.
CLEAR = 0
STRIPE = 98


def overlay(physical: np.ndarray, posterior: np.ndarray, stripe: int = 4) -> np.ndarray:
    """Stripes where borders restrict the map: a pattern is told from walls by any eye.

    Hard borders get stripes as broad as the gaps between them, soft ones narrower stripes.

    Args:
        physical, posterior: (H, W) int8, without and with the virtual borders.
        stripe: [cells] width of a stripe.

    Returns:
        (H, W) int8 for RViz's colour scheme "costmap".
    """
    rows, columns = np.indices(posterior.shape)
    phase = (rows + columns) % (2 * stripe)
    changed = (posterior != physical) & (posterior > 0)
    narrow = max(1, stripe // 3)
    broad = np.where(posterior >= 100, stripe, narrow)
    result = np.where(changed & (phase < broad), STRIPE, CLEAR).astype(np.int8)
    # an edge all round makes small areas visible too
    inner = changed.copy()
    inner[1:, :] &= changed[:-1, :]
    inner[:-1, :] &= changed[1:, :]
    inner[:, 1:] &= changed[:, :-1]
    inner[:, :-1] &= changed[:, 1:]
    result[changed & ~inner] = STRIPE
    return result
