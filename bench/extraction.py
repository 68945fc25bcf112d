#!/usr/bin/env python3
"""Border extraction on simulated strokes: the paper's algorithm against robust mode.

    python3 bench/extraction.py                     20 strokes per cell, a few minutes
    python3 bench/extraction.py --strokes 40 --only usual rough
    python3 bench/extraction.py --disturbances      a spot held still, false spots at one place
    python3 bench/extraction.py --figure docs/images/extraction_stages.png

Robust mode runs twice: on the bare point set, and with stamps and cameras as the node has them. A stroke is bad if its
chain is more than 0.25 m (Hausdorff distance) from the intended one, or if there is none. Writes
out/bench/extraction.json. The generator is src/vb_fusion/test/strokes.py; its figures are assumptions, not tuned.
"""
from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

TOP = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(TOP / "src" / "vb_fusion" / "test"))
from disturbances import beside, held, timed, with_fixed_place  # noqa: E402
from strokes import SHAPES, Setting, draw, hausdorff, jaccard  # noqa: E402

from vb_fusion.extraction import ExtractionError, ExtractionParams, extract_border  # noqa: E402

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
METHODS = {
    "paper": (ExtractionParams.paper(), False),
    "robust": (ExtractionParams.robust(), False),
    "robust, timed": (ExtractionParams.robust(), True),
}
BAD_M = 0.25
DISTURBED = ("corner", "doorway", "rectangle")
FIGURE = (("L", 4), ("corner", 2))  # shapes and seeds of the figure


def measure(stroke, params: ExtractionParams, known: bool) -> dict:
    """One extraction against the truth."""
    extra = {"stamps": stroke.stamps, "cameras": stroke.cameras} if known else {}
    started = time.process_time()
    try:
        chain = extract_border(stroke.points, params, **extra)
    except ExtractionError as error:
        took = time.process_time() - started
        return {"time": took, "error": error.code, "hausdorff": np.inf, "jaccard": 0.0, "kind": False}
    took = time.process_time() - started
    return {
        "time": took,
        "error": None,
        "hausdorff": hausdorff(chain.points, stroke.truth, stroke.closed),
        "jaccard": jaccard(chain.points, stroke.truth) if stroke.closed else None,
        "kind": chain.closed == stroke.closed,
    }


def cell(shape: str, setting: Setting, count: int) -> dict:
    """All methods on the same strokes of one shape in one setting."""
    strokes = [draw(shape, setting, np.random.default_rng([k, sorted(SHAPES).index(shape)])) for k in range(count)]
    result = {}
    for name, (params, known) in METHODS.items():
        found = [measure(stroke, params, known) for stroke in strokes]
        distances = np.array([f["hausdorff"] for f in found])
        result[name] = {
            "jaccard_median": round(float(np.median([f["jaccard"] for f in found])), 4) if SHAPES[shape][1] else None,
            "hausdorff_median_m": round(float(np.median(distances)), 4) if np.isfinite(np.median(distances)) else None,
            "bad_percent": round(100.0 * float((distances > BAD_M).mean()), 1),
            "wrong_kind_percent": round(100.0 * float(np.mean([not f["kind"] for f in found])), 1),
            "time_median_ms": round(1e3 * float(np.median([f["time"] for f in found])), 1),
        }
    return result


def disturbances(count: int) -> dict:
    """Bad strokes [%] of each method while the spot is held still, or false spots are seen at one place."""
    scenes = {}
    for spots, cameras in ((250, 1), (750, 3)):
        for where, share in (("start", 0.0), ("middle", 0.5), ("end", 1.0)):
            scenes[f"held still 10 s at the {where}, {spots} spots"] = [
                held(timed(shape, k), share, spots, cameras, k) for shape in DISTURBED for k in range(count)
            ]
    for spots in (100, 500, 2000):
        for away in (0.3, 0.6, 1.0):
            scenes[f"{spots} false spots {away} m away"] = [
                with_fixed_place(stroke, beside(stroke, away, share), spots, when, k % 2, k)
                for k in range(count)
                for shape in DISTURBED
                for when, share in (("at the same stamps", 0.5), ("interleaved", 0.02), ("throughout", 0.8))
                for stroke in [timed(shape, k)]
            ]
    result = {}
    for name, strokes in scenes.items():
        result[name] = {"strokes": len(strokes)}
        for method, (params, known) in METHODS.items():
            bad = np.mean([measure(stroke, params, known)["hausdorff"] > BAD_M for stroke in strokes])
            result[name][method + ", bad_percent"] = round(100.0 * float(bad), 1)
        shares = "  ".join(f"{method} {result[name][method + ', bad_percent']:5.1f} %" for method in METHODS)
        print(f"{name:45s} {shares}", flush=True)
    return result


