"""extract_border in robust mode: drawn strokes within bounds, the closing rule, and inputs that are not strokes."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from shapely.geometry import Polygon, box

from generated_strokes import Setting, draw, hausdorff, jaccard
from people_strokes import Seen, drawings, half, see
from refusals import refused
from vb_core import geometry
from vb_core.errors import CodedError
from vb_fusion.extraction import ExtractionParams, extract_border
from vb_fusion.polygonal_chain import classify_closure

BASE = Setting()
ROUGH = BASE.replace(bias=0.04, tremor=0.03, noise=0.02)
RECTANGLE = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.2], [0.0, 1.2], [0.0, 0.0]])


def extract_stroke(stroke):
    """Extracts the border of a generated stroke."""
    return extract_border(stroke.points, stamps=stroke.stamps, cameras=stroke.cameras)


@pytest.mark.parametrize(
    "setting, allowed, overlap",
    [
        (BASE, 0.15, 0.93),
        (ROUGH, 0.2, 0.88),
        (BASE.replace(outliers=0.2), 0.15, 0.93),
        (BASE.replace(speed=0.2), 0.15, 0.93),
        (BASE.replace(passes=2), 0.15, 0.93),
        (BASE.replace(overlap=0.4), 0.15, 0.93),
        (BASE.replace(cameras=4), 0.15, 0.93),
        (BASE.replace(cameras=1, speed=0.7), 0.2, 0.88),
    ],
    ids=["usual", "rough", "outliers", "slow", "retraced", "overlap", "four cameras", "one camera, fast"],
)
@pytest.mark.parametrize("shape", ["rectangle", "L", "U"])
def test_a_closed_stroke_becomes_a_polygon_near_to_what_was_drawn(setting, allowed, overlap, shape):
    distances, overlaps = [], []
    for seed in range(3):
        stroke = draw(shape, setting, np.random.default_rng(seed))
        chain = extract_stroke(stroke)
        assert chain.closed, chain.reason
        distances.append(hausdorff(chain.points, stroke.truth, True))
        overlaps.append(jaccard(chain.points, stroke.truth))
    assert max(distances) < 0.25
    assert np.median(distances) < allowed
    assert np.median(overlaps) > overlap


@pytest.mark.parametrize(
    "shape, setting, allowed",
    [
        *((shape, BASE.replace(outliers=share), 0.2) for shape in ("doorway", "corner") for share in (0.03, 0.2)),
        ("corner", BASE.replace(gap=0.35), 0.2),  # a gap in a straight line gets no corner
        ("narrow_U", ROUGH, 0.25),  # its legs are separated by time alone
    ],
)
def test_every_stroke_is_followed(shape, setting, allowed):
    for seed in range(5):
        stroke = draw(shape, setting, np.random.default_rng(seed))
        chain = extract_stroke(stroke)
        assert chain.closed == stroke.closed, chain.reason
        assert hausdorff(chain.points, stroke.truth, stroke.closed) < allowed


@pytest.mark.parametrize("closed", [True, False], ids=["polygon", "curve"])
@pytest.mark.parametrize("before, after", [(0.0, 0.0), (0.2, 0.2), (0.05, 0.35), (0.3, 0.1)])
def test_corners_stay_corners_also_where_nobody_saw_one(closed, before, after):
    s = np.linspace(0, 6, 1200, endpoint=False)
    s = s[(s < 2 - before) | (s > 2 + after)]
    if not closed:
        s = s[s < 4.5]
    at = [0, 2, 3, 5, 6]
    points = np.column_stack([np.interp(s, at, [0, 2, 2, 0, 0]), np.interp(s, at, [0, 0, 1, 1, 0])])
    chain = extract_border(points + np.random.default_rng(0).normal(0, 0.005, points.shape), stamps=s / 0.4)
    assert chain.closed == closed
    for corner, allowed in [([2, 0], 0.04), ([2, 1], 0.02)] + closed * [([0, 1], 0.02)]:
        assert np.linalg.norm(chain.points - corner, axis=1).min() < allowed


def test_stroke_runs_in_the_direction_it_was_drawn():
    x = np.linspace(0, 2, 200)
    points = np.column_stack([x, 0 * x])
    stamps = np.arange(200) / 25.0
    assert extract_border(points, stamps=stamps).points[0, 0] < 0.1
    assert extract_border(points, stamps=-stamps).points[0, 0] > 1.9


# ----------------------------------------------------------------- closed or open
@pytest.mark.parametrize("gap", [0.1, 0.2, 0.3])
@pytest.mark.parametrize("corners", [3, 60], ids=["triangle", "circle"])
@pytest.mark.parametrize("begin", [0.0, 0.4, 0.9])
def test_figures_with_a_gap_of_a_third_of_their_size_are_closed(gap, corners, begin):
    angle = np.linspace(0, 2 * np.pi, corners + 1)
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    dense = geometry.resample_chain(ring, 0.01)
    dense = np.roll(dense[:-1], -int(begin * len(dense) / 3), axis=0)
    away = np.linalg.norm(dense - dense[0], axis=1)
    wide = np.linalg.norm(np.ptp(ring, axis=0)) * gap
    last = int(np.flatnonzero((away >= wide) & (np.arange(len(dense)) > len(dense) / 2))[-1])
    assert classify_closure(dense[: last + 1]).closed


def bent_wave(degrees):
    """Returns a wave whose ends come near each other, but which encloses next to nothing."""
    along = np.radians(np.linspace(0, degrees, 600))
    radius = 1.0 + 0.45 * np.sin(9 * along)
    return radius[:, None] * np.column_stack([np.cos(along), 0.45 * np.sin(along)])


ALONG = np.linspace(0.0, 2.0, 400)[:, None]
TURN = np.linspace(0, 2 * np.pi, 100)
LOOP = np.column_stack([0.25 * np.sin(TURN), 0.25 - 0.25 * np.cos(TURN)])
LINES = {
    **{f"U {depth} m": np.array([[0.0, depth], [0.0, 0.0], [1.0, 0.0], [1.0, depth]]) for depth in (0.7, 1.0, 3.0)},
    "long wave": np.hstack([ALONG, 0.8 * np.sin(12 * ALONG)]),
    "tremor": np.hstack([0.35 * ALONG, np.random.default_rng(2).normal(0, 0.02, (400, 1))])[::20],
    "there and back": np.hstack([1.0 - np.abs(ALONG - 1.0), 0.0005 * ALONG]),
    **{f"wave bent by {degrees} degrees": bent_wave(degrees) for degrees in (200, 240, 280)},
    "loop in its middle": geometry.resample_chain(np.vstack([[[-1.0, 0.0]], LOOP, [[1.0, 0.0]]]), 0.02),
}


@pytest.mark.parametrize("line", LINES.values(), ids=list(LINES))
@pytest.mark.parametrize("scale", [0.5, 1.0, 10.0])
def test_lines_are_open_at_every_scale(line, scale):
    assert not classify_closure(scale * line).closed


# ----------------------------------------------------------------- no strokes
@pytest.mark.parametrize("params", [ExtractionParams(mode="paper"), ExtractionParams()], ids=["paper", "robust"])
@pytest.mark.parametrize(
    "points, code",
    [
        (np.zeros((0, 2)), "no_spots"),
        ([], "no_spots"),
        (np.full((30, 2), np.nan), "no_spots"),
        (np.full((30, 2), np.inf), "no_spots"),
        ([[1.0, 2.0]], "too_few_spots"),
        (np.ones((50, 2)), "no_line"),
        (np.random.default_rng(0).normal(0, 0.02, (50, 2)), "no_line"),
    ],
)
def test_missing_too_few_and_unmoved_spots_are_refused(params, points, code):
    with refused(code):
        extract_border(points, params, stamps=0.04 * np.arange(len(points)))


@pytest.mark.parametrize("params", [ExtractionParams(mode="paper"), ExtractionParams()], ids=["paper", "robust"])
def test_non_finite_far_and_unconnected_spots_are_left_out(params):
    rng = np.random.default_rng(0)
    line = np.column_stack([np.linspace(0, 2, 300), np.zeros(300)]) + rng.normal(0, 0.01, (300, 2))
    points = np.vstack([line, rng.normal([5, 5], 0.03, (200, 2)), [[np.nan, 0], [np.inf, 1], [1e300, 0]]])
    chain = extract_border(points, params, stamps=0.04 * np.arange(len(points)))  # all are from one camera
    assert chain.length == pytest.approx(2.0, abs=0.2)
    assert np.abs(chain.points[:, 1]).max() < 0.1


@pytest.mark.parametrize("strays", [0.03, 0.3])
def test_a_line_is_found_among_hundreds_of_strays_at_once(strays):
    rate = 300_000 / (6.5 / BASE.speed * BASE.cameras)
    stroke = draw("rectangle", BASE.replace(rate=rate, outliers=strays), np.random.default_rng(0))
    chain = extract_stroke(stroke)
    assert chain.closed
    assert hausdorff(chain.points, stroke.truth, True) < 0.15


# ----------------------------------------------------------------- people's strokes, cameras and the track
@pytest.mark.parametrize("shape, every, rounds", [("", 2, 1), ("zigzag", 1, 4)])
def test_lines_that_people_drew_become_what_they_meant(shape, every, rounds):
    """Half of the development set, and all its zigzags (bench/extraction/accuracy.py judges the other strokes)."""
    drawn = [drawing for drawing in drawings() if half(drawing) == "develop" and shape in drawing.shape][::every]
    wrong = []
    for number, drawing in enumerate(rounds * drawn):
        stroke = see(drawing, Seen(speed=(0.3, 0.7)), np.random.default_rng([300, number]))
        chain = extract_stroke(stroke)
        drawn_line = geometry.resample_chain(stroke.truth, 0.01, stroke.closed)
        line = geometry.resample_chain(chain.points, 0.01, chain.closed)
        far = cKDTree(drawn_line).query(line)[0].max()
        if not stroke.closed:
            far = max(far, cKDTree(line).query(drawn_line)[0].max())
        if far > 0.25 or chain.closed != stroke.closed:
            wrong.append((drawing.id, drawing.shape, round(float(far), 2), chain.reason))
    assert rounds * len(drawn) > 20
    assert len(wrong) <= 1, wrong


def line_spots(ways, speed=0.4, rate=25.0, seed=0, noise=0.005, cameras=1, start=0.0):
    """Returns the arguments of extract_border for a pointer that moves along a chain (M, 2) [m]."""
    rng = np.random.default_rng(seed)
    dense = geometry.resample_chain(np.asarray(ways, float), speed / rate)
    points = np.vstack([dense + rng.normal(0, noise, dense.shape) for _ in range(cameras)])
    stamps = np.concatenate([start + (np.arange(len(dense)) + 0.3 * k) / rate for k in range(cameras)])
    return {"points": points, "stamps": stamps, "cameras": np.repeat(np.arange(cameras), len(dense))}


def still(place, start, count=20, camera=0):
    """Returns the same for a pointer that is held at a place (2,), or is at each of (count, 2) in turn."""
    places = np.tile(place, (count, 1)) if np.ndim(place) == 1 else place
    return {"points": places, "stamps": start + np.arange(count) / 25.0, "cameras": np.full(count, camera)}


def joined(*parts):
    """Returns the spots of all parts as one drawing."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def by_robot(spots):
    """Extracts the border of spots whose second camera is on a robot."""
    return extract_border(**spots, mobile=spots["cameras"] == 1)


