"""The dwells (places where the hand rested), and the one among them that is the seed."""

from typing import NamedTuple, Optional, Tuple

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from examples import STEADY, rows
from refusals import refused
from vb_fusion.extraction import DrawnBorder, extract_dwells
from vb_fusion.seed_point import find_stays, group_into_patches


@pytest.mark.parametrize("points, code", [([], "no_spots"), ([[np.nan, 1]], "no_spots"), ([[0, 0]], "no_seed")])
def test_too_few_or_non_finite_spots_are_refused(points, code):
    with refused(code):
        extract_dwells(points, stamps=np.arange(len(points)) / 25.0)


def seen(place, first, last, *cameras, rate=25):
    """Returns parts of a scene, one per camera: a light at a place, or moving between two, from first to last [s]."""
    return [(place, first, last, rate, camera) for camera in cameras]


def find(parts, border=(), random_seed=0, dropped=0.0):
    """Returns the dwells of a scene after the spots of a border. The camera called `robot` is on a robot."""
    rng = np.random.default_rng(random_seed)
    spots = []
    for place, first, last, rate, camera in parts:
        count = int((last - first) * rate)
        path = place if np.ndim(place) == 1 else np.linspace(*place, count)
        points = rng.normal(path, 0.015, (count, 2))
        spots.append((points, np.sort(rng.uniform(first, last, count)), np.full(count, camera)))
    columns = [np.concatenate(column) for column in zip(*spots)]
    kept = np.random.default_rng(random_seed).random(len(columns[0])) >= dropped
    points, stamps, cameras = (column[kept] for column in columns)
    return extract_dwells(points, border_points=border, stamps=stamps, cameras=cameras, mobile=cameras == "robot")


def around(place, count):
    """Returns border spots around a place."""
    return np.random.default_rng(2).normal(place, 0.015, (count, 2))


class Scene(NamedTuple):
    """A scene, the border's spots before it, the seed that is expected, and the place that is reported as well."""

    seed: Tuple[float, float]
    parts: list
    border: np.ndarray = np.zeros((0, 2))
    other: Optional[Tuple[float, float]] = None


HERE, THERE, FALSE = (0.0, 0.0), (1.0, 2.0), (2.0, 1.0)
BOTH = ("red", "green")
POINTER = seen(HERE, 0.0, 1.7, *BOTH)
LIGHT = seen(FALSE, 2.5, 5.5, "green")
FLASHES = [part for i in range(5) for part in seen(THERE, 3.0 + i, 3.3 + i, "blue", rate=10)]  # flashes from paper
TWO = seen(FALSE, 0.0, 3.0, *BOTH) + seen(THERE, 0.0, 3.0, "blue")
LONGER = seen(HERE, 0.0, 6.0, "red", rate=40) + seen(THERE, 8.0, 10.0, "red", rate=40)
SCENES = {
    "two cameras off": Scene(THERE, seen((1.02, 2.0), 0.0, 2.0, "red") + seen((0.98, 2.0), 0.0, 2.0, "green")),
    "later": Scene(THERE, seen(HERE, 0.0, 2.0, "red") + seen(THERE, 2.0, 4.0, "red")),
    "back again": Scene(HERE, seen(HERE, 0, 2, "red") + seen(THERE, 2, 4, "red") + seen(HERE, 4, 6, "red")),
    "more cameras": Scene(THERE, seen(THERE, 0.0, 6.0, *BOTH, rate=18) + seen(FALSE, 1.5, 6.0, "blue", rate=100)),
    "in turn": Scene(THERE, seen(FALSE, 0.0, 8.0, "blue", rate=15) + seen(THERE, 2.0, 8.0, "blue", rate=6)),
    "the way there": Scene(THERE, seen((HERE, THERE), 0.0, 2.4, "red") + seen(THERE, 2.4, 3.6, "red")),
    "moving on": Scene(THERE, seen(THERE, 0.0, 2.0, "red") + seen((THERE, (1.8, 2)), 2.0, 2.8, "red")),
    "flashes come after it": Scene(HERE, seen(HERE, 0.0, 2.0, "red") + FLASHES),
    "a rest at the border's end": Scene(THERE, seen(HERE, 0, 3, "red") + seen(THERE, 3, 4, "red"), around(HERE, 50)),
    "a longer one there": Scene(THERE, LONGER, border=around(HERE, 50)),
    "a shorter one": Scene(THERE, seen(HERE, 0.0, 1.0, "red", rate=40) + seen(THERE, 3.0, 6.0, "red", rate=40)),
    # light that appears elsewhere is the seed if as many cameras see it
    "one camera's light": Scene(HERE, POINTER + LIGHT, other=FALSE),
    "both cameras' light": Scene(FALSE, POINTER + seen(FALSE, 2.5, 5.5, *BOTH)),
    "seen on its way": Scene(FALSE, POINTER + seen((HERE, (1.85, 0.93)), 1.7, 2.5, "green", rate=50) + LIGHT),
    "after the border's end": Scene(FALSE, POINTER + LIGHT, border=np.zeros((3, 2))),
    "two at once": Scene(FALSE, TWO),
    "two at once, the brighter one known": Scene(THERE, TWO, border=around(FALSE, 200)),
}
for rate in (5, 25, 100):  # one camera sees white paper all the time, another the pointer from its arrival on
    paper = seen(FALSE, 0.0, 6.0, "blue", rate=rate) + seen(THERE, 1.5, 6.0, "red", rate=18)
    SCENES[f"paper, {rate}"] = Scene(THERE, paper)
    SCENES[f"known paper, {rate}"] = Scene(THERE, paper, border=around(FALSE, 1000))
