"""Drawn examples: settings, and numbers."""

import math

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

# the same examples whenever the same code runs, however busy the computer
STEADY = settings(derandomize=True, suppress_health_check=list(HealthCheck))

_STEP = 1e-4 * math.pi


def off_thresholds(low, high):
    """Draws numbers between two bounds, none of which equals a decimal, nor does a difference of two but 0.

    Where a rule compares a measured number with a threshold, a number on it would leave the decision to rounding.
    """
    return st.integers(math.ceil(low / _STEP), math.floor(high / _STEP) - 1).map(lambda number: (number + 0.5) * _STEP)
