"""Limits the rate of requests."""

from __future__ import annotations

from typing import Dict, Tuple


class RateLimiter:
    """A token bucket per key: `burst` requests at once, then `rate` a second. Keeps the 1000 keys that were used last.

    No bucket is shared by all keys, because strangers could empty it for everybody.
    """

    def __init__(self, rate: float, burst: float) -> None:
        self._rate, self._burst = rate, burst
        self._buckets: Dict[str, Tuple[float, float]] = {}  # the key used last comes last

    def allows(self, key: str, now: float) -> bool:
        """Takes a token at a time [s]. Returns False if there is none. A clock set back only delays new tokens."""
        tokens, refilled_at = self._buckets.pop(key, (self._burst, now))
        tokens = min(self._burst, tokens + self._rate * max(0.0, now - refilled_at))
        taken = 1.0 if tokens >= 1.0 else 0.0
        self._buckets[key] = (tokens - taken, now)
        while len(self._buckets) > 1000:
            del self._buckets[next(iter(self._buckets))]
        return taken > 0.0
