import numpy as np
import pytest
from hypothesis import given
from hypothesis.extra.numpy import arrays

from refusals import refused
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_evaluation import metrics

masks = arrays(bool, (6, 7))


@given(masks, masks)
def test_jaccard_is_the_share_of_common_cells(a, b):
    first = {tuple(cell) for cell in np.argwhere(a)}
    second = {tuple(cell) for cell in np.argwhere(b)}
    union = first | second
    expected = len(first & second) / len(union) if union else 1.0
    assert metrics.jaccard(a, b) == expected == metrics.jaccard(b, a)


def test_jaccard_needs_equal_shapes():
    with refused("bad_shape"):
        metrics.jaccard(np.ones((2, 3), bool), np.ones((3, 2), bool))


def test_only_free_cells_count_as_restricted():
    prior = GridMap(np.array([[0, 0, 100], [-1, 0, 20]], np.int8), 1.0)
    posterior = prior.with_data(np.array([[0, 100, 100], [100, 75, 100]], np.int8))
    assert metrics.restricted_cells(prior, posterior).tolist() == [[False, True, False], [False, False, True]]
    with pytest.raises(CodedError):
        metrics.restricted_cells(prior, GridMap(posterior.data, 0.5))


def test_a_path_crosses_what_lies_between_its_points():
    grid = GridMap(np.zeros((10, 10), np.int8), 0.1)
    region = np.zeros((10, 10), bool)
    region[5, 5] = True
    assert metrics.path_meets_region(np.array([[0.05, 0.55], [0.95, 0.55]]), grid, region)
    assert not metrics.path_meets_region(np.array([[0.05, 0.45], [0.95, 0.45]]), grid, region)
    assert not metrics.path_meets_region(np.zeros((0, 2)), grid, region)
    # a path that leaves the map is judged by its part on the map
    assert metrics.path_meets_region(np.array([[-3.0, 0.55], [3.0, 0.55]]), grid, region)


def test_boundary_error_of_a_line_that_is_moved_is_how_far():
    grid = GridMap(np.zeros((40, 60), np.int8), 0.025)
    truth, drawn = np.zeros(grid.shape, bool), np.zeros(grid.shape, bool)
    truth[:, :30], drawn[:, :34] = True, True
    error = metrics.boundary_error(grid, truth, drawn)
    assert (error.mean, error.p95, error.largest) == pytest.approx((0.1, 0.1, 0.1))
    assert metrics.boundary_error(grid, truth, truth).largest == 0.0
    assert metrics.boundary_error(grid, truth, np.zeros_like(truth)) is None


def test_boundary_error_counts_only_free_floor_and_both_directions():
    data = np.zeros((40, 60), np.int8)
    data[:20, 29:31] = 100  # a wall along half of the line
    grid = GridMap(data, 0.025)
    truth = np.zeros(grid.shape, bool)
    truth[:, :30] = True
    truth &= data == 0
    spot = truth.copy()
    spot[5, 50] = True  # one cell far away: seen only in the direction from the drawn boundary to the true one
    error = metrics.boundary_error(grid, truth, spot)
    assert error.largest > 0.5
    assert error.mean == pytest.approx(4 * error.largest / 44, rel=0.1)


def test_the_area_drawn_round_shows_what_the_rest_hides():
    floor = np.ones((40, 100), bool)
    truth = floor.copy()
    truth[:16, :20] = False  # everything but the corner is to be restricted
    drawn = floor.copy()
    drawn[:16, :15] = False
    assert metrics.jaccard(truth, drawn) > 0.97
    inside = [metrics.enclosed_cells(floor, cells, truth) for cells in (truth, drawn)]
    assert metrics.jaccard(*inside) == pytest.approx(15 / 20)
    # if the restricted part is the smaller one, nothing changes
    assert (metrics.enclosed_cells(floor, ~drawn, ~truth) == ~drawn).all()
