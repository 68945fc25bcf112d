"""extract_seed: the place where the hand dwelt."""

import numpy as np
import pytest

from vb_core.errors import CodedError
from vb_fusion.extraction import extract_seed
from vb_fusion.live_extraction import DrawnBorder
from vb_fusion.stroke.seed import find_dwells


@pytest.mark.parametrize("points, code", [([], "no_spots"), ([[np.nan, 1]], "no_spots"), ([[0, 0]], "no_seed")])
def test_refusals(points, code):
    with pytest.raises(CodedError) as caught:
        extract_seed(points, stamps=np.arange(len(points)) / 25.0)
    assert caught.value.code == code


# ----------------------------------------------------------- a bright thing that a camera takes for the spot
FALSE = (2.0, 1.0)


def scene(*parts, seed=0):
    """Points, stamps and cameras of (place or the two ends of a way, first [s], last [s], rate [1/s], camera)."""
    rng = np.random.default_rng(seed)
    points, stamps, cameras = [], [], []
    for place, first, last, rate, camera in parts:
        count = int((last - first) * rate)
        way = place if np.ndim(place) == 1 else np.linspace(*place, count)
        points.append(rng.normal(way, 0.015, (count, 2)))
        stamps.append(np.sort(rng.uniform(first, last, count)))
        cameras.append(np.full(count, camera))
    return np.vstack(points), {"stamps": np.concatenate(stamps), "cameras": np.concatenate(cameras)}


FLASHES = [((1, 2), 3.0 + i, 3.3 + i, 10, "robot") for i in range(5)]  # of paper, in a robot's images as it turns
SEEDS = {
    "two cameras off": ([((1.02, 2.0), 0.0, 2.0, 25, "red"), ((0.98, 2.0), 0.0, 2.0, 25, "green")], (1, 2)),
    "the later one": ([((0, 0), 0.0, 2.0, 25, "red"), ((1, 2), 2.0, 4.0, 25, "red")], (1, 2)),
    "back again": ([((0, 0), t, t + 2.0, 25, "red") for t in (0.0, 4.0)] + [((1, 2), 2.0, 4.0, 25, "red")], (0, 0)),
    "more cameras": (
        [((1, 2), 0.0, 6.0, 18, "red"), ((1, 2), 0.0, 6.0, 18, "green"), (FALSE, 1.5, 6.0, 100, "robot")],
        (1, 2),
    ),
    "in turn with a bright place": ([(FALSE, 0.0, 8.0, 15, "robot"), ((1, 2), 2.0, 8.0, 6, "robot")], (1, 2)),
    "the way there": ([(((0, 0), (1, 2)), 0.0, 2.4, 25, "red"), ((1, 2), 2.4, 3.6, 25, "red")], (1, 2)),
    "moving on in the end": ([((1, 2), 0.0, 2.0, 25, "red"), (((1, 2), (1.8, 2)), 2.0, 2.8, 25, "red")], (1, 2)),
    "flashes come after it": ([((0, 0), 0.0, 2.0, 25, "red"), *FLASHES], (0, 0)),
}


@pytest.mark.parametrize("parts, seed", SEEDS.values(), ids=list(SEEDS))
def test_the_seed_is_where_the_pointer_dwelt_last(parts, seed):
    for number in range(5):
        points, extra = scene(*parts, seed=number)
        assert np.linalg.norm(extract_seed(points, **extra) - seed) < 0.03


@pytest.mark.parametrize("rate", [5, 25, 100])
@pytest.mark.parametrize("known", [True, False], ids=["seen before", "new with the state"])
def test_a_place_that_was_bright_before_is_not_the_seed(rate, known):
    # the robot's camera sees the paper all the time, a ceiling camera the pointer once it has got there
    points, extra = scene((FALSE, 0.0, 6.0, rate, "robot"), ((1, 2), 1.5, 6.0, 18, "red"))
    before = np.random.default_rng(1).normal(FALSE, 0.02, (1000, 2)) if known else None
    assert np.linalg.norm(extract_seed(points, before=before, **extra) - [1, 2]) < 0.02


def test_the_end_of_the_border_where_the_spot_rested_is_not_the_seed():
    points, extra = scene(((0, 0), 0.0, 3.0, 25, "red"), ((1, 2), 3.0, 4.0, 25, "red"))
    before = np.column_stack([np.linspace(-2, 0, 100), np.zeros(100)])
    before = np.vstack([before, np.random.default_rng(2).normal(0, 0.015, (50, 2))])
    assert np.linalg.norm(extract_seed(points, before=before, **extra) - [1, 2]) < 0.02


@pytest.mark.parametrize("first, last", [(6.0, 1.5), (10.0, 2.0), (20.0, 3.0)])
def test_the_last_dwell_is_the_seed_and_a_longer_one_before_is_told(first, last):
    for seed in range(5):
        points, extra = scene(
            ((0, 0), 0.0, first, 40, "red"), ((1, 2), first + 2, first + 2 + last, 40, "red"), seed=seed
        )
        dwells = find_dwells(points, **extra)
        assert np.linalg.norm(dwells[-1].point - [1, 2]) < 0.02
        assert np.linalg.norm(DrawnBorder(dwells=dwells).other_dwell.point) < 0.02


