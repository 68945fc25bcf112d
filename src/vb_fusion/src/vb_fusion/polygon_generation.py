"""Algorithm 3: the thinned points in the order of the chain (paper, Sect. 4.3.2, "Polygon Generation")."""
from __future__ import annotations

from typing import List, Optional, Tuple

import numpy as np
from scipy.spatial import cKDTree


def generate_poly(pointset_in: np.ndarray, max_neighbor_dist: float) -> np.ndarray:
    """Algorithm 3, `generatePoly(in, out, params)`: a walk to nearest neighbours, forward and backward.

    Of several nearest neighbours the first is taken.

    Args:
        pointset_in: (N, 2) float64 [m], at least one, finite.
        max_neighbor_dist: [m] the longest step.

    Returns:
        polygon: (M,) int64 indices into pointset_in, along the chain; points that the walk left out are missing.
    """
    unmarked = _Unmarked(pointset_in, max_neighbor_dist)
    dir1: List[int] = []  # l. 2
    dir2: List[int] = []
    forward = True  # l. 3
    p = 0  # l. 4
    unmarked.set_marked(p)  # l. 5
    dir1.append(p)  # l. 6
    while unmarked.left:  # l. 7
        n = unmarked.nearest_neighbor(p)  # l. 8
        if n is not None:  # l. 9
            if forward:  # l. 10
                dir1.append(n)
            else:
                dir2.append(n)
            unmarked.set_marked(n)
            p = n
        else:  # l. 15
            if forward:  # l. 16
                p = 0
                forward = False
            else:
                break  # l. 20
    dir1.reverse()  # l. 21
    return np.array(dir1 + dir2, dtype=np.int64)  # l. 22


class _Unmarked:
    """The points that the walk has not visited yet."""

    def __init__(self, points: np.ndarray, max_dist: float) -> None:
        self._points = np.asarray(points, dtype=float)
        self._tree = cKDTree(self._points)
        self._below = np.nextafter(max_dist, np.inf)  # kd-trees look for distances below their bound
        self._marked = np.zeros(len(self._points), dtype=bool)
        self.left = len(self._points)
        # a few neighbours of every point are asked for at once; most steps need no more
        self._near = self._neighbors(self._points, min(16, self.left))

    def set_marked(self, p: int) -> None:
        self._marked[p] = True
        self.left -= 1

    def nearest_neighbor(self, p: int) -> Optional[int]:
        """getNearestUnmarkedNeighbor: at most max_dist away, or None."""
        distance, index = self._near[0][p], self._near[1][p]
        while True:
            found = np.isfinite(distance)
            complete = len(distance) == len(self._points) or not found.all()
            distance, index = distance[found], index[found]
            free = ~self._marked[index]
            # all points as near as the nearest free one must have been listed before the first of them is chosen
            if free.any() and (complete or distance[free][0] < distance[-1]):
                return int(index[free][distance[free] == distance[free][0]].min())
            if complete:
                return None
            distance, index = self._neighbors(self._points[p], min(4 * len(distance), len(self._points)))

    def _neighbors(self, points: np.ndarray, k: int) -> Tuple[np.ndarray, np.ndarray]:
        """Distances [m] and indices of the k nearest points to each of `points`; inf where there are fewer."""
        return self._tree.query(points, k=np.arange(1, k + 1), distance_upper_bound=self._below)
