"""The integration against exact polygons, and its invariants."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings, strategies as st
from shapely import affinity
from shapely.geometry import LineString, Point, box
from shapely.ops import split

from examples import STEADY
from refusals import refused
from vb_core import sentences
from vb_core.grid_map import GridMap
from vb_evaluation.metrics import jaccard
from vb_map_integration.border import IntegrationError, VirtualBorder
from vb_map_integration.border_region import compute_region
from vb_map_integration.open_chains import BorderOnGrid, cut_free_space

from oracle import ORIGINS, RESOLUTION, ROOMS, place, rasterise, side_of, world

FEW = settings(STEADY, max_examples=25)


def coordinates(line):
    return np.array(line.coords)


def inside_point(random, shape, margin=0.06):
    low, high = np.array(shape.bounds).reshape(2, 2)
    inner = shape.buffer(-margin)
    assert not inner.is_empty
    while True:
        point = random.uniform(low, high)
        if inner.contains(Point(point)):
            return point


def codes(result):
    return [issue.code for issue in result.issues]


@FEW
@given(st.integers(0, 10**6), st.sampled_from(sorted(ROOMS)), st.sampled_from(ORIGINS))
def test_curves_match_exact_ones(seed, room_name, origin):
    random = np.random.default_rng(seed)
    plain = ROOMS[room_name]
    # the exact line runs from wall to wall; only its middle is drawn, and the extension must add the rest
    while True:
        ends = [plain.exterior.interpolate(value, normalized=True) for value in random.uniform(0, 1, 2)]
        through = LineString(ends)
        # slivers between wall and line, and gaps between line and corner, would be dominated by rounding
        parts = split(plain, affinity.scale(through, 1.01, 1.01)).geoms
        fits = len(parts) == 2 and all(part.area > 0.5 and part.buffer(-0.06).geom_type == "Polygon" for part in parts)
        margins = random.uniform(0.05, 0.4, 2) * through.length
        # an end so near to a wall beside it is joined to that one
        beside = [plain.exterior.distance(through.interpolate(at)) < 0.25 for at in (margins[0], -margins[1])]
        fits &= plain.buffer(1e-6).covers(through) and not any(beside & (margins > 0.15))
        if through.length > 1.5 and fits:
            break
    count = random.integers(2, 40)
    drawn = [through.interpolate(d) for d in np.linspace(margins[0], through.length - margins[1], count)]
    drawn_line = place(LineString(drawn), origin)
    full = np.array(place(through, origin).coords)
    unit = (full[1] - full[0]) / np.linalg.norm(full[1] - full[0])
    long_line = LineString([full[0] - 0.01 * unit, full[1] + 0.01 * unit])
    prior, room = world(plain, origin)
    point = inside_point(random, room.difference(drawn_line.buffer(0.1)))
    truth_area = side_of(room, long_line, point)
    result = compute_region(prior, VirtualBorder(coordinates(drawn_line), point, closed=False))
    assert jaccard(result.restricted_cells, rasterise(truth_area, prior)) >= 0.99
    assert (result.posterior.data[prior.data == 100] == 100).all()
    assert (result.posterior.data[prior.data == -1] == -1).all()


HALL = ROOMS["rectangle"]
TWO_ROOMS = shapely.union_all([box(0.3, 0.3, 4.0, 4.7), box(4.1, 0.3, 7.7, 4.7)])
BOXES = [box(3.8, 0.8, 4.2, 1.0), box(3.9, 0.5, 4.1, 0.6), box(3.7, 3.8, 4.3, 4.0)]
TABLE = box(2.0, 1.5, 5.0, 3.5)
BEND = [(6.1, 4.2), (6.1, 3.6), (5.9, 3.0), (6.3, 2.6), (6.9, 2.6), (7.3, 2.6)]
CORNER = LineString([(6.1, 4.8), *BEND, (7.8, 2.6)])
# scenario 1: 0.70 m across a doorway, the only connection of the two rooms
DOOR, DOORWAY = [(4.05, y) for y in np.linspace(2.02, 2.68, 15)], box(3.9, 2.0, 4.2, 2.7)


@pytest.mark.parametrize("origin", ORIGINS)
@pytest.mark.parametrize(
    "room, boxes, chain, seed, area, far",
    [
        pytest.param(HALL, (), BEND, (7.0, 4.0), side_of(HALL, CORNER, (7.0, 4.0)), 0, id="bent"),
        pytest.param(HALL, (), BEND, (2.0, 2.0), side_of(HALL, CORNER, (2.0, 2.0)), 0, id="beyond"),
        pytest.param(TWO_ROOMS.union(DOORWAY), (), DOOR, (6.0, 1.0), box(4.05, 0.0, 8.0, 5.0), 0, id="door"),
        pytest.param(HALL, BOXES, [(4.0, 3.5), (4.0, 1.5)], (1.0, 1.0), box(0, 0, 4, 5), 2, id="behind boxes"),
        pytest.param(
            HALL,
            [TABLE],
            [(4.5, 3.6), (4.5, 4.0), (5.5, 4.0), (5.5, 3.0), (5.1, 3.0)],
            (5.2, 3.7),
            box(4.5, 3.0, 5.5, 4.0),
            0,
            id="round the corner of a large table",
        ),
        pytest.param(
            TWO_ROOMS, (), [(1.0, 2.5), (4.2, 2.5)], (2.0, 1.0), box(0.3, 0.3, 4.0, 2.5), 0, id="beyond a wall"
        ),
    ],
)
def test_a_curve_restricts_the_seeds_side_up_to_joining_walls(room, boxes, chain, seed, area, far, origin):
    prior, _ = world(room, origin, boxes)
    line, point = place(LineString(chain), origin), place(Point(seed), origin)
    result = compute_region(prior, VirtualBorder(coordinates(line), coordinates(point)[0]))
    free = area.intersection(room).difference(shapely.union_all(boxes))
    min_overlap = 0.99 if boxes != [TABLE] else 0.98
    assert jaccard(result.restricted_cells, rasterise(place(free, origin), prior)) >= min_overlap
    assert codes(result) == ["extended_far"] * far


@pytest.mark.parametrize("tremor", [0.0, 0.01, 0.02])
def test_a_tremor_at_the_end_hardly_turns_the_extension(tremor):
    prior, room = world(HALL, (0.0, 0.0, 0.0))
    for seed in range(10):
        random = np.random.default_rng(seed)
        chain = np.column_stack([np.full(40, 4.0), np.linspace(1.5, 3.5, 40)]) + random.normal(0, tremor, (40, 2))
        result = compute_region(prior, VirtualBorder(chain, (7.0, 1.0), closed=False))
        assert jaccard(result.restricted_cells, rasterise(room.intersection(box(4.0, 0, 8, 5)), prior)) >= 0.94


@FEW
@given(st.integers(0, 10**6))
def test_a_line_beside_a_doorway_closes_the_doorway_only(seed):
    """Both ends are up to 0.15 m in front of or behind the walls of a closet, whose corner stands free in the room."""
    random = np.random.default_rng(seed)
    closet = [box(2.95, 0.3, 3.05, 0.8), box(2.95, 1.6, 3.05, 2.05), box(0.3, 1.95, 3.05, 2.05)]
    prior, _ = world(HALL, (0.0, 0.0, 0.0), closet)
    inside = rasterise(box(0.3, 0.3, 3.0, 1.95), prior) & (prior.data == 0)
    chain = np.linspace((3.0 + random.uniform(-0.15, 0.15), 0.8), (3.0 + random.uniform(-0.15, 0.15), 1.6), 4)
    result = compute_region(prior, VirtualBorder(chain, seed=(1.5, 1.2), closed=False))
    assert jaccard(result.restricted_cells, inside) > 0.9


@FEW
@given(st.integers(0, 10**6))
def test_nothing_leaks_through_corners(seed):
    """The two sides of the curve never mix, even if walls one cell thick are met at any angle."""
    random = np.random.default_rng(seed)
    size = 60
    data = np.zeros((size, size), np.int8)
    for k in range(size):  # diagonal walls whose cells only touch at corners
        data[k, min(size - 1, max(0, k - 25))] = 100
        data[k, max(0, min(size - 1, k + 25))] = 100
    data[[0, -1]] = 100
    data[:, [0, -1]] = 100
    prior = GridMap(data, RESOLUTION)
    center = np.array([30.0, 30.0]) + random.uniform(-4, 4, 2)
    angle = random.uniform(-1.3, 1.3) + 3 * np.pi / 4
    unit = np.array([np.cos(angle), np.sin(angle)])
    if abs(unit @ [1, 1]) > 1.2:
        return
    ends = prior.grid_to_world(center + np.array([-6, 6])[:, None] * unit)
    normal = np.array([-unit[1], unit[0]])
    seeds = prior.grid_to_world(center + np.array([-4, 4])[:, None] * normal)
    first, second = (compute_region(prior, VirtualBorder(ends, s, closed=False)).restricted_cells for s in seeds)
    assert not (first & second).any()
    # nothing is restricted beyond the diagonal walls
    assert not (first | second)[[5, 50], [50, 5]].any()


@FEW
@given(st.integers(0, 10**6), st.floats(0.0, 1.0), st.booleans())
def test_invariants_on_noisy_maps(seed, occupancy, closed):
    """For any map, the prior stays unchanged, no value is lowered, and obstacles and unknown cells stay as they are."""
    random = np.random.default_rng(seed)
    data = random.choice([0, 0, 0, 0, 0, 20, 100, -1], (80, 120)).astype(np.int8)
    prior = GridMap(data.copy(), 0.05, (-1.0, 2.0, 0.3))
    points = prior.grid_to_world(random.uniform(-10, 120, (random.integers(3, 12), 2)))
    try:
        point = prior.grid_to_world([random.uniform(5, 75, 2)])[0]
        border = VirtualBorder(points, point, occupancy, closed)
        result = compute_region(prior, border)
    except IntegrationError:
        assert np.array_equal(prior.data, data)
        return
    after = result.posterior.data
    assert np.array_equal(prior.data, data)
    assert result.posterior.same_geometry(prior)
    assert (after[data >= 0] >= data[data >= 0]).all()
    assert (after[data == 100] == 100).all()
    assert np.array_equal(after[~result.restricted_cells], data[~result.restricted_cells])
    assert not (result.restricted_cells & (data >= 65)).any()
    unknown = result.restricted_cells & (data < 0)
    assert closed or not unknown.any()
    assert (after[unknown] == (border.cell_value if border.cell_value >= 65 else -1)).all()
    known = result.restricted_cells & (data >= 0)
    assert np.array_equal(after[known], np.maximum(data[known], border.cell_value))
    assert result.area_m2 == pytest.approx(result.restricted_cells.sum() * 0.05**2)


@pytest.mark.parametrize(
    "said, points, seed, closed",
    [
        ("seed_on_obstacle", [(4, 1), (4, 4)], (2.5, 2.5), False),
        ("seed_outside_map", [(4, 1), (4, 4)], (9.0, 1.0), False),
        ("outside_map", [(14, 1), (14, 4)], (1.0, 1.0), False),
        ("no_separation", [(2.2, 2.2), (2.8, 2.8)], (1.0, 1.0), False),
        ("seed_on_both_sides", [(2, 1), (6, 4), (6, 1), (2, 4)], (4.0, 4.3), False),
        (["covers_nearly_all"], [(0.2, 0.2), (7.8, 0.2), (7.8, 4.8), (0.2, 4.8)], (1, 1), True),
        (["seed_moved"], [(4, 1), (4, 4)], (2.1, 2.5), False),
        (["seed_moved"], [(4, 1), (4, 4)], (4.0, 2.5), False),
        ([], [(4, 1), (4, 4)], (1.9, 2.5), False),
    ],
)
def test_refusals_and_warnings_are_coded(said, points, seed, closed):
    prior, _ = world(HALL, (0.0, 0.0, 0.0), [box(2.0, 2.0, 3.0, 3.0)])
    before = prior.data.copy()
    try:
        answer = codes(compute_region(prior, VirtualBorder(points, seed, closed=closed)))
    except IntegrationError as error:
        answer = error.message and error.code
    assert answer == said and np.array_equal(prior.data, before)


def test_a_curve_in_another_room_separates_nothing():
    prior, _ = world(TWO_ROOMS, (0.0, 0.0, 0.0))
    with refused("no_separation"):
        compute_region(prior, VirtualBorder([(1.0, 2.5), (3.0, 2.5)], (6.0, 1.0), closed=False))


@pytest.mark.parametrize("offset", [-0.012, -0.006, 0.006, 0.012])
def test_a_seed_within_a_cell_of_the_curve_stays_on_its_side(offset):
    prior, room = world(HALL, (0.0, 0.0, 0.0))
    result = compute_region(prior, VirtualBorder([(4.0125, 1.0), (4.0125, 4.0)], (4.0125 + offset, 4.4), closed=False))
    side = box(0, 0, 4.0125, 5) if offset < 0 else box(4.0125, 0, 8, 5)
    assert jaccard(result.restricted_cells, rasterise(room.intersection(side), prior)) >= 0.99


def test_each_side_of_a_cut_can_be_filled():
    points = np.array([(20.0, 5.0), (20.0, 14.0)])
    cut = cut_free_space(BorderOnGrid(np.zeros((20, 40), np.uint8), 0.05, points, seed=np.array([5.0, 10.0])))
    areas = [np.count_nonzero(cut.fill_side(start)[1]) for start in [(10, 5), (10, 35)]]
    assert areas == [20 * 20, 20 * 19]


@pytest.mark.parametrize("ends, far", [((4.9, 0.1), []), ((4.9, 1.5), ["at its last point"])])
def test_extending_an_end_across_free_floor_warns_with_the_length(ends, far):
    """Of 1,250 lines on real maps, 656 were extended by more than a metre, 355 of them without a warning."""
    prior, _ = world(HALL, (0.0, 0.0, 0.0), [])
    result = compute_region(prior, VirtualBorder([(4.0, ends[0]), (4.0, ends[1])], (7.0, 1.0), closed=False))
    issues = [issue for issue in result.issues if issue.code == "extended_far"]
    assert [sentences.translate(issue.values["side_code"]) for issue in issues] == far
    length = f"{np.linalg.norm(result.line[-1] - (4.0, ends[1])):.1f}"
    assert all(issue.values["length"] == length and f"{length} m" in issue.message for issue in issues)


def test_a_map_without_walls_is_parted_at_its_edge_and_says_so():
    prior = GridMap(np.zeros((100, 100), np.int8), 0.05)
    result = compute_region(prior, VirtualBorder([(2.5, 1.0), (2.5, 4.0)], (1.0, 1.0), closed=False))
    assert codes(result) == ["no_wall_found", "no_wall_found"]
    assert (result.restricted_cells == (np.arange(100) < 50)).all(), "the left half of the map"


def test_the_extension_takes_huge_and_tiny_numbers():
    prior, _ = world(HALL, (0.0, 0.0, 0.0))
    for points in ([(4.0, 1.0), (4.0, 9e5)], [(4.0, 2.0), (4.0, 2.0001)], [(-9e5, 2.0), (9e5, 2.0)]):
        result = compute_region(prior, VirtualBorder(points, (1.0, 1.0), closed=False))
        assert 0.3 < result.area_m2 / (7.4 * 4.4) < 0.55


@pytest.mark.parametrize(
    "code, values",
    [
        ("bad_points", {"points": [(0, 0), (float("nan"), 1)]}),
        ("bad_points", {"points": [(0, 0), (float("inf"), 1)]}),
        ("bad_points", {"points": [(0, 0, 0), (1, 1, 1)]}),
        ("bad_points", {"points": [("a", "b")]}),
        ("bad_points", {"points": [(0, 0), (1e9, 1)]}),
        ("too_few_points", {"points": []}),
        ("too_few_points", {"points": [(1, 1)]}),
        ("too_few_points", {"points": [(1, 1), (1, 1)]}),
        ("too_few_points", {"points": [(1, 1), (2, 2)], "closed": True}),
        ("too_many_points", {"points": np.zeros((100000, 2))}),
        ("bad_seed", {"seed": (float("nan"), 0)}),
        ("bad_seed", {"seed": (1, 2, 3)}),
        ("bad_occupancy", {"occupancy": 1.01}),
        ("bad_occupancy", {"occupancy": -0.1}),
        ("bad_occupancy", {"occupancy": float("nan")}),
        ("bad_occupancy", {"zone": "avoid", "occupancy": 1.0}),
        ("bad_speed", {"zone": "slow", "max_speed": 2.0}),  # must not become 1.27
        ("bad_time", {"created": -1.0}),
        ("bad_name", {"name": "a\nb"}),
    ],
)
def test_a_border_is_checked_when_it_is_made(code, values):
    with refused(code):
        VirtualBorder(**{"points": [(0, 0), (1, 1)], "seed": (0, 1), **values})


def test_the_kind_is_decided_from_the_gap():
    circle = [(np.cos(a), np.sin(a)) for a in np.linspace(0.1, 2 * np.pi - 0.1, 50)]
    assert VirtualBorder(circle, (0, 0)).closed is True
    assert VirtualBorder([(0, 0), (0.35, 0.0), (0.7, 0)], (0, 1)).closed is False
    assert VirtualBorder([(0, 0), (0, 1), (1, 1), (1, 0)], (0.5, 0.5)).closed is False
    repeated = VirtualBorder([(0, 0), (0, 1), (1, 1), (0, 0)], (0.2, 0.5))
    assert (repeated.closed, len(repeated.points)) == (True, 3)
