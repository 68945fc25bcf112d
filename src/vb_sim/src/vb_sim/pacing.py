"""Simulated time that keeps step with real time, or runs faster, and how well it does."""

from __future__ import annotations

import threading
from typing import Set, Tuple

CATCH_UP = 0.3  # [s] the most that is caught up
QUICKEST = 0.7  # the minimum wait, as a share of the period


class Pacer:
    """Computes how long to wait between equal steps of simulated time.

    A late step makes the next ones come a little sooner, never in a burst: cameras and controllers
    would see none of the time in between. What is too late to catch up with is dropped.

    Args:
        period: [s] simulated time per step.
        now: [s] a monotonic clock's time.

    Attributes:
        pace: simulated seconds per real second, at most.
    """

    def __init__(self, period: float, now: float) -> None:
        self._period = period
        self.pace = 1.0
        self._due = now + period
        self._stepped = now

    def wait(self, now: float) -> float:
        """Returns how long [s] to wait, at `now`, before the next step; call it once per step."""
        self._due = max(self._due, now - CATCH_UP)
        period = self._period / self.pace
        moment = max(self._due, self._stepped + QUICKEST * period, now)
        self._due += period
        self._stepped = moment
        return moment - now


class Lockstep:
    """Makes simulated time wait for the nodes that drive a robot, so that a busy computer never makes them late.

    While all of them arrive, each must arrive once in every step that ends with `wait`. One that is silent for
    `timeout` has nothing to do: it is not waited for until it arrives again.

    Args:
        expected: who they are.
        timeout: [s] of wall time.
    """

    def __init__(self, expected: Tuple[str, ...], timeout: float = 1.0) -> None:
        self._expected, self._timeout = set(expected), timeout
        self._arrived: Set[str] = set()
        self._active = False
        self._condition = threading.Condition()

    def arrive(self, who: str) -> None:
        """Records that a node has sent a command; from any thread."""
        with self._condition:
            self._arrived.add(who)
            self._condition.notify_all()

    def wait(self) -> None:
        """Ends a step: waits until all have arrived in it."""
        with self._condition:
            if self._active:
                self._condition.wait_for(lambda: self._arrived >= self._expected, self._timeout)
            self._active = self._arrived >= self._expected
            self._arrived.clear()
