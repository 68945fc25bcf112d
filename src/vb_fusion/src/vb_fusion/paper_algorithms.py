"""Algorithms 1 to 3 of the paper as written (Sect. 4.3.2), on bare points.

Where the paper leaves a choice open, the first point is taken. All pairs of neighbours are held in memory, as common
implementations of DBSCAN do. If there are too many, the points are refused. The default mode has no such limit.
"""

from __future__ import annotations

from typing import List

import numpy as np
from scipy.sparse import coo_matrix
from scipy.spatial import cKDTree

from vb_core import geometry
from vb_core.errors import CodedError

MAX_PAIRS = 20_000_000  # pairs of neighbours: a gigabyte, some 6,000 points at one place or 50,000 along a line


def find_cluster(pointset_in: np.ndarray, eps: float, min_pts: int, min_exp: float, min_size: int) -> np.ndarray:
    """Finds the drawn cluster: Algorithm 1, `clustering(in, out, params)`.

    Args:
        pointset_in: (N, 2) float64 [m], finite.
        eps: [m] distance of neighbours.
        min_pts: neighbours, itself included, that make a core point.
        min_exp: [m] a cluster's expansion must exceed it; Table 1's max_exp is infinite.
        min_size: the fewest points of a cluster.

    Returns:
        pointset_out: (M,) int64 indices into pointset_in, ascending; empty if no cluster qualifies.
    """
    pointset_out = np.zeros(0, dtype=np.int64)  # l. 2
    clusters = dbscan(pointset_in, eps, min_pts)  # l. 3
    large_clusters = [c for c in clusters if len(c) >= min_size]
    for c in sorted(large_clusters, key=len, reverse=True):  # l. 4, 5
        if min_exp < geometry.bounding_diagonal(pointset_in[c]):  # l. 6, the expansion
            pointset_out = c  # l. 7
            break  # l. 8
    return pointset_out


def dbscan(points: np.ndarray, eps: float, min_pts: int) -> List[np.ndarray]:
    """Clusters points (N, 2) by DBSCAN (Ester et al. 1996) with Euclidean distance, and leaves out noise.

    Returns:
        One ascending array of indices per cluster, in the order of the clusters' first core points.
    """
    from sklearn.cluster import DBSCAN  # 80 MB that the default mode does not need

    _tree(points, eps)
    label = DBSCAN(eps=eps, min_samples=min_pts).fit(points).labels_
    return [np.flatnonzero(label == number) for number in range(int(label.max()) + 1)]


def _tree(points: np.ndarray, radius: float) -> cKDTree:
    """Builds a k-d tree of points, or raises CodedError "too_many_spots" if too many pairs of them are neighbours."""
    tree = cKDTree(points)
    pairs = (int(tree.count_neighbors(tree, radius)) - len(points)) // 2
    if pairs > MAX_PAIRS:
        raise CodedError("too_many_spots", spots=len(points))
    return tree


def thin_points(pointset_in: np.ndarray, max_neighbor_dist: float) -> np.ndarray:
    """Replaces neighbours by their mean: Algorithm 2, `thinning(in, out, params)`.

    Args:
        pointset_in: (N, 2) float64 [m], finite.
        max_neighbor_dist: [m] distance of neighbours.

    Returns:
        pointset_out: (M, 2) float64 [m], the means in the order they were made, then the points without neighbours.
    """
    count = len(pointset_in)
    pairs = _tree(pointset_in, max_neighbor_dist).query_pairs(max_neighbor_dist, output_type="ndarray")
    rows, columns = np.vstack([pairs, pairs[:, ::-1]]).T
    near = coo_matrix((np.ones(len(rows), dtype=bool), (rows, columns)), shape=(count, count)).tocsr()
    neighbors = np.split(near.indices, near.indptr[1:-1])
    numbers = np.diff(near.indptr)
    left = np.ones(count, dtype=bool)
    pointset_out = []  # l. 2
    while left.any():  # l. 3
        p = int(np.argmax(numbers))  # l. 4
        n = neighbors[p][left[neighbors[p]]]  # l. 5
        if not n.size:  # l. 6, 10
            break
        taken = np.append(n, p)
        pointset_out.append(pointset_in[taken].mean(axis=0))  # l. 7, 9
        left[taken] = False  # l. 8
        for gone in taken:
            numbers[neighbors[gone]] -= 1
        numbers[~left] = -1
    return np.vstack([np.array(pointset_out).reshape(-1, 2), pointset_in[left]])  # l. 12


def generate_polygon(pointset_in: np.ndarray, max_neighbor_dist: float) -> np.ndarray:
    """Orders points by walking to nearest neighbours, forward and back: Algorithm 3, `generatePoly(in, out, params)`.

    Args:
        pointset_in: (N, 2) float64 [m], at least one, finite.
        max_neighbor_dist: [m] the longest step.

    Returns:
        polygon: (M,) int64 indices into pointset_in, along the chain; points that the walk left out are missing.
    """
    unmarked = np.ones(len(pointset_in), dtype=bool)
    dir1, dir2 = [0], []  # l. 2 to 6
    unmarked[0] = False
    walk = dir1
    p = 0
    while unmarked.any():  # l. 7
        squares = np.where(unmarked, ((pointset_in - pointset_in[p]) ** 2).sum(axis=1), np.inf)
        n = int(np.argmin(squares))  # l. 8
        if squares[n] <= max_neighbor_dist**2:  # l. 9
            walk.append(n)  # l. 10 to 14
            unmarked[n] = False
            p = n
        elif walk is dir1:  # l. 16
            walk = dir2
            p = 0
        else:
            break  # l. 20
    return np.array(dir1[::-1] + dir2, dtype=np.int64)  # l. 21, 22
