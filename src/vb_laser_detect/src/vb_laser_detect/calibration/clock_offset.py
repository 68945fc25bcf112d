"""Measures how far another computer's clock is from this one's, by NTP's exchange of times (RFC 5905, Sect. 8)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence, Tuple

from vb_core.errors import CodedError

# request sent (here), request received (there), answer sent (there), answer received (here) [s]
Exchange = Tuple[float, float, float, float]


@dataclass(frozen=True)
class ClockOffset:
    """The other clock minus this one.

    Attributes:
        offset: [s] positive if the other clock is ahead.
        uncertainty: [s] the truth is not farther than this from `offset`, however the delays there and back differ.
    """

    offset: float
    uncertainty: float

    def exceeds(self, limit: float) -> bool:
        """Returns whether the clocks are certainly farther apart than a limit [s]."""
        return abs(self.offset) - self.uncertainty > limit


def estimate_clock_offset(samples: Sequence[Exchange]) -> ClockOffset:
    """Estimates the offset by the quickest exchange: network delays only add.

    Raises:
        CodedError: "no_clock_samples" without one that can be true.
    """
    found = []
    for sent, received, answered, returned in samples:
        delay = (returned - sent) - (answered - received)
        if returned >= sent and answered >= received and delay >= 0.0:
            found.append((delay, ((received - sent) + (answered - returned)) / 2.0))
    if not found:
        raise CodedError("no_clock_samples")
    delay, offset = min(found)
    return ClockOffset(offset, delay / 2.0)
