"""Where the spot that was confirmed last can be by now."""
from __future__ import annotations

import math
from typing import Optional, Tuple

from vb_laser_detect.appearance import Region
from vb_laser_detect.tracker import SLACK_PX

_MOVED_PX = 8.0  # a spot that is held still does not leave a place so far
_HELD_S = 0.6  # [s] a hand that draws leaves such a place sooner
_TRUST_S = 0.5  # [s] for so long a spot is followed through what it cannot be measured well in


class FollowedSpot:
    """The last confirmed spot of a camera, in pixels.

    Attributes:
        diagonal: [px] of the image; half of it per second is how fast a spot can be.
        now: [s] stamp of the image that is searched.
        max_gap_s: [s] what was not seen for so long is as good as a new one.
        last: u, v [px] and stamp [s]; None before the first one.
    """

    def __init__(self, max_gap_s: float) -> None:
        self.diagonal, self.now, self.max_gap_s = 0.0, 0.0, max_gap_s
        self.last: Optional[Tuple[float, float, float]] = None
        self._speed = (0.0, 0.0)  # [px/s]
        self._certain_s = -math.inf  # [s] stamp of the last one that was certain
        self._held_at: Optional[Tuple[float, float, float]] = None  # where it last began to stay, and since when

    def see(self, u: float, v: float, certain: bool = True) -> None:
        """Takes in the image's confirmed spot; see `Candidate.certain`."""
        if certain:
            self._certain_s = self.now
        elapsed = self.now - self.last[2] if self.last is not None else 0.0
        jumped = self.last is None or math.hypot(u - self.last[0], v - self.last[1]) > self.gate()
        if jumped or elapsed <= 0:
            self._speed = (0.0, 0.0)
        else:
            self._speed = ((u - self.last[0]) / elapsed, (v - self.last[1]) / elapsed)
        self.last = (u, v, self.now)
        if jumped:
            self._held_at = (u, v, -math.inf)  # another one, which has not moved yet
        elif math.hypot(u - self._held_at[0], v - self._held_at[1]) > _MOVED_PX:
            self._held_at = self.last

    def gate(self) -> float:
        """[px] how far it can have moved since it was seen."""
        return SLACK_PX + 0.5 * self.diagonal * (self.now - self.last[2])

    def reaches(self, u: float, v: float) -> bool:
        """Whether it can be at a place [px] by now, however a hand may have moved it."""
        return self._recent() and math.hypot(u - self.last[0], v - self.last[1]) <= self.gate()

    def trusted(self) -> bool:
        """Whether it was measured well a short time ago."""
        return self.last is not None and self.now - self._certain_s <= _TRUST_S

    def expected_at(self, u: float, v: float) -> bool:
        """Whether it is about at a place [px] by now if it went on as it did."""
        if not self._recent():
            return False
        ahead_u, ahead_v, reach = self._expected()
        return math.hypot(u - ahead_u, v - ahead_v) <= reach

    def expected_in(self, region: Region) -> Optional[Region]:
        """The part of a region where it is by now if it went on as it did; None if it is none of that."""
        if not self._recent():
            return None
        u, v, reach = self._expected()
        left, top = max(region[0], int(u - reach)), max(region[1], int(v - reach))
        right, bottom = min(region[2], int(u + reach) + 1), min(region[3], int(v + reach) + 1)
        return (left, top, right, bottom) if left < right and top < bottom else None

    def _recent(self) -> bool:
        return self.last is not None and self.now - self.last[2] <= self.max_gap_s

    def _expected(self) -> Tuple[float, float, float]:
        elapsed = self.now - self.last[2]
        reach = SLACK_PX + 0.5 * elapsed * math.hypot(*self._speed)
        return self.last[0] + self._speed[0] * elapsed, self.last[1] + self._speed[1] * elapsed, reach

    def moves(self) -> bool:
        """Whether it was drawn with when it was last seen; what is laid down, or shines by itself, stays."""
        return self.last is not None and self._held_at is not None and self.last[2] - self._held_at[2] < _HELD_S
