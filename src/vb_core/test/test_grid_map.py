import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from refusals import refused
from vb_core import geometry
from vb_core.errors import CodedError
from vb_core.grid_map import UNKNOWN, GridMap, distance_transform, sample


@given(st.floats(-20, 20), st.floats(-20, 20), st.floats(-math.pi, math.pi), st.floats(0.01, 1.0))
def test_cells_and_points_are_inverse(x, y, yaw, resolution):
    grid = GridMap(np.zeros((7, 11), np.int8), resolution, (x, y, yaw))
    cells = np.argwhere(np.ones(grid.shape, bool))
    # columns run along the x axis of the origin's frame, rows along its y axis
    in_frame = np.column_stack([resolution * (cells[:, ::-1] + 0.5), np.zeros(len(cells))])
    places = geometry.transform_points(geometry.transform_from_pose2d(x, y, yaw), in_frame)[:, :2]
    assert np.allclose(grid.cell_to_world(cells), places)
    assert (grid.world_to_cell(grid.cell_to_world(cells)) == cells).all()
    assert grid.contains_cells(cells).all()
    for beyond in ((-1, 0), (0, -1), (7, 0), (0, 11)):
        assert not grid.contains_cells([beyond]).any()


def test_row_zero_is_the_lowest_y():
    data = np.zeros((4, 3), np.int8)
    data[0, 2] = 100
    grid = GridMap(data.tolist(), 0.5, (-1.0, 2.0, 0.0))
    assert grid.data.dtype == np.int8
    assert sample(grid, grid.data, [[0.25, 2.25], [0.25, 2.75], [9.0, 9.0]], UNKNOWN).tolist() == [100, 0, UNKNOWN]
    assert np.allclose(grid.corners(), [[-1, 2], [0.5, 2], [0.5, 4], [-1, 4]])


def test_far_points_do_not_overflow():
    grid = GridMap(np.zeros((2, 2), np.int8), 0.05)
    assert not grid.contains_cells(grid.world_to_cell([[1e300, -1e300], [1e9, 1e9]])).any()


@pytest.mark.parametrize(
    "data, resolution, origin",
    [
        (np.zeros((0, 3), np.int8), 0.1, (0, 0, 0)),
        (np.zeros(5, np.int8), 0.1, (0, 0, 0)),
        (np.zeros((2, 2), np.int8), 0.0, (0, 0, 0)),
        (np.zeros((2, 2), np.int8), math.nan, (0, 0, 0)),
        (np.zeros((2, 2), np.int8), 0.1, (0, math.inf, 0)),
    ],
    ids=["no rows", "one dimension", "no resolution", "resolution NaN", "infinite origin"],
)
def test_impossible_maps_are_refused(data, resolution, origin):
    with refused("bad_map"):
        GridMap(data, resolution, origin)


def test_distances_are_exact_and_reproducible():
    rng = np.random.default_rng(4)
    marked = rng.random((31, 47)) < 0.01
    cells = np.argwhere(np.ones(marked.shape, bool))
    pairs = np.linalg.norm(cells[:, None] - np.argwhere(marked)[None], axis=2)
    expected = pairs.min(axis=1).reshape(marked.shape).astype(np.float32)
    ballast = []
    for size in rng.integers(1, 5000, 500):  # shifts the rows to other memory addresses
        ballast = ballast[-20:] + [np.empty(size, np.uint8)]
        assert (distance_transform(marked) == expected).all()


def test_distances_are_infinite_if_nothing_is_marked():
    assert np.isinf(distance_transform(np.zeros((3, 4), bool))).all()


def test_geometries_differ_by_resolution_size_and_origin():
    cells = np.zeros((4, 5), np.int8)
    first = GridMap(cells, 0.05, (1.0, 2.0, 0.0))
    assert first.same_geometry(first.with_data(cells + 1))
    with pytest.raises(CodedError):
        first.with_data(cells.T)
    assert not first.same_geometry(GridMap(cells[:3], 0.05, first.origin))
    for resolution, origin in ((0.025, (1.0, 2.0, 0.0)), (0.05, (1.0, 2.05, 0.0)), (0.05, (1.0, 2.0, 0.1))):
        assert not first.same_geometry(GridMap(cells, resolution, origin))
    # points one cell apart stay one cell apart in grid coordinates
    assert np.ptp(first.world_to_grid([[1.0, 2.0], [1.05, 2.0]]), axis=0) == pytest.approx([1.0, 0.0])
