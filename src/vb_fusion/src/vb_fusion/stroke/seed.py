"""The seed point: the last place where the pointer dwelt.

The pointer's track is found as for the border (stroke/track.py): the sequence of places that explains most with the
least effort. What a place explains is another thing here: the pointer dwells instead of moving, and may be switched off
on its way. So what counts is light that is new at its place, and a jump costs a blink of it, or little more.
"""

from __future__ import annotations

from typing import Optional, Sequence, Tuple

import numpy as np
from scipy.spatial import cKDTree

from vb_fusion.line.chain import ExtractionError
from vb_fusion.resumable_loop import ResumableLoop
from vb_fusion.stroke.observations import TIME_BIN, TREMOR, make_observations, merge_observations
from vb_fusion.stroke.track import find_best_steps, find_places, trace_path

HAND_RADIUS = 1.5 * TREMOR  # [m] a hand that holds still stays within this of its mean, cameras' offsets included
MIN_SPOTS = 3
NEW_PLACE_GAIN = 1.0  # weight of a place that was not seen before
KNOWN_PLACE_GAIN = 0.2  # weight of a place that was seen before the seed was requested


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
    been at its place [s], the less it counts as new. Cameras that agree confirm each other.

    Args:
        points: (N, 2) [m], any order. Without stamps it is the place where most of them are.
        before: (K, 2) [m] spots that were seen before the seed was requested: the border's.

    Returns:
        (2,) float64 [m].

    Raises:
        ExtractionError: "no_spots", "no_seed" or "bad_points".
    """
    seen = make_observations(points, stamps, cameras, confidences, mobile)
    if len(seen.points) == 0:
        raise ExtractionError("no_spots")
    if len(seen.points) < MIN_SPOTS:
        raise ExtractionError("no_seed", spots=len(seen.points), needed=MIN_SPOTS)
    seen = seen if stamps is None else merge_observations(seen)
    places = None if stamps is None else find_places(seen)
    at = seen.points if places is None else places.points
    spot, earlier = _spots_of_floor(at)
    gains, path = np.ones(len(at)), np.arange(len(at))
    if before is not None and len(before) >= MIN_SPOTS:
        # balanced trees take longer to make than to ask
        floor = cKDTree(make_observations(before).points, compact_nodes=False, balanced_tree=False)
        known = floor.query(at, k=[MIN_SPOTS], distance_upper_bound=HAND_RADIUS)[0][:, 0]
        gains[np.isfinite(known)] = KNOWN_PLACE_GAIN
    if places is not None:
        gains *= places.cameras / (1.0 + TIME_BIN * earlier)
        gain, previous = find_best_steps(at, places.stamps, gains, np.inf, NEW_PLACE_GAIN, ResumableLoop())
        path = trace_path(int(gain.argmax()), previous, np.ones(len(at), dtype=bool))
    dwelt = np.bincount(spot[path], gains[path])[spot[path]]
    # on its way it dwells nowhere for half as long
    last = int(np.argmax(dwelt)) if places is None else int(np.flatnonzero(dwelt >= 0.5 * dwelt.max())[-1])
    middle = at[path[last]]
    for _ in range(5):
        inside = np.linalg.norm(at[path] - middle, axis=1) <= HAND_RADIUS
        middle = at[path[inside]].mean(axis=0)
    return middle


def _spots_of_floor(at: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Groups places (P, 2) [m] into spots of floor of HAND_RADIUS.

    Returns:
        (P,) which spot of floor each place belongs to; (P,) how many places were there before it.
    """
    spot, earlier = np.zeros(len(at), dtype=int), np.zeros(len(at), dtype=int)
    middles, seen = np.empty_like(at), np.zeros(len(at), dtype=int)
    count = 0
    for place, point in enumerate(at):
        away = np.hypot(*(middles[:count] - point).T) if count else np.array([np.inf])
        spot[place] = int(np.argmin(away))
        if away[spot[place]] > HAND_RADIUS:
            spot[place], middles[count] = count, point
            count += 1
        earlier[place] = seen[spot[place]]
        seen[spot[place]] += 1
    return spot, earlier
