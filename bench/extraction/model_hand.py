#!/usr/bin/env python3
"""Measures border extraction on strokes of a hand that moves by published models (hand_movements.py).

    python3 bench/extraction/model_hand.py --other REVISION    also another version, on the same strokes
    python3 bench/extraction/model_hand.py --seed 500000       seeds below 1,000 are for development; unseen only once

Two cameras at 25 and 30 images/s have errors of 3 cm each; the hand's tremor is 1.2 cm; 20 % of the images and bursts of
0.2 s are dropped; 3 % of the spots are nearby strays.

A border is bad if it is more than 0.25 m (Hausdorff distance) from the drawn line, its kind is wrong, or extraction
fails. A bad border is silent if no warning says that spots were left out or not seen; *warned* counts these warnings.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from typing import Any, Callable, Dict, List, NamedTuple, Tuple

import numpy as np
from scipy.signal import lfilter

from bench.extraction import hand_movements
from bench.extraction.hand_movements import BOX, STEP, DrawnScene, trace_polygon, trace_ring, trace_with_hidden_piece
from bench.harness import TOP, ResultTable, arguments, import_from, share, versions

sys.path.insert(0, str(TOP / "src" / "vb_fusion" / "test"))
from generated_strokes import hausdorff  # noqa: E402

from vb_core import geometry  # noqa: E402

MODULES = "vb_fusion.extraction", "vb_fusion.spot_collector"
BAD_M = 0.25
MARGIN = 0.5  # [m] around the drawing, in which strays appear
RATES = (25.0, 30.0)  # [1/s] of the cameras
BIAS, NOISE = 0.03, 0.005  # [m] errors of the cameras
TREMOR = 0.012  # [m] of the hand
DROPPED, STRAYS = 0.2, 0.03  # shares of the images that are dropped, and of the spots that are strays
BURSTS = 0.3  # [1/s] rate of bursts of dropped images


class Judgement(NamedTuple):
    """Whether a border or seed is bad, whether it is bad without a warning, whether one was given, and the error [m]."""

    bad: bool
    silent: bool
    reported: bool
    error: float


def observe(scene: DrawnScene, rng: np.random.Generator):
    """Simulates the cameras' observation of a scene; returns points, stamps and cameras, in order of arrival."""
    end = len(scene.path) * STEP
    decay = np.exp(-STEP / 0.25)
    pushes = rng.normal(0.0, TREMOR * np.sqrt(1 - decay**2), scene.path.shape)
    hand = lfilter([1.0], [1.0, -decay], pushes, axis=0)
    rows = []
    for camera, rate in enumerate(RATES):
        t = np.arange(rng.uniform(0.0, 1.0 / rate), end, 1.0 / rate)
        for burst_start in rng.uniform(0.0, end, rng.poisson(BURSTS * end)):
            t = t[(t < burst_start) | (t > burst_start + rng.exponential(0.2))]
        index = np.minimum((t / STEP).astype(int), len(scene.path) - 1)
        seen = scene.shown[index] & (rng.random(len(t)) >= DROPPED)
        t, index = t[seen], index[seen]
        angle = rng.uniform(0.0, 2.0 * np.pi)
        bias = BIAS * np.array([np.cos(angle), np.sin(angle)])
        positions = scene.path[index] + hand[index] + bias + rng.normal(0.0, NOISE, (len(t), 2))
        rows.append(np.column_stack([t, positions, np.full(len(t), camera)]))
    count = int(round(STRAYS * sum(map(len, rows))))
    low, high = scene.path.min(axis=0) - MARGIN, scene.path.max(axis=0) + MARGIN
    strays = np.column_stack([rng.uniform(0.0, end, count), rng.uniform(low, high, (count, 2))])
    rows.append(np.column_stack([strays, rng.integers(0, len(RATES), count)]))
    rows = np.vstack(rows)
    rows = rows[np.argsort(rows[:, 0])]
    stamps = np.where(rows[:, 0] > 0.5 * end, rows[:, 0] - scene.setback, rows[:, 0])
    return rows[:, 1:3], stamps, rows[:, 3].astype(int)


