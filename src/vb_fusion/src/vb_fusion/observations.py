"""Stages 0 and 2: the spots, checked and put in order of time, and later corrected for errors of the cameras' poses.

All later stages work on observations. An observation is what one camera saw at one position within a time bin: about
ten a second from a camera that sees a hand draw, more only where the pointer is quick. A million spots become a few
thousand.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Optional, Sequence

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import spsolve

TREMOR = 0.05  # [m] a hand held still stays within it, and cameras agree within it
LOCALIZATION_ERROR = 0.15  # [m] by which a robot's pose may be off, differently every second
BIN_PHASE = 0.031  # [bins] shift of the bins: none should begin at a round time, as images come at round intervals
TIME_BIN = 0.1  # [s] within it a hand moves the pointer by centimetres, and a camera with 10 images/s sees it
MAX_DROPOUTS = 3.0  # median intervals between occupied time bins, within which a moving pointer is seen again
# correlation of a robot's error with the error a second later: it is corrected within metres
ERROR_CORRELATION = math.exp(-0.1)
MAX_COORDINATE = 1e5  # [m] from the origin: no floor is larger


@dataclass(frozen=True)
class Observations:
    """The cameras' observations as arrays, one row per observation, ordered by time if there are stamps.

    Attributes:
        points: (N, 2) [m].
        stamps: (N,) [s] since the drawing began; zeros for bare points.
        cameras: (N,) int, index of the camera; for merged observations, the index of one of their cameras.
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

    def merge(self, labels: np.ndarray) -> "Observations":
        """Merges observations with the same label (N,), numbered from 0, into one at their weighted mean."""
        weights = np.bincount(labels, self.weights)
        x, y, times = (np.bincount(labels, self.weights * values) / weights for values in (*self.points.T, self.stamps))
        cameras = np.empty(len(weights), dtype=int)
        cameras[labels] = self.cameras
        span = int(self.cameras.max()) + 1
        return Observations(
            points=np.column_stack([x, y]),
            stamps=times,
            cameras=cameras,
            weights=weights,
            mobile=np.bincount(labels, ~self.mobile) == 0,
            spots=np.bincount(labels, self.spots).astype(int),
            witnesses=np.bincount(np.unique(labels * span + self.cameras) // span),
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
    """Makes one observation of each spot. Rows that are not finite, or beyond MAX_COORDINATE, are left out.

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
    """Merges spots of one camera, time bin and position into one observation. The result is in order of time and position."""
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


def remove_offsets(observations: Observations) -> Observations:
    """Removes the cameras' offsets. An offset common to all cameras cannot be known.

    Cameras that see the pointer at the same time disagree, as their poses are known to centimetres only. The
    disagreements are modelled by one offset per stationary camera and, since localisation errors change as a robot
    drives and turns, by one per second for a camera on a robot. A robot's offset changes little from one second to the
    next: it is a first-order autoregressive process. Where the robot alone sees the pointer, its offset is therefore
    inferred from just before and after, when other cameras saw the pointer too. All offsets are found together by
    weighted least squares; those of stationary cameras are held near zero far more firmly, so that a lost robot does
    not move the border.

    An observation is the pointer's position in its time bin plus the offset of its camera. The positions are
    eliminated, which leaves the differences from the mean of the bin.
    """
    bins = time_bins(observations.stamps)
    # unknowns exist only where something was seen: second 0 of each stationary camera, some seconds of each robot's
    second = np.where(observations.mobile, 1 + bins // 10 - bins.min() // 10, 0)
    span = int(second.max()) + 1
    unknowns, index = np.unique(observations.cameras * span + second, return_inverse=True)
    # the observations of a time bin are adjacent
    row = np.cumsum(np.append(0, np.diff(bins) != 0))
    in_bin = csr_matrix((np.ones(len(row)), (row, index)), shape=(int(row[-1]) + 1, len(unknowns)))
    share = diags(1.0 / np.bincount(row)) @ in_bin
    # each equation is divided by its standard deviation: the hand's tremor for differences, the placement error for a
    # camera's offset, and for a robot only the part of its error that is new since the previous second with a spot
    camera, time = np.divmod(unknowns, span)
    follows_on = (np.diff(camera) == 0) & (time[:-1] > 0)
    correlation = np.where(follows_on, ERROR_CORRELATION ** np.diff(time), 0.0)
    prior_precision = np.where(time > 0, (0.5 * TREMOR / LOCALIZATION_ERROR) ** 2, 1.0)
    prior_precision[1:] /= 1.0 - correlation**2
    change = diags([np.ones(len(time)), -correlation], [0, -1])
    equations = diags(np.bincount(index).astype(float)) + change.T @ diags(prior_precision) @ change - in_bin.T @ share
    differences = np.column_stack(
        [np.bincount(index, axis) - share.T @ np.bincount(row, axis) for axis in observations.points.T]
    )
    # rounded to 0.1 mm, so that positions found before stay the same while more is seen
    offsets = np.round(spsolve(equations.tocsc(), differences).reshape(-1, 2), 4)
    return replace(observations, points=observations.points - offsets[index])
