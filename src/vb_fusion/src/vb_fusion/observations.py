"""Stage 0 of extraction.py: the spots as observations, checked, merged where they repeat each other, in order of time.

All later stages work on observations. An observation is what one camera saw at one position within a time bin. A camera
that sees a hand draw gives about ten a second, and more only where the pointer is quick. So a million spots become some
thousand observations. What all cameras saw close together in one time bin is merged again, into a cluster.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Optional, Sequence, Tuple

import numpy as np

from vb_core.errors import CodedError

TREMOR = 0.05  # [m] a hand held still stays within it, and cameras agree within it
LOCALIZATION_ERROR = 0.15  # [m] by which a robot's pose may be off, differently every second
BIN_PHASE = 0.031  # [bins] shift of the bins. Images come at round intervals, so no bin should begin at a round time
TIME_BIN = 0.1  # [s] within it a hand moves the pointer by centimetres, and a camera with 10 images/s sees it
DROPOUT_FACTOR = 3.0  # [median intervals between occupied time bins] within it a moving pointer is seen again
MAX_COORDINATE = 1e5  # [m] from the origin. No floor is larger
CLUSTER_WIDTH = 2.0 * TREMOR  # [m] width of the floor that a cluster covers
MAX_SIMULTANEOUS_CLUSTERS = 10  # clusters of one time bin, the strongest ones


@dataclass(frozen=True)
class Observations:
    """The cameras' observations as arrays, one row per observation, in order of time.

    Attributes:
        points: (N, 2) [m].
        stamps: (N,) [s] since the drawing began.
        time_bins: (N,) int, number of the time bin.
        cameras: (N,) int, index of the camera. If several cameras saw it, then the index of one of them.
        weights: (N,) > 0, from the number of spots, their confidence and the kind of camera.
        mobile: (N,) bool, whether only mobile cameras saw it.
        spot_counts: (N,) int, number of spots merged into each.
        witnesses: (N,) int, number of cameras that saw it.
    """

    points: np.ndarray
    stamps: np.ndarray
    time_bins: np.ndarray
    cameras: np.ndarray
    weights: np.ndarray
    mobile: np.ndarray
    spot_counts: np.ndarray
    witnesses: np.ndarray

    @cached_property
    def dropout_time(self) -> float:
        """The time [s] within which a moving pointer is seen again, a few usual intervals between occupied bins."""
        pauses = np.diff(np.unique(self.time_bins))
        usual_pause = float(np.median(pauses)) if len(pauses) else 1.0
        return DROPOUT_FACTOR * TIME_BIN * usual_pause

    def select(self, rows) -> "Observations":
        """Returns the observations that `rows` selects: a mask (N,) or indices."""
        return Observations(*(getattr(self, column.name)[rows] for column in fields(self)))

    def merge(self, labels: np.ndarray) -> "Observations":
        """Merges observations of one time bin with the same label (N,), numbered from 0, at their weighted mean.

        The result is in order of time, then of position.
        """
        weights = np.bincount(labels, self.weights)
        x = np.bincount(labels, self.weights * self.points[:, 0]) / weights
        y = np.bincount(labels, self.weights * self.points[:, 1]) / weights
        times = np.bincount(labels, self.weights * self.stamps) / weights
        first = np.unique(labels, return_index=True)[1]
        # each camera counts once per label. Every row must be of one camera, as all rows are before they form clusters
        span = int(self.cameras.max()) + 1
        label_cameras = np.unique(labels * span + self.cameras)
        merged = Observations(
            points=np.column_stack([x, y]),
            stamps=times,
            time_bins=self.time_bins[first],
            cameras=self.cameras[first],
            weights=weights,
            mobile=np.bincount(labels, ~self.mobile) == 0,
            spot_counts=np.bincount(labels, self.spot_counts).astype(int),
            witnesses=np.bincount(label_cameras // span),
        )
        return merged.select(np.lexsort((y, x, times)))


def observe(
    points: np.ndarray,
    stamps: Sequence[float],
    cameras: Optional[Sequence] = None,
    confidences: Optional[Sequence[float]] = None,
    mobile: Optional[Sequence[bool]] = None,
    needed: int = 1,
    too_few: str = "too_few_spots",
) -> Tuple[Observations, Observations]:
    """Makes one observation of all spots of one camera, time bin and position, and finds the observations' clusters.

    Spots that are not finite, or beyond MAX_COORDINATE, are left out. Stamps are counted from the beginning of the
    drawing, so that the same drawing gives the same border at any hour.

    Args:
        points, stamps, cameras, confidences, mobile: as for `extract_border`.
        needed, too_few: see `require_spots`.

    Returns:
        The observations, in order of time and position, and their clusters, see `find_clusters`.
    """
    points = np.asarray(points, dtype=float).reshape(-1, 2)
    stamps = np.asarray(stamps, dtype=float)
    usable = np.flatnonzero(is_on_floor(points) & np.isfinite(stamps))
    require_spots(len(usable), needed, too_few)
    count = len(points)
    cameras = np.zeros(count, dtype=int) if cameras is None else np.unique(cameras, return_inverse=True)[1]
    mobile = np.zeros(count, dtype=bool) if mobile is None else np.asarray(mobile, dtype=bool)
    confidences = np.ones(count) if confidences is None else np.nan_to_num(np.asarray(confidences, dtype=float))
    # a detector that reports confidence 0 still saw something
    weights = np.where(mobile, TREMOR / LOCALIZATION_ERROR, 1.0) * np.clip(confidences, 0.1, 1.0)
    # stamps are rounded to microseconds, because a double that counts seconds since 1970 is no more precise
    stamps = np.round(stamps[usable] - stamps[usable].min(), 6)
    time_bins = np.floor(stamps / TIME_BIN + BIN_PHASE).astype(np.int64)
    columns = (points[usable], stamps, time_bins, cameras[usable], weights[usable], mobile[usable])
    once = np.ones(len(usable), dtype=int)
    observations = _merge_repeats(Observations(*columns, spot_counts=once, witnesses=once))
    return observations, find_clusters(observations)


def require_spots(count: int, needed: int, too_few: str = "too_few_spots") -> None:
    """Refuses fewer spots than are needed. Raises CodedError "no_spots" if there are none at all, else `too_few`."""
    if count == 0:
        raise CodedError("no_spots")
    if count < needed:
        raise CodedError(too_few, spots=count, needed=needed)


def is_on_floor(points: np.ndarray) -> np.ndarray:
    """Returns, as (N,) bool, which points (N, 2) [m] are finite and not beyond MAX_COORDINATE."""
    return (np.abs(points) <= MAX_COORDINATE).all(axis=1)


def _merge_repeats(spots: Observations) -> Observations:
    """Merges spots of one camera, time bin and cell of the floor. The result is in order of time and position."""
    cells = np.floor(spots.points / TREMOR).astype(np.int64)
    keys = np.zeros(len(cells), dtype=np.int64)
    for column in (spots.time_bins, spots.cameras, *cells.T):
        column = column - column.min()
        keys = keys * (int(column.max()) + 1) + column
    return spots.merge(np.unique(keys, return_inverse=True)[1])


def find_clusters(observations: Observations) -> Observations:
    """Finds the strongest clusters of each time bin, at most MAX_SIMULTANEOUS_CLUSTERS, in order of time."""
    group = observations.time_bins.copy()
    # split at gaps along x, then along y, then along x again
    for axis in (0, 1, 0):
        order = np.lexsort((observations.points[:, axis], group))
        is_next_group = np.diff(group[order]) != 0
        is_beyond_gap = np.diff(observations.points[order, axis]) > CLUSTER_WIDTH
        group[order] = np.append(0, np.cumsum(is_next_group | is_beyond_gap))
    clusters = observations.merge(group)
    x, y = clusters.points.T
    # weights are rounded because another computer may sum equal ones in another order
    strongest_first = np.lexsort((y, x, -np.round(clusters.weights, 6), clusters.time_bins))
    bins = clusters.time_bins[strongest_first]
    rank_in_bin = np.arange(len(bins)) - np.searchsorted(bins, bins)
    return clusters.select(np.sort(strongest_first[rank_in_bin < MAX_SIMULTANEOUS_CLUSTERS]))
