import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from shapely.geometry import box

from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_evaluation import metrics

masks = arrays(bool, (6, 7))


@given(masks, masks)
def test_jaccard_against_sets(a, b):
    first = {tuple(cell) for cell in np.argwhere(a)}
    second = {tuple(cell) for cell in np.argwhere(b)}
    union = first | second
    expected = len(first & second) / len(union) if union else 1.0
    assert metrics.jaccard(a, b) == expected == metrics.jaccard(b, a)


def test_jaccard_of_two_boxes_is_that_of_their_areas():
    grid = np.indices((100, 100)).transpose(1, 2, 0)
    inside = lambda x1, y1, x2, y2: ((grid >= (y1, x1)) & (grid < (y2, x2))).all(axis=2)  # noqa: E731
    a, b = box(10, 10, 50, 60), box(20, 5, 70, 40)
    assert metrics.jaccard(inside(10, 10, 50, 60), inside(20, 5, 70, 40)) == pytest.approx(
        a.intersection(b).area / a.union(b).area
    )


def test_jaccard_needs_equal_shapes():
    with pytest.raises(CodedError) as caught:
        metrics.jaccard(np.ones((2, 3), bool), np.ones((3, 2), bool))
    assert caught.value.code == "bad_shape"


def test_only_free_cells_count_as_restricted():
    prior = GridMap(np.array([[0, 0, 100], [-1, 0, 20]], np.int8), 1.0)
    posterior = prior.with_data(np.array([[0, 100, 100], [100, 75, 100]], np.int8))
    expected = [[False, True, False], [False, False, True]]
    assert metrics.restricted_cells(prior, posterior).tolist() == expected
    with pytest.raises(CodedError):
        metrics.restricted_cells(prior, GridMap(posterior.data, 0.5))


def test_a_path_crosses_what_lies_between_its_points():
    grid = GridMap(np.zeros((10, 10), np.int8), 0.1)
    region = np.zeros((10, 10), bool)
    region[5, 5] = True
    assert metrics.crosses(np.array([[0.05, 0.55], [0.95, 0.55]]), grid, region)
    assert not metrics.crosses(np.array([[0.05, 0.45], [0.95, 0.45]]), grid, region)
    assert not metrics.crosses(np.zeros((0, 2)), grid, region)
    # a path that leaves the map is judged by what lies on it
    assert metrics.crosses(np.array([[-3.0, 0.55], [3.0, 0.55]]), grid, region)
