#!/usr/bin/env python3
"""The border of a hand that moves by published models.

    python3 bench/extraction/model_hand.py --other 8df6eb0     beside another version, on the same strokes
    python3 bench/extraction/model_hand.py --seed 500000       seeds below 1,000 are for development; a range is fresh once

Sides are minimum-jerk movements (Flash and Hogan, J. Neurosci. 5, 1985); on curves the speed is proportional to the
curvature's power -1/3 (Lacquaniti, Terzuolo and Viviani, Acta Psychol. 54, 1983). Corners are missed by 0.75 % of the
figure and 5 mm, sides bend by 1 % of their length (assumed). Two cameras at 25 and 30 images/s are off by 3 cm each; the
hand trembles by 1.2 cm; 20 % of the images and bursts of 0.2 s are dropped; 3 % of the spots are strays near the drawing.

A border is bad if it is more than 0.25 m (Hausdorff distance) from what was drawn, its kind is wrong, or there is none;
a bad one is silent if nothing tells that something was left out or not seen; *told* is how often that was said at all.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any, Callable, Dict, List, Tuple

import numpy as np

from bench.extraction.hand import BOX, Eyes, held, hidden, lifted, look, polygon, ring, shapes, sides_apart, slow
from bench.frame import TOP, Table, arguments, import_from, share, versions

sys.path.insert(0, str(TOP / "src" / "vb_fusion" / "test"))
from strokes import hausdorff  # noqa: E402

from vb_core import geometry  # noqa: E402

MODULES = (
    "vb_fusion.extraction",
    "vb_fusion.collector",
    "vb_core.errors",
    "vb_fusion.live_extraction",
    "vb_fusion.stroke.seed",
)
BAD_M = 0.25
Judgement = Tuple[bool, bool, bool, float]


def judge_seed(make: Callable, eyes: Eyes, modules: List[Any], rng: np.random.Generator) -> Judgement:
    """Judges the seed as `judge` does a border; 15 cm beside the place that is meant it is bad."""
    scene, live, finding = make(rng), *modules[3:]
    points, stamps, cameras = look(scene, eyes, rng)
    drawn = live.DrawnBorder(dwells=finding.find_dwells(points, stamps=stamps, cameras=cameras))
    off = float(np.hypot(*(scene.truth[0] - drawn.seed)))
    told = drawn.other_dwell is not None
    return off > 0.15, off > 0.15 and not told, told, off


def judge(make: Callable, eyes: Eyes, modules: List[Any], rng: np.random.Generator) -> Judgement:
    """Returns whether the border is bad, whether silently, whether something is told, and how far off it is [m]."""
    extraction, collecting, errors = modules[:3]
    scene = make(rng)
    collector = collecting.Collector()
    collector.set_state(collecting.BORDER, "drawing", 0.0)
    for at, stamp, camera in zip(*look(scene, eyes, rng)):
        collector.add(collecting.FloorSpot(stamp, *at, str(camera), 1.0, False))
    rows = collector.collection().border
    try:
        chain = extraction.extract_border(rows[:, 1:3], stamps=rows[:, 0], cameras=rows[:, 4].astype(int))
    except errors.CodedError:
        return True, False, True, np.nan
    truth = scene.truth[np.append(True, np.hypot(*np.diff(scene.truth, axis=0).T) > 1e-9)]
    off = hausdorff(chain.points, geometry.resample_chain(truth, 0.01), scene.closed)
    bad = off > BAD_M or chain.closed != scene.closed
    told = bool(chain.left_out_spots) or getattr(chain, "unseen", 0.0) > 0.5 * extraction.ExtractionParams().eps
    return bad, bad and not told, told, off


USUAL = Eyes()
ROWS: Dict[str, Tuple[Callable, Eyes, int]] = {
    "figures and lines": (shapes, USUAL, 120),
    "hidden piece of 0.5, 0.6, 0.8 m": (lambda rng: hidden(rng.choice([0.5, 0.6, 0.8]), rng), USUAL, 120),
    "sides in the order 1-3-2-4": (sides_apart, USUAL, 30),
    "pointer lifted once": (lifted, USUAL, 60),
    "5 cm/s": (slow, USUAL, 80),
    **{f"ring of {size:g} m": (lambda rng, size=size: ring(size, rng), USUAL, 40) for size in (0.2, 0.3)},
    "clocks set back by 5 s": (lambda rng: polygon(BOX, True, rng), replace(USUAL, setback=5.0), 12),
    "seed, held longer at a wrong place before": (held, USUAL, 60),
}


def main() -> None:
    """Measures row by row."""
    parser = arguments(__doc__, seed=0, other=True)
    parser.add_argument("--times", type=float, default=1.0, help="of each row's number of strokes")
    parser.add_argument("--only", nargs="*", default=[""], help="rows with one of these in their names")
    given = parser.parse_args()
    table = Table(given.csv)
    for number, (name, (make, eyes, count)) in enumerate(ROWS.items()):
        for version, source in versions(given).items() if any(part in name for part in given.only) else ():
            modules, seeds = import_from(source, *MODULES), range(max(1, int(count * given.times)))
            look_at = judge_seed if make is held else judge
            found = [look_at(make, eyes, modules, np.random.default_rng([given.seed + k, number])) for k in seeds]
            bad, silent, told, off = np.array(found, float).T
            counts = {"bad": int(bad.sum()), "silent": share(int(silent.sum()), len(found)), "told": int(told.sum())}
            table.add(row=name, version=version, **counts, median_m=float(np.nanmedian(off)))


if __name__ == "__main__":
    main()
