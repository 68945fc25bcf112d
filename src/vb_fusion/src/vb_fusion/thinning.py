"""Algorithm 2: nearby points are replaced by their mean (paper, Sect. 4.3.2, "Thinning").

The counts of neighbours are kept up to date while points are removed, so that each pair of neighbours is looked
at once. Inputs so dense that the pairs themselves are too many are put onto a lattice first, whose sites carry
the sum and the number of their points: means stay means of points, and only who counts as a neighbour is blurred
by less than half a lattice diagonal.
"""
from __future__ import annotations

from typing import Tuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from vb_fusion.clustering import cell_keys

# Pairs of neighbours that are listed; a drawing of a minute has about a hundred thousand. Beyond it, the lattice.
EXACT_PAIRS = 120_000
_LATTICE = (0.1, 0.15, 0.2, 0.3, 0.4, 0.6)  # of max_neighbor_dist, the first that is coarse enough is taken
_BLOCK = 1024
_FEW_BLOCKS = 16  # looking at all of them costs less than finding out which have changed


def thinning(pointset_in: np.ndarray, max_neighbor_dist: float) -> np.ndarray:
    """Algorithm 2, `thinning(in, out, params)`.

    Of several points with most neighbours the first is taken.

    Args:
        pointset_in: (N, 2) float64 [m], finite.
        max_neighbor_dist: [m] distance of neighbours.

    Returns:
        pointset_out: (M, 2) float64 [m], the means in the order they were made, then the points without neighbours.
    """
    points = np.asarray(pointset_in, dtype=float).reshape(-1, 2)
    sums, weights = points, np.ones(len(points), dtype=np.int64)
    sites = points
    for lattice in _LATTICE:
        if _pairs_estimate(sites, max_neighbor_dist) <= EXACT_PAIRS:
            break
        sums, weights = lattice_sites(points, lattice * max_neighbor_dist)
        sites = sums / weights[:, None]
    neighbors = _Neighbors(sites, weights, max_neighbor_dist)

    pointset_out = []  # l. 2
    while True:  # l. 3
        p = neighbors.point_with_most()  # l. 4
        n = neighbors.of(p)  # l. 5
        if n.size or weights[p] > 1:  # l. 6; a site of several points is a point with neighbours
            taken = np.append(n, p)
            mean = sums[taken].sum(axis=0) / weights[taken].sum()  # l. 7
            neighbors.remove(taken)  # l. 8
            pointset_out.append(mean)  # l. 9
        else:  # l. 10
            break  # l. 11
        if not neighbors.alive.any_left():
            break
    rest = neighbors.alive.indices()
    return np.vstack([np.array(pointset_out).reshape(-1, 2), sites[rest]])  # l. 12


def _pairs_estimate(points: np.ndarray, radius: float) -> float:
    """About how many pairs of points are neighbours: the square of each cell's number of points, for a disc's area."""
    _, keys = cell_keys(points, radius)
    counts = np.unique(keys, return_counts=True)[1].astype(float)
    return float(np.pi / 2.0 * (counts**2).sum())


def lattice_sites(points: np.ndarray, side: float) -> Tuple[np.ndarray, np.ndarray]:
    """Sum (S, 2) and number (S,) of the points in each occupied cell of a lattice."""
    _, keys = cell_keys(points, side)
    _, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
    sums = np.column_stack([np.bincount(inverse, points[:, axis]) for axis in range(2)])
    return sums, counts


class _Alive:
    """Which points are still in the set, with their number."""

    def __init__(self, count: int) -> None:
        self.mask = np.ones(count, dtype=bool)
        self.left = count

    def any_left(self) -> bool:
        return self.left > 0

    def indices(self) -> np.ndarray:
        return np.flatnonzero(self.mask)


class _Neighbors:
    """The neighbourhood graph of a shrinking point set, with the number of neighbours of each point."""

    def __init__(self, sites: np.ndarray, weights: np.ndarray, radius: float) -> None:
        pairs = cKDTree(sites).query_pairs(radius, output_type="ndarray")
        count = len(sites)
        rows, columns = np.concatenate([pairs[:, 0], pairs[:, 1]]), np.concatenate([pairs[:, 1], pairs[:, 0]])
        graph = csr_matrix((np.ones(len(rows), dtype=bool), (rows, columns)), shape=(count, count))
        self._starts, self._columns = graph.indptr, graph.indices
        self._weights = weights
        self.alive = _Alive(count)
        # padded to whole blocks, so that the largest count is found by blocks
        padded = -(-max(count, 1) // _BLOCK) * _BLOCK
        self._counts = np.full(padded, -1, dtype=np.int64)
        self._counts[:count] = np.bincount(rows, weights[columns], minlength=count).astype(np.int64) + weights - 1
        self._blocks = self._counts.reshape(-1, _BLOCK)
        self._best = self._blocks.max(axis=1)

    def point_with_most(self) -> int:
        """getPointWithMostNeighbors: the first one with the largest count."""
        block = int(np.argmax(self._best))
        return block * _BLOCK + int(np.argmax(self._blocks[block]))

    def of(self, p: int) -> np.ndarray:
        """getNeighbors: those still in the set."""
        n = self._columns[self._starts[p] : self._starts[p + 1]]
        return n[self.alive.mask[n]]

    def remove(self, taken: np.ndarray) -> None:
        """Takes points out of the set."""
        self.alive.mask[taken] = False
        self.alive.left -= len(taken)
        starts, ends = self._starts[taken], self._starts[taken + 1]
        touched = np.concatenate([self._columns[start:end] for start, end in zip(starts.tolist(), ends.tolist())])
        lost = np.repeat(self._weights[taken], ends - starts)
        # counts of points already taken go down too, from -1: nobody looks at them again
        if 20 * len(touched) > len(self._counts):
            self._counts -= np.bincount(touched, lost, minlength=len(self._counts)).astype(np.int64)
        else:
            np.subtract.at(self._counts, touched, lost)
        self._counts[taken] = -1
        if len(self._best) <= _FEW_BLOCKS:
            self._best = self._blocks.max(axis=1)
        else:
            changed = np.unique(np.concatenate([touched, taken]) // _BLOCK)
            self._best[changed] = self._blocks[changed].max(axis=1)
