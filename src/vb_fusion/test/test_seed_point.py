"""The dwells (places where the hand rested), and the one among them that is the seed."""

import numpy as np
import pytest

from refusals import refused
from vb_fusion.extraction import DrawnBorder
from vb_fusion.seed_point import find_dwells


@pytest.mark.parametrize("points, code", [([], "no_spots"), ([[np.nan, 1]], "no_spots"), ([[0, 0]], "no_seed")])
def test_too_few_or_non_finite_spots_are_refused(points, code):
    with refused(code):
        find_dwells(points, stamps=np.arange(len(points)) / 25.0)


def seen(place, first, last, *cameras, rate=25):
    """Returns parts of a scene, one per camera: a light at a place, or moving between two, from first to last [s]."""
    return [(place, first, last, rate, camera) for camera in cameras]


def find(parts, before=(), seed=0, dropped=0.0):
    """Returns the dwells of a scene, and a drawing with them; the camera called `robot` is on a robot."""
    rng = np.random.default_rng(seed)
    points, stamps, cameras = [], [], []
    for place, first, last, rate, camera in parts:
        count = int((last - first) * rate)
        way = place if np.ndim(place) == 1 else np.linspace(*place, count)
        points.append(rng.normal(way, 0.015, (count, 2)))
        stamps.append(np.sort(rng.uniform(first, last, count)))
        cameras.append(np.full(count, camera))
    points, stamps, cameras = np.vstack(points), np.concatenate(stamps), np.concatenate(cameras)
    kept = np.random.default_rng(seed).random(len(points)) >= dropped
    known = {"stamps": stamps[kept], "cameras": cameras[kept], "mobile": cameras[kept] == "robot"}
    dwells = find_dwells(points[kept], before=before, **known)
    return dwells, DrawnBorder(dwells=dwells)


def around(place, count):
    """Returns border spots around a place."""
    return np.random.default_rng(2).normal(place, 0.015, (count, 2))


HERE, THERE, FALSE = (0, 0), (1, 2), (2.0, 1.0)
BOTH = ("red", "green")
POINTER, LIGHT = seen(HERE, 0.0, 1.7, *BOTH), seen(FALSE, 2.5, 5.5, "green")
FLASHES = [part for i in range(5) for part in seen(THERE, 3.0 + i, 3.3 + i, "blue", rate=10)]  # flashes from paper
TWO = seen(FALSE, 0.0, 3.0, *BOTH) + seen(THERE, 0.0, 3.0, "blue")
# name: (the seed, the scene)
SEEDS = {
    "two cameras off": (THERE, seen((1.02, 2.0), 0.0, 2.0, "red") + seen((0.98, 2.0), 0.0, 2.0, "green")),
    "later": (THERE, seen(HERE, 0.0, 2.0, "red") + seen(THERE, 2.0, 4.0, "red")),
    "back again": (HERE, [*seen(HERE, 0.0, 2.0, "red"), *seen(THERE, 2.0, 4.0, "red"), *seen(HERE, 4.0, 6.0, "red")]),
    "more cameras": (THERE, seen(THERE, 0.0, 6.0, *BOTH, rate=18) + seen(FALSE, 1.5, 6.0, "blue", rate=100)),
    "in turn": (THERE, seen(FALSE, 0.0, 8.0, "blue", rate=15) + seen(THERE, 2.0, 8.0, "blue", rate=6)),
    "the way there": (THERE, seen((HERE, THERE), 0.0, 2.4, "red") + seen(THERE, 2.4, 3.6, "red")),
    "moving on": (THERE, seen(THERE, 0.0, 2.0, "red") + seen((THERE, (1.8, 2)), 2.0, 2.8, "red")),
    "flashes come after it": (HERE, seen(HERE, 0.0, 2.0, "red") + FLASHES),
    "a rest at the border's end": (THERE, seen(HERE, 0.0, 3.0, "red") + seen(THERE, 3.0, 4.0, "red")),
    "a longer one there": (THERE, seen(HERE, 0.0, 6.0, "red", rate=40) + seen(THERE, 8.0, 10.0, "red", rate=40)),
    "a shorter one": (THERE, seen(HERE, 0.0, 1.0, "red", rate=40) + seen(THERE, 3.0, 6.0, "red", rate=40)),
    # light that appears elsewhere is the seed if as many cameras see it
    "one camera's light": (HERE, POINTER + LIGHT),
    "both cameras' light": (FALSE, POINTER + seen(FALSE, 2.5, 5.5, *BOTH)),
    "seen on its way": (FALSE, POINTER + seen((HERE, (1.85, 0.93)), 1.7, 2.5, "green", rate=50) + LIGHT),
    "after the border's end": (FALSE, POINTER + LIGHT),
    "two at once": (FALSE, TWO),
    "two at once, the brighter one known": (THERE, TWO),
}
BORDERS = {
    "a rest at the border's end": around(HERE, 50),
    "a longer one there": around(HERE, 50),
    "after the border's end": np.zeros((3, 2)),
    "two at once, the brighter one known": around(FALSE, 200),
}
OTHERS = {"one camera's light": FALSE}
for rate in (5, 25, 100):  # one camera sees white paper all the time, another the pointer from its arrival on
    paper = seen(FALSE, 0.0, 6.0, "blue", rate=rate) + seen(THERE, 1.5, 6.0, "red", rate=18)
    SEEDS[f"paper, {rate}"] = SEEDS[f"known paper, {rate}"] = (THERE, paper)
    BORDERS[f"known paper, {rate}"] = around(FALSE, 1000)
