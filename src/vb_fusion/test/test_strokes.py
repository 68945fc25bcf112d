"""Stages of the extraction against oracles: the same rules, written a second time with plain loops."""

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from examples import STEADY, off_thresholds

from vb_core.geometry import chain_length
from vb_fusion import seed_point, strokes
from vb_fusion.polygonal_chain import Closure, classify_closure
from vb_fusion.observations import LOCALIZATION_ERROR, TIME_BIN, TREMOR, Observations, observe


def rows(*columns, least=1, most):
    """Makes a strategy for a table of these columns with `least` to `most` rows."""
    return st.lists(st.tuples(*columns), min_size=least, max_size=most)


# ----------------------------------------------------------------- closing
def closing_turn(points, lever):
    """Returns the degrees by which a line turns from its end over the gap to its start, directions over a lever [m]."""
    arc = [chain_length(points[: index + 1]) for index in range(len(points))]
    line = points @ [1.0, 1.0j]
    after_start, before_end = np.interp([lever, arc[-1] - lever], arc, line)
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
    elif gap and gap * closing_turn(kept, 0.1 * length) > 180.0 * width:
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


# ----------------------------------------------------------------- the pointer's track
# x and y [m], time [s], camera
SPOTS = rows(off_thresholds(0.0, 1.0), off_thresholds(0.0, 1.0), off_thresholds(0.0, 1.5), st.integers(0, 2), most=25)


def chained(group, values):
    """Splits a group of indices wherever their sorted values are more than a cluster's width apart."""
    ordered, parts = sorted(group, key=lambda index: values[index]), []
    for index in ordered:
        if not parts or values[index] - values[parts[-1][-1]] > strokes.CLUSTER_WIDTH:
            parts.append([])
        parts[-1].append(index)
    return parts


@settings(STEADY, max_examples=80)
@given(SPOTS)
def test_what_is_near_each_other_in_a_time_bin_is_one_cluster(spots):
    x, y, times, cameras = np.array(spots).T
    seen, found = observe(np.column_stack([x, y]), times, cameras.astype(int), None, cameras == 2)
    bins = seen.time_bins
    places = [np.flatnonzero(bins == number) for number in np.unique(bins)]
    for axis in (0, 1, 0):
        places = [part for group in places for part in chained(group, seen.points[:, axis])]
    # of more in one bin, only the strongest are kept, as the next test shows
    assume(max(Counter(bins[place[0]] for place in places).values()) <= strokes.MAX_SIMULTANEOUS_CLUSTERS)
    assert len(found.points) == len(places)
    wanted = sorted(
        (
            *np.average(seen.points[place], axis=0, weights=seen.weights[place]),
            np.average(seen.stamps[place], weights=seen.weights[place]),
            len(set(seen.cameras[place].tolist())),
            all(seen.mobile[place].tolist()),
        )
        for place in places
    )
    columns = (*found.points.T, found.stamps, found.witnesses, found.mobile)
    assert np.allclose(sorted(zip(*(column.tolist() for column in columns))), wanted)
    assert (np.diff(found.stamps) >= 0).all()


def test_of_one_moment_the_ten_strongest_places_are_kept():
    points = np.column_stack([np.arange(14.0), np.zeros(14)])
    strong = np.arange(14) % 7 + 1.0
    _, found = observe(points, np.zeros(14), None, strong / 10.0)
    kept = sorted(np.lexsort((points[:, 0], -strong))[:10])
    assert np.allclose(np.sort(found.points[:, 0]), kept)


@settings(STEADY, max_examples=60)
@given(rows(off_thresholds(0.0, 0.6), off_thresholds(0.0, 0.6), off_thresholds(0.02, 0.2), most=14))
def test_clusters_passed_at_one_speed_add_the_floor_between_them(steps):
    points, times = np.cumsum(np.array(steps)[:, :2], axis=0), np.cumsum(np.array(steps)[:, 2])
    expected, dropout = np.zeros(len(points)), 0.35
    for middle in range(len(points)):
        for first, last in ((middle - back, middle + ahead) for back in (1, 2) for ahead in (1, 2)):
            if first < 0 or last >= len(points):
                continue
            duration, length = times[last] - times[first], math.dist(points[first], points[last])
            if duration > dropout or length > 6.0 * duration:
                continue
            share = (times[middle] - times[first]) / duration
            offset = math.dist(points[first] + share * (points[last] - points[first]), points[middle])
            floor = max(0.5 * length - TREMOR, 0.0) * 4.0 * share * (1.0 - share)
            floor *= math.exp(-((offset / max(0.15 * length, TREMOR)) ** 2))
            for cluster, weight in ((first, 0.5), (middle, 1.0), (last, 0.5)):
                expected[cluster] = max(expected[cluster], weight * floor)
    assert strokes._swept(points, times, dropout) == pytest.approx(expected)


