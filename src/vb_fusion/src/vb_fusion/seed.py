"""The seed point: where the person pointed, of spots that also hold strays, bright things and the way there."""
from __future__ import annotations

from dataclasses import dataclass
from typing import List, Optional, Sequence

import numpy as np
from scipy.spatial import cKDTree

from vb_fusion.chain import ExtractionError
from vb_fusion.observations import Observations, observations
from vb_fusion.ridge import merge

HAND = 0.08  # [m] a hand that holds still stays within this of its mean, cameras' biases included
MIN_SPOTS = 3
MOMENT = 0.1  # [s] a camera that sees a place several times within it says no more than with one sight
PLACES = 6  # dwelling places that are compared
KNOWN = 0.2  # what a place counts that was seen before the seed was asked for
KNOWN_SPOTS = 3  # seen so often before
RIVAL_MOMENTS = 4  # a place that was seen in fewer is not compared
TOGETHER = 0.3  # two places seen together in this share of the fewer moments cannot both be the pointer


@dataclass(frozen=True)
class _Place:
    """A place where spots dwelt."""

    at: np.ndarray  # (2,) [m]
    score: float
    moments: np.ndarray  # (K,) int, ascending: when it was seen, in units of MOMENT
    cameras: float  # how many cameras saw it at a time, on average over its moments


def extract_seed(
    points: np.ndarray,
    *,
    stamps: Optional[Sequence[float]] = None,
    cameras: Optional[Sequence] = None,
    confidences: Optional[Sequence[float]] = None,
    before: Optional[np.ndarray] = None,
    min_spots: int = MIN_SPOTS,
) -> np.ndarray:
    """The seed point s (paper, Sect. 3).

    It is the place where the spot dwelt: the densest place of the set, refined as a mean. On the way there the spot
    spreads its sights over a length, strays are alone. With stamps and cameras

    - dwelling is counted in moments of each camera, so that a camera that reports more often does not count for more;
    - the later of two places counts up to twice: a person who points twice means the second;
    - a place that was seen before already counts less: something bright, or the end of the border;
    - of two places that are seen together one is not the pointer: it is the one that fewer cameras see, else the one
      that was there first.

    With fewer than `min_spots` usable spots there is no seed.

    Args:
        points: (N, 2) [m], any order.
        before: (K, 2) [m] spots that were seen before the seed was asked for, those of the border.

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
    places = _places(seen, None if before is None else observations(before).points)
    best = max(places, key=lambda place: place.score)
    for place in sorted(places, key=lambda place: -place.score):
        if place is not best and _overrules(place, best):
            best = place
    return best.at


def _places(seen: Observations, before: Optional[np.ndarray]) -> List[_Place]:
    """The places where spots dwelt most, each no part of another."""
    weights = _weights(seen)
    sites = merge(seen.points, weights, side=0.02)
    w = sites.weights.copy()
    tree = cKDTree(sites.points)
    known = np.ones(len(w))
    if before is not None and len(before) >= KNOWN_SPOTS:
        nearest = cKDTree(before).query(sites.points, k=[KNOWN_SPOTS], distance_upper_bound=HAND)[0][:, 0]
        known[np.isfinite(nearest)] = KNOWN
    i, j = tree.query_pairs(HAND, output_type="ndarray").T
    found: List[_Place] = []
    while len(found) < PLACES:
        dwell = w + np.bincount(i, w[j], minlength=len(w)) + np.bincount(j, w[i], minlength=len(w))
        score = dwell * known * (w > 0.0)
        k = int(np.argmax(score))
        if not score[k] > 0.0:
            break
        at = sites.points[k]
        for _ in range(5):
            near = [n for n in tree.query_ball_point(at, HAND) if w[n] > 0.0]
            if not near:
                break
            at = np.average(sites.points[near], axis=0, weights=w[near])
        found.append(_place(seen, at, float(score[k])))
        w[tree.query_ball_point(at, 2.0 * HAND)] = 0.0
        w[k] = 0.0
    return found


def _weights(seen: Observations) -> np.ndarray:
    """(N,) what each spot counts: its share of its camera's moment, more if it was seen late."""
    if seen.stamps is None:
        return seen.weights
    moment = _moments(seen)
    camera = np.zeros(len(moment), dtype=int) if seen.cameras is None else seen.cameras
    # the share is that of its own place: what else the camera saw in that moment takes nothing from it
    cell = np.floor(seen.points / HAND).astype(np.int64)
    keys = np.column_stack([moment, camera, cell])
    _, inverse, counts = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    late = (seen.stamps - seen.stamps.min()) / max(float(np.ptp(seen.stamps)), 1e-9)
    return seen.weights / counts[inverse.ravel()] * (1.0 + late)


def _moments(seen: Observations) -> np.ndarray:
    return np.floor((seen.stamps - seen.stamps.min()) / MOMENT).astype(np.int64)


def _place(seen: Observations, at: np.ndarray, score: float) -> _Place:
    if seen.stamps is None:
        return _Place(at, score, np.zeros(0, dtype=np.int64), 0.0)
    near = np.linalg.norm(seen.points - at, axis=1) <= 1.5 * HAND
    moments = _moments(seen)[near]
    camera = np.zeros(len(moments), dtype=int) if seen.cameras is None else seen.cameras[near]
    unique = np.unique(moments)
    sights = len(np.unique(np.column_stack([moments, camera]), axis=0))
    return _Place(at, score, unique, sights / max(len(unique), 1))


def _overrules(place: _Place, best: _Place) -> bool:
    """Is `place` the pointer where the two are seen together, though `best` was seen for longer?"""
    fewer = min(len(place.moments), len(best.moments))
    if fewer < RIVAL_MOMENTS or place.score < 0.1 * best.score:
        return False
    if len(np.intersect1d(place.moments, best.moments)) < TOGETHER * fewer:
        return False
    if abs(place.cameras - best.cameras) > 0.5:
        return place.cameras > best.cameras
    return bool(place.moments[0] > best.moments[0] + RIVAL_MOMENTS)
