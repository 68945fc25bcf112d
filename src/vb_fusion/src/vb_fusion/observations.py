"""What is known of each spot beyond its place, and what robust mode makes of it.

The paper's algorithm works on the bare point set. Where stamps, cameras and confidences are at hand, stray detections
are recognised by having no predecessor and no successor, the cameras' biases against each other are taken out, and
the order of drawing helps to join pieces and gives the chain its direction. All of it is optional.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Sequence

import numpy as np
from scipy.spatial import cKDTree

from vb_fusion.chain import ExtractionError

SIMULTANEOUS = 0.03  # [s] two cameras saw the same spot: less than one frame apart
SAME_SPOT = 0.3  # [m] simultaneous spots farther apart are not the same one
MIN_SIMULTANEOUS = 15  # as many are needed for a bias
NEXT_IN_TIME = 0.3  # [s] within it a spot is seen again
FASTEST = 2.0  # [m/s] of a spot that draws
COMPANY = 0.1  # [m] between two sights of a spot, beyond its way


@dataclass(frozen=True)
class Observations:
    """Spots with what is known of them; every array has one row per spot, None where it is not known."""

    points: np.ndarray  # (N, 2) [m]
    weights: np.ndarray  # (N,) above 0
    stamps: Optional[np.ndarray] = None  # (N,) [s], any order
    cameras: Optional[np.ndarray] = None  # (N,) int, index of the camera

    def select(self, keep: np.ndarray) -> "Observations":
        """The spots where keep (N,) is true, or with these indices."""
        return Observations(
            self.points[keep],
            self.weights[keep],
            None if self.stamps is None else self.stamps[keep],
            None if self.cameras is None else self.cameras[keep],
        )

    @property
    def ranks(self) -> Optional[np.ndarray]:
        """(N,) place of each spot in the order of drawing, 0 first to 1 last.

        It is the share of the weight seen before: neither a pause nor, with bounded weights, a spot held still counts.
        """
        if self.stamps is None:
            return None
        order = np.argsort(self.stamps, kind="stable")
        before = np.cumsum(self.weights[order]) - self.weights[order]
        ranks = np.empty(len(order))
        ranks[order] = before / max(before[-1], 1e-9)
        return ranks


def observations(
    points: np.ndarray,
    stamps: Optional[Sequence[float]] = None,
    cameras: Optional[Sequence] = None,
    confidences: Optional[Sequence[float]] = None,
    limit: float = 1e5,
) -> Observations:
    """Checks and gathers; points that are not finite or farther than `limit` [m] from the origin are left out.

    Raises:
        ExtractionError: "bad_points" if the shapes do not fit.
    """
    try:
        array = np.asarray(points, dtype=float)
    except (TypeError, ValueError):
        raise ExtractionError("bad_points", "the points are no numbers") from None
    if array.size == 0:
        array = array.reshape(0, 2)
    if array.ndim != 2 or array.shape[1] != 2:
        raise ExtractionError("bad_points", f"expected points of shape (N, 2), got {array.shape}")
    for name, values in (("stamps", stamps), ("cameras", cameras), ("confidences", confidences)):
        if values is not None and len(values) != len(array):
            raise ExtractionError("bad_points", f"expected {len(array)} {name}, got {len(values)}")
    keep = np.isfinite(array).all(axis=1)
    keep[keep] = (np.abs(array[keep]) <= limit).all(axis=1)
    weights = np.ones(len(array))
    if confidences is not None:
        confidence = np.nan_to_num(np.asarray(confidences, dtype=float), nan=0.0)
        # a detector that says 0 still saw something
        weights = np.clip(confidence, 0.1, 1.0)
        weights = weights / weights.mean() if len(weights) else weights
    times = None
    if stamps is not None:
        times = np.asarray(stamps, dtype=float)
        if not np.isfinite(times).all():
            times = None
    index = None if cameras is None else np.unique(np.asarray(cameras), return_inverse=True)[1]
    return Observations(array, weights, times, index).select(keep)


def without_strays(seen: Observations) -> Observations:
    """Leaves out spots that nobody saw just before or after anywhere near; needs stamps."""
    if seen.stamps is None or len(seen.points) < 10:
        return seen
    # within NEXT_IN_TIME a spot moves its way at most; one metric for both: radius COMPANY
    speed_scale = COMPANY / NEXT_IN_TIME
    space = np.column_stack([seen.points * (COMPANY / (COMPANY + FASTEST * 0.08)), seen.stamps * speed_scale])
    reach = 1.5 * COMPANY
    # three in a cell whose diagonal is the reach have each other; only the rest has to be looked at
    cells = np.floor((space - space.min(axis=0)) / (reach / np.sqrt(3.0))).astype(np.int64)
    width = cells.max(axis=0) + 1
    keys = (cells[:, 0] * width[1] + cells[:, 1]) * width[2] + cells[:, 2]
    _, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
    kept = counts[inverse] >= 3
    lonely = np.flatnonzero(~kept)
    if lonely.size:
        kept[lonely] = cKDTree(space).query(space[lonely], k=[3])[0][:, 0] <= reach
    # recordings at a low rate have no such company at all
    return seen.select(kept) if kept.mean() > 0.6 else seen


def without_bias(seen: Observations) -> Observations:
    """Takes out what the cameras disagree about the same spot; needs stamps and cameras.

    The biases of all cameras against each other are solved for at once; what they have in common cannot be known.
    """
    if seen.stamps is None or seen.cameras is None or len(seen.points) == 0:
        return seen
    count = int(seen.cameras.max()) + 1
    rows, measured = [], []
    order = np.argsort(seen.stamps, kind="stable")
    for a in range(count):
        ours = order[seen.cameras[order] == a]
        for b in range(a + 1, count):
            theirs = order[seen.cameras[order] == b]
            if min(len(ours), len(theirs)) < MIN_SIMULTANEOUS:
                continue
            partner = theirs[nearest_in(seen.stamps[theirs], seen.stamps[ours])]
            difference = seen.points[ours] - seen.points[partner]
            same = (np.abs(seen.stamps[ours] - seen.stamps[partner]) <= SIMULTANEOUS) & (
                np.linalg.norm(difference, axis=1) <= SAME_SPOT
            )
            if same.sum() < MIN_SIMULTANEOUS:
                continue
            row = np.zeros(count)
            row[a], row[b] = 1.0, -1.0
            trust = np.sqrt(float(same.sum()))
            rows.append(trust * row)
            measured.append(trust * np.median(difference[same], axis=0))
    if not rows:
        return seen
    bias = np.linalg.lstsq(np.array(rows), np.array(measured), rcond=None)[0]
    return Observations(seen.points - bias[seen.cameras], seen.weights, seen.stamps, seen.cameras)


def nearest_in(sorted_values: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Index of the nearest of the sorted values for each wanted one."""
    right = np.minimum(np.searchsorted(sorted_values, wanted), len(sorted_values) - 1)
    left = np.maximum(right - 1, 0)
    return np.where(wanted - sorted_values[left] <= sorted_values[right] - wanted, left, right)
