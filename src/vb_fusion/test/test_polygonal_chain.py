"""The decision whether a line is closed, against its rule written a second time with plain loops."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from examples import STEADY
from vb_core.geometry import chain_length
from vb_fusion.observations import TREMOR
from vb_fusion.polygonal_chain import Closure, classify_closure


def closing_turn(points, arc):
    """Returns the degrees by which a line turns from its end over the gap to its start, directions over a tenth of it."""
    line, lever = points @ [1.0, 1.0j], 0.1 * (arc[-1] - arc[0])
    after_start, before_end = np.interp([arc[0] + lever, arc[-1] - lever], arc, line)
    directions = line[-1] - before_end, line[0] - line[-1], after_start - line[0]
    return sum(abs(math.degrees(np.angle(b / a))) for a, b in zip(directions[:-1], directions[1:]))


def decide(points):
    """Decides whether a line is closed.

    Of a point in its first third and one in its last third, those are its ends for which the distance between them plus
    half the length beyond them is smallest. Then the line is open if this opening is wider than half of the figure, if
    the gap times the turn is wider than half a turn of the mean width, or if that width is less than a tremor.
    """
    arc = [chain_length(points[: index + 1]) for index in range(len(points))]
    whole, openings = arc[-1], {}
    for first in (index for index in range(len(points)) if arc[index] <= whole / 3.0):
        for last in (index for index in range(len(points)) if arc[index] >= whole / 1.5):
            beyond = arc[first] + whole - arc[last]
            openings[first, last] = math.dist(points[first], points[last]) + 0.5 * beyond
    (first, last), *others = sorted(openings, key=lambda ends: openings[ends])
    assume(not others or openings[others[0]] - openings[first, last] > 1e-9)
    kept = points[first : last + 1]
    gap, length, (x, y) = math.dist(kept[0], kept[-1]), chain_length(kept), kept.T
    width = abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))) / (length + gap)
    if openings[first, last] > 0.5 * max(math.dist(a, b) for a in kept for b in kept):
        code = "open_apart"
    elif gap and gap * closing_turn(kept, arc[first : last + 1]) > 180.0 * width:
        code = "open_wide"
    elif width < TREMOR:
        code = "open_flat"
    else:
        code = "closed_gap" if len(kept) == len(points) else "closed_trimmed"
        return Closure(True, code, gap, length, first, last)
    return Closure(False, code, math.dist(points[0], points[-1]), whole, 0, len(points) - 1)


@settings(STEADY, max_examples=150)
@given(
    st.floats(0.03, 1.0),
    st.floats(1.0, 8.0),
    st.floats(0.5, 1.1),
    st.floats(0.0, 6.3),
    st.floats(-0.2, 0.2),
    st.integers(4, 40),
)
def test_a_line_is_closed_as_the_rule_says(size, flatness, share, begin, spiral, count):
    """For parts of ellipses and spirals, flat to round, half a turn to more than a whole one."""
    angle = begin + 2.0 * math.pi * share * np.linspace(0.0, 1.0, count)
    radius = size * (1.0 + spiral * np.linspace(0.0, 1.0, count))
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle) / flatness])
    expected = decide(points)
    # for a figure that crosses itself, the sum of triangles is not its area
    assume(share <= 1.0 or expected.first > 0 or expected.last < count - 1)
    assume(np.ptp(angle[expected.first : expected.last + 1]) < 2.0 * math.pi)
    found = classify_closure(points)
    assert (found.gap, found.length) == pytest.approx((expected.gap, expected.length))
    assert replace(found, gap=expected.gap, length=expected.length) == expected


def test_a_triangle_of_four_points_is_closed():
    found = classify_closure(np.array([[0.0, 0.0], [2.0, 0.0], [1.0, 1.5], [0.1, 0.1]]))
    assert (found.closed, found.code, found.first, found.last) == (True, "closed_gap", 0, 3)


@pytest.mark.parametrize("points, percent", [([[1.0, 2.0], [4.0, 6.0]], "100"), ([[1.0, 2.0]] * 5, "0")])
def test_two_points_or_a_spot_are_open(points, percent):
    found = classify_closure(np.array(points))
    apart = math.dist(points[0], points[-1])
    assert found == Closure(False, "open_two_points", apart, apart, 0, len(points) - 1)
    assert found.values["percent"] == percent


def test_a_closures_values_are_rounded_for_its_sentence():
    closure = Closure(True, "closed_gap", gap=0.333, length=4.0, first=0, last=9)
    assert closure.values == {"gap": "0.33", "percent": "8", "length": "4.00"}
