"""Robust mode, second half: from points on the ridge to one path through them.

A minimum spanning tree leaves out the longest link of each loop, so its longest path follows a stroke from end to
end, or a loop once round, and passes by side branches: no greedy walk that jumps and turns back. Pieces parted by
gaps are joined end to end, where they continue each other.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import List, Optional

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra, minimum_spanning_tree
from scipy.spatial import cKDTree

from vb_fusion.ridge import merge

NODE = 0.03  # [m] spacing of the nodes on the ridge
LINK = 0.11  # [m] nodes of one piece are at most this far apart
END_MARGIN = 0.1  # [m] by which the ends of two pieces are farther apart than the points they stand for
TINY = 0.12  # [m] a piece that is shorter, at an end and beyond a gap, is no part of the line
SCRAP = 0.35  # [m] a piece at an end, beyond a gap, that is shorter than this and not clearly elongated is clutter
SCRAP_ELONGATION = 2.0  # ratio of its spread along and across; 0.2 m of a stroke have 2.3, a round spot has 1.2
DRAWN = 0.75  # correlation of place and time in a piece that was drawn


@dataclass
class Path:
    """A path: nodes (K, 2) [m], weight of the points it stands for, mean place in time (rank 0..1) of its nodes, and
    the indices of the sites it was found in."""

    nodes: np.ndarray
    weight: float
    ranks: Optional[np.ndarray]
    sites: np.ndarray
    elongation: float = np.inf  # of the points it stands for: spread along over spread across

    @property
    def expansion(self) -> float:
        """Diagonal [m] of its bounding box."""
        return float(np.linalg.norm(np.ptp(self.nodes, axis=0)))

    def reversed(self) -> "Path":
        """The same path from its other end."""
        ranks = None if self.ranks is None else self.ranks[::-1]
        return Path(self.nodes[::-1], self.weight, ranks, self.sites, self.elongation)


def pieces(
    ridge: np.ndarray, seen: np.ndarray, weights: np.ndarray, max_gap: float, ranks: Optional[np.ndarray]
) -> List[Path]:
    """The longest path of each connected piece of the ridge.

    Args:
        ridge: (S, 2) [m] sites moved onto the ridge.
        seen: (S, 2) [m] the same sites where they were.
        weights: (S,).
        max_gap: [m] the longest link.
        ranks: (S,) place in time of each site, 0 first to 1 last, or None.
    """
    sites = merge(ridge, weights, NODE)
    nodes, count = sites.points, len(sites.points)
    at = None if ranks is None else np.bincount(sites.of_point, weights * ranks) / sites.weights
    if count == 1:
        return [Path(nodes, float(sites.weights[0]), at, np.arange(len(seen)))]
    tree = cKDTree(nodes)
    k = min(3, count)
    second = tree.query(nodes, k=[k])[0][:, 0]
    link = float(np.clip(2.2 * np.median(second), LINK, max_gap))
    pairs = tree.query_pairs(link, output_type="ndarray")
    lengths = np.linalg.norm(nodes[pairs[:, 0]] - nodes[pairs[:, 1]], axis=1) + 1e-12
    if at is not None:
        # what was drawn at another time is a neighbour by chance: the other leg of a U, or the start at the end
        lengths *= _another_time(at[pairs[:, 0]], at[pairs[:, 1]])
    graph = csr_matrix((lengths, (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    spanning = minimum_spanning_tree(graph)
    spanning = spanning.tocoo()
    rows, columns = spanning.row, spanning.col
    reward = np.linalg.norm(nodes[rows] - nodes[columns], axis=1) + 1e-12
    if at is not None:
        # nor does it make a path longer, when something bright lies beside the end of the line
        reward /= _another_time(at[rows], at[columns])
    spanning = csr_matrix((reward, (rows, columns)), shape=(count, count))
    spanning = (spanning + spanning.T).tocsr()
    _, labels = connected_components(spanning, directed=False)
    order = np.argsort(labels, kind="stable")
    label_of_site = labels[sites.of_point]
    by_label = np.argsort(label_of_site, kind="stable")
    starts = np.searchsorted(label_of_site[by_label], np.arange(labels.max() + 2))
    members_of = np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)
    found = []
    for k, (members, path) in enumerate(zip(members_of, _longest_paths(spanning, labels, members_of))):
        own = by_label[starts[k] : starts[k + 1]]
        found.append(Path(nodes[path], float(sites.weights[members].sum()), None if at is None else at[path], own))
        if TINY <= found[-1].expansion and float(np.linalg.norm(np.ptp(nodes[members], axis=0))) < SCRAP:
            found[-1].elongation = _elongation(seen[own], weights[own], None if ranks is None else ranks[own])
    return found


def _another_time(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Factor 1 .. 5 by which links are longer whose ends were drawn at other times (ranks a, b)."""
    return 1.0 + np.minimum(np.abs(a - b) / 0.05, 4.0)


def _longest_paths(forest: csr_matrix, labels: np.ndarray, members_of: List[np.ndarray]) -> List[np.ndarray]:
    """Nodes of the longest path in each tree of a forest, all trees at once.

    Args:
        forest: (K, K) lengths of the edges, symmetric.
        labels: (K,) which tree each node belongs to, 0 .. T-1.
        members_of: T arrays with each tree's nodes, ascending.
    """
    some = np.array([members[0] for members in members_of])
    one_end = _farthest(dijkstra(forest, indices=some, min_only=True), labels)
    # the node farthest from anywhere in a tree is an end of a longest path
    distance, before, _ = dijkstra(forest, indices=one_end, min_only=True, return_predecessors=True)
    paths = []
    for at in _farthest(distance, labels):
        path = [int(at)]
        while before[path[-1]] >= 0:  # scipy marks a path's start with a negative number
            path.append(int(before[path[-1]]))
        paths.append(np.array(path))
    return paths


