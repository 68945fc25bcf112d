"""Searches the shortest paths over a grid of cells."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

NEIGHBORS = ((0, 1), (1, 0), (1, 1), (1, -1))  # (rows, columns): each joins two cells in both directions


class ShortestPaths:
    """Finds least-cost paths from one start over a grid (Dijkstra, 8-connected).

    Args:
        cost: (H, W) of a step of one cell's side in each cell; inf: it is never entered.
        gates: (K, 2) cells (row, column) where paths begin; entry: (K,) the cost of reaching them from the start.

    Attributes:
        costs: (H, W) of the path to each cell; inf where there is none.
    """

    def __init__(self, cost: np.ndarray, gates: np.ndarray, entry: np.ndarray) -> None:
        rows, columns = cost.shape
        index = np.arange(cost.size).reshape(cost.shape)
        # the start is one more node; a length of 0 would be no edge
        edges = [(np.full(len(gates), cost.size), index[tuple(gates.T)], np.maximum(entry, 1e-6))]
        for dr, dc in NEIGHBORS:
            here = (slice(0, rows - dr), slice(max(0, -dc), columns - max(0, dc)))
            there = (slice(dr, rows), slice(max(0, dc), columns + min(0, dc)))
            length = 0.5 * np.hypot(dr, dc) * (cost[here] + cost[there])
            both = np.isfinite(length)
            edges.append((index[here][both], index[there][both], length[both]))
        begin, end, length = (np.concatenate(column) for column in zip(*edges))
        graph = csr_matrix((length, (begin, end)), shape=(cost.size + 1, cost.size + 1))
        costs, self._before = dijkstra(graph, directed=False, indices=cost.size, return_predecessors=True)
        self.costs = costs[:-1].reshape(cost.shape)

    def path_to(self, cell) -> np.ndarray:
        """Returns the cells (N, 2) of the path to a cell (row, column), in order; (0, 2) if there is none."""
        node, path = int(np.ravel_multi_index(tuple(cell), self.costs.shape)), []
        while np.isfinite(self.costs[tuple(cell)]) and node != self.costs.size:
            path.append(node)
            node = int(self._before[node])
        return np.column_stack(np.unravel_index(np.array(path[::-1], dtype=int), self.costs.shape))
