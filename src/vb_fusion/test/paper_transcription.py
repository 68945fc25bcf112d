"""Algorithms 1 to 3 of the paper, transcribed line by line with plain loops: the oracle for paper mode."""

from __future__ import annotations

import math
from typing import List, Tuple

import numpy as np
from scipy.sparse.csgraph import connected_components

Point = Tuple[float, float]


def near(a: Point, b: Point, distance: float) -> bool:
    return (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 <= distance**2


def dbscan(points: List[Point], eps: float, min_pts: int) -> List[List[int]]:
    """Returns clusters by Ester et al. 1996: connected core points, with all points in reach of one of them."""
    within = np.array([[near(a, b, eps) for b in points] for a in points])
    cores = np.flatnonzero(within.sum(axis=0) >= min_pts)
    count, label = connected_components(within[np.ix_(cores, cores)])
    return [np.flatnonzero(within[cores[label == number]].any(axis=0)).tolist() for number in range(count)]


def clustering(points: List[Point], eps, min_pts, min_exp, min_size) -> List[int]:
    pointset_out: List[int] = []
    clusters = dbscan(points, eps, min_pts)
    clusters = sorted([c for c in clusters if len(c) >= min_size], key=len, reverse=True)
    for c in clusters:
        xs, ys = [points[i][0] for i in c], [points[i][1] for i in c]
        if min_exp < math.hypot(max(xs) - min(xs), max(ys) - min(ys)):
            pointset_out = c
            break
    return pointset_out


def thinning(points: List[Point], max_neighbor_dist: float) -> List[Point]:
    pointset_in, pointset_out = list(points), []
    while pointset_in:

        def neighbors(k: int) -> List[int]:
            p = pointset_in[k]
            return [j for j, q in enumerate(pointset_in) if j != k and near(p, q, max_neighbor_dist)]

        counts = [len(neighbors(k)) for k in range(len(pointset_in))]
        p = counts.index(max(counts))
        n = neighbors(p)
        if not n:
            break
        taken = n + [p]
        pointset_out.append(tuple(sum(pointset_in[k][axis] for k in taken) / len(taken) for axis in range(2)))
        pointset_in = [q for k, q in enumerate(pointset_in) if k not in taken]
    return pointset_out + pointset_in


def generate_poly(points: List[Point], max_neighbor_dist: float) -> List[int]:
    dir1, dir2, marked, forward, p = [0], [], {0}, True, 0
    while len(marked) < len(points):
        unmarked = [k for k in range(len(points)) if k not in marked and near(points[p], points[k], max_neighbor_dist)]
        if unmarked:
            n = min(unmarked, key=lambda k: (points[p][0] - points[k][0]) ** 2 + (points[p][1] - points[k][1]) ** 2)
            (dir1 if forward else dir2).append(n)
            marked.add(n)
            p = n
        elif forward:
            p, forward = 0, False
        else:
            break
    return dir1[::-1] + dir2
