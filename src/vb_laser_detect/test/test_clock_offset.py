"""Offsets of clocks from samples whose delays are known."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vb_core.errors import CodedError
from vb_laser_detect.calibration.clock_offset import ClockOffset, estimate_clock_offset


def exchange(offset, there, within, back, start=1000.0):
    return start, start + there + offset, start + there + within + offset, start + there + within + back


def test_equal_ways_give_the_exact_offset():
    found = estimate_clock_offset([exchange(0.05, 0.002, 0.001, 0.002)])
    assert found.offset == pytest.approx(0.05, abs=1e-9) and found.uncertainty == pytest.approx(0.002, abs=1e-9)
    assert found.exceeds(0.01) and not found.exceeds(0.05)
    assert not ClockOffset(0.011, 0.002).exceeds(0.01)  # it may be an effect of the way


@settings(deadline=None)
@given(offset=st.floats(-10, 10), there=st.floats(0, 0.1), within=st.floats(0, 0.1), back=st.floats(0, 0.1))
def test_the_truth_is_within_the_uncertainty(offset, there, within, back):
    found = estimate_clock_offset([exchange(offset, there, within, back)])
    assert abs(found.offset - offset) <= found.uncertainty + 1e-9


def test_the_quickest_exchange_counts():
    rng = random.Random(1)
    samples = [exchange(-0.02, 0.001 + rng.expovariate(50), 0.0, 0.001, 1000.0 + i) for i in range(20)]
    samples.append(exchange(-0.02, 0.0005, 0.0, 0.0005, 2000.0))
    assert estimate_clock_offset(samples).offset == pytest.approx(-0.02, abs=1e-9)


@pytest.mark.parametrize("samples", [[], [(10.0, 9.0, 9.5, 9.9)], [(10.0, 20.0, 19.0, 10.1)]])
def test_impossible_exchanges_are_refused(samples):
    with pytest.raises(CodedError) as raised:
        estimate_clock_offset(samples)
    assert raised.value.code == "no_clock_samples"
