"""Drawn examples: settings, numbers, and values of any kind."""

import math

from hypothesis import HealthCheck, settings, strategies as st

# the same examples whenever the same code runs, however busy the computer
STEADY = settings(derandomize=True, suppress_health_check=list(HealthCheck))

# whatever JSON and YAML can hold
ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=8,
)

_STEP = 1e-4 * math.pi


def off_thresholds(low, high):
    """Draws numbers between two bounds, none of which equals a decimal, nor does a difference of two but 0.

    Where a rule compares a measured number with a threshold, a number on it would leave the decision to rounding.
    """
    return st.integers(math.ceil(low / _STEP), math.floor(high / _STEP) - 1).map(lambda number: (number + 0.5) * _STEP)


def rows(*columns, least=1, most):
    """Makes a strategy for a table of these columns with `least` to `most` rows."""
    return st.lists(st.tuples(*columns), min_size=least, max_size=most)
