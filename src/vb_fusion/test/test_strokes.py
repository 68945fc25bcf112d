"""Which clusters are the pointer's, as strokes: cases by hand, and random ones against plain loops and full search."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from examples import STEADY, off_thresholds, rows
from vb_fusion.observations import LOCALIZATION_ERROR, TIME_BIN, TREMOR, Observations, observe
from vb_fusion.strokes import LOOK_BACK, UNSEEN_SPEED
from vb_fusion.strokes import divide_track, find_best_track, find_observations_near, floor_gains

UNIT = off_thresholds(0.0, 1.0)


def track(points, times, mobile=False):
    """Returns a cluster of one spot at each point and time."""
    ones = np.ones(len(times), int)
    return Observations(points, times, ones, ones, ones, np.full(len(times), mobile), ones, ones)


# ----------------------------------------------------------------- the floor that each cluster adds
PLACES = np.repeat(np.arange(24), 3)
QUICK = [3.0, 3.1, 3.2]
DRIFT = (
    1.0 - 12.0 * 1.84 * (0.01 / 0.1) ** 2
)  # at 0.01 m/s, where bilinear shares give the times a variance of 1.84 s^2
GAINS = {  # x and y [m], times [s], which of these clusters, and the floor [m] that it adds if a dropout lasts 1 s
    "alone": ([0.03], 0.06, [0.0], 0, 0.05),
    # a width is shared by 1 / 1.5 of the clusters around it, or by two
    "ten in each width, at a node": (0.01 * np.arange(41), 0.0, [0.0] * 41, 20, 0.015),
    "ten in each width, between nodes": (0.01 * np.arange(41), 0.0, [0.0] * 41, 25, 0.0075),
    "three at each of many places": (0.2 * (PLACES // 3) - 0.47, 0.2 * (PLACES % 3) - 0.44, 0.0 * PLACES, 37, 0.05),
    # light that is there for longer than 2 s fades, unless it moves on
    "five within 4.1 s": ([0.0] * 5, 0.0, np.arange(5.0), 2, 0.03 * (2.0 / 4.1) ** 2),
    "three within 2.1 s, as pauses count for 1 s": ([0.0] * 3, 0.0, [0.0, 9.0, 22.0], 2, 0.05 * (2.0 / 2.1) ** 2),
    "drift along x": (0.03 + 0.01 * np.arange(5), 0.05, np.arange(5.0), 2, 0.03 * (2.0 / (4.1 * DRIFT)) ** 2),
    "drift along y": (0.05, 0.03 + 0.01 * np.arange(5), np.arange(5.0), 2, 0.03 * (2.0 / (4.1 * DRIFT)) ** 2),
    "slow hand": (0.01 * np.arange(101), 0.05, 0.2 * np.arange(101), 50, 0.02),
    # three places passed at one speed add half of the way but a tremor; their ends half of that
    "quick hand": ([0.0, 0.5, 1.0], 0.0, QUICK, 1, 0.45),
    "quick hand's begin and end": (0.7, [0.3, 0.8, 1.3], QUICK, [0, 2], 0.225),
    "quick hand beyond a stray": ([0.0, 0.2, 0.5, 1.0], [0.0, 0.6, 0.0, 0.0], [0.0, 0.05, 0.1, 0.2], 2, 0.45),
    "quick hand before a stray": ([0.0, 0.5, 0.7, 1.0], [0.0, 0.0, 0.6, 0.0], [0.0, 0.1, 0.15, 0.2], 1, 0.45),
    "among strays": ([1.0, 1.2, 1.5, 1.7, 2.0], [2.0, 2.6, 2.0, 2.6, 2.0], 0.05 * np.arange(5), 2, 0.45),
    "beside the straight line": ([0.0, 0.5, 1.0], [0.0, 0.15, 0.0], QUICK, 1, 0.45 / math.e),
    "beside a short straight line": ([0.0, 0.15, 0.3], [0.0, 0.02, 0.0], QUICK, 1, 0.1 * math.exp(-0.16)),
    "a quarter of the way": ([0.0, 0.25, 1.0], 0.0, [0.0, 0.05, 0.2], 1, 0.75 * 0.45),
    "faster than any hand": ([0.0, 0.65, 1.3], 0.0, QUICK, 1, 0.05),
    "after a dropout": ([0.0, 0.5, 1.0], 0.0, [0.0, 0.6, 1.2], 1, 0.05),
}


@pytest.mark.parametrize("x, y, times, cluster, gain", GAINS.values(), ids=list(GAINS))
def test_a_cluster_adds_floor(x, y, times, cluster, gain):
    points = np.column_stack(np.broadcast_arrays(x, y))
    assert floor_gains(points, np.array(times), 1.0)[cluster] == pytest.approx(gain, abs=1e-4)


# ----------------------------------------------------------------- the track and its strokes
@settings(STEADY, max_examples=80)
@given(
    rows(st.floats(0, 2), st.floats(0, 2), st.sampled_from([0.0, 0.1, 0.7]), st.floats(0, 0.2), least=0, most=25),
    st.sampled_from([0.05, 1.0]),
)
def test_the_best_track_equals_an_exhaustive_search(clusters, free_jump):
    x, y, pauses, gains = np.array([*clusters, (1.0, 1.0, 0.1, 0.1)]).T
    points, times = np.column_stack([x, y]), np.cumsum(pauses)

    def step_cost(start, end):
        time = times[end] - times[start]
        if time <= 0.0 or end - start > LOOK_BACK:
            return math.inf
        effort = max(math.dist(points[start], points[end]) - TREMOR, 0.0) ** 2
        return free_jump * math.log1p(effort / (min(time, 0.4) * UNSEEN_SPEED) / free_jump)

    totals = []  # gain less cost of the best track that ends at each cluster
    for end, gain in enumerate(gains):
        totals.append(gain + max([0.0, *(totals[start] - step_cost(start, end) for start in range(end))]))
    for count in range(1, len(points) + 1):
        track, total = find_best_track(points[:count], times[:count], 0.4, gains[:count], free_jump)
        assert total == pytest.approx(max(totals[:count]))
        steps = zip(track[:-1], track[1:])
        assert gains[track].sum() - sum(step_cost(*step) for step in steps) == pytest.approx(total)


@settings(STEADY, max_examples=60)
@given(rows(UNIT, UNIT, off_thresholds(0.0, 1.5), most=25), st.booleans())
def test_what_lies_beside_a_line_at_its_time_is_the_pointers(spots, line_is_mobile):
    """For a line along x, from 0 m at 0.2 s to 1 m at 1.2 s; a robot's may be off by LOCALIZATION_ERROR more."""
    line = np.column_stack([np.linspace(0.0, 1.0, 11), np.full(11, 0.5)])
    pointer = track(line, np.linspace(0.2, 1.2, 11), line_is_mobile)
    seen, _ = observe(np.array(spots)[:, :2], np.array(spots)[:, 2])
    found = set(find_observations_near(seen, pointer).tolist())
    reach = 2.0 * TREMOR + LOCALIZATION_ERROR * line_is_mobile
    for index, ((x, y), time) in enumerate(zip(seen.points, seen.stamps)):
        pointer_x = min(max(time - 0.2, 0.0), 1.0)
        distance = math.hypot(x - pointer_x, y - 0.5)
        assume(abs(distance - reach) > 1e-6 and min(abs(time - 0.2 + TIME_BIN), abs(time - 1.2 - TIME_BIN)) > 1e-6)
        assert (index in found) == (0.2 - TIME_BIN <= time < 1.2 + TIME_BIN and distance <= reach)