def track(points, times, mobile=False):
    """Returns a cluster of one spot at each point and time."""
    ones = np.ones(len(times), int)
    return Observations(points, times, ones, ones, ones, np.full(len(times), mobile), ones, ones)


@settings(STEADY, max_examples=60)
@given(SPOTS, st.booleans())
def test_what_lies_beside_a_line_at_its_time_is_the_pointers(spots, line_is_mobile):
    """For a line along x, from 0 m at 0.2 s to 1 m at 1.2 s; a robot's may be off by LOCALIZATION_ERROR more."""
    line = np.column_stack([np.linspace(0.0, 1.0, 11), np.full(11, 0.5)])
    pointer = track(line, np.linspace(0.2, 1.2, 11), line_is_mobile)
    seen, _ = observe(np.array(spots)[:, :2], np.array(spots)[:, 2])
    found = set(strokes._observations_near(seen, pointer).tolist())
    reach = 2.0 * TREMOR + LOCALIZATION_ERROR * line_is_mobile
    for index, ((x, y), time) in enumerate(zip(seen.points, seen.stamps)):
        pointer_x = min(max(time - 0.2, 0.0), 1.0)
        distance = math.hypot(x - pointer_x, y - 0.5)
        assume(abs(distance - reach) > 1e-6 and min(abs(time - 0.2 + TIME_BIN), abs(time - 1.2 - TIME_BIN)) > 1e-6)
        assert (index in found) == (0.2 - TIME_BIN <= time < 1.2 + TIME_BIN and distance <= reach)


@settings(STEADY, max_examples=150)
@given(rows(st.integers(1, 7), st.sampled_from([0.08, 0.3, 0.5, 0.6]), st.booleans(), st.booleans(), most=7))
def test_short_pieces_beside_a_pause_and_unseen_step_are_dropped(pieces):
    """Pieces: (places, [m] from the piece before, whether after a pause, whether its floor covers the step)."""
    counts, ways, pauses, wide = (np.array(column) for column in zip(*pieces))
    begin, number = np.cumsum(counts) - counts, np.repeat(np.arange(len(counts)), counts)
    steps, waits, floor = np.full(len(number), 0.05), np.full(len(number), 0.1), np.repeat(0.3 * wide, counts)
    steps[begin], waits[begin] = ways, np.where(pauses, 0.9, 0.1)
    x, times = np.cumsum(steps), np.cumsum(waits)
    # the longest step that leaves no unseen part: a place's width, plus the floor of both sides if there was no pause
    reach = 0.1 + np.where(pauses, 0.0, floor[begin - 1] + floor[begin])
    parted = ways > reach
    parted[0] = False
    piece = np.cumsum(parted)[number]
    run = np.cumsum(parted & pauses)[number]
    length = np.bincount(piece)
    kept = []
    for place in range(len(x)):
        there = run == run[place]
        ahead, behind = (length[piece[there & side]].max() for side in (piece <= piece[place], piece >= piece[place]))
        stray = (ahead < 5 and run[place] > 0) or (behind < 5 and run[place] < run[-1])
        kept += [] if stray else [place]
    wanted = []
    for place in kept:
        before = wanted[-1][-1] if wanted else place
        if not wanted or (run[place] != run[before] and x[place] - x[before] > 0.475):
            wanted.append([])
        wanted[-1].append(place)
    found, glints = strokes._divide(track(np.column_stack([x, 0.0 * x]), times), floor, 0.5, 0.475)
    assert [stroke.tolist() for stroke in found] == wanted
    outside = [place for place in range(len(x)) if not kept or place < kept[0] or place > kept[-1]]
    assert np.concatenate([[], *glints]).tolist() == [place for place in outside if length[piece[place]] > 1]


def seen_within(size, least):
    """Makes a strategy for clusters in a square of this size [m], at least so many: (x, y, pause [s])."""
    return rows(off_thresholds(0.0, size), off_thresholds(0.0, size), off_thresholds(0.0, 0.6), least=least, most=40)


