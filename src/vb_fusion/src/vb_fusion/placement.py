"""Stage 2: where the pointer really was.

Cameras that see the pointer at the same time disagree: their poses are known to centimetres only. The disagreements
are explained by one offset per stationary camera, and for a camera on a robot, whose localisation comes and goes, by
one offset per second. All offsets are found at once by weighted least squares; stationary cameras are held near zero
far more firmly than mobile ones, so that a robot that is lost does not move the border.
"""
from __future__ import annotations

from typing import List, Tuple

import numpy as np

from vb_fusion.observations import TREMBLE, Sights

AT_ONCE = 0.03  # [s] two cameras saw the same spot: less than one image apart
LOCALISATION = 0.15  # [m] what a robot's pose may be off, differently every second


def without_offsets(seen: Sights) -> Sights:
    """The sights without their cameras' offsets; an offset common to all cameras cannot be known."""
    groups, of_sight, mobile = _offsets_to_find(seen)
    if groups < 2:
        return seen
    first, second = _compared(seen, of_sight)
    if len(first) == 0:
        return seen
    key = of_sight[first] * groups + of_sight[second]
    rows: List[np.ndarray] = []
    measured: List[np.ndarray] = []

    def require(plus: int, minus: int, value, deviation: float) -> None:
        row = np.zeros(groups)
        row[plus] = 1.0
        if minus >= 0:
            row[minus] = -1.0
        rows.append(row / deviation)
        measured.append(np.asarray(value) / deviation)

    difference = seen.points[first] - seen.points[second]
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    for run in np.split(order, starts[1:]):
        a, b = divmod(int(key[run[0]]), groups)
        # cameras share the tremor only if they look at once: neighbours in time are not new evidence
        require(a, b, np.median(difference[run], axis=0), 0.5 * TREMBLE / np.sqrt(len(run)))
    for group in range(groups):
        require(group, -1, (0.0, 0.0), LOCALISATION if mobile[group] else 0.5 * TREMBLE)
    offsets = np.linalg.lstsq(np.array(rows), np.array(measured), rcond=None)[0]
    return seen.moved(seen.points - offsets[of_sight])


def _offsets_to_find(seen: Sights) -> Tuple[int, np.ndarray, np.ndarray]:
    """How many offsets, which one each sight has, and which are a mobile camera's."""
    second = np.where(seen.mobile, np.floor((seen.stamps - seen.stamps[0]) + 0.0007), 0).astype(np.int64)
    key = seen.cameras.astype(np.int64) * (int(second.max()) + 2) + second + seen.mobile
    unique, first, of_sight = np.unique(key, return_index=True, return_inverse=True)
    return len(unique), of_sight, seen.mobile[first]


def _compared(seen: Sights, of_sight: np.ndarray) -> Tuple[np.ndarray, np.ndarray]:
    """Pairs of sights (first, second) of two cameras that saw the same spot at once."""
    first: List[np.ndarray] = []
    second: List[np.ndarray] = []
    cameras = np.unique(seen.cameras)
    for number, a in enumerate(cameras):
        ours = np.flatnonzero(seen.cameras == a)
        for b in cameras[number + 1 :]:
            theirs = np.flatnonzero(seen.cameras == b)
            partner = theirs[nearest_in(seen.stamps[theirs], seen.stamps[ours])]
            at_once = np.abs(seen.stamps[ours] - seen.stamps[partner]) <= AT_ONCE
            at_once &= np.linalg.norm(seen.points[ours] - seen.points[partner], axis=1) <= 2.0 * LOCALISATION
            first.append(ours[at_once])
            second.append(partner[at_once])
    if not first:
        return np.zeros(0, dtype=int), np.zeros(0, dtype=int)
    return np.concatenate(first), np.concatenate(second)


def nearest_in(ordered: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Index of the nearest of the ordered values for each wanted one."""
    right = np.minimum(np.searchsorted(ordered, wanted), len(ordered) - 1)
    left = np.maximum(right - 1, 0)
    return np.where(wanted - ordered[left] <= ordered[right] - wanted, left, right)
