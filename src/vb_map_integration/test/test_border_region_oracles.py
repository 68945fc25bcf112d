"""Cells of borders, against oracles that examine every cell."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings, strategies as st
from scipy.ndimage import label

from examples import STEADY, off_thresholds
from refusals import refused
from vb_core.grid_map import GridMap
from vb_map_integration.border import VirtualBorder
from vb_map_integration.border_region import compute_region, polygon_mask
from vb_map_integration.open_chains import MAX_SEED_SHIFT, WALL_WIDTH, rasterize_chain
from vb_map_integration.restricted_cells import Region

# on cells' centres, edges and corners, and anywhere else
PLACE = st.tuples(*(st.integers(-24, 4 * end).map(lambda n: n / 4) | off_thresholds(-6.0, end) for end in (18, 14)))


def winding(vertices, shape):
    """Returns two (H, W) bool: cells whose centre a polygon winds round, and cells whose centre is on its outline."""
    rows, columns = np.indices(shape)
    ends = (np.array(vertices) @ [1, 1j])[:, None, None] - columns - 1j * rows
    turns = np.angle(np.roll(ends, -1, axis=0) * ends.conj())
    on_outline = (np.abs(ends) < 1e-6) | (np.abs(np.abs(turns) - math.pi) <= 1e-6)
    return np.abs(turns.sum(axis=0)) > 1.0, on_outline.any(axis=0)


@settings(STEADY, max_examples=80)
@given(st.lists(PLACE, min_size=3, max_size=7))
def test_a_polygons_cells_are_those_whose_centre_it_winds_round(vertices):
    shape, corners = (9, 12), np.array(vertices)
    window, mask = polygon_mask(corners, shape)
    cells = np.zeros(shape, bool)
    cells[window] = mask == 255
    assert set(np.unique(mask)) <= {0, 255}
    inside, on_outline = winding(corners, shape)
    assert ((cells == inside) | on_outline).all()  # a centre on the outline may be on either side


CHAINS = st.lists(PLACE, min_size=2, max_size=6).map(np.array)
SHAPE = (9, 12)  # of the map on which chains are traced


@settings(STEADY, max_examples=100)
@given(CHAINS)
def test_a_traced_point_is_on_its_segment_and_in_its_cell(chain):
    steps = np.hypot(*np.diff(chain, axis=0).T)
    assume(steps.min() > 1e-3)
    trace, arc = rasterize_chain(chain, SHAPE), np.concatenate([[0.0], np.cumsum(steps)])
    assert trace.points.shape == trace.cells.shape
    assert (np.diff(trace.arc) >= -1e-9).all()
    share = (trace.arc - arc[trace.segment]) / steps[trace.segment]
    assert np.allclose(trace.points, chain[trace.segment] + share[:, None] * np.diff(chain, axis=0)[trace.segment])
    assert ((share > -1e-9) & (share < 1.0 + 1e-9)).all()
    # in its cell, or beside the corner at which the chain crosses into the next one
    distances = np.abs(trace.points - trace.cells[:, ::-1]).max(axis=1, initial=0.0)
    is_inside = distances <= 0.5 + 1e-9
    assert (distances <= 1.5).all() and 2 * is_inside.sum() >= len(is_inside)


@settings(STEADY, max_examples=100)
@given(CHAINS)
def test_a_traced_chain_leaves_no_gap(chain):
    assume(np.hypot(*np.diff(chain, axis=0).T).min() > 1e-3)
    trace = rasterize_chain(chain, SHAPE)
    # every cell of the map that a densely sampled chain meets is traced, and none more than one cell off the map
    dense = np.vstack([a + np.linspace(0.0, 1.0, 800)[:, None] * (b - a) for a, b in zip(chain[:-1], chain[1:])])
    is_inner = np.abs(dense - np.round(dense)).max(axis=1) < 0.2  # not near corners, which the samples may miss
    met = {(row, column) for column, row in np.floor(dense[is_inner] + 0.5).astype(int).tolist()}
    traced = set(map(tuple, trace.cells.tolist()))
    assert {(row, column) for row, column in met if 0 <= row < 9 and 0 <= column < 12} <= traced
    assert all(-1 <= row <= 9 and -1 <= column <= 12 for row, column in traced)
    # successive cells share an edge, except where the chain was outside the map
    hops = np.abs(np.diff(trace.cells, axis=0)).sum(axis=1)
    is_on_map = ((trace.cells >= 0) & (trace.cells < SHAPE)).all(axis=1)
    assert not (is_on_map[:-1] & is_on_map[1:] & (hops == 2)).any()


@settings(STEADY, max_examples=60)
@given(
    st.lists(st.integers(-1, 100), min_size=12, max_size=12),
    st.lists(st.booleans(), min_size=12, max_size=12),
    st.integers(0, 100),
    st.booleans(),
)
def test_painting_raises_what_is_under_the_mask_and_lowers_nothing(cells, mask, value, covers_unknown):
    painted = np.array(cells, np.int8).reshape(3, 4)
    covered = 255 * np.array(mask, np.uint8).reshape(3, 4)
    Region((slice(0, 3), slice(0, 4)), covered, value, covers_unknown, 1.0).raise_cells(painted)
    wanted = [max(cell, value) if under and (cell >= 0 or covers_unknown) else cell for cell, under in zip(cells, mask)]
    assert painted.ravel().tolist() == wanted


@settings(STEADY, max_examples=40)
@given(st.lists(st.tuples(st.floats(-0.3, 1.8), st.floats(-0.3, 1.3)), min_size=2, max_size=5), st.integers(0, 99))
def test_a_wall_covers_half_its_width_on_each_side_of_its_chain(points, noise):
    resolution = 0.05
    cells = np.where(np.random.default_rng(noise).random((20, 30)) < 0.1, 100, 0).astype(np.int8)
    grid = GridMap(cells, resolution)
    chain = np.array(points)
    assume(np.hypot(*np.diff(chain, axis=0).T).min() > 0.01)
    trace = rasterize_chain(grid.world_to_grid(chain), cells.shape)
    core = [cell for cell in trace.cells.tolist() if 0 <= cell[0] < 20 and 0 <= cell[1] < 30]
    reach = int(WALL_WIDTH / 2.0 / resolution + 1e-6)
    wanted = np.zeros(cells.shape, bool)
    for row, column in core:
        wanted[max(0, row - reach) : row + reach + 1, max(0, column - reach) : column + reach + 1] = True
    assume(core and (wanted & (cells == 0)).any())
    region = compute_region(grid, VirtualBorder(chain, None, is_wall=True))
    assert (region.restricted_cells == wanted & (cells == 0)).all()
    assert cells[region.window].shape == region.mask.shape == tuple(part.stop - part.start for part in region.window)


def nearest(allowed, seed, radius):
    """Returns the allowed cells nearest to a seed (column, row), none if they are beyond the radius."""
    away = {cell: math.dist(cell[::-1], seed) for cell in zip(*np.nonzero(allowed))}
    least = min(away.values(), default=math.inf)
    return {cell for cell, distance in away.items() if distance <= min(radius, least + 1e-9)}


def polygon_by_cells(cells, vertices, seed):
    """Returns what a polygon restricts, or the refusal's code, and the warnings' codes; all in cells (column, row)."""
    height, width = cells.shape
    ring = vertices + vertices[:1]
    codes = ["outside_map"] * any(not (-0.5 <= x < width - 0.5 and -0.5 <= y < height - 0.5) for x, y in vertices)
    row, column = (math.floor(value + 0.5) for value in reversed(seed))
    if not (0 <= row < height and 0 <= column < width):
        return "seed_outside_map", codes
    codes += ["border_self_intersects"] * (not shapely.LineString(ring).is_simple)
    inner, _ = winding(vertices, cells.shape)
    if not inner.any():
        return "empty_region", codes
    obstacle, unknown = cells >= 65, cells < 0
    radius = MAX_SEED_SHIFT / 0.05
    if inner[row, column]:
        region, moves = inner & ~obstacle, obstacle[row, column]
        starts = nearest(region, seed, radius) if moves else {(row, column)}
    else:
        codes.append("restricts_outside")
        moves = obstacle[row, column] or unknown[row, column]
        starts = nearest(~obstacle & ~unknown & ~inner, seed, radius) if moves else {(row, column)}
        floors, _ = label(~obstacle & ~unknown)
        regions = [(floors == floors[start]) & ~inner for start in starts]
        region = regions[0] if regions else None
    if not starts:
        return "seed_on_obstacle", codes
    codes += ["seed_moved"] * bool(moves)
    if not region.any():
        return "empty_region", codes
    return region, codes + ["covers_nearly_all"] * bool(region.sum() > 0.98 * (~obstacle & ~unknown).sum())


@pytest.mark.parametrize("draw", range(8))
def test_a_polygon_restricts_what_its_definition_says_cell_by_cell(draw):
    random = np.random.default_rng(draw)
    for _ in range(12):
        cells = random.choice([30, 64, 65, 100, -1], (9, 12)).astype(np.int8)
        cells[random.random(cells.shape) < random.choice([0.0, 0.6])] = 0
        if random.random() < 0.2:
            cells[:] = np.where(random.random(cells.shape) < 0.04, 0, 100)
        grid = GridMap(cells, 0.05, (-0.3, 0.2, random.uniform(-3.0, 3.0)))
        value = int(random.choice([1, 29, 64, 65, 100]))
        vertices = [tuple(vertex) for vertex in random.uniform(-4.0, 15.0, (random.integers(3, 7), 2)).tolist()]
        seed = random.uniform((-1.0, -1.0), (13.0, 10.0)).tolist()
        border = VirtualBorder(grid.grid_to_world(vertices), grid.grid_to_world(seed)[0], value / 100.0, closed=True)
        wanted, codes = polygon_by_cells(cells, vertices, seed)
        if isinstance(wanted, str):
            with refused(wanted):
                compute_region(grid, border)
            continue
        region = compute_region(grid, border)
        assert [issue.code for issue in region.issues] == codes
        assert (region.restricted_cells == wanted).all() and np.array_equal(region.line, border.points)
        assert math.isclose(region.area_m2, wanted.sum() * 0.05**2)
        raised = wanted & ((cells >= 0) | (value >= 65))
        assert np.array_equal(region.posterior.data, np.where(raised, np.maximum(cells, value), cells))
        robots = random.integers(-3, 15, (2, 2)).tolist()  # (row, column)
        on_map = [(row, column) for row, column in robots if 0 <= row < 9 and 0 <= column < 12]
        assert region.contains_any(np.array(robots)) == any(wanted[cell] for cell in on_map)
