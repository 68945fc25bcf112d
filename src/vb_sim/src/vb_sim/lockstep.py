"""Simulated time that waits for the nodes that drive a robot."""

from __future__ import annotations

import threading
from typing import Set, Tuple


class Lockstep:
    """Makes simulated time wait for the nodes that drive a robot, so that a busy computer never makes them late.

    As long as all of them arrive in every step, `wait` ends a step once each has. One that is silent for `timeout` has
    nothing to do: steps then end at once, until all arrive within one step again.

    Args:
        expected: the names of these nodes.
        timeout: [s] of wall time.
    """

    def __init__(self, expected: Tuple[str, ...], timeout: float = 1.0) -> None:
        self._expected, self._timeout = set(expected), timeout
        self._arrived: Set[str] = set()
        self._active = False
        self._condition = threading.Condition()

    def arrive(self, who: str) -> None:
        """Records that a node has published in this step; from any thread."""
        with self._condition:
            self._arrived.add(who)
            self._condition.notify_all()

    def wait(self) -> None:
        """Ends a step: waits until all have arrived in it, if they did in the last one."""
        with self._condition:
            if self._active:
                self._condition.wait_for(lambda: self._arrived >= self._expected, self._timeout)
            self._active = self._arrived >= self._expected
            self._arrived.clear()
