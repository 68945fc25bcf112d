"""Algorithm 1: the points that belong to the polygonal chain (paper, Sect. 4.3.2, "Clustering").

DBSCAN is computed exactly on a grid (Gunawan's construction): cells whose diagonal is eps hold points that
are all neighbours of each other, so only pairs of cells have to be compared. A stroke with 100,000 points has
ten thousand neighbours within eps for each of them; listing those, as usual implementations do, takes minutes.
"""
from __future__ import annotations

import math
from typing import List, Tuple

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

# cells of side eps / sqrt(2) that may hold a neighbour, one of each pair of opposite directions
_HALF_RING = [
    (dx, dy)
    for dx in range(0, 3)
    for dy in range(-2, 3)
    if (dx > 0 or dy > 0) and max(dx - 1, 0) ** 2 + max(abs(dy) - 1, 0) ** 2 < 2
]


def clustering(
    pointset_in: np.ndarray, eps: float, min_pts: int, min_exp: float, max_exp: float, min_size: int
) -> np.ndarray:
    """Algorithm 1, `clustering(in, out, params)`.

    Args:
        pointset_in: (N, 2) float64 [m], finite.
        eps: [m] distance of neighbours.
        min_pts: neighbours, itself included, that make a core point.
        min_exp, max_exp: [m] open interval for a cluster's expansion.
        min_size: the fewest points of a cluster.

    Returns:
        pointset_out: (M,) int64 indices into pointset_in, ascending; empty if no cluster qualifies.
    """
    pointset_out = np.zeros(0, dtype=np.int64)  # l. 2
    clusters = dbscan(pointset_in, eps, min_pts)  # l. 3
    clusters = order_clusters_by_size(clusters, min_size)  # l. 4
    for c in clusters:  # l. 5
        if min_exp < expansion(pointset_in[c]) < max_exp:  # l. 6
            pointset_out = c  # l. 7
            break  # l. 8
    return pointset_out


def order_clusters_by_size(clusters: List[np.ndarray], min_size: int) -> List[np.ndarray]:
    """The clusters of at least `min_size` points, largest first; equal ones keep their order."""
    return sorted((c for c in clusters if len(c) >= min_size), key=lambda c: -len(c))


def expansion(points: np.ndarray) -> float:
    """Diagonal [m] of the smallest axis-parallel box round the points (N, 2)."""
    return float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))


def dbscan(points: np.ndarray, eps: float, min_pts: int) -> List[np.ndarray]:
    """DBSCAN (Ester et al. 1996) with Euclidean distance; noise is left out.

    Where DBSCAN leaves open to which of several clusters a border point goes, it goes to its nearest core point's.

    Returns:
        One ascending array of indices per cluster, in the order of the clusters' first core points.
    """
    labels = dbscan_labels(points, eps, min_pts)
    members = np.flatnonzero(labels >= 0)
    if members.size == 0:
        return []
    order = members[np.argsort(labels[members], kind="stable")]
    return np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)


