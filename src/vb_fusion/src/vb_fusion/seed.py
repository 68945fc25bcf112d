"""The seed point: where the person pointed, of spots that also hold strays and the way there."""
from __future__ import annotations

from typing import Optional, Sequence

import numpy as np
from scipy.spatial import cKDTree

from vb_fusion.chain import ExtractionError
from vb_fusion.observations import observations
from vb_fusion.ridge import merge

HAND = 0.08  # [m] a hand that holds still stays within this of its mean, cameras' biases included
MIN_SPOTS = 3


def extract_seed(
    points: np.ndarray,
    *,
    stamps: Optional[Sequence[float]] = None,
    cameras: Optional[Sequence] = None,
    confidences: Optional[Sequence[float]] = None,
    min_spots: int = MIN_SPOTS,
) -> np.ndarray:
    """The seed point s (paper, Sect. 3).

    It is the place where the spot dwelt: the densest place of the set, refined as a mean. On the way there the spot
    spreads its sights over a length, strays are alone.  With stamps the later of two equally dense places is taken:
    a person who points twice means the second. With fewer than `min_spots` usable spots there is no seed.

    Args:
        points: (N, 2) [m], any order.

    Returns:
        (2,) float64 [m].

    Raises:
        ExtractionError: "no_spots", "no_seed" or "bad_points".
    """
    seen = observations(points, stamps, cameras, confidences)
    if len(seen.points) == 0:
        raise ExtractionError("no_spots", "no spot was seen for the seed point: point at the side to be restricted")
    if len(seen.points) < min_spots:
        raise ExtractionError(
            "no_seed", f"only {len(seen.points)} of at least {min_spots} spots were seen for the seed point: hold still"
        )
    weights = seen.weights
    if seen.ranks is not None:
        weights = weights * (1.0 + seen.ranks)  # what was pointed at last counts up to twice
    sites = merge(seen.points, weights, side=0.02)
    tree = cKDTree(sites.points)
    i, j = tree.query_pairs(HAND, output_type="ndarray").T
    w, count = sites.weights, len(sites.points)
    dwell = w + np.bincount(i, w[j], minlength=count) + np.bincount(j, w[i], minlength=count)
    best = sites.points[int(np.argmax(dwell))]
    for _ in range(5):
        near = tree.query_ball_point(best, HAND)
        best = np.average(sites.points[near], axis=0, weights=w[near])
    return best