# light that stays in a robot's image after the pointer was switched off: to a moving camera it is new
for last in (4, 7, 30):
    parts = seen(HERE, 0.0, 2.0, "red") + seen(THERE, 2.2, 2.2 + last, "robot", rate=5)
    SEEDS[f"a robot's, {last}"], SEEDS[f"only a robot's, {last}"] = (HERE, parts), (THERE, parts)
    OTHERS[f"a robot's, {last}"], BORDERS[f"only a robot's, {last}"] = THERE, around(HERE, 50)
for first, last in ((6.0, 1.5), (10.0, 2.0), (20.0, 3.0)):
    parts = seen(HERE, 0.0, first, "red", rate=40) + seen(THERE, first + 2, first + 2 + last, "red", rate=40)
    SEEDS[f"a longer one, {first:.0f}"], OTHERS[f"a longer one, {first:.0f}"] = (THERE, parts), HERE


@pytest.mark.parametrize("name", SEEDS)
def test_the_last_dwell_is_the_seed_and_a_longer_one_is_reported(name):
    for number in range(5):
        (seed, parts), other = SEEDS[name], OTHERS.get(name)
        drawn = find(parts, BORDERS.get(name, ()), number)[1]
        assert np.linalg.norm(drawn.seed - seed) < 0.02
        assert (drawn.other_dwell is None) == (other is None)
        assert other is None or np.linalg.norm(drawn.other_dwell.point - other) < 0.02


@pytest.mark.parametrize("apart, count", [(0.04, 1), (0.12, 2), (0.3, 2)])
def test_places_nearer_than_the_hand_s_tremor_are_one_dwell(apart, count):
    assert len(find(seen((1.0, 2.0), 0.0, 2.0, "red") + seen((1.0 + apart, 2.0), 2.0, 4.0, "red"))[0]) == count


@pytest.mark.parametrize("speed", [0.2, 0.3, 0.5])
def test_a_place_that_the_pointer_comes_to_is_one_dwell(speed):
    way = seen(((1.0, 0.0), HERE), 0.0, 1.0 / speed, "red") + seen(HERE, 1.0 / speed, 1.0 / speed + 3.0, "red")
    for seed in range(20):
        dwells, drawn = find(way, seed=seed)
        assert drawn.other_dwell is None
        assert len(dwells) == 1 or np.linalg.norm(dwells[-2].point) > 0.075


def test_a_camera_that_misses_images_sees_a_dwell():
    for seed in range(5):
        dwells, _ = find(seen(THERE, 0.0, 3.0, "blue", rate=5), seed=seed, dropped=0.2)
        assert len(dwells) == 1 and np.linalg.norm(dwells[0].point - THERE) < 0.03
