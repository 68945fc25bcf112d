"""Schedules the images of simulated cameras."""

from __future__ import annotations

from collections import deque
from typing import Callable, Deque, Dict, List, Optional, Sequence, Tuple

TICK = 0.025  # [s] how far time is extrapolated beyond the last step of /clock
MAX_BACKLOG = 3  # [frames] a camera that is so far behind drops all frames but the newest


class SmoothClock:
    """Simulated time, extrapolated between the messages on /clock, which arrive only every few hundredths of a second.

    Args:
        simulated: returns the simulated time [s], which advances in steps.
        steady: returns a monotonic wall time [s].
    """

    def __init__(self, simulated: Callable[[], float], steady: Callable[[], float]) -> None:
        self._simulated = simulated
        self._steady = steady
        self._offsets: Deque[float] = deque(maxlen=25)
        self._last: Optional[float] = None

    def now(self) -> float:
        """Returns the time [s]. It stops when the simulated time does."""
        simulated, steady = self._simulated(), self._steady()
        if simulated != self._last:
            self._last = simulated
            # a step may be noticed late but never early, so the largest offset is right while both clocks keep pace
            self._offsets.append(simulated - steady)
        extrapolated = steady + max(self._offsets)
        return min(max(extrapolated, simulated), simulated + TICK)


class FrameSchedule:
    """Spreads the images of several cameras evenly over the time between two frames.

    Each camera's stamps are multiples of its period plus an offset of its own.

    Args:
        rates: [1/s] frames of each camera.
        latency_s: [s] from an image's stamp to its delivery.
    """

    def __init__(self, rates: Sequence[float], latency_s: float) -> None:
        periods = [1.0 / rate for rate in rates]
        phases = [period * index / len(rates) for index, period in enumerate(periods)]
        self._timings = list(zip(periods, phases))  # [s]
        self._latency_s = latency_s
        self._next: Dict[int, int] = {}  # number of each camera's next image
        self.skipped = 0  # number of images left out

    def due(self, now: float) -> List[Tuple[int, float]]:
        """Returns the images (camera index, stamp [s]) to deliver now, oldest first."""
        images = []
        for index, (period, phase) in enumerate(self._timings):
            newest = int((now - self._latency_s - phase) / period + 1e-6)
            first = self._next.get(index, newest)
            has_jumped_back = first - newest > MAX_BACKLOG
            if has_jumped_back:
                first = newest
            if newest - first >= MAX_BACKLOG:
                self.skipped += newest - first
                first = newest
            images += [(index, number * period + phase) for number in range(first, newest + 1)]
            self._next[index] = max(first, newest + 1)
        return sorted(images, key=lambda image: image[1])

    def time_to_next(self, now: float) -> float:
        """Returns the time [s] until the next image is due."""
        numbers = [self._next.get(index, 0) for index in range(len(self._timings))]
        stamps = [number * period + phase for number, (period, phase) in zip(numbers, self._timings)]
        return max(0.0, min(stamps, default=now + 1.0) + self._latency_s - now)