@settings(STEADY, max_examples=100)
@given(seen_within(0.4, 1) | seen_within(0.15, 12), st.sampled_from([0.3, 1.0]))
def test_clusters_share_the_floor_they_add_and_standing_light_fades(steps, dropout):
    points, times = np.array(steps)[:, :2], np.cumsum(np.array(steps)[:, 2])
    nodes = {}  # the places around each node of a lattice, with their bilinear weights
    for place, (x, y) in enumerate(points / strokes.CLUSTER_WIDTH):
        for i, j in ((math.floor(x) + dx, math.floor(y) + dy) for dx in (0, 1) for dy in (0, 1)):
            nodes.setdefault((i, j), {})[place] = (1.0 - abs(x - i)) * (1.0 - abs(y - j))
    still, moved = {}, {}
    for node, there in nodes.items():
        seen, shares = times[list(there)], np.array(list(there.values()))
        stay = TIME_BIN + np.minimum(np.diff(seen), dropout).sum()
        off = seen - np.average(seen, weights=np.maximum(shares, 1e-12))
        deviations = [shares @ (off * values) for values in (off, *points[list(there)].T)]
        duration = math.sqrt(12.0 / shares.sum() / deviations[0]) if deviations[0] > 1e-6 else 0.0
        moved[node] = min(1.0, (duration * math.hypot(*deviations[1:]) / strokes.CLUSTER_WIDTH) ** 2)
        assume(deviations[0] > 1e-6 or deviations[0] < 1e-12)
        still[node] = stay * (1.0 - moved[node])
    swept = strokes._swept(points, times, dropout)
    found = strokes.floor_gains(points, times, dropout)
    for place in range(len(points)):
        about = [there for there in nodes.values() if place in there]
        company = sum(there[place] * sum(there.values()) for there in about) / sum(there[place] ** 2 for there in about)
        stay = max(still[node] for node, there in nodes.items() if place in there)
        moving = sum(there[place] * moved[node] for node, there in nodes.items() if place in there)
        gain = max(strokes.CLUSTER_WIDTH / max(company / 1.5, 2.0), strokes.MIN_GAIN * moving, swept[place])
        assert found[place] == pytest.approx(gain * min(1.0, 2.0 / max(stay, 0.1)) ** 2, abs=2e-4)


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
        if time <= 0.0 or end - start > strokes.LOOK_BACK:
            return math.inf
        effort = max(math.dist(points[start], points[end]) - TREMOR, 0.0) ** 2
        return free_jump * math.log1p(effort / (min(time, 0.4) * strokes.UNSEEN_SPEED) / free_jump)

    totals = []  # gain less cost of the best track that ends at each cluster
    for end, gain in enumerate(gains):
        totals.append(gain + max([0.0, *(totals[start] - step_cost(start, end) for start in range(end))]))
    for count in range(1, len(points) + 1):
        track, total = strokes.find_best_track(points[:count], times[:count], 0.4, gains[:count], free_jump)
        assert total == pytest.approx(max(totals[:count]))
        steps = zip(track[:-1], track[1:])
        assert gains[track].sum() - sum(step_cost(*step) for step in steps) == pytest.approx(total)


@settings(STEADY, max_examples=60)
@given(rows(st.integers(0, 3), st.integers(1, 9), most=60))
def test_light_stays_where_it_is_seen_again_within_half_a_second(steps):
    patch, bins = np.array([number for number, _ in steps]), np.cumsum([wait for _, wait in steps])
    stays = []  # lists of places
    for number in range(4):
        there = [place for place in range(len(patch)) if patch[place] == number]
        for before, place in zip([None, *there], there):
            if before is None or bins[place] - bins[before] > 5:
                stays.append([])
            stays[-1].append(place)
    held = [stay for stay in stays if len(stay) >= 7] or [max(stays, key=len)]
    wanted = [sum((stay for stay in held if patch[stay[0]] == number), []) for number in range(4)]
    found = [clusters.tolist() for clusters in seed_point._find_stays(patch, bins)]
    assert found == sorted(filter(None, wanted), key=lambda clusters: clusters[-1])


@settings(STEADY, max_examples=60)
@given(rows(off_thresholds(0.0, 0.4), off_thresholds(0.0, 0.4), most=30))
def test_a_floor_patch_is_as_wide_as_a_hand_that_holds_still(places):
    middles, wanted, counts = [], [], []
    for place in places:
        near = [number for number in range(len(middles)) if math.dist(middles[number], place) <= seed_point.HAND_RADIUS]
        if not near:
            near = [len(middles)]
            middles.append(place)
        wanted.append(min(near, key=lambda number: math.dist(middles[number], place)))
        counts.append(wanted[:-1].count(wanted[-1]))
    patch, earlier = seed_point._floor_patches(np.array(places))
    assert patch.tolist() == wanted
    assert earlier.tolist() == counts