@pytest.mark.parametrize("apart, count", [(0.04, 1), (0.12, 2), (0.3, 2)])
def test_places_nearer_than_a_hand_trembles_are_one_dwell(apart, count):
    points, extra = scene(((1.0, 2.0), 0.0, 2.0, 25, "red"), ((1.0 + apart, 2.0), 2.0, 4.0, 25, "red"))
    assert len(find_dwells(points, **extra)) == count


@pytest.mark.parametrize("speed", [0.2, 0.3, 0.5])
def test_a_place_that_the_pointer_comes_to_is_one_dwell(speed):
    for seed in range(20):
        parts = (
            (((1.0, 0.0), (0.0, 0.0)), 0.0, 1.0 / speed, 25, "red"),
            ((0.0, 0.0), 1.0 / speed, 1.0 / speed + 3.0, 25, "red"),
        )
        points, extra = scene(*parts, seed=seed)
        dwells = find_dwells(points, **extra)
        assert DrawnBorder(dwells=dwells).other_dwell is None
        assert len(dwells) == 1 or np.linalg.norm(dwells[-2].point) > 0.075


@pytest.mark.parametrize("last", [1.8, 7.0, 30.0])
def test_what_only_a_robot_sees_is_no_seed_where_a_steady_camera_saw_the_pointer_dwell(last):
    """White paper stays in a robot's image after the pointer was switched off; to a camera that moves it is new."""
    points, extra = scene(((0, 0), 0.0, 2.0, 25, "red"), ((1, 2), 2.2, 2.2 + last, 5, "robot"))
    extra["mobile"] = extra["cameras"] == "robot"
    drawn = DrawnBorder(dwells=find_dwells(points, **extra))
    assert np.linalg.norm(drawn.seed) < 0.03
    assert np.linalg.norm(drawn.other_dwell.point - [1, 2]) < 0.03
    # where the steady camera saw but the border's end, the robot's place is meant
    end = np.random.default_rng(2).normal(0, 0.015, (50, 2))
    assert np.linalg.norm(extract_seed(points, before=end, **extra) - [1, 2]) < 0.03


POINTER, END = [((0, 0), 0.0, 1.7, 25, camera) for camera in ("green", "red")], np.zeros((3, 2))


@pytest.mark.parametrize(
    "later, before, taken",
    [
        ([(FALSE, 2.5, 5.5, 25, "green")], None, (0, 0)),
        ([(FALSE, 2.5, 5.5, 25, camera) for camera in ("green", "red")], None, FALSE),
        ([(((0, 0), (1.85, 0.93)), 1.7, 2.5, 50, "green"), (FALSE, 2.5, 5.5, 25, "green")], None, FALSE),
        ([(FALSE, 2.5, 5.5, 25, "green")], END, FALSE),
    ],
    ids=["one camera's light", "as many cameras", "the pointer was seen on its way", "after the border's end"],
)
def test_light_that_comes_up_elsewhere_is_the_seed_if_as_many_cameras_see_it(later, before, taken):
    for seed in range(5):
        points, extra = scene(*POINTER, *later, seed=seed)
        drawn = DrawnBorder(dwells=find_dwells(points, before=before, **extra))
        assert np.linalg.norm(drawn.seed - taken) < 0.04
        # the other one is told, unless it was the shorter one, or the border's end
        assert (drawn.other_dwell is None) == (taken == FALSE)


def test_a_camera_that_misses_images_sees_a_dwell():
    for seed in range(5):
        points, extra = scene(((1, 2), 0.0, 3.0, 5, "robot"), seed=seed)
        rng = np.random.default_rng(seed)
        seen = rng.random(len(points)) > 0.2
        dwells = find_dwells(points[seen], **{name: np.asarray(values)[seen] for name, values in extra.items()})
        assert len(dwells) == 1 and np.linalg.norm(dwells[0].point - [1, 2]) < 0.03


def test_a_shorter_dwell_before_and_the_rest_at_the_borders_end_are_not_told():
    points, extra = scene(((0, 0), 0.0, 1.0, 40, "red"), ((1, 2), 3.0, 6.0, 40, "red"))
    assert DrawnBorder(dwells=find_dwells(points, **extra)).other_dwell is None
    points, extra = scene(((0, 0), 0.0, 6.0, 40, "red"), ((1, 2), 8.0, 10.0, 40, "red"))
    dwells = find_dwells(points, before=np.random.default_rng(2).normal(0, 0.015, (50, 2)), **extra)
    assert DrawnBorder(dwells=dwells).other_dwell is None


def test_of_two_lights_at_once_the_one_that_was_there_before_is_not_the_seed_though_more_cameras_see_it():
    points, extra = scene(
        *((FALSE, 0.0, 3.0, 25, camera) for camera in ("red", "green")), ((1, 2), 0.0, 3.0, 25, "blue")
    )
    before = np.random.default_rng(1).normal(FALSE, 0.02, (200, 2))
    assert np.linalg.norm(extract_seed(points, before=before, **extra) - [1, 2]) < 0.03
    assert np.linalg.norm(extract_seed(points, **extra) - FALSE) < 0.03
