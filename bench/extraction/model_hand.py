#!/usr/bin/env python3
"""Measures border extraction on strokes of a hand that moves by published models.

    python3 bench/extraction/model_hand.py --other REVISION    also another version, on the same strokes
    python3 bench/extraction/model_hand.py --seed 500000       seeds below 1,000 are for development; unseen only once

Sides are minimum-jerk movements (Flash and Hogan, J. Neurosci. 5, 1985); the speed on curves is proportional to
curvature^(-1/3) (Lacquaniti, Terzuolo and Viviani, Acta Psychol. 54, 1983). Corners are missed by 0.75 % of the figure
and 5 mm, sides bend by 1 % of their length (assumed). Two cameras at 25 and 30 images/s have errors of 3 cm each; the
hand's tremor is 1.2 cm; 20 % of the images and bursts of 0.2 s are dropped; 3 % of the spots are nearby strays.

A border is bad if it is more than 0.25 m (Hausdorff distance) from the drawn line, its kind is wrong, or extraction
fails. A bad border is silent if no warning says that spots were left out or not seen; *told* counts these warnings.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace
from typing import Any, Callable, Dict, List, NamedTuple, Tuple

import numpy as np
from scipy.signal import lfilter

from bench.harness import TOP, Table, arguments, import_from, share, versions

sys.path.insert(0, str(TOP / "src" / "vb_fusion" / "test"))
from generated_strokes import hausdorff  # noqa: E402

from vb_core import geometry  # noqa: E402

MODULES = "vb_fusion.extraction", "vb_fusion.spot_collector"
BAD_M = 0.25
MARGIN = 0.5  # [m] around the drawing, in which strays appear
SLOW = 0.1  # [m/s] below which a hand moves at constant speed
STEP = 0.005  # [s] between samples of the hand's movement
BEND = 0.01  # [share of a side's length]
BOX = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.2], [0.0, 1.2]])
# errors of the cameras and the hand
RATES = (25.0, 30.0)  # [1/s] of the cameras
BIAS, NOISE, TREMOR = 0.03, 0.005, 0.012  # [m]
DROPPED, BURSTS, STRAYS = 0.2, 0.3, 0.03  # share, [1/s], share


class Judgement(NamedTuple):
    """Whether a border or seed is bad, and that silently; whether a warning was given; and the error [m]."""

    bad: bool
    silent: bool
    reported: bool
    error: float


@dataclass
class Scene:
    """A drawn line, the pointer's path (N, 2) [m] in steps of STEP, and whether cameras see the spot at each step."""

    truth: np.ndarray
    closed: bool
    path: np.ndarray
    shown: np.ndarray
    setback: float = 0.0  # [s] by which all clocks are set back in the middle


def side(start, end, speed: float, rng: np.random.Generator) -> np.ndarray:
    """Returns a movement between two points with minimum jerk, or at constant speed if the hand is slow."""
    offset = np.subtract(end, start)
    length = float(np.hypot(*offset))
    u = np.linspace(0.0, 1.0, max(2, int(length / speed / STEP)))
    progress = u**3 * (10.0 - 15.0 * u + 6.0 * u * u) if speed > SLOW else u
    bend = rng.normal(0.0, BEND) * np.sin(np.pi * progress)
    across = np.array([-offset[1], offset[0]])
    return start + progress[:, None] * offset + bend[:, None] * across


def curve(line: np.ndarray, speed: float) -> np.ndarray:
    """Returns a movement along a smooth dense line by the power law, which starts and ends at rest."""
    d = np.gradient(line, axis=0)
    dx, dy = d.T
    ddx, ddy = np.gradient(d, axis=0).T
    ds = np.hypot(dx, dy)
    curvature = np.abs(dx * ddy - dy * ddx) / ds**3
    progress = np.cumsum(ds * np.maximum(curvature, 0.2) ** (1.0 / 3.0))
    u = np.linspace(0.0, 1.0, int(ds.sum() / speed / STEP))
    eased = np.clip((u - 0.1 * np.sin(2.0 * np.pi * u) / (2.0 * np.pi) * 8.0), 0.0, 1.0)
    shares = (progress - progress[0]) / np.ptp(progress)
    return np.column_stack([np.interp(eased, shares, axis) for axis in line.T])


