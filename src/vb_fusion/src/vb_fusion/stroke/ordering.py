"""Bare points, without stamps: an order in space instead of the order in time.

The points are gathered into sites on a lattice; lonely sites go. The sites' minimum spanning tree follows the line,
and its longest path is the stroke: a ring is opened at its widest gap. Legs closer than two sites cannot be told
apart, and something bright beside the line may pass for a part of it: with stamps both can.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra, minimum_spanning_tree
from scipy.spatial import Delaunay, QhullError, cKDTree

from vb_fusion.stroke.observations import TREMOR

SITE_SPACING = 1.2 * TREMOR  # [m] of the lattice: wider than a line trembles, narrower than a border's slots
MIN_COMPANY = 0.15  # of the usual company: strays have less


def order_points(points: np.ndarray, widest_gap: float) -> np.ndarray:
    """Orders bare points along the stroke.

    Args:
        points: (N, 2) [m]
        widest_gap: [m] that may be missing between two points of the stroke.

    Returns:
        Indices of the points that belong to the stroke, in the order of its path; empty if there is none.
    """
    cell = np.floor(points / SITE_SPACING).astype(np.int64)
    cell -= cell.min(axis=0)
    _, site = np.unique(cell[:, 0] * (int(cell[:, 1].max()) + 1) + cell[:, 1], return_inverse=True)
    count = np.bincount(site)
    at = np.column_stack([np.bincount(site, points[:, k]) / count for k in range(2)])
    tree = cKDTree(at)
    pairs = tree.query_pairs(2.0 * SITE_SPACING, output_type="ndarray")
    capped = np.minimum(count, 3.0 * np.median(count))
    company = (
        capped
        + np.bincount(pairs[:, 0], capped[pairs[:, 1]], len(at))
        + np.bincount(pairs[:, 1], capped[pairs[:, 0]], len(at))
    )
    usual = np.median(company[company > 2.0]) if (company > 2.0).any() else 1.0
    at = at[company >= MIN_COMPANY * usual]
    path = _longest_path(at, widest_gap)
    if len(path) < 2:
        return np.zeros(0, dtype=int)
    away, nearest = cKDTree(at[path]).query(points)
    chosen = np.flatnonzero(away <= 3.0 * TREMOR)
    # points of one site in the order of the path's direction there
    forward = at[path][np.minimum(nearest + 1, len(path) - 1)] - at[path][np.maximum(nearest - 1, 0)]
    along = ((points - at[path][nearest]) * forward).sum(axis=1) / np.maximum((forward**2).sum(axis=1), 1e-12)
    rank = nearest + np.clip(along, -0.5, 0.5)
    return chosen[np.lexsort((points[chosen, 1], points[chosen, 0], rank[chosen]))]


def _longest_path(at: np.ndarray, widest_gap: float) -> np.ndarray:
    """Returns the indices of the sites along the longest path of the minimum spanning trees."""
    count = len(at)
    if count < 2:
        return np.zeros(0, dtype=int)
    try:
        corners = Delaunay(at).simplices
        pairs = np.unique(np.sort(np.vstack([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])), axis=0)
    except (QhullError, ValueError):  # all on one line
        order = np.lexsort((at[:, 1], at[:, 0]))
        pairs = np.column_stack([order[:-1], order[1:]])
    way = np.linalg.norm(at[pairs[:, 0]] - at[pairs[:, 1]], axis=1)
    near = (way <= widest_gap) & (way > 0.0)
    graph = csr_matrix((way[near], (pairs[near, 0], pairs[near, 1])), shape=(count, count))
    tree = minimum_spanning_tree(graph)
    parts, part = connected_components(tree, directed=False)
    low = np.full((parts, 2), np.inf)
    high = np.full((parts, 2), -np.inf)
    for axis in range(2):
        np.minimum.at(low[:, axis], part, at[:, axis])
        np.maximum.at(high[:, axis], part, at[:, axis])
    largest = int(np.argmax(np.linalg.norm(high - low, axis=1)))
    start = int(np.flatnonzero(part == largest)[0])
    for _ in range(2):
        distance, previous = dijkstra(tree, directed=False, indices=start, return_predecessors=True)
        start = int(np.argmax(np.where(np.isfinite(distance), distance, -1.0)))
    path = [start]
    while previous[path[-1]] >= 0:
        path.append(int(previous[path[-1]]))
    return np.array(path)