def off_the_axis(chain):
    """Returns the largest distance [m] of a chain from the x axis."""
    return np.abs(geometry.resample_chain(chain.points, 0.02)[:, 1]).max()


def test_a_robot_lost_for_a_second_does_not_move_the_border():
    spots = line_spots([[0, 0], [3, 0]], cameras=2)
    lost = (spots["cameras"] == 1) & (np.abs(spots["stamps"] - 3.5) < 0.5)
    spots["points"][lost] += [0.0, 0.12]
    assert off_the_axis(by_robot(spots)) < 0.025


@pytest.mark.parametrize("off", [0.12, 0.18])
def test_spots_of_a_lost_robot_beside_the_line_are_not_a_stroke(off):
    """They are the same line, seen from a wrong pose. A line that is drawn there later is another stroke."""
    spots = line_spots([[0, 0], [3, 0], [3, 2]], cameras=3)
    spots["points"][spots["cameras"] == 1] += off * np.array([0.6, 0.8])
    chain = by_robot(spots)
    assert chain.left_out_spots == 0
    assert hausdorff(chain.points, np.array([[0, 0], [3, 0], [3, 2]]), False) < 0.08
    again = line_spots([[0, off + 1.0], [2.5, off + 1.0]], start=spots["stamps"].max() + 10.0)
    again["cameras"] += 1
    assert abs(by_robot(joined(spots, again)).left_out_spots - len(again["points"])) <= 3


