"""Stage 0: the spots as they came, checked and sorted by time.

Everything after this works on sights. A sight is what one camera saw of one place within 20 ms: at 25 or 30 images
per second that is one spot, and a million spots become some ten thousand sights.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Optional, Sequence

import numpy as np

from vb_fusion.chain import ExtractionError

TREMBLE = 0.05  # [m] a hand that holds still stays within it, and cameras agree within it
LOCALISATION = 0.15  # [m] what a robot's pose may be off, differently every second
QUANTUM = 0.02  # [s] less than the time between two images of a usual camera
FARTHEST = 1e5  # [m] from the origin: no floor is larger


@dataclass(frozen=True)
class Sights:
    """What the cameras saw, ordered by time; arrays with one row per sight.

    Attributes:
        points: (N, 2) [m].
        stamps: (N,) [s], ascending; None for bare points.
        cameras: (N,) int, index of the camera.
        weights: (N,) > 0: how many spots, how confident, seen by which kind of camera.
        mobile: (N,) bool, seen by a camera that moves.
        spots: how many spots these are.
    """

    points: np.ndarray
    stamps: Optional[np.ndarray]
    cameras: np.ndarray
    weights: np.ndarray
    mobile: np.ndarray
    spots: int

    def select(self, rows: np.ndarray) -> "Sights":
        """The sights where rows (N,) is true, or with these indices."""
        stamps = None if self.stamps is None else self.stamps[rows]
        return Sights(
            self.points[rows], stamps, self.cameras[rows], self.weights[rows], self.mobile[rows], self.spots
        )

    def moved(self, points: np.ndarray) -> "Sights":
        """The same sights at other places (N, 2) [m]."""
        return replace(self, points=points)


def gather(
    points: np.ndarray,
    stamps: Optional[Sequence[float]] = None,
    cameras: Optional[Sequence] = None,
    confidences: Optional[Sequence[float]] = None,
    mobile: Optional[Sequence[bool]] = None,
) -> Sights:
    """Checks spots and merges them to sights; rows that are not finite, or are off any floor, are left out.

    Raises:
        ExtractionError: "bad_points" if the shapes do not fit.
    """
    try:
        array = np.asarray(points, dtype=float)
    except (TypeError, ValueError):
        raise ExtractionError("bad_points", what="numbers") from None
    if array.size == 0:
        array = array.reshape(0, 2)
    if array.ndim != 2 or array.shape[1] != 2:
        raise ExtractionError("bad_points", what=f"points of shape (N, 2) instead of {array.shape}")
    count = len(array)
    columns = {"stamps": stamps, "cameras": cameras, "confidences": confidences, "mobile": mobile}
    for name, values in columns.items():
        if values is not None and len(values) != count:
            raise ExtractionError("bad_points", what=f"{count} {name} instead of {len(values)}")
    known = np.zeros(count, dtype=int) if cameras is None else np.unique(np.asarray(cameras), return_inverse=True)[1]
    moving = np.zeros(count, dtype=bool) if mobile is None else np.asarray(mobile, dtype=bool)
    # a detector that reports 0 still saw something
    trust = np.ones(count) if confidences is None else np.clip(np.nan_to_num(np.asarray(confidences, float)), 0.1, 1.0)
    trust = np.where(moving, TREMBLE / LOCALISATION, 1.0) * trust
    times = None if stamps is None else np.asarray(stamps, dtype=float)
    usable = (np.abs(array) <= FARTHEST).all(axis=1) & np.isfinite(0.0 if times is None else times)
    sights = Sights(array, times, known, trust, moving, int(usable.sum())).select(usable)
    return sights if times is None or len(sights.points) == 0 else _condensed(sights)


def _condensed(spots: Sights) -> Sights:
    """Spots of one camera, place and quantum become one; the result is in order of time, then of place."""
    offset = spots.stamps.min()
    quantum = np.floor((spots.stamps - offset) / QUANTUM + 0.013).astype(np.int64)
    cell = np.floor(spots.points / TREMBLE).astype(np.int64)
    cell -= cell.min(axis=0)
    width, height = (int(size) for size in cell.max(axis=0) + 1)
    key = (quantum * (int(spots.cameras.max()) + 1) + spots.cameras) * width * height + cell[:, 0] * height + cell[:, 1]
    _, first, index = np.unique(key, return_index=True, return_inverse=True)
    weights = np.bincount(index, spots.weights)
    x, y, stamps = (
        np.bincount(index, spots.weights * values) / weights for values in (*spots.points.T, spots.stamps - offset)
    )
    order = np.lexsort((y, x, stamps))
    sights = Sights(
        np.column_stack([x, y]), offset + stamps, spots.cameras[first], weights, spots.mobile[first], spots.spots
    )
    return sights.select(order)