def speed() -> dict:
    """Processor time [ms] of one extraction, by number of points."""
    result = {name: {} for name in ("paper", "robust")}
    for count in (1000, 10_000, 100_000, 1_000_000):
        rate = count / (6.5 / USUAL.speed * USUAL.cameras * (1 - USUAL.dropped))
        stroke = draw("rectangle", USUAL.replace(rate=rate), np.random.default_rng(0))
        for name in result:
            times = []
            for _ in range(3 if count <= 10_000 else 1):
                times.append(measure(stroke, METHODS[name][0], False)["time"])
            result[name][str(len(stroke.points))] = round(1e3 * min(times), 1)
    return result


def figure(path: Path) -> None:
    """The stages on a polygon and on a separating curve, like the paper's figure of the processing stages."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    columns = ("point set", "paper: cluster", "paper: thinned", "paper: chain", "robust: chain")
    panels, axes = plt.subplots(2, 5, figsize=(17, 4.7), sharex=True, sharey=True, constrained_layout=True)
    for axis, title in zip(axes[0], columns):
        axis.set_title(title)
    for row, (shape, seed) in zip(axes, FIGURE):
        stroke = draw(shape, USUAL.replace(outliers=0.1), np.random.default_rng(seed))
        paper = extract_border(stroke.points, ExtractionParams.paper())
        robust = extract_border(stroke.points)
        for axis in row:
            axis.set_aspect("equal")
            axis.set_xlim(-4.1, 4.1)
            axis.set_ylim(-2.6, 2.6)
            axis.set_xticks([])
            axis.set_yticks([])
        row[0].plot(*stroke.points.T, ".", color="black", markersize=2)
        for axis in row[1:]:
            axis.plot(*stroke.points.T, ".", color="0.75", markersize=2)
        row[1].plot(*paper.stages["cluster"].T, ".", color="tab:green", markersize=2.5)
        row[2].plot(*paper.stages["thinned"].T, ".", color="tab:red", markersize=4)
        for axis, chain in ((row[3], paper), (row[4], robust)):
            points = np.vstack([chain.points, chain.points[:1]]) if chain.closed else chain.points
            axis.plot(*points.T, ".-", color="tab:blue", linewidth=1.5, markersize=4)
    axes[1, 0].plot([-3.8, -2.8], [-2.3, -2.3], "-", color="black", linewidth=3)
    axes[1, 0].text(-2.7, -2.3, "1 m", verticalalignment="center")
    path.parent.mkdir(parents=True, exist_ok=True)
    panels.savefig(str(path), dpi=90)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--strokes", type=int, default=20, help="per cell")
    parser.add_argument("--only", nargs="*", choices=list(SETTINGS), help="settings")
    usual_shapes = [shape for shape in SHAPES if shape != "circle"]
    parser.add_argument("--shapes", nargs="*", choices=list(SHAPES), default=usual_shapes)
    parser.add_argument("--figure", type=Path, help="only draw the stages into this file")
    parser.add_argument("--disturbances", action="store_true", help="only the disturbances, beside --out")
    parser.add_argument("--out", type=Path, default=TOP / "out" / "bench" / "extraction.json")
    arguments = parser.parse_args()
    if arguments.figure:
        figure(arguments.figure)
        print(f"wrote {arguments.figure}")
        return 0
    if arguments.disturbances:
        found = disturbances(arguments.strokes)
        path = arguments.out.with_name("extraction_disturbances.json")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps({"bad_above_m": BAD_M, "cells": found}, indent=1) + "\n")
        print(f"wrote {path}")
        return 0
    print(f"{'setting':20s} {'shape':10s} " + " ".join(f"{name:^33s}" for name in METHODS))
    print(f"{'':31s} " + " ".join(f"{'Jaccard':>8s} {'Hausd. m':>8s} {'bad %':>6s} {'ms':>6s}  " for _ in METHODS))
    cells = {}
    for name in arguments.only or SETTINGS:
        for shape in arguments.shapes:
            # a gap of 0.4 m in a doorway of 0.7 m leaves nothing to find
            if not SHAPES[shape][1] and any(word in name for word in ("gap", "ends")):
                continue
            found = cells.setdefault(name, {})[shape] = cell(shape, SETTINGS[name], arguments.strokes)
            columns = []
            for method in METHODS:
                f = found[method]
                index = "   -    " if f["jaccard_median"] is None else f"{f['jaccard_median']:8.3f}"
                distance = "    none" if f["hausdorff_median_m"] is None else f"{f['hausdorff_median_m']:8.3f}"
                columns.append(f"{index} {distance} {f['bad_percent']:6.1f} {f['time_median_ms']:6.1f}  ")
            print(f"{name:20s} {shape:10s} " + " ".join(columns), flush=True)
    times = speed()
    for method, by_count in times.items():
        print(f"{method:7s} " + ", ".join(f"{count} points {ms:.0f} ms" for count, ms in by_count.items()))
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    document = {"strokes_per_cell": arguments.strokes, "bad_above_m": BAD_M, "cells": cells, "processor_time_ms": times}
    arguments.out.write_text(json.dumps(document, indent=1) + "\n")
    print(f"wrote {arguments.out.relative_to(TOP) if TOP in arguments.out.parents else arguments.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
