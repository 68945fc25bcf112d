"""The length of a pixel on the floor."""
from __future__ import annotations

import math
from typing import Callable, List, Optional, Sequence, Tuple

import numpy as np

# pixels (N, 2) to the floor (N, 2) [m], rows of NaN where there is none
ToFloor = Callable[[np.ndarray], np.ndarray]


def metres_per_pixel(to_floor: ToFloor, pixels: Sequence[Tuple[float, float]]) -> List[Optional[float]]:
    """[m/px] floor length of each of N pixels (u, v), the mean over directions; None where the floor is not seen."""
    if not len(pixels):
        return []
    corners = np.asarray(pixels, dtype=float)[:, None] + np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)])
    points = np.asarray(to_floor(corners.reshape(-1, 2)), dtype=float)[:, :2].reshape(-1, 3, 2)
    (ax, ay), (bx, by) = (points[:, 1] - points[:, 0]).T, (points[:, 2] - points[:, 0]).T
    areas = np.abs(ax * by - ay * bx)
    return [math.sqrt(area) if math.isfinite(area) and area > 0 else None for area in areas.tolist()]
