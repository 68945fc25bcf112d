"""The seed point: the last place where the pointer dwelt.

The pointer's track is found as for the border (track.py): the sequence of places that explains most with the least
effort. What a place explains is another thing here: the pointer dwells instead of moving, and may be switched off on
its way. So what counts is light that is new at its place, and a jump costs no more than a blink of it.
"""
from __future__ import annotations

from typing import Optional, Sequence

import numpy as np
from scipy.spatial import cKDTree

from vb_fusion.chain import ExtractionError
from vb_fusion.observations import TREMBLE, gather
from vb_fusion.track import BLINK, MOMENT, best_path, find_places

HAND = 1.5 * TREMBLE  # [m] a hand that holds still stays within this of its mean, cameras' offsets included
MIN_SPOTS = 3
KNOWN = 0.2  # what a place counts that was seen before the seed was asked for


def extract_seed(
    points: np.ndarray,
    *,
    stamps: Optional[Sequence[float]] = None,
    cameras: Optional[Sequence] = None,
    confidences: Optional[Sequence[float]] = None,
    mobile: Optional[Sequence[bool]] = None,
    before: Optional[np.ndarray] = None,
) -> np.ndarray:
    """Finds the seed point s (paper, Sect. 3): where the pointer dwelt last.

    A place that was seen before already counts less: something bright, or the end of the border. The longer light has
    been at its place [s], the less it is new. Cameras that agree are each other's witnesses.

    Args:
        points: (N, 2) [m], any order. Without stamps it is the place where most of them are.
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
    if seen.stamps is None:
        at, gains = seen.points, np.ones(len(seen.points))
    else:
        places = find_places(seen)
        at = places.points
        pairs = np.unique(np.column_stack([places.sights, seen.cameras]), axis=0)
        witnesses = np.bincount(pairs[:, 0], minlength=len(at)).astype(float)
        around = cKDTree(at).query_ball_point(at, HAND)
        earlier = np.array([np.count_nonzero(np.array(rows) < place) for place, rows in enumerate(around)])
        gains = witnesses / (1.0 + MOMENT * earlier)
    if before is not None and len(before) >= MIN_SPOTS:
        known = cKDTree(gather(before).points).query(at, k=[MIN_SPOTS], distance_upper_bound=HAND)[0][:, 0]
        gains = np.where(np.isfinite(known), KNOWN, 1.0) * gains
    if seen.stamps is not None:
        path = best_path(at, places.stamps, gains, np.inf, BLINK / MOMENT)[0]
        at, gains = at[path], gains[path]
    near = cKDTree(at).query_ball_point(at, HAND)
    dwelt = np.array([gains[rows].sum() for rows in near])
    # on the way it dwells nowhere for half as long
    last = int(np.argmax(dwelt)) if seen.stamps is None else int(np.flatnonzero(dwelt >= 0.5 * dwelt.max())[-1])
    middle = at[last]
    for _ in range(5):
        inside = np.linalg.norm(at - middle, axis=1) <= HAND
        middle = at[inside].mean(axis=0)
    return middle
