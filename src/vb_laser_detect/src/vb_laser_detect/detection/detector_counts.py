"""Counts and rates of a detector, for its status message and diagnostics."""
from __future__ import annotations

import threading
from collections import Counter, deque
from dataclasses import dataclass, field
from typing import Deque, Dict, Tuple

import numpy as np

_WINDOW_S = 5.0


@dataclass(frozen=True)
class Summary:
    """Counts since the start; rates and times over the last seconds, NaN where nothing happened."""

    processed: int
    detected: int
    spots: int
    refusals: Dict[str, int] = field(default_factory=dict)
    rate_hz: float = 0.0
    latency_ms: float = float("nan")
    latency_p95_ms: float = float("nan")
    search_ms: float = float("nan")


class DetectorCounts:
    """Written by the worker, read by a timer."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._frames: Deque[Tuple[float, float, float]] = deque()
        self._refusals: Counter = Counter()
        self._processed = self._detected = self._spots = 0

    def refuse(self, code: str) -> None:
        """Counts a rejected image or spot."""
        with self._lock:
            self._refusals[code] += 1

    def frame(self, now: float, stamp: float, search_s: float, spots: int) -> None:
        """Counts a searched image.

        Args:
            now, stamp: [s] the current and the image's time, on the same clock.
            search_s: [s] of the search itself.
            spots: published for this image.
        """
        with self._lock:
            if self._frames and now < self._frames[-1][0]:
                self._frames.clear()
            self._frames.append((now, now - stamp, search_s))
            self._processed += 1
            self._detected += spots > 0
            self._spots += spots

    def recall(self, frames: int) -> None:
        """Counts earlier frames whose spot was published late, once it was confirmed."""
        with self._lock:
            self._detected += frames
            self._spots += frames

    def summary(self, now: float) -> Summary:
        """The counts so far."""
        with self._lock:
            while self._frames and not now - _WINDOW_S <= self._frames[0][0] <= now:
                self._frames.popleft()
            frames = np.array(self._frames, dtype=float).reshape(-1, 3)
            counts = dict(sorted(self._refusals.items()))
            processed, detected, spots = self._processed, self._detected, self._spots
        if not len(frames):
            return Summary(processed, detected, spots, counts)
        span = now - frames[0, 0]
        return Summary(
            processed,
            detected,
            spots,
            counts,
            rate_hz=len(frames) / max(span, 0.2),
            latency_ms=1e3 * float(np.median(frames[:, 1])),
            latency_p95_ms=1e3 * float(np.percentile(frames[:, 1], 95)),
            search_ms=1e3 * float(np.median(frames[:, 2])),
        )