def missed(targets: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Returns the points that a hand aiming at points (N, 2) hits."""
    return targets + rng.normal(0.0, 1.0, targets.shape) * (0.005 + 0.0075 * np.hypot(*np.ptp(targets, axis=0)))


def polygon(corners: np.ndarray, closed: bool, rng: np.random.Generator, speed=(0.2, 0.5)) -> Scene:
    """Draws one side after another, with a short rest at each corner."""
    corners_hit = missed(np.vstack([corners, corners[:1]]) if closed else corners, rng)
    pace, parts = rng.uniform(*speed), []
    for start, end in zip(corners_hit, corners_hit[1:]):
        parts += [side(start, end, pace, rng), np.repeat([end], int(rng.uniform(0.0, 0.4) / STEP), axis=0)]
    path = np.vstack(parts)
    return Scene(path, closed, path, np.ones(len(path), bool))


def ring(size: float, rng: np.random.Generator, sweep: float = 2.0 * np.pi, flat=(0.85, 1.0)) -> Scene:
    """Draws an ellipse or a part of it; the end of a whole ellipse misses its start."""
    angle = rng.uniform(0.0, 2.0 * np.pi) + np.linspace(0.0, sweep, 800)
    flatness = rng.uniform(*flat)
    line = 0.5 * size * np.column_stack([np.cos(angle), flatness * np.sin(angle)])
    miss = rng.normal(0.0, 0.005 + 0.015 * size, 2)
    line += np.linspace(0.0, 1.0, 800)[:, None] * miss
    path = curve(line, rng.uniform(0.2, 0.5) * min(1.0, (size / 0.6) ** 0.5))
    return Scene(path, sweep > 6.0, path, np.ones(len(path), bool))


def hidden(width: float, rng: np.random.Generator) -> Scene:
    """Draws a box, of which no camera sees a piece."""
    scene = polygon(np.roll(BOX, rng.integers(4), axis=0), True, rng)
    arc = geometry.arc_lengths(scene.path)
    scene.shown = np.abs(arc - rng.uniform(0.6, arc[-1] - 0.6)) > 0.5 * width
    return scene


def lifted(rng: np.random.Generator) -> Scene:
    """Draws a box and switches the pointer off once, and continues some centimetres before or after that point."""
    scene = polygon(BOX, True, rng)
    off = int(rng.uniform(0.2, 0.8) * len(scene.path))
    pause = int(rng.uniform(0.5, 3.0) / STEP)
    on = max(0, off + int(rng.uniform(-0.4, 0.4) / STEP))
    scene.path = np.vstack([scene.path[:off], np.repeat(scene.path[off : off + 1], pause, axis=0), scene.path[on:]])
    scene.shown = np.ones(len(scene.path), bool)
    scene.shown[off : off + pause] = False
    return scene


def sides_apart(rng: np.random.Generator) -> Scene:
    """Draws the sides of a box in the order 1-3-2-4, with the pointer off between them."""
    speed, parts, shown, drawn = rng.uniform(0.2, 0.5), [], [], {}
    for number in (0, 2, 1, 3):
        ends = missed(BOX[[number, (number + 1) % 4]], rng)
        if parts:
            parts.append(side(parts[-1][-1], ends[0], 1.2, rng))
            shown.append(np.zeros(len(parts[-1]), bool))
        drawn[number] = side(ends[0], ends[1], speed, rng)
        parts.append(drawn[number])
        shown.append(np.ones(len(drawn[number]), bool))
    return Scene(np.vstack([drawn[number] for number in range(4)]), True, np.vstack(parts), np.concatenate(shown))


def look(scene: Scene, rng: np.random.Generator):
    """Simulates the cameras' observation of a scene; returns points, stamps and cameras, in order of arrival."""
    end = len(scene.path) * STEP
    decay = np.exp(-STEP / 0.25)
    hand = lfilter([1.0], [1.0, -decay], rng.normal(0.0, TREMOR * np.sqrt(1 - decay**2), scene.path.shape), axis=0)
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


def shapes(rng: np.random.Generator) -> Scene:
    """Draws a figure or line as people do; the ends of a line are at least half of the figure apart."""
    figures = [BOX, BOX[:3] * [0.6, 1.2], 0.7 * BOX @ [[0.8, 0.6], [-0.6, 0.8]]]
    kind = rng.integers(6)
    if kind < 3:
        return polygon(figures[kind], True, rng)
    if kind == 3:
        return polygon(BOX[:3], False, rng)
    radius = rng.uniform(0.6, 2.0)
    if kind == 4:
        return ring(radius, rng, 2.0 * np.pi, (0.5, 1.0))
    return ring(radius, rng, rng.uniform(1.5, 3.5))


def slow(rng: np.random.Generator) -> Scene:
    """Draws a line or a small box at 5 cm/s."""
    small = rng.random() < 0.5
    return polygon(0.6 * BOX if small else np.array([[0.0, 0.0], [0.9, 0.0]]), bool(small), rng, (0.05, 0.05))


def held(rng: np.random.Generator) -> Scene:
    """Holds the pointer at a wrong point, then shorter at the intended one, switched on or off in between."""
    seconds = ((6.0, 1.5), (10.0, 2.0), (20.0, 3.0))[rng.integers(3)]
    wrong_point, angle = rng.uniform(-1.0, 1.0, 2), rng.uniform(0.0, 2.0 * np.pi)
    right_point = wrong_point + rng.uniform(0.4, 1.6) * np.array([np.cos(angle), np.sin(angle)])
    parts = [np.repeat([point], int(time / STEP), axis=0) for point, time in zip((wrong_point, right_point), seconds)]
    parts.insert(1, side(wrong_point, right_point, rng.uniform(0.3, 1.0), rng))
    shown = [np.ones(len(part), bool) for part in parts]
    shown[1][:] = rng.random() < 0.5
    return Scene(right_point[None], False, np.vstack(parts), np.concatenate(shown))


def extract(scene: Scene, state: str, modules: List[Any], rng: np.random.Generator) -> Any:
    """Returns the `DrawnBorder` of what the cameras see of a scene in this state."""
    extraction, collecting = modules
    collector = collecting.SpotCollector()
    collector.set_state(getattr(collecting, state), "drawing", 0.0)
    for position, stamp, camera in zip(*look(scene, rng)):
        collector.add(collecting.FloorSpot(stamp, *position, str(camera), 1.0, False))
    live = extraction.LiveExtractor(extraction.ExtractionParams(), 1.0)
    return live.update(collector.snapshot(), time.monotonic)


def judge_seed(make: Callable, modules: List[Any], rng: np.random.Generator) -> Judgement:
    """Judges the seed as `judge` judges a border; it is bad if it is more than 15 cm from the intended point."""
    scene = make(rng)
    drawn = extract(scene, "SEED", modules, rng)
    error = float(np.hypot(*(scene.truth[0] - drawn.seed)))
    reported = drawn.competing_dwell is not None
    return Judgement(error > 0.15, error > 0.15 and not reported, reported, error)


def judge(make: Callable, modules: List[Any], rng: np.random.Generator) -> Judgement:
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
    "figures and lines": (shapes, 120),
    "hidden piece of 0.5, 0.6, 0.8 m": (lambda rng: hidden(rng.choice([0.5, 0.6, 0.8]), rng), 120),
    "sides in the order 1-3-2-4": (sides_apart, 30),
    "pointer lifted once": (lifted, 60),
    "5 cm/s": (slow, 80),
    **{f"ring of {size:g} m": (lambda rng, size=size: ring(size, rng), 40) for size in (0.2, 0.3)},
    "clocks set back by 5 s": (lambda rng: replace(polygon(BOX, True, rng), setback=5.0), 12),
    "seed, held longer at a wrong place before": (held, 60),
}


def main() -> None:
    """Measures all rows."""
    parser = arguments(__doc__, seed=0, other=True)
    parser.add_argument("--times", type=float, default=1.0, help="factor for each row's number of strokes")
    options = parser.parse_args()
    table = Table(options.csv, options.seed)
    for number, (name, (make, count)) in enumerate(ROWS.items()):
        for version, source in versions(options).items():
            modules, seeds = import_from(source, *MODULES), range(max(1, int(count * options.times)))
            judge_stroke = judge_seed if make is held else judge
            judgements = [judge_stroke(make, modules, np.random.default_rng([options.seed + k, number])) for k in seeds]
            bad, silent, reported, errors = np.array(judgements, float).T
            shares = {key: share(int(flags.sum()), len(flags)) for key, flags in (("bad", bad), ("silent", silent))}
            median_m = float(np.nanmedian(errors))
            table.add(row=name, version=version, **shares, told=int(reported.sum()), median_m=median_m)


if __name__ == "__main__":
    main()
