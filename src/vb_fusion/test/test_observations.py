"""Spots become observations and clusters, against the rule written a second time with plain loops."""

from collections import Counter

import numpy as np
from hypothesis import assume, given, settings, strategies as st

from examples import STEADY, off_thresholds, rows
from vb_fusion.observations import CLUSTER_WIDTH, MAX_SIMULTANEOUS_CLUSTERS, observe


def split_at_gaps(group, values):
    """Splits a group of indices wherever their sorted values are more than a cluster's width apart."""
    ordered, parts = sorted(group, key=lambda index: values[index]), []
    for index in ordered:
        if not parts or values[index] - values[parts[-1][-1]] > CLUSTER_WIDTH:
            parts.append([])
        parts[-1].append(index)
    return parts


@settings(STEADY, max_examples=80)
@given(rows(off_thresholds(0.0, 1.0), off_thresholds(0.0, 1.0), off_thresholds(0.0, 1.5), st.integers(0, 2), most=25))
def test_what_is_near_each_other_in_a_time_bin_is_one_cluster(spots):
    x, y, times, cameras = np.array(spots).T
    seen, found = observe(np.column_stack([x, y]), times, cameras.astype(int), None, cameras == 2)
    bins = seen.time_bins
    places = [np.flatnonzero(bins == number) for number in np.unique(bins)]
    for axis in (0, 1, 0):
        places = [part for group in places for part in split_at_gaps(group, seen.points[:, axis])]
    # of more in one bin, only the strongest are kept, as the next test shows
    assume(max(Counter(bins[place[0]] for place in places).values()) <= MAX_SIMULTANEOUS_CLUSTERS)
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
