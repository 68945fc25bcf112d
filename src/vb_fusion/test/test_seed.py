"""extract_seed: the place where the hand dwelt."""
import numpy as np
import pytest

from vb_fusion.extraction import ExtractionError, extract_seed


def spots(count=60, at=(1.0, 2.0), spread=0.015, seed=0):
    return np.random.default_rng(seed).normal(at, spread, (count, 2))


def test_mean_of_a_steady_hand():
    assert np.linalg.norm(extract_seed(spots()) - [1, 2]) < 0.01


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_stray_spots_do_not_move_it(share):
    strays = np.random.default_rng(1).uniform(-4, 4, (int(60 * share), 2))
    assert np.linalg.norm(extract_seed(np.vstack([spots(), strays])) - [1, 2]) < 0.02


def test_the_way_there_does_not_move_it():
    way = np.linspace([0, 0], [1, 2], 60)
    points = np.vstack([way, spots(30)])
    assert np.linalg.norm(extract_seed(points, stamps=np.arange(90) / 25.0) - [1, 2]) < 0.03


def test_two_cameras_with_biases_give_the_middle():
    points = np.vstack([spots(at=(1.02, 2.0)), spots(at=(0.98, 2.0), seed=1)])
    assert np.linalg.norm(extract_seed(points) - [1, 2]) < 0.015


def test_of_two_places_the_later_one():
    points = np.vstack([spots(at=(0.0, 0.0)), spots(at=(1.0, 2.0), seed=1)])
    assert np.linalg.norm(extract_seed(points, stamps=np.arange(120) / 25.0) - [1, 2]) < 0.02
    assert np.linalg.norm(extract_seed(points, stamps=-np.arange(120) / 25.0)) < 0.02


@pytest.mark.parametrize(
    "points, code",
    [([], "no_spots"), ([[np.nan, 1]], "no_spots"), ([[0, 0]], "no_seed"), (np.zeros(3), "bad_points")],
)
def test_refusals(points, code):
    with pytest.raises(ExtractionError) as caught:
        extract_seed(points)
    assert caught.value.code == code


def test_equal_points():
    assert extract_seed(np.ones((10, 2))) == pytest.approx([1, 1])