@pytest.mark.parametrize("place", [(0.0, 0.10), (0.0, -0.10)])
def test_spots_seen_by_a_robot_alone_keep_its_last_offset(place):
    """The offset is that from the other cameras just before and after."""
    spots = line_spots([[0, 0], [3, 0]], cameras=2)
    robot = spots["cameras"] == 1
    spots["points"][robot] += place
    seen = robot | (np.abs(spots["points"][:, 0] - 1.5) > 0.5)  # the middle metre is seen by the robot alone
    assert off_the_axis(by_robot({name: values[seen] for name, values in spots.items()})) < 0.05


def test_a_line_drawn_back_over_itself_ends_where_it_turned():
    strokes = [draw("doorway", BASE.replace(passes=2), np.random.default_rng(seed)) for seed in range(12)]
    distances = [hausdorff(extract_stroke(stroke).points, stroke.truth, False) for stroke in strokes]
    assert np.median(distances) < 0.07, distances


def with_strays(spots, seed, share=0.03, margin=0.5):
    """Returns the spots with strays near the drawing added."""
    rng = np.random.default_rng([seed, 5])
    points, stamps = spots["points"], spots["stamps"]
    count = int(share * len(points))
    strays = rng.uniform(points.min(axis=0) - margin, points.max(axis=0) + margin, (count, 2))
    times = rng.uniform(stamps.min(), stamps.max(), count)
    return joined(spots, {"points": strays, "stamps": times, "cameras": rng.integers(0, 2, count)})


