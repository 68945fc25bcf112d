"""The seed point: the last place where the pointer dwelt.

The pointer's track is found as for the border (strokes.py): it is the sequence of clusters that gains most at the least
cost. Here the pointer dwells instead of moving, and may be switched off on its way. So a cluster's gain is high if no
light was seen there before, and a jump costs about as much as that gain. Single flashes then do not attract the track.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import groupby
from typing import List, Optional, Sequence, Tuple

import numpy as np
from scipy.spatial import cKDTree

from vb_fusion.observations import TIME_BIN, TREMOR, Observations, is_on_floor
from vb_fusion.strokes import find_best_track

HAND_RADIUS = 1.5 * TREMOR  # [m] a hand held still stays within this of its mean, camera offsets included
MIN_DWELL = 0.7  # [s] a hand that passes at 0.2 m/s, as slowly as people draw, is within HAND_RADIUS for this long
MAX_STEP = 0.3  # [m] between two sightings of a moving pointer, which is three images of ten a second at 1 m/s
MAX_BLINK = 0.5  # [s] steady light is seen again within this, even if two images in a row are missed at 5 a second
MIN_SPOTS = 3
NEW_PLACE_GAIN = 1.0  # gain of a place where no light was seen before
KNOWN_PLACE_GAIN = 0.2  # gain of any other place. One camera that sees new light outweighs two that see old light


@dataclass(frozen=True)
class Dwell:
    """A place (2,) [m] where the pointer dwelt, and for how long [s]."""

    point: np.ndarray
    seconds: float
    was_lit_before: bool  # whether light was seen there before
    followed: bool  # whether the pointer was seen on its way there
    witnesses: int  # number of stationary cameras that saw it


def choose_seed(dwells: Sequence[Dwell]) -> Dwell:
    """Chooses the dwell that is meant as the seed point s (paper, Sect. 3): the last, unless too few cameras confirm it.

    Every camera sees the pointer's light on the floor, but only one sees a false light. To a mobile camera every bright
    object is new. So light that appears elsewhere needs at least as many stationary cameras as the light before it.
    """
    chosen = dwells[0]
    for dwell in dwells[1:]:
        if dwell.followed or chosen.was_lit_before or dwell.witnesses >= chosen.witnesses:
            chosen = dwell
    return chosen


def find_competing_dwell(dwells: Sequence[Dwell]) -> Optional[Dwell]:
    """Finds the last dwell at a new place that was longer or later than the chosen one."""
    seed = choose_seed(dwells)
    chosen = [dwell is seed for dwell in dwells].index(True)
    longer = [dwell for dwell in dwells[:chosen] if dwell.seconds > seed.seconds]
    rivals = [dwell for dwell in [*longer, *dwells[chosen + 1 :]] if not dwell.was_lit_before]
    return rivals[-1] if rivals else None


def find_dwells(
    observations: Observations, clusters: Observations, border_points: Sequence[Sequence[float]]
) -> List[Dwell]:
    """Finds the places where the pointer dwelt, in the order in which it left them. There is at least one.

    A place where light was already seen before counts less, as it may be a bright object or the end of the border. The
    longer [s] light stays at a place, the less it counts as new. Each camera that sees a cluster adds to its gain.

    Args:
        observations: observations in order of time, at least one.
        clusters: clusters of these observations, in order of time.
        border_points: (K, 2) [m] spots seen before the seed was requested, the border's.
    """
    positions = clusters.points
    patch, earlier = group_into_patches(positions)
    border_points = np.asarray(border_points, dtype=float).reshape(-1, 2)
    # a balanced tree takes longer to build than its queries take
    tree = cKDTree(border_points[is_on_floor(border_points)], compact_nodes=False, balanced_tree=False)
    distances, _ = tree.query(positions, k=[MIN_SPOTS], distance_upper_bound=HAND_RADIUS)
    was_lit_before = np.isfinite(distances[:, 0])
    place_gains = np.where(was_lit_before, KNOWN_PLACE_GAIN, NEW_PLACE_GAIN)
    gains = place_gains * clusters.witnesses / (1.0 + TIME_BIN * earlier)
    track, _ = find_best_track(positions, clusters.stamps, clusters.dropout_time, gains, NEW_PLACE_GAIN)
    path = positions[track]
    path_patch = patch[track]
    dwells: List[Dwell] = []
    for stay in find_stays(path_patch, clusters.time_bins[track]):
        last = stay[-1]
        point = _middle(path, last)
        seconds = TIME_BIN * len(stay)
        arrival = int(np.argmax(path_patch == path_patch[last]))
        followed = arrival > 0 and math.dist(path[arrival], path[arrival - 1]) <= MAX_STEP
        if dwells and math.dist(point, dwells[-1].point) <= HAND_RADIUS:
            # a pointer that arrives slowly begins its dwell on another floor patch, at the edge of the place
            begun = dwells.pop()
            seconds += begun.seconds
            followed = begun.followed
        was_lit = bool(was_lit_before[track[last]])
        dwells.append(Dwell(point, seconds, was_lit, followed, _count_witnesses(observations, point)))
    return dwells


def find_stays(patch: np.ndarray, bins: np.ndarray) -> List[np.ndarray]:
    """Finds where light stayed. Brief flashes that recur at one place are not a dwell.

    Args:
        patch, bins: (P,) the floor patch and the time bin of each cluster of the pointer's track, in order of time.

    Returns:
        For each patch on which light stayed for MIN_DWELL, its clusters without the flashes. Patches are in the order
        of their last clusters. If there is no such patch, only the clusters of the longest stay.
    """
    order = np.argsort(patch, kind="stable")
    is_other_patch = np.diff(patch[order]) != 0
    was_dark = np.diff(bins[order]) * TIME_BIN > MAX_BLINK
    stays = np.split(order, np.flatnonzero(is_other_patch | was_dark) + 1)
    held = [stay for stay in stays if len(stay) * TIME_BIN >= MIN_DWELL]
    if not held:
        held = [max(stays, key=len)]
    on_one_patch = []
    for _, group in groupby(held, key=lambda stay: patch[stay[0]]):
        on_one_patch.append(np.concatenate(list(group)))
    return sorted(on_one_patch, key=lambda clusters: clusters[-1])


def _count_witnesses(observations: Observations, point: np.ndarray) -> int:
    """Counts the stationary cameras that saw light at a point (2,) [m]."""
    distances = np.linalg.norm(observations.points - point, axis=1)
    is_witness = ~observations.mobile & (distances <= HAND_RADIUS)
    return int((np.bincount(observations.cameras[is_witness]) >= MIN_SPOTS).sum())


def _middle(positions: np.ndarray, cluster: int) -> np.ndarray:
    """Returns the middle (2,) of the clusters (P, 2) [m] round one of them, by mean shift within HAND_RADIUS."""
    middle = positions[cluster]
    for _ in range(5):
        middle = positions[np.linalg.norm(positions - middle, axis=1) <= HAND_RADIUS].mean(axis=0)
    return middle


def group_into_patches(positions: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Groups clusters (P, 2) [m] into floor patches of radius HAND_RADIUS.

    Returns:
        (P,) the patch of each cluster, and (P,) the number of clusters that were there before it.
    """
    patch, earlier, counts = np.zeros((3, len(positions)), dtype=int)
    middles = np.full_like(positions, np.inf)  # a patch that does not exist yet is infinitely far away
    count = 0
    for cluster, point in enumerate(positions):
        distances = np.hypot(*(middles[: count + 1] - point).T)
        patch[cluster] = int(np.argmin(distances))
        if distances[patch[cluster]] > HAND_RADIUS:
            patch[cluster] = count
            middles[count] = point
            count += 1
        earlier[cluster] = counts[patch[cluster]]
        counts[patch[cluster]] += 1
    return patch, earlier
