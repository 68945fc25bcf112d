"""Where the spot that was confirmed last can be by now."""
from __future__ import annotations

import math
from typing import Optional, Tuple

from vb_laser_detect.tracker import SLACK_PX

_MOVED_PX = 8.0  # a spot that is held still does not leave a place so far
_HELD_S = 0.6  # [s] a hand that draws leaves such a place sooner


class FollowedSpot:
    """The last confirmed spot of a camera, in pixels.

    Attributes:
        diagonal: [px] of the image; half of it per second is how fast a spot can be.
        last: u, v [px] and stamp [s]; None before the first one.
    """

    def __init__(self) -> None:
        self.diagonal = 0.0
        self.last: Optional[Tuple[float, float, float]] = None
        self._held_at: Optional[Tuple[float, float, float]] = None  # where it was when it last began to stay, and since when

    def forget(self) -> None:
        """Nothing is followed any more."""
        self.last = self._held_at = None

    def see(self, u: float, v: float, stamp: float) -> None:
        """Takes in a confirmed spot."""
        jumped = self.last is None or math.hypot(u - self.last[0], v - self.last[1]) > self.gate(stamp)
        self.last = (u, v, stamp)
        if jumped:
            self._held_at = (u, v, -math.inf)  # another one, which has not moved yet
        elif math.hypot(u - self._held_at[0], v - self._held_at[1]) > _MOVED_PX:
            self._held_at = self.last

    def gate(self, stamp: float) -> float:
        """[px] how far it can have moved until a time [s]."""
        return SLACK_PX + 0.5 * self.diagonal * (stamp - self.last[2])

    def reaches(self, u: float, v: float, stamp: float, max_gap_s: float, share: float = 1.0) -> bool:
        """Whether it can be at a place [px] at a time [s], or within a share of the distance that it can go.

        False if it was not seen for longer than `max_gap_s`: then it is as good as a new one.
        """
        if self.last is None or stamp - self.last[2] > max_gap_s:
            return False
        return math.hypot(u - self.last[0], v - self.last[1]) <= share * self.gate(stamp)

    def moves(self) -> bool:
        """Whether it was drawn with when it was last seen; what is laid down, or shines by itself, stays where it is."""
        return self.last is not None and self._held_at is not None and self.last[2] - self._held_at[2] < _HELD_S