def dbscan_labels(points: np.ndarray, eps: float, min_pts: int) -> np.ndarray:
    """(N,) int64: the cluster of each point, -1 for noise."""
    points = np.asarray(points, dtype=float).reshape(-1, 2)
    labels = np.full(len(points), -1, dtype=np.int64)
    core = _core_points(points, eps, min_pts)
    cores = np.flatnonzero(core)
    if cores.size == 0:
        return labels
    found = _connect(points[cores], eps)
    # numbered by first appearance
    _, first, inverse = np.unique(found, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    labels[cores] = rank[inverse]
    rest = np.flatnonzero(~core)
    if rest.size:
        distance, nearest = cKDTree(points[cores]).query(points[rest], distance_upper_bound=_just_above(eps))
        reached = np.isfinite(distance)
        labels[rest[reached]] = labels[cores[nearest[reached]]]
    return labels


def cell_keys(points: np.ndarray, side: float) -> Tuple[np.ndarray, np.ndarray]:
    """Integer cells (N, 2) of points, counted from their lowest corner, and one int64 key for each."""
    cells = np.floor((points - points.min(axis=0)) / side).astype(np.int64)
    return cells, cells[:, 0] * _stride(cells) + cells[:, 1]


def _stride(cells: np.ndarray) -> int:
    return int(cells[:, 1].max()) + 5  # room for two cells beyond either side


def _just_above(eps: float) -> float:
    """kd-trees look for distances below their bound, DBSCAN's are at most eps."""
    return float(np.nextafter(eps, math.inf))


def _core_points(points: np.ndarray, eps: float, min_pts: int) -> np.ndarray:
    if min_pts <= 1 or len(points) == 0:
        return np.ones(len(points), dtype=bool)
    _, keys = cell_keys(points, _side(eps))
    _, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
    core = counts[inverse] >= min_pts  # all of a cell are neighbours of each other
    sparse = np.flatnonzero(~core)
    if sparse.size and len(points) >= min_pts:
        distance, _ = cKDTree(points).query(points[sparse], k=[min_pts], distance_upper_bound=_just_above(eps))
        core[sparse] = np.isfinite(distance[:, 0])
    return core


def _side(eps: float) -> float:
    return eps / math.sqrt(2.0) * (1.0 - 1e-9)


def _connect(points: np.ndarray, eps: float) -> np.ndarray:
    """(N,) component of each point in the graph that joins points at most eps apart."""
    cells, keys = cell_keys(points, _side(eps))
    unique, first, inverse, counts = np.unique(keys, return_index=True, return_inverse=True, return_counts=True)
    if len(unique) == 1:
        return np.zeros(len(points), dtype=np.int64)
    order = np.argsort(inverse, kind="stable")
    starts = np.concatenate([[0], np.cumsum(counts)])
    stride = _stride(cells)
    cell_of = cells[first]
    # Cells at most two apart differ in their place modulo five. With that as a third coordinate, far apart, one
    # tree answers "the nearest point that lies in that neighbouring cell".
    height = (cell_of[:, 0] % 5 * 5 + cell_of[:, 1] % 5) * (10.0 * eps)
    tree = None
    edges: List[np.ndarray] = [np.zeros((2, 0), dtype=np.int64)]
    neighbours = _neighbouring_cells(unique, cell_of, stride)
    # Where points are dense the two that are farthest towards each other's cell settle it at once.
    ordered = points[order]
    for (dx, dy), a, b in neighbours:
        towards = ordered @ np.array([float(dx), float(dy)])
        most = np.repeat(np.maximum.reduceat(towards, starts[:-1]), counts)
        least = np.repeat(np.minimum.reduceat(towards, starts[:-1]), counts)
        foremost = order[_first_of_each(towards == most, starts)]
        hindmost = order[_first_of_each(towards == least, starts)]
        near = ((points[foremost[a]] - points[hindmost[b]]) ** 2).sum(axis=1) <= eps**2
        edges.append(np.vstack([a[near], b[near]]))
    component = _components(edges, len(unique))
    for _, a, b in neighbours:
        still_open = component[a] != component[b]
        a, b = a[still_open], b[still_open]
        if a.size == 0:
            continue
        if tree is None:
            tree = cKDTree(np.column_stack([points, height[inverse]]))
        small, large = np.where(counts[a] <= counts[b], a, b), np.where(counts[a] <= counts[b], b, a)
        sizes = counts[small]
        pair = np.repeat(np.arange(len(small)), sizes)
        within = np.arange(len(pair)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        asked = order[starts[small][pair] + within]
        distance, _ = tree.query(
            np.column_stack([points[asked], height[large][pair]]), distance_upper_bound=_just_above(eps)
        )
        met = np.unique(pair[np.isfinite(distance)])
        edges.append(np.vstack([small[met], large[met]]))
        component = _components(edges, len(unique))
    return component[inverse].astype(np.int64)


def _neighbouring_cells(unique: np.ndarray, cell_of: np.ndarray, stride: int) -> List[tuple]:
    """((dx, dy), a, b): for each half direction the occupied cells a that have an occupied cell b there."""
    found = []
    for dx, dy in sorted(_HALF_RING, key=lambda offset: offset[0] ** 2 + offset[1] ** 2):
        wanted = unique + dx * stride + dy
        at = np.minimum(np.searchsorted(unique, wanted), len(unique) - 1)
        # the key of a cell below the first row belongs to the column before
        a = np.flatnonzero((unique[at] == wanted) & (cell_of[at, 0] == cell_of[:, 0] + dx))
        found.append(((dx, dy), a, at[a]))
    return found


def _first_of_each(flags: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """The place of the first true flag in each of the runs that begin at `starts`."""
    places = np.flatnonzero(flags)
    return places[np.searchsorted(places, starts[:-1])]


def _components(edges: List[np.ndarray], count: int) -> np.ndarray:
    rows, columns = np.hstack(edges)
    graph = coo_matrix((np.ones(len(rows), dtype=bool), (rows, columns)), shape=(count, count))
    return connected_components(graph, directed=False)[1]
