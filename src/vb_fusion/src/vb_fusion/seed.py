"""The seed point: the last place where the pointer dwelt.

It is found in the same places of each moment as the border's track (track.py). On its path the pointer dwells
nowhere for long, strays are alone, and something bright was there before the pointer came.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import List, Optional, Sequence

import numpy as np
from scipy.spatial import cKDTree

from vb_fusion.chain import ExtractionError
from vb_fusion.observations import TREMBLE, Sights, gather
from vb_fusion.track import MOMENT, find_places

HAND = 1.5 * TREMBLE  # [m] a hand that holds still stays within this of its mean, cameras' offsets included
MIN_SPOTS = 3
KNOWN = 0.2  # what a place counts that was seen before the seed was asked for
RIVAL_MOMENTS = 4  # a place that was seen in fewer is not compared
TOGETHER = 0.3  # two places seen together in this share of the fewer moments cannot both be the pointer


@dataclass(frozen=True)
class _Dwelling:
    """A place where something dwelt."""

    at: np.ndarray  # (2,) [m]
    score: float
    moments: np.ndarray  # (K,) int, ascending: when it was seen
    cameras: float  # how many cameras saw it at a time, on average


def extract_seed(
    points: np.ndarray,
    *,
    stamps: Optional[Sequence[float]] = None,
    cameras: Optional[Sequence] = None,
    confidences: Optional[Sequence[float]] = None,
    mobile: Optional[Sequence[bool]] = None,
    before: Optional[np.ndarray] = None,
) -> np.ndarray:
    """Finds the seed point s (paper, Sect. 3): where the pointer dwelt longest; later places count up to twice.

    A place that was seen before already counts less: something bright, or the end of the border. Of two places that
    are seen together one is not the pointer: it is the one that fewer cameras see, else the one that was there first.

    Args:
        points: (N, 2) [m], any order. Without stamps all of them count alike.
        before: (K, 2) [m] spots that were seen before the seed was asked for, those of the border.

    Returns:
        (2,) float64 [m].

    Raises:
        ExtractionError: "no_spots", "no_seed" or "bad_points".
    """
    seen = gather(points, stamps, cameras, confidences, mobile)
    if seen.spots == 0:
        raise ExtractionError("no_spots")
    if seen.spots < MIN_SPOTS:
        raise ExtractionError("no_seed", spots=seen.spots, needed=MIN_SPOTS)
    dwellings = _dwellings(seen, None if before is None else gather(before).points)
    best = dwellings[0]
    for rival in dwellings[1:]:
        if _overrules(rival, best):
            best = rival
    return best.at


def _dwellings(seen: Sights, before: Optional[np.ndarray]) -> List[_Dwelling]:
    """The six places where something dwelt most, none part of another, the one that counts most first."""
    if seen.stamps is None:
        at, moment, cameras, late = seen.points, np.zeros(len(seen.points), int), np.ones(len(seen.points)), 0.0
    else:
        places = find_places(seen)
        at = places.points
        moment = np.floor((places.stamps - places.stamps[0]) / MOMENT).astype(np.int64)
        pairs = np.unique(places.sights * (int(seen.cameras.max()) + 1) + seen.cameras)
        cameras = np.bincount(pairs // (int(seen.cameras.max()) + 1), minlength=len(at)).astype(float)
        late = (places.stamps - places.stamps[0]) / max(float(np.ptp(places.stamps)), 1e-9)
    counts = cameras * (1.0 + late)
    if before is not None and len(before) >= MIN_SPOTS:
        known = cKDTree(before).query(at, k=[MIN_SPOTS], distance_upper_bound=HAND)[0][:, 0]
        counts = np.where(np.isfinite(known), KNOWN, 1.0) * counts
    found: List[_Dwelling] = []
    free = np.ones(len(at), dtype=bool)
    # where places are many, a few hundred of them say where something dwelt
    asked = np.unique(np.linspace(0, len(at) - 1, 500).astype(int))
    while len(found) < 6 and free[asked].any():
        tree = cKDTree(at[free])
        near = tree.query_ball_point(at[asked], HAND)
        scores = np.array([counts[free][rows].sum() if free[k] else -1.0 for k, rows in zip(asked, near)])
        best = int(np.argmax(scores))
        middle = at[asked[best]]
        for _ in range(5):
            inside = free & (np.linalg.norm(at - middle, axis=1) <= HAND)
            if inside.any():
                middle = np.average(at[inside], axis=0, weights=counts[inside])
        there = np.linalg.norm(at - middle, axis=1) <= 1.5 * HAND
        unique = np.unique(moment[there])
        found.append(_Dwelling(middle, float(scores[best]), unique, float(cameras[there].sum()) / max(len(unique), 1)))
        free &= np.linalg.norm(at - middle, axis=1) > 2.0 * HAND
        free[asked[best]] = False
    return found


def _overrules(rival: _Dwelling, best: _Dwelling) -> bool:
    """Is the rival the pointer where the two are seen together, though `best` was seen for longer?"""
    fewer = min(len(rival.moments), len(best.moments))
    if fewer < RIVAL_MOMENTS or rival.score < 0.1 * best.score:
        return False
    if len(np.intersect1d(rival.moments, best.moments)) < TOGETHER * fewer:
        return False
    if abs(rival.cameras - best.cameras) > 0.5:
        return rival.cameras > best.cameras
    return bool(rival.moments[0] > best.moments[0] + RIVAL_MOMENTS)