DIVISIONS = {  # parts of a track, see `lay_out`; the clusters of each stroke and of each glint
    "glints round the line": ([(4,), (5, 0.5, 0.9), (2, 0.5, 0.9)], [range(4, 9)], [range(4), range(9, 11)]),
    "strays round the line": ([(1,), (5, 0.5, 0.9), (1, 0.5, 0.9)], [range(1, 6)], []),
    "one cluster": ([(1,)], [range(1)], []),
    "only glints": ([(4,), (4, 0.5, 0.9)], [], [range(4), range(4, 8)]),
    "quick hand": ([(5,), (2, 0.5), (5, 0.5), (2, 0.5)], [range(14)], []),
    "quick hand's begin, stray at the end": ([(2,), (5, 0.5), (1, 0.5, 0.9)], [range(7)], []),
    "glint between two strokes": ([(5,), (2, 0.2, 0.9), (5, 0.3, 0.9)], [range(5), range(7, 12)], []),
    "glints before a pause": ([(5,), (2, 0.5), (3, 0.5), (5, 0.5, 0.9)], [range(5), range(10, 15)], []),
    "glints after a pause": ([(5,), (2, 0.5, 0.9), (3, 0.5), (5, 0.5)], [range(5), range(10, 15)], []),
    "after one of two": ([(1,), (2, 0.5, 0.9), (5, 0.5), (5, 0.5, 0.9)], [range(3, 8), range(8, 13)], [range(1, 3)]),
    "bridged gap": ([(5,), (5, 0.45, 0.9)], [range(10)], []),
    "wide gap, quick end": ([(5,), (5, 0.5, 0.9), (2, 0.5)], [range(5), range(5, 12)], []),
    "pause without a step": ([(3,), (3, 0.08, 0.9)], [range(6)], []),
    "pause over covered floor": ([(4, 0.0, 0.1, 0.2), (5, 0.45, 0.9, 0.2)], [range(4, 9)], [range(4)]),
    "over floor": ([(4,), (4, 0.2, 0.1, 0.15), (4, 0.4, 0.1, 0.2), (5, 0.5, 0.9)], [range(12), range(12, 17)], []),
    "step over more": (
        [(4, 0.0, 0.1, 0.1), (4, 0.45, 0.1, 0.2), (5, 0.5, 0.9)],
        [range(8, 13)],
        [range(4), range(4, 8)],
    ),
}


def lay_out(count, step=0.0, wait=0.1, covered=0.0):
    """Returns the steps [m], waits [s] and floor [m] of some clusters 0.05 m apart, from the step to the first on."""
    return [step] + (count - 1) * [0.05], [wait] + (count - 1) * [0.1], count * [covered]


@pytest.mark.parametrize("parts, strokes, glints", DIVISIONS.values(), ids=list(DIVISIONS))
def test_a_track_is_divided_into_strokes_and_glints(parts, strokes, glints):
    steps, waits, floor = (np.concatenate(column) for column in zip(*(lay_out(*part) for part in parts)))
    points = np.column_stack([np.cumsum(steps), 0.0 * steps])
    found = divide_track(track(points, np.cumsum(waits)), floor, 0.5, 0.475)
    expected = [list(stroke) for stroke in strokes], [list(glint) for glint in glints]
    assert tuple([clusters.tolist() for clusters in group] for group in found) == expected
