"""Decides which sounds are still worth playing: they arrive faster than they can be played, and old ones mislead."""
from __future__ import annotations

import threading
import time
from collections import deque
from typing import Callable, Deque, Optional, Tuple

from vb_feedback.sound.tone_synthesis import TICK

_MOST = 4  # waiting sounds; the oldest are dropped


class SoundQueue:
    """Queue of sounds for a worker.

    A tick plays only if nothing else waits; other sounds keep their order.

    Args:
        max_age: [s] a sound that waited longer is dropped: it would report something that is over.
        clock: [s] a steady one: a loudspeaker does not follow simulated time.
    """

    def __init__(self, max_age: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._max_age, self._clock = max_age, clock
        self._condition = threading.Condition()
        self._waiting: Deque[Tuple[str, float]] = deque(maxlen=_MOST)
        self._closed = False

    def put(self, name: str) -> None:
        """Takes a sound."""
        with self._condition:
            if self._waiting and name == TICK:
                return
            if self._waiting and self._waiting[0][0] == TICK:
                self._waiting.popleft()
            self._waiting.append((name, self._clock()))
            self._condition.notify()

    def take(self) -> Optional[str]:
        """Waits for the next sound to play; None once closed."""
        with self._condition:
            while not self._closed:
                while self._waiting:
                    name, since = self._waiting.popleft()
                    if self._clock() - since <= self._max_age:
                        return name
                self._condition.wait()
        return None

    def close(self) -> None:
        """Ends the worker."""
        with self._condition:
            self._closed = True
            self._condition.notify()