@pytest.mark.parametrize("images", [1, 3], ids=["stray", "glint"])
def test_sides_in_any_order_are_one_polygon_also_among_strays(images):
    """Crossing an unseen gap has a cost, which a flash does not lower, however near to the gap's ends it is."""
    bad = 0
    for seed in range(8):
        parts = []
        start = 0.0
        for number, later in zip((0, 2, 1, 3), (2, 1, 3, 0)):
            side = RECTANGLE[number : number + 2]
            parts.append(line_spots(side, seed=9 * seed + number, noise=0.012, cameras=2, start=start))
            # a flash 0.2 s after a side's last spot, 0.28 m from the start of a later side
            start = parts[-1]["stamps"].max() + 1.5
            parts.append(still(RECTANGLE[later] + 0.2, start - 1.3, images))
        chain = extract_border(**with_strays(joined(*parts), seed))
        bad += not chain.closed or hausdorff(chain.points, RECTANGLE[:4], True) > 0.25
    assert bad <= 1, bad


@pytest.mark.parametrize("length", [0.3, 0.7, 1.0])
def test_a_piece_beside_the_line_is_never_left_out_without_a_word(length):
    beside = line_spots([[0, 3], [length, 3]], speed=0.2, start=15.0)
    chain = extract_border(**joined(line_spots([[0, 0], [2, 0]]), beside))
    assert chain.length == pytest.approx(2.0, abs=0.05)
    assert abs(chain.left_out_spots - len(beside["points"])) <= 3
    assert chain.left_out[:, 1].min() > 2.8


@pytest.mark.parametrize("images", [5, 10])
@pytest.mark.parametrize("place, start", [([2.5, 0.0], 9.0), ([-0.5, 0.0], 0.0)], ids=["end", "beginning"])
def test_an_end_seen_too_seldom_is_left_out_with_a_word(images, place, start):
    line = line_spots([[0, 0], [2, 0]], start=2.0)
    seldom = still(place, start, images)
    chain = extract_border(**joined(line, seldom))
    assert chain.length == pytest.approx(2.0, abs=0.05)
    assert chain.left_out_spots == images
    assert extract_border(**line).left_out_spots == 0


