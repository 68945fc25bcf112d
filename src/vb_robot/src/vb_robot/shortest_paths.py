"""Searches shortest paths over a grid of cells."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

NEIGHBORS = ((0, 1), (1, 0), (1, 1), (1, -1))  # (rows, columns); each joins two cells in both directions


class ShortestPaths:
    """Finds least-cost paths from one start over a grid (Dijkstra, 8-connected).

    Args:
        cost: (H, W) cost of a step of one cell's side in each cell; inf for cells that are never entered.
        gates: (K, 2) cells (row, column) where paths start; entry_costs: (K,) costs of reaching them from the start.

    Attributes:
        costs: (H, W) cost of the path to each cell; inf without a path.
    """

    def __init__(self, cost: np.ndarray, gates: np.ndarray, entry_costs: np.ndarray) -> None:
        rows, columns = cost.shape
        index = np.arange(cost.size).reshape(cost.shape)
        # the start is an additional node; an edge of length 0 would be missing from the graph
        edges = [(np.full(len(gates), cost.size), index[tuple(gates.T)], np.maximum(entry_costs, 1e-6))]
        for dr, dc in NEIGHBORS:
            cells = (slice(0, rows - dr), slice(max(0, -dc), columns - max(0, dc)))
            neighbors = (slice(dr, rows), slice(max(0, dc), columns + min(0, dc)))
            length = 0.5 * np.hypot(dr, dc) * (cost[cells] + cost[neighbors])
            passable = np.isfinite(length)
            edges.append((index[cells][passable], index[neighbors][passable], length[passable]))
        starts, ends, length = (np.concatenate(column) for column in zip(*edges))
        graph = csr_matrix((length, (starts, ends)), shape=(cost.size + 1, cost.size + 1))
        costs, self._before = dijkstra(graph, directed=False, indices=cost.size, return_predecessors=True)
        self.costs = costs[:-1].reshape(cost.shape)

    def path_to(self, cell) -> np.ndarray:
        """Returns the cells (N, 2) of the path to a cell (row, column), in order; (0, 2) without a path."""
        node, path = int(np.ravel_multi_index(tuple(cell), self.costs.shape)), []
        while np.isfinite(self.costs[tuple(cell)]) and node != self.costs.size:
            path.append(node)
            node = int(self._before[node])
        return np.column_stack(np.unravel_index(np.array(path[::-1], dtype=int), self.costs.shape))
