"""What people are told when no camera sees where they point, and what comes of it."""
from __future__ import annotations

import enum
import math
from typing import Hashable, Optional

from vb_robot.sightings import LOST_AFTER

RENEWED_AFTER = 20.0  # [s] the same words again


class _Matter(enum.Enum):
    NONE = 0
    AHEAD = 1
    COMING = 2
    NOBODY = 3


class Notices:
    """Gives a sentence when the matter changes, and each not more often than needed."""

    def __init__(self) -> None:
        self._key: Hashable = None
        self._matter = _Matter.NONE
        self._said_at = {}

    def step(
        self, now: float, key: Hashable, silent: float, uncovered: bool, ahead: bool, comes: bool, able: bool, who: str
    ) -> Optional[str]:
        """The sentence that is due now, if any.

        Args:
            now: [s]; key: changes with interaction and state.
            silent: [s] since any camera saw the spot; 0 while none is expected.
            uncovered: whether it is known that no stationary camera sees where the spot probably is.
            ahead: whether the line leads to, or runs beside, floor that no stationary camera sees.
            comes: whether a robot is on its way or there; able: whether any robot could come; who: its name.
        """
        if key != self._key:
            self._key, self._matter = key, _Matter.NONE
            self._said_at.clear()
        matter = self._matter_of(silent, ahead, comes, able)
        if matter is self._matter:
            return None
        self._matter = matter
        if matter is _Matter.NONE or 0.0 <= now - self._said_at.get(matter, -math.inf) < RENEWED_AFTER:
            return None
        self._said_at[matter] = now
        if matter is _Matter.AHEAD:
            return f"No camera in the room sees the floor there: {who} comes to look"
        place = "Nobody can see this corner" if uncovered else "Nobody sees the spot"
        if matter is _Matter.COMING:
            return f"{place}: {who} comes to look, hold still"
        return f"{place}, and no robot can come: draw where a camera sees it"

    @staticmethod
    def _matter_of(silent: float, ahead: bool, comes: bool, able: bool) -> _Matter:
        if silent > LOST_AFTER:
            return _Matter.COMING if comes and able else _Matter.NOBODY
        return _Matter.AHEAD if ahead and comes else _Matter.NONE
