"""Counts, rates and missing inputs of a detector, for its status message and notices."""

from __future__ import annotations

from collections import Counter, deque
from typing import Any, Deque, Dict, List, Optional, Tuple

import numpy as np

from vb_core.errors import CodedError

_WINDOW = 5.0  # [s]
_SILENCE = 3.0  # [s] without an input that was there before, until it counts as missing
# [s] until an input that was never there counts as missing: a lab's nodes start one by one, for up to a minute
_POSES_START, _CAMERAS_START = 30.0, 60.0
_FAULTS = {"no_camera_info": "camera_no_lens", "no_transform": "camera_no_pose"}  # notice for what an image lacks
SLOW_RATE = 5.0  # [1/s] at which a stroke at 0.5 m/s leaves one spot per 10 cm; slower cameras work, but draw coarsely
MAX_CLOCK_OFFSET = 0.1  # [s] a pointer moved at 0.5 m/s is 5 cm further on by then


class InputWatch:
    """Finds what a detector lacks, from its images. Not thread safe.

    Args:
        now: [s] when the detector was started; 0: simulated time has not begun, and the first time given counts.
    """

    def __init__(self, now: float) -> None:
        self._complete = False  # whether any image so far lacked nothing
        self._started = now
        self._image_at: Optional[float] = None
        self._missing: Tuple[Optional[CodedError], float] = (None, now)  # what images lack, and since when [s]

    def record_image(self, now: float, missing: Optional[CodedError]) -> None:
        """Records an image at a time [s], and what is missing to locate its spots, or None."""
        self._image_at = now
        missing_before, since_before = self._missing
        is_same = missing is not None and missing_before is not None and missing.code == missing_before.code
        since = since_before if is_same else now
        self._missing = missing, since
        self._complete |= missing is None

    def current_fault(self, now: float) -> Optional[CodedError]:
        """Returns the fault at a time [s], or None: there are no images, or they lack something, with `why` in detail."""
        self._started = self._started or now
        if self._image_at is None:
            return CodedError("camera_silent") if now - self._started > _CAMERAS_START else None
        if now - self._image_at > _SILENCE:
            return CodedError("camera_silent")
        missing, since = self._missing
        if missing is None or now - since <= (_SILENCE if self._complete else _POSES_START):
            return None
        code = _FAULTS.get(missing.code)
        return missing if code is None else CodedError(code, why=missing.message)


class DetectorCounts:
    """Counts since the start, and what the images of the last seconds were like. Not thread safe."""

    def __init__(self) -> None:
        self._frames: Deque[Tuple[float, float, float]] = deque()
        self._rejections: Counter = Counter()
        self._sums: Counter = Counter(processed=0, spots=0)

    def count_rejections(self, *codes: str) -> None:
        """Counts rejected images or spots."""
        self._rejections.update(codes)

    def count_image(self, now: float, stamp: float, search_s: float, spots: int) -> None:
        """Counts a searched image.

        Args:
            now, stamp: [s] the current and the image's time, on the same clock.
            search_s: [s] of the search itself.
            spots: published after this image, one for each image that shows one.
        """
        if self._frames and now < self._frames[-1][0]:
            self._frames.clear()
        self._frames.append((now, now - stamp, search_s))
        self._sums.update(processed=1, spots=spots)

    def find_image_faults(self, foreign_clock: bool) -> List[CodedError]:
        """Returns what is wrong with the images of the last seconds. `foreign_clock`: whether another node stamped them.

        A busy computer delays some images, clocks that differ shift all of them: the quickest one counts.
        """
        frames = np.array(self._frames, dtype=float).reshape(-1, 3)
        span = float(frames[-1, 0] - frames[0, 0]) if len(frames) else 0.0
        if span < 0.5 * _WINDOW:
            return []
        faults = []
        rate = (len(frames) - 1) / span
        if rate < SLOW_RATE:
            faults.append(CodedError("camera_slow", rate=f"{rate:.1f}"))
        age = min((frames[:, 1] - frames[:, 2]).tolist(), key=abs)
        if foreign_clock and abs(age) > MAX_CLOCK_OFFSET + 2.0 / rate:
            faults.append(CodedError("camera_clock", age=f"{age:.2f}"))
        return faults

    def summary(self, now: float) -> Dict[str, Any]:
        """Returns counts since the start and rates and times over the last seconds, named as in vb_msgs/DetectorStatus.

        Times are NaN where nothing happened.
        """
        while self._frames and not now - _WINDOW <= self._frames[0][0] <= now:
            self._frames.popleft()
        frames = np.array(self._frames or [(now, np.nan, np.nan)], dtype=float)
        latency, p95 = (1e3 * np.percentile(frames[:, 1], (50, 95))).tolist()
        rejections = dict(sorted(self._rejections.items()))
        return {
            **self._sums,
            "rejections": list(rejections),
            "rejection_counts": list(rejections.values()),
            "rate_hz": len(self._frames) / max(now - frames[0, 0], 0.2),
            "latency_ms": latency,
            "latency_p95_ms": p95,
            "search_ms": 1e3 * float(np.median(frames[:, 2])),
        }
