"""Robust mode, first half: from a raw point set to the ridge along which it is dense.

Points are merged on a fine lattice, lonely ones are dropped, and the rest is moved onto the local ridge of their
density (subspace-constrained mean shift, Ozertem and Erdogmus 2011). Two cameras with different biases draw two
tracks: a kernel wider than their distance makes them one ridge, and still keeps apart the legs of a narrow U.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Tuple

import numpy as np
from scipy.spatial import cKDTree

from vb_fusion.clustering import cell_keys

LATTICE = 0.025  # [m] finer than the noise of a camera
MAX_SITES = 30_000  # a room drawn full; beyond it a coarser lattice
KERNEL = 0.045  # [m] standard deviation; two tracks up to 0.1 m apart merge, 0.2 m stay apart
REACH = 0.12  # [m] radius in which points support each other
ITERATIONS = 3
ANOTHER_TIME = 0.12  # share of the drawing after which the spot passes by again, as on the other leg of a U
FOREIGN = 0.3  # weight of what was drawn at another time


@dataclass(frozen=True)
class Sites:
    """Weighted points: (S, 2) [m], (S,) weights, and (N,) the site of each point that was given."""

    points: np.ndarray
    weights: np.ndarray
    of_point: np.ndarray

    def select(self, keep: np.ndarray) -> "Sites":
        """The sites where keep (S,) is true; points of others get -1."""
        number = np.where(keep, np.cumsum(keep) - 1, -1)
        of_point = np.where(self.of_point >= 0, number[self.of_point], -1)
        return Sites(self.points[keep], self.weights[keep], of_point)


def merge(points: np.ndarray, weights: np.ndarray, side: float = LATTICE) -> Sites:
    """The weighted mean of the points in each cell of a lattice; coarser if there are too many cells."""
    while True:
        _, keys = cell_keys(points, side)
        _, inverse = np.unique(keys, return_inverse=True)
        count = int(inverse.max()) + 1
        if count <= MAX_SITES or side >= 0.1:
            break
        side *= 1.5
    total = np.bincount(inverse, weights, minlength=count)
    mean = np.column_stack([np.bincount(inverse, weights * points[:, axis]) / total for axis in range(2)])
    return Sites(mean, total, inverse)


def weighted_quantile(values: np.ndarray, weights: np.ndarray, q: float) -> float:
    """The value below which the share q of the weight lies."""
    order = np.argsort(values)
    cumulated = np.cumsum(weights[order])
    return float(values[order][min(int(np.searchsorted(cumulated, q * cumulated[-1])), len(values) - 1)])


def supported(sites: Sites, max_reach: float, share: float = 0.1) -> Tuple[np.ndarray, float]:
    """Which sites lie on something drawn.

    A stroke's points have company within a radius that fits their spacing; stray detections have little. How much
    is usual is measured on the set itself: at least two of three points are drawn ones.

    Args:
        share: of the usual company that is enough.

    Returns:
        (S,) bool, and the radius [m] that was used.
    """
    tree = cKDTree(sites.points)
    count = len(sites.points)
    if count < 3:
        return np.ones(count, dtype=bool), REACH
    second = tree.query(sites.points, k=[3])[0][:, 0]
    # 0.6: stray points are far from everything, the drawn majority decides
    reach = float(np.clip(3.0 * weighted_quantile(second, sites.weights, 0.6), REACH, max_reach))
    i, j = tree.query_pairs(reach, output_type="ndarray").T
    w = sites.weights
    company = w + np.bincount(i, w[j], minlength=count) + np.bincount(j, w[i], minlength=count)
    usual = _usual(sites, company)
    # a point at the end of a stroke has half the usual company, a fast stretch seen by one camera of two a fifth
    return company >= max(share * usual, min(3.0, 0.6 * usual)) - 1e-9, reach


def _usual(sites: Sites, company: np.ndarray) -> float:
    """The usual company of what was drawn: each piece of the floor counts once, however often it was seen."""
    _, keys = cell_keys(sites.points, REACH)
    _, inverse = np.unique(keys, return_inverse=True)
    most = np.zeros(int(inverse.max()) + 1)
    np.maximum.at(most, inverse, company)
    drawn = most[most >= 3.0]  # stray detections have one or two
    return float(np.median(drawn if len(drawn) else most))


def onto_ridge(sites: Sites, ranks: Optional[np.ndarray] = None) -> np.ndarray:
    """(S, 2) [m]: each site moved to the ridge of the sites' density across the direction of its surroundings.

    Args:
        ranks: (S,) place in time of each site, 0 first to 1 last: what was drawn at another time attracts less.
    """
    data, w = sites.points, sites.weights
    count = len(data)
    i, j = cKDTree(data).query_pairs(2.5 * KERNEL, output_type="ndarray").T
    rows, columns = np.concatenate([i, j, np.arange(count)]), np.concatenate([j, i, np.arange(count)])
    seen, weight = data[columns], w[columns]
    if ranks is not None:
        apart = np.abs(ranks[rows] - ranks[columns])
        weight = weight * np.where(apart > ANOTHER_TIME, FOREIGN, 1.0)
    moved = data.copy()
    for _ in range(ITERATIONS):
        d = seen - moved[rows]
        k = weight * np.exp(-0.5 / KERNEL**2 * np.einsum("ij,ij->i", d, d))
        total = np.bincount(rows, k, minlength=count)
        kx, ky = k * d[:, 0], k * d[:, 1]
        mx, my = np.bincount(rows, kx, minlength=count) / total, np.bincount(rows, ky, minlength=count) / total
        xx = np.bincount(rows, kx * d[:, 0], minlength=count) / total - mx * mx
        yy = np.bincount(rows, ky * d[:, 1], minlength=count) / total - my * my
        xy = np.bincount(rows, kx * d[:, 1], minlength=count) / total - mx * my
        # the normal is the direction of least spread; only the step along it is taken
        angle = 0.5 * np.arctan2(2.0 * xy, xx - yy) + 0.5 * np.pi
        nx, ny = np.cos(angle), np.sin(angle)
        step = mx * nx + my * ny
        moved = moved + np.column_stack([step * nx, step * ny])
    return moved
