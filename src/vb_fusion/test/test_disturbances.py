"""Density must not outweigh geometry: a spot held still, and false spots that stay at one place."""

from functools import lru_cache

import pytest

from disturbances import beside, held, timed, with_fixed_place
from strokes import hausdorff

from vb_fusion.extraction import extract_border


@lru_cache(maxsize=None)
def undisturbed(shape: str, seed: int) -> float:
    """Hausdorff distance [m] that the same stroke has without the disturbance."""
    return distance(timed(shape, seed))


def distance(stroke) -> float:
    """Hausdorff distance [m] of the chain to the intended one."""
    chain = extract_border(stroke.points, stamps=stroke.stamps, cameras=stroke.cameras)
    assert chain.closed == stroke.closed, chain.reason
    return hausdorff(chain.points, stroke.truth, stroke.closed)


def test_a_spot_held_still_seldom_does_harm():
    """A rate over many draws: one draw tells nothing, and passes or fails by what it happens to be."""
    strokes = harmed = 0
    for shape in ("corner", "doorway", "rectangle"):
        for share in (0.0, 0.5, 1.0):
            for seed in range(4):
                count, cameras = ((250, 1), (750, 3))[seed % 2]
                disturbed = held(timed(shape, 200 + seed), share, count, cameras, seed)
                strokes += 1
                harmed += distance(disturbed) >= max(0.12, undisturbed(shape, 200 + seed) + 0.06)
    assert strokes == 36
    assert harmed <= 2, f"{harmed} of {strokes}"


# a place abreast of the middle, near an end, beside a short line
SCENES = [("corner", 0.5), ("corner", 0.02), ("doorway", 0.9)]
WHEN = ["at the same stamps", "interleaved", "before", "after", "throughout"]


@pytest.mark.parametrize("when", WHEN)
@pytest.mark.parametrize("away", [0.3, 0.6, 1.0])
def test_false_spots_at_one_place_seldom_do_harm(away, when):
    """A rate over many draws: one draw tells nothing, and passes or fails by what it happens to be."""
    strokes = harmed = 0
    for seed in range(10):
        for number, (shape, share) in enumerate(SCENES):
            stroke = timed(shape, 100 + seed)
            count = (100, 500, 2000)[(seed + number) % 3]
            seen = with_fixed_place(stroke, beside(stroke, away, share), count, when, seed % 2, seed)
            strokes += 1
            harmed += distance(seen) >= max(0.12, undisturbed(shape, 100 + seed) + 0.06)
    assert strokes == 30
    assert harmed <= 3, f"{harmed} of {strokes}"


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    "shape, places",
    [
        ("corner", [(0.5, 0.4, 1500, "throughout", 1)]),
        ("rectangle", [(0.5, 0.7, 1000, "throughout", 0)]),
        ("corner", [(0.6, 0.3, 800, "interleaved", 0), (0.4, 0.8, 800, "at the same stamps", 1)]),
        ("corner", [(0.0, 0.5, 1000, "throughout", 1)]),
    ],
    ids=["held still too", "closed", "two places", "on the line"],
)
def test_false_places_leave_the_line_as_it_is(shape, places, seed):
    stroke = timed(shape, seed)
    seen = held(stroke, 0.6, 500, 2, seed) if places[0][2] == 1500 else stroke
    for number, (away, share, count, when, camera) in enumerate(places):
        place = beside(stroke, away, share)
        seen = with_fixed_place(seen, place, count, when, camera, seed + 20 * number)
    assert distance(seen) < max(0.12, undisturbed(shape, seed) + 0.06)
