"""Decides when a simulated camera takes its images."""

from __future__ import annotations

from typing import Dict, List, Sequence, Tuple

BEHIND = 3  # late frames that are still taken; older ones are dropped


class FrameSchedule:
    """Spreads the images of several cameras evenly over the time between two frames.

    Each camera's stamps are on a fixed grid of its period, shifted against the others'.

    Args:
        rates: [1/s] frames of each camera.
        latency_s: [s] from an image's stamp to its delivery.
    """

    def __init__(self, rates: Sequence[float], latency_s: float) -> None:
        self._periods = [1.0 / rate for rate in rates]
        self._phases = [period * index / len(rates) for index, period in enumerate(self._periods)]
        self._latency_s = latency_s
        self._next: Dict[int, int] = {}  # number of each camera's next image
        self.skipped = 0  # images that were left out

    def due(self, now: float) -> List[Tuple[int, float]]:
        """Images (camera index, stamp [s]) to deliver now, oldest first."""
        images = []
        for index, (period, phase) in enumerate(zip(self._periods, self._phases)):
            newest = int((now - self._latency_s - phase) / period + 1e-6)
            following = self._next.get(index, newest)
            if newest - following >= BEHIND:
                self.skipped += newest - following
                following = newest
            images += [(index, number * period + phase) for number in range(following, newest + 1)]
            self._next[index] = max(following, newest + 1)
        return sorted(images, key=lambda image: image[1])

    def wait(self, now: float) -> float:
        """Returns how long [s] it is until the next image is due."""
        moments = [
            self._next.get(index, 0) * period + phase + self._latency_s
            for index, (period, phase) in enumerate(zip(self._periods, self._phases))
        ]
        return max(0.0, min(moments, default=now + 1.0) - now)