@pytest.mark.parametrize("middle, width", [(1.0, 0.5), (1.0, 0.8), (2.0, 0.6), (4.2, 0.5)])
def test_an_unseen_piece_is_reported_even_with_strays_across_it(middle, width):
    for seed in range(5):
        spots = line_spots(RECTANGLE, speed=0.25, noise=0.012, cameras=2, seed=seed)
        assert extract_border(**spots).longest_unseen_gap < 0.25
        seen = np.abs(0.25 * (spots["stamps"] - spots["stamps"][0]) - middle) > 0.5 * width
        # beside the line, in the middle of the unseen interval
        stray = still(spots["points"][~seen].mean(axis=0) + [0.25, 0.25], spots["stamps"][~seen].mean(), 1)
        chain = extract_border(**joined({name: values[seen] for name, values in spots.items()}, stray))
        assert chain.longest_unseen_gap > 0.25
        assert chain.closed
        assert hausdorff(chain.points, RECTANGLE[:4], True) < 0.25


@pytest.mark.parametrize("days", [30, 365])
def test_a_robots_clock_that_is_off_costs_no_memory(days):
    """Only seconds in which something was seen have unknowns."""
    spots = line_spots([[0, 0], [3, 0]], cameras=2)
    spots["stamps"][spots["cameras"] == 1] += 86400.0 * days
    assert off_the_axis(by_robot(spots)) < 0.05


@pytest.mark.parametrize("beside", [0.0, 0.06, 0.1])
def test_neighbouring_tips_passed_shortly_after_each_other_are_kept(beside):
    """Light that comes back to a place after a second is the pointer: a bright object would have stayed visible."""
    for seed in range(4):
        parts = []
        at = 0.0
        tips = [[0.0, 0.0], [0.1, 0.9], [0.3, 0.0], [0.1 + beside, 0.95], [0.5, 0.0], [0.1 + 2 * beside, 1.0]]
        for number, (start, end) in enumerate(zip(tips, tips[1:])):
            parts.append(line_spots([start, end], speed=4.0, cameras=2, seed=9 * seed + number, start=at))
            at += float(np.linalg.norm(np.subtract(end, start))) / 4.0 + 0.04
            for camera in (0, 1):
                places = np.random.default_rng([seed, number, camera]).normal(end, 0.01, (20, 2))
                parts.append(still(places, at + 0.01 * camera, camera=camera))
            at += 0.84
        assert hausdorff(extract_border(**joined(*parts)).points, np.array(tips), False) < 0.15


@pytest.mark.parametrize("speed, limit", [(0.05, 0.15), (0.02, 0.25)])
def test_a_slow_hand_is_no_light_that_stays(speed, limit):
    distances = []
    for seed in range(10):
        line = line_spots([[0, 0], [0.9, 0]], speed=speed, noise=0.012, cameras=2, seed=seed)
        chain = extract_border(**with_strays(line, seed))
        distances.append(hausdorff(chain.points, np.array([[0, 0], [0.9, 0]]), False))
    assert sorted(distances)[-2] <= limit, distances


HOOK = [[0, 0.2], [-0.2, 0.1], [-0.15, 0], [0, 0]]
CORNER = [[0, 0], [1.5, 0], [1.5, 1.0]]
TIP = [[0, 0], [0.01, 1.0], [0.02, 0], [0.8, 0]]
CIRCLE = 0.5 * np.column_stack([np.cos(TURN), np.sin(TURN)])
SCENES = {
    # people rest at a corner and draw a side so quickly that hardly any of it is seen
    "a quick leg after a rest": (
        [*CORNER, [0.9, 1.2]],
        lambda seed: joined(
            line_spots(CORNER, cameras=2, seed=seed),
            still([1.5, 1.0], 6.3),
            line_spots([[1.5, 1.0], [0.9, 1.2]], speed=4.0, cameras=2, seed=seed + 9, start=7.1),
        ),
    ),
    "a slow hook is no rest": (
        [*HOOK, [1.5, 0]],
        lambda seed: joined(line_spots(HOOK, 0.04, seed=seed), line_spots([[0, 0], [1.5, 0]], seed=seed, start=14.5)),
    ),
    "a stroke that goes on from an end": (
        [[2, 0], [0, 0], [0, 1.5]],
        lambda seed: joined(line_spots([[0, 0], [2, 0]], seed=seed), line_spots([[0, 1.5], [0, 0.1]], start=15.0)),
    ),
    "legs almost on each other": (TIP, lambda seed: line_spots(TIP, seed=seed)),
    "two images a second": (RECTANGLE, lambda seed: line_spots(RECTANGLE, rate=2.0, seed=seed)),
    "a ring without noise": (CIRCLE, lambda seed: line_spots(CIRCLE, 0.2, seed=seed, noise=0.0, cameras=2)),
}


