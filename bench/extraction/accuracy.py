#!/usr/bin/env python3
"""Measures border extraction on people's and generated strokes, beside the paper's mode and another version.

    python3 bench/extraction/accuracy.py --judge               people's and generated strokes for judging, about an hour
    python3 bench/extraction/accuracy.py --other 3655b17       also the code of another revision, on the same strokes
    python3 bench/extraction/accuracy.py --judge --seed 300000 other seeds, which are unseen only the first time

By default, the development half of people's strokes and seeds below 1,000 are used; with --judge, the other half and
seeds from 100,000 or --seed. A generated stroke is bad if its chain is more than 0.25 m (Hausdorff distance) from the
intended chain, or if extraction fails. A person's stroke is bad if the extracted line is more than 0.25 m from the
drawn one. Of a polygon, only the distance of the extracted line from the drawn one counts, not the reverse; but a
Jaccard index below 0.8 is bad too. Times are processor time.
"""

from __future__ import annotations

import sys
import time
from typing import Any, Callable, Dict, Iterator, List, Tuple

import numpy as np
from scipy.spatial import cKDTree

from bench.harness import TOP, ResultTable, arguments, import_from, share
from vb_core import geometry
from vb_fusion import extraction

sys.path.insert(0, str(TOP / "src" / "vb_fusion" / "test"))
import people_strokes  # noqa: E402
from disturbances import beside, held, timed, with_fixed_place  # noqa: E402
from generated_strokes import SHAPES, Setting, Stroke, draw, hausdorff, jaccard  # noqa: E402

BAD_M, BAD_JACCARD = 0.25, 0.8
Extract = Callable[[Stroke], Any]

USUAL = Setting()
SETTINGS = {
    "usual": USUAL,
    "outliers 20 %": USUAL.replace(outliers=0.20),
    "slow 0.2 m/s": USUAL.replace(speed=0.2),
    "fast 1 m/s": USUAL.replace(speed=1.0),
    "white tremor": USUAL.replace(tremor_time=0.02),
    "gap 0.4 m": USUAL.replace(gap=0.4),
    "ends 0.4 m apart": USUAL.replace(end_gap=0.4),
    "ends overlap 0.4 m": USUAL.replace(overlap=0.4),
    "drawn twice": USUAL.replace(passes=2),
}
CLOSED_ONLY = ("gap", "ends")
ROBOT = "two fifths seen by a robot only"
PEOPLE = {
    "0.2-0.5 m/s": people_strokes.Seen(),
    "0.3-0.7 m/s": people_strokes.Seen(speed=(0.3, 0.7)),
    "0.2-0.5 m/s, half the frames dropped": people_strokes.Seen(dropped=0.5),
    "0.5-1.0 m/s": people_strokes.Seen(speed=(0.5, 1.0)),
    "1 camera at 30 frames/s": people_strokes.Seen(cameras=1, rate=30.0),
    "4 cameras at 10 frames/s, 4 cm off": people_strokes.Seen(cameras=4, rate=10.0, bias=0.04),
    ROBOT: people_strokes.Seen(robot=people_strokes.Localization()),
    f"{ROBOT}, off by 5 cm, 3 deg": people_strokes.Seen(robot=people_strokes.Localization(0.05, 0.05)),
    f"{ROBOT}, off by 5 cm, 3 deg, every 3 s": people_strokes.Seen(robot=people_strokes.Localization(0.05, 0.05, 3.0)),
}
Group = Tuple[str, Iterator[Stroke]]  # a cell's name and strokes


def strokes_of_people(half: str, draws: int, base: int) -> Iterator[Group]:
    """Yields cells with one half of people's strokes, one cell for each way in which cameras see them."""
    drawings = [item for item in enumerate(people_strokes.drawings()) if half == people_strokes.half(item[1])]
    for name, viewing in PEOPLE.items():
        rngs = (
            (drawing, np.random.default_rng([base + k, number])) for number, drawing in drawings for k in range(draws)
        )
        yield name, (people_strokes.see(drawing, viewing, rng) for drawing, rng in rngs)


def generated(name: str, count: int, base: int) -> Iterator[Group]:
    """Yields cells with strokes of all shapes in one setting."""
    for shape in SHAPES:
        if shape != "circle" and (SHAPES[shape][1] or not name.startswith(CLOSED_ONLY)):
            shape_index = sorted(SHAPES).index(shape)
            seeds = (np.random.default_rng([base + k, shape_index]) for k in range(count))
            yield f"{name}, {shape}", (draw(shape, SETTINGS[name], seed) for seed in seeds)