def extract(scene: DrawnScene, state: str, modules: List[Any], rng: np.random.Generator) -> Any:
    """Returns the `DrawnBorder` of what the cameras see of a scene in this state."""
    extraction, collecting = modules
    collector = collecting.SpotCollector()
    collector.set_state(getattr(collecting, state), "drawing", 0.0)
    for position, stamp, camera in zip(*observe(scene, rng)):
        collector.add(collecting.FloorSpot(stamp, *position, str(camera), 1.0, False))
    live = extraction.LiveExtractor(extraction.ExtractionParams(), 1.0)
    return live.update(collector.snapshot(), time.monotonic)


def judge_seed(make: Callable, modules: List[Any], rng: np.random.Generator) -> Judgement:
    """Judges the seed as `judge_border` judges a border; it is bad if it is more than 15 cm from the intended point."""
    scene = make(rng)
    drawn = extract(scene, "SEED", modules, rng)
    error = float(np.hypot(*(scene.truth[0] - drawn.seed)))
    reported = drawn.competing_dwell is not None
    return Judgement(error > 0.15, error > 0.15 and not reported, reported, error)


def judge_border(make: Callable, modules: List[Any], rng: np.random.Generator) -> Judgement:
    """Judges the border that is extracted from what the cameras see of a scene."""
    scene = make(rng)
    chain = extract(scene, "BORDER", modules, rng).chain
    if chain is None:
        return Judgement(bad=True, silent=False, reported=True, error=np.nan)
    truth = scene.truth[np.append(True, np.hypot(*np.diff(scene.truth, axis=0).T) > 1e-9)]
    error = hausdorff(chain.points, geometry.resample_chain(truth, 0.01), scene.closed)
    bad = error > BAD_M or chain.closed != scene.closed
    gap = getattr(chain, "longest_unseen_gap", 0.0)
    reported = bool(chain.left_out_spots) or gap > 0.5 * modules[0].ExtractionParams().eps
    return Judgement(bad, bad and not reported, reported, error)


ROWS: Dict[str, Tuple[Callable, int]] = {
    "figures and lines": (hand_movements.trace_random_figure, 120),
    "hidden piece of 0.5, 0.6, 0.8 m": (lambda rng: trace_with_hidden_piece(rng.choice([0.5, 0.6, 0.8]), rng), 120),
    "sides in the order 1-3-2-4": (hand_movements.trace_sides_apart, 30),
    "pointer lifted once": (hand_movements.trace_with_lifted_pointer, 60),
    "5 cm/s": (hand_movements.trace_slowly, 80),
    **{f"ring of {size:g} m": (lambda rng, size=size: trace_ring(size, rng), 40) for size in (0.2, 0.3)},
    "clocks set back by 5 s": (lambda rng: replace(trace_polygon(BOX, True, rng), setback=5.0), 12),
    "seed, held longer at a wrong place before": (hand_movements.hold_twice, 60),
}


def main() -> None:
    """Measures all rows."""
    parser = arguments(__doc__, seed=0, other=True)
    parser.add_argument("--times", type=float, default=1.0, help="factor for each row's number of strokes")
    options = parser.parse_args()
    table = ResultTable(options.csv, options.seed)
    for number, (name, (make, count)) in enumerate(ROWS.items()):
        for version, source in versions(options).items():
            modules = import_from(source, *MODULES)
            stroke_count = max(1, int(count * options.times))
            judge_stroke = judge_seed if make is hand_movements.hold_twice else judge_border
            rngs = [np.random.default_rng([options.seed + k, number]) for k in range(stroke_count)]
            judgements = [judge_stroke(make, modules, rng) for rng in rngs]
            bad, silent, reported, errors = np.array(judgements, float).T
            shares = {"bad": share(int(bad.sum()), len(bad)), "silent": share(int(silent.sum()), len(silent))}
            median_m = float(np.nanmedian(errors))
            table.add(row=name, version=version, **shares, warned=int(reported.sum()), median_m=median_m)


if __name__ == "__main__":
    main()
