"""Stage 0: the spots as observations, checked, merged where they repeat each other, and in order of time.

All later stages work on observations: what one camera saw at one position within a time bin. A camera that sees a hand
draw gives about ten a second, and more only where the pointer is quick. A million spots become a few thousand.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Optional, Sequence

import numpy as np

TREMOR = 0.05  # [m] a hand held still stays within it, and cameras agree within it
LOCALIZATION_ERROR = 0.15  # [m] by which a robot's pose may be off, differently every second
BIN_PHASE = 0.031  # [bins] shift of the bins. Images come at round intervals, so no bin should begin at a round time
TIME_BIN = 0.1  # [s] within it a hand moves the pointer by centimetres, and a camera with 10 images/s sees it
MAX_DROPOUTS = 3.0  # median intervals between occupied time bins, within which a moving pointer is seen again
MAX_COORDINATE = 1e5  # [m] from the origin. No floor is larger


@dataclass(frozen=True)
class Observations:
    """The cameras' observations as arrays, one row per observation, in order of time.

    Attributes:
        points: (N, 2) [m].
        stamps: (N,) [s] since the drawing began.
        cameras: (N,) int, index of the camera. An observation merged from several cameras has any of theirs.
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

    @property
    def time_bins(self) -> np.ndarray:
        """(N,) int, number of each observation's time bin."""
        return np.floor(self.stamps / TIME_BIN + BIN_PHASE).astype(np.int64)

    @property
    def dropout_time(self) -> float:
        """The time [s] within which a moving pointer is seen again, a few usual intervals between occupied bins."""
        pauses = np.diff(np.unique(self.time_bins))
        usual_pause = float(np.median(pauses)) if len(pauses) else 1.0
        return MAX_DROPOUTS * TIME_BIN * usual_pause

    def select(self, rows) -> "Observations":
        """Returns the observations that `rows` selects: a mask (N,) or indices."""
        return Observations(*(getattr(self, column.name)[rows] for column in fields(self)))

    def merge(self, labels: np.ndarray) -> "Observations":
        """Merges observations with the same label (N,), numbered from 0, into one at their weighted mean.

        The result is in order of time, then of position.
        """
        weights = np.bincount(labels, self.weights)
        x, y, times = (np.bincount(labels, self.weights * values) / weights for values in (*self.points.T, self.stamps))
        cameras = np.empty(len(weights), dtype=int)
        cameras[labels] = self.cameras
        span = int(self.cameras.max()) + 1
        merged = Observations(
            points=np.column_stack([x, y]),
            stamps=times,
            cameras=cameras,
            weights=weights,
            mobile=np.bincount(labels, ~self.mobile) == 0,
            spots=np.bincount(labels, self.spots).astype(int),
            witnesses=np.bincount(np.unique(labels * span + self.cameras) // span),
        )
        return merged.select(np.lexsort((y, x, times)))


def make_observations(
    points: np.ndarray,
    stamps: Sequence[float],
    cameras: Optional[Sequence] = None,
    confidences: Optional[Sequence[float]] = None,
    mobile: Optional[Sequence[bool]] = None,
) -> Observations:
    """Makes one observation of all spots of one camera, time bin and position.

    The arguments are those of `extract_border`. Spots that are not finite, or beyond MAX_COORDINATE, are left out. Stamps
    are counted from the beginning of the drawing, so that the same drawing gives the same border at any hour.
    """
    points = np.asarray(points, dtype=float).reshape(-1, 2)
    stamps = np.asarray(stamps, dtype=float)
    count = len(points)
    cameras = np.zeros(count, dtype=int) if cameras is None else np.asarray(cameras)
    if cameras.dtype.kind not in "iu" or (count and not 0 <= cameras.min() <= cameras.max() < 256):
        cameras = np.unique(cameras, return_inverse=True)[1]
    mobile = np.zeros(count, dtype=bool) if mobile is None else np.asarray(mobile, dtype=bool)
    confidences = np.ones(count) if confidences is None else np.nan_to_num(np.asarray(confidences, dtype=float))
    # a detector that reports confidence 0 still saw something
    weights = np.where(mobile, TREMOR / LOCALIZATION_ERROR, 1.0) * np.clip(confidences, 0.1, 1.0)
    usable = is_on_floor(points) & np.isfinite(stamps)
    began = stamps[usable].min() if usable.any() else 0.0
    # stamps are rounded to microseconds, because a double that counts seconds since 1970 is no more precise
    stamps = np.round(stamps - began, 6)
    once = np.ones(count, dtype=int)
    spots = Observations(points, stamps, cameras, weights, mobile, spots=once, witnesses=once).select(usable)
    return _merge_repeats(spots) if usable.any() else spots


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