def _farthest(distance: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """(T,) for each label 0 .. T-1 its first node with the largest distance."""
    order = np.lexsort((-distance, labels))
    return order[np.searchsorted(labels[order], np.arange(labels.max() + 1))]


def join(found: List[Path], max_gap: float) -> List[Path]:
    """Joins pieces end to end across gaps of at most `max_gap` [m]: lines first, then with what scraps there are.

    Something bright beside the line must not become a stop on the way from one piece of it to the next.
    """
    lines, scraps = [path for path in found if not is_scrap(path)], [path for path in found if is_scrap(path)]
    joined = _join(lines, max_gap)
    return _join(joined + scraps, max_gap) if scraps else joined


def _join(found: List[Path], max_gap: float) -> List[Path]:
    """Joins pieces end to end, the best continuation first.

    The cost of a join is its length, up to three times as much where the chain would have to turn back, and half as
    much again where the one end was not drawn right after the other.
    """
    if len(found) < 2:
        return found
    ends = np.array([end for path in found for end in (path.nodes[0], path.nodes[-1])])
    out = np.array([d for path in found for d in (_outward(path.nodes), _outward(path.nodes[::-1]))])
    pairs = cKDTree(ends).query_pairs(max_gap, output_type="ndarray")
    pairs = pairs[pairs[:, 0] // 2 != pairs[:, 1] // 2]
    if len(pairs) == 0:
        return found
    a, b = pairs.T
    across = ends[b] - ends[a]
    distance = np.linalg.norm(across, axis=1)
    unit = across / np.maximum(distance, 1e-9)[:, None]
    turn = (1.0 - (out[a] * unit).sum(axis=1)) / 2.0 + (1.0 + (out[b] * unit).sum(axis=1)) / 2.0
    cost = distance * (1.0 + turn)
    if found[0].ranks is not None:
        rank = np.array([r for path in found for r in (path.ranks[0], path.ranks[-1])])
        cost = cost * np.where(np.abs(rank[a] - rank[b]) > 0.1, 1.5, 1.0)
    partner = np.full(len(ends), -1)
    group = np.arange(len(found))
    for e in np.argsort(cost, kind="stable"):
        i, j = int(a[e]), int(b[e])
        if partner[i] >= 0 or partner[j] >= 0 or group[i // 2] == group[j // 2]:
            continue
        partner[i], partner[j] = j, i
        group[group == group[j // 2]] = group[i // 2]
    return [_concatenate(found, np.flatnonzero(group == g), partner) for g in np.unique(group)]


def _concatenate(found: List[Path], members: np.ndarray, partner: np.ndarray) -> Path:
    """One path of the joined pieces; scraps at its ends are dropped."""
    start = next(end for m in members for end in (2 * m, 2 * m + 1) if partner[end] < 0)
    sequence: List[Path] = []
    end = int(start)
    while end >= 0:
        path = found[end // 2]
        sequence.append(path if end % 2 == 0 else path.reversed())
        end = int(partner[end ^ 1])
    while len(sequence) > 1 and is_scrap(sequence[0]):
        sequence.pop(0)
    while len(sequence) > 1 and is_scrap(sequence[-1]):
        sequence.pop()
    ranks = None if sequence[0].ranks is None else np.concatenate([path.ranks for path in sequence])
    weight, sites = sum(path.weight for path in sequence), np.concatenate([path.sites for path in sequence])
    return Path(np.vstack([path.nodes for path in sequence]), weight, ranks, sites)


def is_scrap(path: Path) -> bool:
    """Is a path no line, but something bright at one place?"""
    return path.expansion < TINY or (path.expansion < SCRAP and path.elongation < SCRAP_ELONGATION)


def _elongation(points: np.ndarray, weights: np.ndarray, ranks: Optional[np.ndarray]) -> float:
    """Ratio of the standard deviations along and across the points' main direction.

    It is 1 for too few points to tell, and for points that were not seen one after the other along that direction:
    what a camera looks at askance is elongated too.
    """
    if len(points) < 3:
        return 1.0
    spread, axes = np.linalg.eigh(np.cov(points.T, aweights=weights, bias=True))
    if ranks is not None and len(points) >= 5 and np.ptp(ranks) > 0.0:
        along = (points - points.mean(axis=0)) @ axes[:, 1]
        if abs(np.corrcoef(along, ranks)[0, 1]) < DRAWN:
            return 1.0
    return float(np.sqrt(spread[1] / max(spread[0], 1e-8)))


def _outward(nodes: np.ndarray) -> np.ndarray:
    """Unit direction in which a path leaves through its first node; zero if it is too short to tell."""
    if len(nodes) < 2:
        return np.zeros(2)
    steps = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(nodes, axis=0), axis=1))])
    inner = nodes[min(int(np.searchsorted(steps, 0.2)), len(nodes) - 1)]
    direction = nodes[0] - inner
    norm = float(np.linalg.norm(direction))
    return direction / norm if norm > 0.1 else np.zeros(2)
