"""Decides which sounds are still worth playing: they arrive faster than they can be played, and old ones mislead."""
from __future__ import annotations

from collections import deque
from typing import Deque, Optional, Tuple

from vb_feedback.sound.tone_synthesis import SOUNDS, TICK


class SoundQueue:
    """Queue of sounds. Not thread safe.

    A tick plays only if nothing else waits; other sounds keep their order.

    Args:
        max_age: [s] a sound that waited longer is dropped: it would report something that is over.
        most: maximum number of waiting sounds; the oldest are dropped.
    """

    def __init__(self, max_age: float, most: int = 4) -> None:
        self._max_age = max_age
        self._waiting: Deque[Tuple[str, float]] = deque(maxlen=most)

    def add(self, name: str, now: float) -> bool:
        """Takes a sound at a time [s] of a steady clock; False if it will not be played."""
        if name not in SOUNDS:
            return False
        if name == TICK:
            if self._waiting:
                return False
        elif self._waiting and self._waiting[0][0] == TICK:
            self._waiting.popleft()
        self._waiting.append((name, now))
        return True

    def take(self, now: float) -> Optional[str]:
        """The next sound to play; None if there is none."""
        while self._waiting:
            name, since = self._waiting.popleft()
            if now - since <= self._max_age:
                return name
        return None
