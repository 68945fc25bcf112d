"""Counts and rates of a detector, and what it lacks, for its status message and diagnostics."""

from __future__ import annotations

import threading
from collections import Counter, deque
from typing import Any, Deque, Dict, Optional, Tuple

import numpy as np

_WINDOW = 5.0  # [s]
_SILENCE, _START = 3.0, 15.0  # [s] what was there and is missed; what never was: cameras and poses start one by one
_FAULTS = {"no_camera_info": "camera_no_lens", "no_transform": "camera_no_pose"}  # by what an image lacks


class InputWatch:
    """Tells people's code of what a detector lacks now, by its images. Not thread safe."""

    def __init__(self) -> None:
        self._complete = False  # whether an image lacked nothing before
        self._image_at: Optional[float] = None
        self._missing: Tuple[str, float] = ("", 0.0)  # what images lack, and since when [s]

    def see_image(self, now: float, missing: str) -> None:
        """Notes an image at a time [s], and the code of what is missing to place its spots; "" for nothing."""
        self._image_at = now
        if missing != self._missing[0]:
            self._missing = missing, now
        self._complete |= not missing

    def fault(self, now: float) -> str:
        """Returns what is wrong at a time [s]; "" also for a camera that never sent an image, which check_lab tells."""
        if self._image_at is None:
            return ""
        if now - self._image_at > _SILENCE:
            return "camera_silent"
        lasting = now - self._missing[1] > (_SILENCE if self._complete else _START)
        return _FAULTS.get(self._missing[0], "") if lasting else ""


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
