"""Stage 0: the spots, checked and put in order of time.

All later stages work on observations. An observation is what one camera saw at one position within a time bin: about
ten a second from a camera that sees a hand draw, more only where the pointer is quick. A million spots become a few
thousand.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Optional, Sequence

import numpy as np

TREMOR = 0.05  # [m] a hand held still stays within it, and cameras agree within it
LOCALIZATION_ERROR = 0.15  # [m] by which a robot's pose may be off, differently every second
BIN_PHASE = 0.031  # of a bin: no bin should begin at a round time, as images come at round intervals
TIME_BIN = 0.1  # [s] within it a hand moves the pointer by centimetres, and a camera with 10 images/s sees it
MAX_DROPOUTS = 3.0  # median intervals between occupied time bins, within which a moving pointer is seen again
MAX_COORDINATE = 1e5  # [m] from the origin: no floor is larger


@dataclass(frozen=True)
class Observations:
    """The cameras' observations as arrays, one row per observation, ordered by time if there are stamps.

    Attributes:
        points: (N, 2) [m].
        stamps: (N,) [s] since the drawing began; zeros for bare points.
        cameras: (N,) int, index of the camera; for merged observations, of one of their cameras.
        weights: (N,) > 0, from the number of spots, their confidence and the kind of camera.
        mobile: (N,) bool, whether seen by mobile cameras only.
        spots: (N,) number of spots merged into each.
        witnesses: (N,) int, number of cameras that saw it.
    """

    points: np.ndarray
    stamps: np.ndarray
    cameras: np.ndarray
    weights: np.ndarray
    mobile: np.ndarray
    spots: np.ndarray
    witnesses: np.ndarray

    def select(self, rows) -> "Observations":
        """Returns the observations that `rows` selects: a mask (N,) or indices."""
        return Observations(*(getattr(self, column.name)[rows] for column in fields(self)))

    def merge(self, group: np.ndarray) -> "Observations":
        """Merges the observations of each group (N,), numbered from 0, into one at their weighted mean."""
        weights = np.bincount(group, self.weights)
        x, y, times = (np.bincount(group, self.weights * one) / weights for one in (*self.points.T, self.stamps))
        cameras = np.empty(len(weights), dtype=int)
        cameras[group] = self.cameras
        span = int(self.cameras.max()) + 1
        return Observations(
            points=np.column_stack([x, y]),
            stamps=times,
            cameras=cameras,
            weights=weights,
            mobile=np.bincount(group, ~self.mobile) == 0,
            spots=np.bincount(group, self.spots).astype(int),
            witnesses=np.bincount(np.unique(group * span + self.cameras) // span),
        )


def time_bins(stamps: np.ndarray) -> np.ndarray:
    """Returns the number (N,) int of the time bin of each stamp [s]."""
    return np.floor(stamps / TIME_BIN + BIN_PHASE).astype(np.int64)


def find_dropout(stamps: np.ndarray) -> float:
    """Finds the time [s] within which a moving pointer is seen again: a few usual intervals between time bins."""
    pauses = np.diff(np.unique(time_bins(stamps)))
    return MAX_DROPOUTS * TIME_BIN * (float(np.median(pauses)) if len(pauses) else 1.0)


def make_observations(
    points: np.ndarray,
    stamps: Optional[Sequence[float]] = None,
    cameras: Optional[Sequence] = None,
    confidences: Optional[Sequence[float]] = None,
    mobile: Optional[Sequence[bool]] = None,
) -> Observations:
    """Makes one observation of each spot; rows that are not finite, or beyond MAX_COORDINATE, are left out.

    Stamps are counted from the beginning of the drawing, so that the same drawing gives the same border at any hour.
    """
    array = np.asarray(points, dtype=float).reshape(-1, 2)
    count = len(array)
    numbers = np.zeros(count, dtype=int) if cameras is None else np.asarray(cameras)
    if numbers.dtype.kind not in "iu" or (count and not 0 <= numbers.min() <= numbers.max() < 256):
        numbers = np.unique(numbers, return_inverse=True)[1]
    moving = np.zeros(count, dtype=bool) if mobile is None else np.asarray(mobile, dtype=bool)
    # a detector that reports confidence 0 still saw something
    trust = np.ones(count) if confidences is None else np.clip(np.nan_to_num(np.asarray(confidences, float)), 0.1, 1.0)
    trust = np.where(moving, TREMOR / LOCALIZATION_ERROR, 1.0) * trust
    times = np.zeros(count) if stamps is None else np.asarray(stamps, dtype=float)
    usable = (np.abs(array) <= MAX_COORDINATE).all(axis=1) & np.isfinite(times)
    began = times[usable].min() if usable.any() else 0.0
    # rounded to microseconds: a double that counts seconds since 1970 is no more precise
    times = np.round(times - began, 6)
    once = np.ones(count, dtype=int)
    return Observations(array, times, numbers, trust, moving, spots=once, witnesses=once).select(usable)


def merge_observations(spots: Observations) -> Observations:
    """Merges spots of one camera, time bin and position into one observation; orders these by time, then position."""
    if len(spots.points) == 0:
        return spots
    bins = time_bins(spots.stamps)
    cell = np.floor(spots.points / TREMOR).astype(np.int64)
    cell -= cell.min(axis=0)
    width, height = (int(size) for size in cell.max(axis=0) + 1)
    cameras = int(spots.cameras.max()) + 1
    key = ((bins - bins.min()) * cameras + spots.cameras) * width * height + cell[:, 0] * height + cell[:, 1]
    merged = spots.merge(np.unique(key, return_inverse=True)[1])
    return merged.select(np.lexsort((*merged.points.T[::-1], merged.stamps)))


def estimate_tremor(stroke: Observations) -> float:
    """Estimates the distance [m] from a stroke within which its observations lie: hand tremor and camera errors.

    It is three standard deviations of the observations from the straight line between those 0.2 s before and after,
    rounded to half powers of two, so that it seldom changes while a line grows.
    """
    after = np.searchsorted(stroke.stamps, stroke.stamps + 2.0 * TIME_BIN)
    before = np.searchsorted(stroke.stamps, stroke.stamps - 2.0 * TIME_BIN) - 1
    inner = np.flatnonzero((before >= 0) & (after < len(after)))
    one, other = before[inner], after[inner]
    share = ((stroke.stamps[inner] - stroke.stamps[one]) / (stroke.stamps[other] - stroke.stamps[one]))[:, None]
    off = stroke.points[inner] - (1.0 - share) * stroke.points[one] - share * stroke.points[other]
    if len(inner) < 10:
        return TREMOR
    # half of the squares are below 2 ln 2 variances of an axis; the errors of the line's ends add half a variance
    deviation = np.sqrt(np.median((off**2).sum(axis=1)) / (3.0 * np.log(2.0)))
    steps = np.round(2.0 * np.log2(max(3.0 * deviation, 1e-6) / TREMOR))
    return float(TREMOR * 2.0 ** (0.5 * np.clip(steps, -2.0, 1.0)))
