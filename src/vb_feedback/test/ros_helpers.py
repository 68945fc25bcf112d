"""Waiting with a deadline, for the rostests of this package."""

from __future__ import annotations

import time


def wait_until(condition, what: str, timeout: float = 120.0):
    """Waits for a condition; gives its first true value, or fails with what was waited for."""
    deadline = time.monotonic() + timeout
    while time.monotonic() < deadline:
        value = condition()
        if value:
            return value
        time.sleep(0.02)
    raise AssertionError(f"waited {timeout:g} s in vain for: {what}")