# light that stays in a robot's image after the pointer was switched off: to a moving camera it is new
for last in (4, 7, 30):
    parts = seen(HERE, 0.0, 2.0, "red") + seen(THERE, 2.2, 2.2 + last, "robot", rate=5)
    SCENES[f"a robot's, {last}"] = Scene(HERE, parts, other=THERE)
    SCENES[f"only a robot's, {last}"] = Scene(THERE, parts, border=around(HERE, 50))
for first, last in ((6.0, 1.5), (10.0, 2.0), (20.0, 3.0)):
    parts = seen(HERE, 0.0, first, "red", rate=40) + seen(THERE, first + 2, first + 2 + last, "red", rate=40)
    SCENES[f"a longer one, {first:.0f}"] = Scene(THERE, parts, other=HERE)


@pytest.mark.parametrize("scene", SCENES.values(), ids=list(SCENES))
def test_the_last_dwell_is_the_seed_and_a_longer_one_is_reported(scene):
    for random_seed in range(5):
        drawn = DrawnBorder(dwells=find(scene.parts, scene.border, random_seed))
        assert np.linalg.norm(drawn.seed - scene.seed) < 0.02
        if scene.other is None:
            assert drawn.competing_dwell is None
        else:
            assert np.linalg.norm(drawn.competing_dwell.point - scene.other) < 0.02


@pytest.mark.parametrize("apart, count", [(0.04, 1), (0.12, 2), (0.3, 2)])
def test_places_nearer_than_the_hand_s_tremor_are_one_dwell(apart, count):
    dwells = find(seen((1.0, 2.0), 0.0, 2.0, "red") + seen((1.0 + apart, 2.0), 2.0, 4.0, "red"))
    assert len(dwells) == count


@pytest.mark.parametrize("speed", [0.2, 0.3, 0.5])
def test_a_place_that_the_pointer_comes_to_is_one_dwell(speed):
    arrival = 1.0 / speed
    parts = seen(((1.0, 0.0), HERE), 0.0, arrival, "red") + seen(HERE, arrival, arrival + 3.0, "red")
    for random_seed in range(20):
        dwells = find(parts, random_seed=random_seed)
        assert DrawnBorder(dwells=dwells).competing_dwell is None
        if len(dwells) > 1:
            assert np.linalg.norm(dwells[-2].point) > 0.075


def test_a_camera_that_misses_images_sees_a_dwell():
    for random_seed in range(5):
        (dwell,) = find(seen(THERE, 0.0, 3.0, "blue", rate=5), random_seed=random_seed, dropped=0.2)
        assert np.linalg.norm(dwell.point - THERE) < 0.03


@settings(STEADY, max_examples=60)
@given(rows(st.integers(0, 3), st.integers(1, 9), most=60))
def test_light_stays_where_it_is_seen_again_within_half_a_second(steps):
    patch, bins = np.array([number for number, _ in steps]), np.cumsum([wait for _, wait in steps])
    stays = []  # lists of clusters; a bin is 0.1 s
    for number in range(4):
        on_patch = np.flatnonzero(patch == number).tolist()
        for before, cluster in zip([None, *on_patch], on_patch):
            if before is None or bins[cluster] - bins[before] > 5:
                stays.append([])
            stays[-1].append(cluster)
    held = [stay for stay in stays if len(stay) >= 7] or [max(stays, key=len)]
    expected = [sum((stay for stay in held if patch[stay[0]] == number), []) for number in range(4)]
    found = [clusters.tolist() for clusters in find_stays(patch, bins)]
    assert found == sorted(filter(None, expected), key=lambda clusters: clusters[-1])


def test_a_floor_patch_is_as_wide_as_a_hand_that_holds_still():
    """It is 0.075 m from the first cluster on a patch to its last; between two patches, the nearer one is meant."""
    x = [0.0, 0.07, 0.08, 0.05, 0.03, 0.05, 0.0, 0.0]
    y = [0.0, 0.0, 0.0, 0.0, 0.0, 0.06, 0.08, 0.05]
    patch, earlier = group_into_patches(np.column_stack([x, y]))
    assert patch.tolist() == [0, 0, 1, 1, 0, 1, 2, 2]
    assert earlier.tolist() == [0, 1, 0, 1, 2, 2, 0, 1]