@pytest.mark.parametrize("line, spots", SCENES.values(), ids=list(SCENES))
def test_what_people_do_is_kept_whole(line, spots):
    for seed in range(4):
        chain = extract_border(**spots(seed))
        closed = line is RECTANGLE or line is CIRCLE
        assert chain.closed == closed
        assert chain.left_out_spots <= 3
        assert hausdorff(chain.points, np.array(line, float), closed) < (0.1 if line is TIP else 0.03)


@pytest.mark.parametrize("size, noise, refusals", [(0.3, 0.012, range(2)), (0.2, 0.03, range(1, 21))])
def test_a_ring_is_closed_or_too_small_but_never_a_curve(size, noise, refusals):
    """A ring is refused if it is too small for its noise."""
    count = 0
    for seed in range(20):
        try:
            spots = line_spots(size * CIRCLE, 0.2, seed=seed, noise=noise, cameras=2)
            assert extract_border(**spots).closed
        except CodedError as error:
            assert error.code in ("figure_too_small", "no_line")
            count += 1
    assert count in refusals


EIGHT = np.column_stack([1.2 * np.sin(TURN), 0.8 * np.sin(2 * TURN)])
LOOP_AT_THE_END = [[0.3, -0.2], [0, 0.1], [0, 1.5], [2, 1.5], [2, 0], [0.1, 0], [-0.2, -0.2]]


@pytest.mark.parametrize("way, right, left", [(EIGHT, 1.28, 1.28), (LOOP_AT_THE_END, 3.0, 0.0)], ids=["eight", "loop"])
def test_a_figure_that_crosses_itself_becomes_one_valid_polygon(way, right, left):
    """An eight keeps both lobes."""
    chain = extract_border(**line_spots(way))
    polygon = Polygon(chain.points)
    assert chain.closed
    assert polygon.is_valid
    assert polygon.intersection(box(0, -2, 2, 2)).area == pytest.approx(right, rel=0.1)
    assert polygon.intersection(box(-2, -2, 0, 2)).area == pytest.approx(left, rel=0.1, abs=0.05)


@pytest.mark.parametrize("shape", ["L", "corner", "rectangle"])
@pytest.mark.parametrize(
    "turn, later, tiny", [(0.7, 0.0, 0.0), (0.0, 1.7e9 + 0.07, 0.0), (0.0, 0.043, 0.0), (0.0, 0.0, 1e-9)]
)
def test_the_border_depends_on_nothing_but_the_drawing(shape, turn, later, tiny):
    """It is the same if turned and moved, half a century later, or rounded differently and in another order."""
    stroke = draw(shape, BASE, np.random.default_rng(3))
    stamps = np.round(stroke.stamps * 25.0) / 25.0
    here = extract_border(stroke.points, stamps=stamps, cameras=stroke.cameras)
    rng = np.random.default_rng(0)
    order = rng.permutation(len(stroke.points)) if tiny else np.arange(len(stroke.points))
    T = geometry.transform_from_pose2d(3.0 * bool(turn), -2.0 * bool(turn), turn)[:2]
    moved = stroke.points @ T[:, :2].T + T[:, 3] + rng.uniform(-tiny, tiny, stroke.points.shape)
    there = extract_border(moved[order], stamps=stamps[order] + later, cameras=stroke.cameras[order])
    found = hausdorff(here.points @ T[:, :2].T + T[:, 3], there.points, here.closed)
    assert found < (0.06 if turn else 1e-3)