def disturbed_strokes(count: int, base: int) -> Iterator[Group]:
    """Yields cells with disturbed strokes: a spot held still, or false spots at one position."""
    share = max(1, count // 9)
    for spots, cameras in ((250, 1), (750, 3)):
        for location, when in (("start", 0.0), ("middle", 0.5), ("end", 1.0)):
            strokes = (
                held(timed(shape, base + k), when, spots, cameras, base + k)
                for shape in ("corner", "doorway", "rectangle")
                for k in range(share)
            )
            yield f"held still 10 s at the {location}, {spots} spots", strokes
    for when in ("at the same stamps", "interleaved", "before", "after", "throughout"):
        for away in (0.3, 0.6, 1.0):
            strokes = (
                with_fixed_place(stroke, beside(stroke, away, part), spots, when, k % 2, base + k)
                for k in range(max(1, share // 3))
                for shape, part in (("corner", 0.5), ("corner", 0.02), ("doorway", 0.9))
                for spots in (100, 500, 2000)
                for stroke in [timed(shape, base + k)]
            )
            yield f"false spots {when}, {away} m away", strokes


def make_extraction(module: Any, mode: str, with_stamps: bool) -> Extract:
    """Returns a version's extraction, which uses stamps and cameras if `with_stamps`."""

    def extract(stroke: Stroke) -> Any:
        extra = {"stamps": stroke.stamps, "cameras": stroke.cameras} if with_stamps else {}
        if with_stamps and stroke.mobile is not None:
            extra["mobile"] = stroke.mobile
        return module.extract_border(stroke.points, module.ExtractionParams(mode=mode), **extra)

    return extract


def measure_stroke(stroke: Stroke, extract: Extract, of_people: bool) -> Dict[str, float]:
    """Compares one extraction with the truth."""
    started = time.process_time()
    try:
        chain = extract(stroke)
    except Exception as refused:  # may be another version's class
        if type(refused).__name__ != "CodedError":
            raise
        return {"bad": 1.0, "kind": 0.0, "distance": np.inf, "jaccard": 0.0, "ms": np.nan}
    duration_ms = 1e3 * (time.process_time() - started)
    index = jaccard(chain.points, stroke.truth) if stroke.closed else np.nan
    if of_people:
        drawn = geometry.resample_chain(stroke.truth, 0.01, stroke.closed)
        line = geometry.resample_chain(chain.points, 0.01, chain.closed)
        distance = float(cKDTree(drawn).query(line)[0].max())
        if not stroke.closed:
            distance = max(distance, float(cKDTree(line).query(drawn)[0].max()))
        bad = distance > BAD_M or (stroke.closed and index < BAD_JACCARD)
    else:
        distance = hausdorff(chain.points, stroke.truth, stroke.closed)
        bad = distance > BAD_M
    kind = float(chain.closed == stroke.closed)
    return {"bad": float(bad), "kind": kind, "distance": distance, "jaccard": index, "ms": duration_ms}


def add_rows(table: ResultTable, group: str, cell: str, strokes: Iterator[Stroke], tools: Dict[str, Extract]) -> None:
    """Adds a row for each method, measured on the same strokes."""
    results_by_method: Dict[str, List[Dict[str, float]]] = {method: [] for method in tools}
    for stroke in strokes:
        for method, extract in tools.items():
            results_by_method[method].append(measure_stroke(stroke, extract, group == "people"))
    for method, results in results_by_method.items():
        index = np.array([result["jaccard"] for result in results])
        distances = [result["distance"] for result in results]
        table.add(
            group=group,
            cell=cell,
            method=method,
            bad=share(int(sum(r["bad"] for r in results)), len(results)),
            kind_right_percent=100.0 * float(np.mean([r["kind"] for r in results])),
            distance_median_m=float(np.median(distances)),
            distance_p95_m=float(np.quantile(np.minimum(distances, 9.0), 0.95)),
            jaccard_median="" if np.isnan(index).all() else float(np.nanmedian(index)),
            time_median_ms=float(np.nanmedian([r["ms"] for r in results] + [0.0])),
        )


def main() -> None:
    groups = ["people", *SETTINGS, "disturbances"]
    parser = arguments(__doc__, other=True)
    parser.add_argument("--strokes", type=int, default=20, help="generated strokes per cell")
    parser.add_argument("--draws", type=int, default=3, help="random views of each person's stroke")
    parser.add_argument("--judge", action="store_true", help="use data that were not used for development")
    parser.add_argument("--seed", type=int, help="first seed (default: 0, or 100000 with --judge)")
    parser.add_argument("--methods", nargs="*", help="measure only these")
    parser.add_argument("--only", nargs="*", choices=groups, default=groups)
    options = parser.parse_args()
    tools = {
        "robust": make_extraction(extraction, "robust", True),
        "paper": make_extraction(extraction, "paper", False),
    }
    if options.other:
        tools["other"] = make_extraction(import_from(options.other, "vb_fusion.extraction")[0], "robust", True)
    tools = {name: tools[name] for name in (options.methods or tools)}
    half, base = ("judge", 100_000) if options.judge else ("develop", 0)
    base = base if options.seed is None else options.seed
    table = ResultTable(options.csv, base)
    for group in options.only:
        if group == "people":
            cells = strokes_of_people(half, options.draws, base)
        else:
            make = disturbed_strokes if group == "disturbances" else lambda count, base: generated(group, count, base)
            cells = make(options.strokes, base)
        for cell, strokes in cells:
            add_rows(table, group if group in ("people", "disturbances") else "generator", cell, strokes, tools)


if __name__ == "__main__":
    main()
