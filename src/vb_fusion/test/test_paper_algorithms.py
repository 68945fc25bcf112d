"""Algorithms 1 to 3 and their speed-ups, against a literal transcription."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import paper_transcription as transcription
from refusals import refused
from vb_fusion.extraction import ExtractionParams, extract_border
from vb_fusion.paper_algorithms import dbscan, find_cluster, generate_polygon, thin_points

# multiples of 1/64 m are exact in binary: comparisons with a distance do not depend on how it is computed
coordinate = st.integers(-128, 128).map(lambda k: k / 64.0)
clouds = st.lists(st.tuples(coordinate, coordinate), min_size=1, max_size=60)
dense_coordinate = st.integers(-24, 24).map(lambda k: k / 64.0)
dense_clouds = st.lists(st.tuples(dense_coordinate, dense_coordinate), min_size=1, max_size=60)
SETTINGS = settings(max_examples=60, deadline=None)


@SETTINGS
@given(clouds, st.sampled_from([0.125, 0.25, 0.5]), st.integers(1, 6))
def test_dbscan_equals_the_definition(points, eps, min_pts):
    found = {frozenset(c.tolist()) for c in dbscan(np.array(points), eps, min_pts)}
    expected = transcription.dbscan(points, eps, min_pts)
    # a border point may be in reach of two clusters: compare only what the definition fixes
    cores = [i for i in range(len(points)) if sum(transcription.near(points[i], p, eps) for p in points) >= min_pts]
    assert {c & frozenset(cores) for c in found} == {frozenset(c) & frozenset(cores) for c in expected}
    assert set().union(*found) == set(sum(expected, []))


@SETTINGS
@given(clouds, st.integers(1, 12))
def test_clustering_equals_the_transcription(points, min_size):
    found = find_cluster(np.array(points), 0.25, 1, 0.3, min_size)
    assert found.tolist() == sorted(transcription.clustering(points, 0.25, 1, 0.3, min_size))


@SETTINGS
@given(dense_clouds)
def test_thinning_equals_the_transcription(points):
    found = thin_points(np.array(points), 0.1)
    expected = np.array(transcription.thinning(points, 0.1))
    assert found.shape == expected.shape
    assert np.allclose(found, expected, atol=1e-12)


@SETTINGS
@given(clouds)
def test_polygon_generation_equals_the_transcription(points):
    assert generate_polygon(np.array(points), 0.5).tolist() == transcription.generate_poly(points, 0.5)


@pytest.mark.parametrize("seed", range(4))
def test_whole_paper_mode_equals_the_transcription(seed):
    rng = np.random.default_rng(seed)
    s = rng.uniform(0, 4, 150)
    points = np.column_stack([np.interp(s, range(5), [0, 1, 1, 0, 0]), np.interp(s, range(5), [0, 0, 1, 1, 0])])
    points = np.vstack([points + rng.normal(0, 0.02, points.shape), rng.uniform(-4, 4, (15, 2))])
    everything = [tuple(p) for p in points]
    cluster = [everything[i] for i in sorted(transcription.clustering(everything, 0.5, 1, 0.3, 10))]
    thinned = transcription.thinning(cluster, 0.1)
    expected = np.array([thinned[i] for i in transcription.generate_poly(thinned, 0.5)])
    chain = extract_border(points, ExtractionParams(mode="paper")).points
    assert chain.shape == expected.shape
    assert np.allclose(chain, expected, atol=1e-9)


def test_points_with_too_many_neighbours_are_refused():
    points = np.random.default_rng(0).normal(0, 0.2, (12000, 2))
    with refused("too_many_spots"):
        extract_border(points, ExtractionParams(mode="paper"))
