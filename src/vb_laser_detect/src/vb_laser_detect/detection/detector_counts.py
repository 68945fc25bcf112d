"""Counts and rates of a detector, for its status message and diagnostics."""

from __future__ import annotations

import threading
from collections import Counter, deque
from typing import Any, Deque, Dict, Tuple

import numpy as np

_WINDOW = 5.0  # [s]


class DetectorCounts:
    """Written by the worker, read by a timer."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._frames: Deque[Tuple[float, float, float]] = deque()
        self._rejections: Counter = Counter()
        self._sums: Counter = Counter(processed=0, detected=0, spots=0)

    def count_rejection(self, code: str) -> None:
        """Counts a rejected image or spot."""
        with self._lock:
            self._rejections[code] += 1

    def count_image(self, now: float, stamp: float, search_s: float, spots: int, backfilled: int = 0) -> None:
        """Counts a searched image.

        Args:
            now, stamp: [s] the current and the image's time, on the same clock.
            search_s: [s] of the search itself.
            spots: published after this image, one for each image that shows one.
            backfilled: of these, spots of earlier images.
        """
        with self._lock:
            if self._frames and now < self._frames[-1][0]:
                self._frames.clear()
            self._frames.append((now, now - stamp, search_s))
            self._sums.update(processed=1, detected=backfilled + int(spots > backfilled), spots=spots)

    def summary(self, now: float) -> Dict[str, Any]:
        """Returns counts since the start and rates and times over the last seconds, named as in vb_msgs/DetectorStatus.

        Times are NaN where nothing happened.
        """
        with self._lock:
            while self._frames and not now - _WINDOW <= self._frames[0][0] <= now:
                self._frames.popleft()
            frames = np.array(self._frames or [(now, np.nan, np.nan)], dtype=float)
            rate = len(self._frames) / max(now - frames[0, 0], 0.2)
            rejections = dict(sorted(self._rejections.items()))
            sums = dict(self._sums)
        latency, p95 = (1e3 * np.percentile(frames[:, 1], (50, 95))).tolist()
        search = 1e3 * float(np.median(frames[:, 2]))
        return {
            **sums,
            "rejections": list(rejections),
            "rejection_counts": list(rejections.values()),
            "rate_hz": rate,
            "latency_ms": latency,
            "latency_p95_ms": p95,
            "search_ms": search,
        }
