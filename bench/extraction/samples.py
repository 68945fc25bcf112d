"""The strokes that extraction is judged by: people's, generated ones, and ones with a disturbance; for accuracy.py."""

from __future__ import annotations

import sys
from typing import Iterator, Tuple

import numpy as np

from bench.frame import TOP

sys.path.insert(0, str(TOP / "src" / "vb_fusion" / "test"))
import people  # noqa: E402
from disturbances import beside, held, timed, with_fixed_place  # noqa: E402
from strokes import SHAPES, Setting, Stroke, draw, hausdorff, jaccard  # noqa: E402, F401

USUAL = Setting()
SETTINGS = {
    "usual": USUAL,
    "rough": USUAL.replace(tremor=0.03, bias=0.04, noise=0.02),
    "outliers 10 %": USUAL.replace(outliers=0.10),
    "outliers 20 %": USUAL.replace(outliers=0.20),
    "slow 0.2 m/s": USUAL.replace(speed=0.2),
    "fast 1 m/s": USUAL.replace(speed=1.0),
    "1 camera": USUAL.replace(cameras=1),
    "4 cameras": USUAL.replace(cameras=4),
    "white tremor": USUAL.replace(tremor_time=0.02),
    "gap 0.4 m": USUAL.replace(gap=0.4),
    "ends 0.4 m apart": USUAL.replace(end_gap=0.4),
    "ends overlap 0.4 m": USUAL.replace(overlap=0.4),
    "drawn twice": USUAL.replace(passes=2),
}
CLOSED_ONLY = ("gap", "ends")
ROBOT = "two fifths seen by a robot only"
PEOPLE = {
    "0.2-0.5 m/s": people.Seen(),
    "0.3-0.7 m/s": people.Seen(speed=(0.3, 0.7)),
    "0.2-0.5 m/s, half the frames dropped": people.Seen(dropped=0.5),
    "0.5-1.0 m/s": people.Seen(speed=(0.5, 1.0)),
    "1 camera at 30 frames/s": people.Seen(cameras=1, rate=30.0),
    "4 cameras at 10 frames/s, 4 cm off": people.Seen(cameras=4, rate=10.0, bias=0.04),
    ROBOT: people.Seen(robot=people.Localization()),
    f"{ROBOT}, off by 5 cm, 3 deg": people.Seen(robot=people.Localization(0.05, 0.05)),
    f"{ROBOT}, off by 5 cm, 3 deg, every 3 s": people.Seen(robot=people.Localization(0.05, 0.05, 3.0)),
}
Group = Tuple[str, Iterator[Stroke]]  # name of a cell, and its strokes


def strokes_of_people(which: str, draws: int, base: int) -> Iterator[Group]:
    """Yields people's strokes of one half, each seen several times, a cell for each way of seeing."""
    drawings = [one for one in enumerate(people.drawings()) if which == people.half(one[1])]
    for name, seen in PEOPLE.items():
        rngs = (
            (drawing, np.random.default_rng([base + k, number])) for number, drawing in drawings for k in range(draws)
        )
        yield name, (people.see(drawing, seen, rng) for drawing, rng in rngs)


def generated(name: str, count: int, base: int) -> Iterator[Group]:
    """Yields strokes of all shapes in one setting."""
    for shape in (shape for shape in SHAPES if shape != "circle"):
        if SHAPES[shape][1] or not name.startswith(CLOSED_ONLY):
            which = sorted(SHAPES).index(shape)
            seeds = (np.random.default_rng([base + k, which]) for k in range(count))
            yield f"{name}, {shape}", (draw(shape, SETTINGS[name], seed) for seed in seeds)


def disturbed(count: int, base: int) -> Iterator[Group]:
    """Yields strokes with a disturbance: a spot held still, false spots at one place."""
    share = max(1, count // 9)
    for spots, cameras in ((250, 1), (750, 3)):
        for where, when in (("start", 0.0), ("middle", 0.5), ("end", 1.0)):
            yield (
                f"held still 10 s at the {where}, {spots} spots",
                (
                    held(timed(shape, base + k), when, spots, cameras, base + k)
                    for shape in ("corner", "doorway", "rectangle")
                    for k in range(share)
                ),
            )
    for when in ("at the same stamps", "interleaved", "before", "after", "throughout"):
        for away in (0.3, 0.6, 1.0):
            yield (
                f"false spots {when}, {away} m away",
                (
                    with_fixed_place(stroke, beside(stroke, away, part), spots, when, k % 2, base + k)
                    for k in range(max(1, share // 3))
                    for shape, part in (("corner", 0.5), ("corner", 0.02), ("doorway", 0.9))
                    for spots in (100, 500, 2000)
                    for stroke in [timed(shape, base + k)]
                ),
            )
