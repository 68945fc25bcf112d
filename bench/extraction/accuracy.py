#!/usr/bin/env python3
"""Border extraction judged: people's strokes and our own generator, this revision against another one.

    python3 bench/extraction/accuracy.py --judge              people's strokes and the generator on judging data, about an hour
    python3 bench/extraction/accuracy.py --judge --strokes 20 --only people usual
    python3 bench/extraction/accuracy.py --against 3655b17    beside it, on the same strokes, the code of another revision
    python3 bench/extraction/accuracy.py --judge --seed 300000 seeds that nobody has seen: a range is fresh once
    python3 bench/extraction/accuracy.py --figures docs/images

Without --judge the developing half of people's strokes and seeds below 1,000 are used; with it the other half and
seeds from 100,000 or --seed. A stroke of the generator is bad if its chain is more than 0.25 m (Hausdorff distance)
from the intended one, or if there is none. A person's stroke is bad if the line lies more than 0.25 m from what was
drawn; where a polygon was meant, the distance is that from the extracted line to the drawn one, and a Jaccard index
below 0.8 is bad too. Writes docs/results/extraction/all.csv; --out changes that.
"""

from __future__ import annotations

import argparse
import csv
import importlib
import io
import re
import subprocess
import sys
import tarfile
import tempfile
import time
from pathlib import Path
from typing import Callable, Dict, Iterator, List, Optional

import numpy as np
from scipy.spatial import cKDTree

TOP = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(TOP / "src" / "vb_fusion" / "test"))
import people  # noqa: E402
from disturbances import beside, held, timed, with_fixed_place  # noqa: E402
from strokes import SHAPES, Setting, Stroke, draw, hausdorff, jaccard  # noqa: E402

from vb_core import geometry  # noqa: E402
from vb_core.errors import CodedError  # noqa: E402
from vb_evaluation.provenance import revision  # noqa: E402
from vb_evaluation.statistics import proportion  # noqa: E402
from vb_fusion import extraction  # noqa: E402
from vb_fusion.stroke.observations import make_observations  # noqa: E402

BAD_M, BAD_JACCARD = 0.25, 0.8
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
OPEN_TOO = [name for name in SETTINGS if not name.startswith(("gap", "ends"))]
DRAWN = [shape for shape in SHAPES if shape != "circle"]
DISTURBED = ("corner", "doorway", "rectangle")
PEOPLE = {
    "0.2-0.5 m/s": people.Seen(),
    "0.3-0.7 m/s": people.Seen(speed=(0.3, 0.7)),
    "0.2-0.5 m/s, half the frames dropped": people.Seen(dropped=0.5),
    "0.5-1.0 m/s": people.Seen(speed=(0.5, 1.0)),
    "1 camera at 30 frames/s": people.Seen(cameras=1, rate=30.0),
    "4 cameras at 10 frames/s, 4 cm off": people.Seen(cameras=4, rate=10.0, bias=0.04),
    "two fifths seen by a robot only": people.Seen(robot=people.Localization()),
    "two fifths seen by a robot only, off by 5 cm, 3 deg": people.Seen(robot=people.Localization(0.05, 0.05)),
    "two fifths seen by a robot only, off by 5 cm, 3 deg, every 3 s": people.Seen(
        robot=people.Localization(0.05, 0.05, 3.0)
    ),
}
Extract = Callable[[Stroke], object]
Found = Dict[str, float]


def methods(before) -> Dict[str, Extract]:
    """Returns what is compared, by name."""

    def run(module, params, known: bool) -> Extract:
        def extract(stroke: Stroke):
            extra = {"stamps": stroke.stamps, "cameras": stroke.cameras} if known else {}
            if known and stroke.mobile is not None:
                extra["mobile"] = stroke.mobile
            return module.extract_border(stroke.points, params, **extra)

        return extract

    now = extraction.ExtractionParams
    found = {
        "robust": run(extraction, now.robust(), True),
        "robust, bare points": run(extraction, now.robust(), False),
        "paper": run(extraction, now.paper(), False),
    }
    if before is not None:
        found["before"] = run(before, before.ExtractionParams.robust(), True)
    return found


def other_revision(revision: str):
    """Loads vb_fusion.extraction of another revision, as a package of its own."""
    archive = subprocess.run(
        ["git", "-C", str(TOP), "archive", revision, "src/vb_fusion/src/vb_fusion"], check=True, stdout=subprocess.PIPE
    ).stdout
    folder = Path(tempfile.mkdtemp()) / "vb_fusion_before"
    with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        for member in tar.getmembers():
            if member.name.endswith(".py") and not member.name.endswith("_node.py"):
                text = tar.extractfile(member).read().decode("utf-8")
                text = re.sub(r"\b(from|import) vb_fusion\b", r"\1 vb_fusion_before", text)
                path = folder / Path(member.name).relative_to("src/vb_fusion/src/vb_fusion")
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text)
    sys.path.insert(0, str(folder.parent))
    return importlib.import_module("vb_fusion_before.extraction")


def measure(stroke: Stroke, extract: Extract, of_people: bool) -> Found:
    """Measures one extraction against the truth."""
    started = time.process_time()
    try:
        chain = extract(stroke)
    except CodedError:
        return {"bad": 1.0, "kind": 0.0, "distance": np.inf, "jaccard": 0.0, "ms": np.nan}
    took = 1e3 * (time.process_time() - started)
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
    return {"bad": float(bad), "kind": kind, "distance": distance, "jaccard": index, "ms": took}


def rows_of(group: str, cell: str, found: Dict[str, List[Found]]) -> List[Dict[str, object]]:
    """Makes one line of the table for each method."""
    rows = []
    for method, results in found.items():
        bad, count = int(sum(r["bad"] for r in results)), len(results)
        share = proportion(bad, count).scaled(100.0)
        index = np.array([r["jaccard"] for r in results])
        rows.append(
            {
                "group": group,
                "cell": cell,
                "method": method,
                "strokes": count,
                "bad": bad,
                "bad_percent": round(share.estimate, 2),
                "low_percent": round(share.low, 2),
                "high_percent": round(share.high, 2),
                "kind_right_percent": round(100.0 * float(np.mean([r["kind"] for r in results])), 2),
                "distance_median_m": round(float(np.median([r["distance"] for r in results])), 4),
                "distance_95_percent_m": round(float(np.quantile([min(r["distance"], 9.0) for r in results], 0.95)), 4),
                "jaccard_median": "" if np.isnan(index).all() else round(float(np.nanmedian(index)), 4),
                "time_median_ms": round(float(np.nanmedian([r["ms"] for r in results] + [0.0])), 1),
            }
        )
        print(
            "{group:12s} {cell:42s} {method:20s} {strokes:5d} bad {bad_percent:6.2f} % "
            "({low_percent:.2f} .. {high_percent:.2f}) kind {kind_right_percent:6.2f} % J {jaccard_median} "
            "d {distance_median_m} {distance_95_percent_m}".format(**rows[-1]),
            flush=True,
        )
    return rows


def judge_people(
    which: str, tools: Dict[str, Extract], draws: int, base: int, path: Path
) -> Iterator[List[Dict[str, object]]]:
    """Measures people's strokes of one half, each seen several times; by speed, and by shape."""
    for name, seen in PEOPLE.items():
        by_shape: Dict[str, Dict[str, List[Found]]] = {}
        for number, drawing in enumerate(people.drawings(path)):
            if which != "all" and people.half(drawing) != which:
                continue
            for repeat in range(draws):
                stroke = people.see(drawing, seen, np.random.default_rng([base + repeat, number]))
                for method, extract in tools.items():
                    cell = by_shape.setdefault(drawing.shape, {}).setdefault(method, [])
                    cell.append(measure(stroke, extract, True))
        everything = {method: [r for shape in by_shape.values() for r in shape[method]] for method in tools}
        yield rows_of("people", f"{name}, all shapes", everything)
        for shape, found in sorted(by_shape.items()):
            yield rows_of("people", f"{name}, {shape}", found)


def judge_generator(name: str, tools: Dict[str, Extract], count: int, base: int) -> List[Dict[str, object]]:
    """Measures all shapes in one setting."""
    rows = []
    for shape in DRAWN:
        if not SHAPES[shape][1] and name not in OPEN_TOO:
            continue
        found: Dict[str, List[Found]] = {method: [] for method in tools}
        for k in range(count):
            stroke = draw(shape, SETTINGS[name], np.random.default_rng([base + k, sorted(SHAPES).index(shape)]))
            for method, extract in tools.items():
                found[method].append(measure(stroke, extract, False))
        rows += rows_of("generator", f"{name}, {shape}", found)
    return rows


def disturbed(count: int, base: int):
    """Yields (name, strokes) of each disturbance: a spot held still, false spots at one place."""
    share = max(1, count // 9)
    for spots, cameras in ((250, 1), (750, 3)):
        for where, when in (("start", 0.0), ("middle", 0.5), ("end", 1.0)):
            yield (
                f"held still 10 s at the {where}, {spots} spots",
                [
                    held(timed(shape, base + k), when, spots, cameras, base + k)
                    for shape in DISTURBED
                    for k in range(share)
                ],
            )
    for when in ("at the same stamps", "interleaved", "before", "after", "throughout"):
        for away in (0.3, 0.6, 1.0):
            yield (
                f"false spots {when}, {away} m away",
                [
                    with_fixed_place(stroke, beside(stroke, away, share_of_line), spots, when, k % 2, base + k)
                    for k in range(max(1, share // 3))
                    for shape, share_of_line in (("corner", 0.5), ("corner", 0.02), ("doorway", 0.9))
                    for spots in (100, 500, 2000)
                    for stroke in [timed(shape, base + k)]
                ],
            )


def speed(tools: Dict[str, Extract]) -> List[Dict[str, object]]:
    """Measures the processor time of one extraction, by number of points; methods in one run, so that their ratio holds."""
    rows = []
    for count in (1000, 10_000, 100_000, 1_000_000):
        rate = count / (6.5 / USUAL.speed * USUAL.cameras * (1 - USUAL.dropped))
        stroke = draw("rectangle", USUAL.replace(rate=rate), np.random.default_rng(0))
        found: Dict[str, List[Found]] = {}
        for method, extract in tools.items():
            repeats = 5 if count <= 10_000 else 1
            found[method] = [measure(stroke, extract, False) for _ in range(repeats)]
        rows += rows_of("speed", f"{len(stroke.points)} points", found)
    return rows


def meander(spots: int, cameras: int = 8, rate: float = 30.0, speed: float = 0.25) -> Stroke:
    """Draws a long line up and down a hall without a rest, until there are so many spots."""
    rng = np.random.default_rng(0)
    duration = spots / (cameras * rate)
    across = np.arange(int(duration * speed / 6.0) + 2)
    truth = np.column_stack([0.8 * np.repeat(across, 2), np.resize([0.0, 6.0, 6.0, 0.0], 2 * len(across))])
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(truth, axis=0), axis=1))])
    stamps = np.sort(rng.uniform(0.0, duration, spots))
    points = np.column_stack([np.interp(speed * stamps, arc, axis) for axis in truth.T])
    which = rng.integers(0, cameras, spots)
    offsets = rng.normal(0, USUAL.bias, (cameras, 2))
    return Stroke(truth, False, points + offsets[which] + rng.normal(0, USUAL.noise, (spots, 2)), stamps, which)


def live(before) -> List[Dict[str, object]]:
    """Measures the processor time of the border so far for each tenth of a second in a drawing's last two seconds.

    Before, up to 4,000 evenly chosen spots were extracted again each time.
    """
    rows = []
    for count in (1000, 10_000, 100_000):
        rate = count / (6.5 / USUAL.speed * USUAL.cameras * (1 - USUAL.dropped))
        dense = draw("rectangle", USUAL.replace(rate=rate, shuffled=False), np.random.default_rng(0))
        for name, stroke in (("rectangle", dense), ("meander", meander(count))):
            spots = make_observations(stroke.points, stroke.stamps, stroke.cameras)
            ends = np.searchsorted(spots.stamps, spots.stamps[-1] - 2.0 + 0.1 * np.arange(21))
            drawing = extraction.GrowingBorder(extraction.ExtractionParams.robust())
            drawing.add(spots.select(slice(ends[0])))
            took: Dict[str, List[float]] = {"robust": [], "before": []}
            for start, end in zip(ends, ends[1:]):
                begun = time.process_time()
                drawing.add(spots.select(slice(start, end)))
                drawing.chain()
                took["robust"].append(1e3 * (time.process_time() - begun))
                if before is not None:
                    chosen = np.linspace(0, end - 1, min(end, 4000)).astype(int)
                    begun = time.process_time()
                    before.extract_border(
                        stroke.points[chosen], stamps=stroke.stamps[chosen], cameras=stroke.cameras[chosen]
                    )
                    took["before"].append(1e3 * (time.process_time() - begun))
            del took["robust"][0]  # which extracts all that came before
            for method, values in took.items():
                if values:
                    cell = f"live, {name}, {len(spots.points)} spots in {spots.stamps[-1] - spots.stamps[0]:.0f} s"
                    rows.append(
                        {
                            "group": "speed",
                            "cell": cell,
                            "method": method,
                            "strokes": len(values),
                            "time_median_ms": round(float(np.median(values)), 1),
                        }
                    )
                    print("{cell:60s} {method:8s} {time_median_ms} ms".format(**rows[-1]), flush=True)
    return rows


def figures(folder: Path) -> None:
    """Draws one picture per stage, of one stroke that has everything: a held spot, a false place, strays, two cameras."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    stroke = held(timed("L", 4, USUAL.replace(outliers=0.1, bias=0.04)), 0.4, 250, 2, 4)
    stroke = with_fixed_place(stroke, beside(stroke, 0.5, 0.3), 300, "throughout", 1, 4)
    chain = extraction.extract_border(stroke.points, stamps=stroke.stamps, cameras=stroke.cameras)
    ring = np.vstack([chain.points, chain.points[:1]]) if chain.closed else chain.points
    middle = stroke.truth.mean(axis=0)
    pictures = (
        ("1_spots", "all spots, by time", lambda a: a.scatter(*stroke.points.T, c=stroke.stamps, s=4, cmap="viridis")),
        (
            "2_track",
            "stage 1: the pointer's",
            lambda a: (
                a.plot(*stroke.points.T, ".", color="0.8", markersize=3),
                a.plot(*chain.stages["cluster"].T, ".", color="tab:green", markersize=3),
            ),
        ),
        (
            "3_samples",
            "stage 2: where it was",
            lambda a: (
                a.plot(*chain.stages["placed"].T, ".", color="0.8", markersize=3),
                a.plot(*chain.stages["thinned"].T, ".-", color="tab:red", markersize=5, linewidth=0.8),
            ),
        ),
        (
            "4_line",
            f"stages 3 to 6: {len(chain.points)} vertices, {chain.code}",
            lambda a: (
                a.plot(*chain.stages["placed"].T, ".", color="0.8", markersize=3),
                a.plot(*ring.T, "o-", color="tab:blue", markersize=5, linewidth=1.5),
            ),
        ),
    )
    panels, axes = plt.subplots(1, 4, figsize=(17, 4.6), sharex=True, sharey=True, constrained_layout=True)
    for axis, (_, title, paint) in zip(axes, pictures):
        paint(axis)
        axis.set_title(title)
        axis.set_aspect("equal")
        axis.set_xlim(middle[0] - 1.7, middle[0] + 1.7)
        axis.set_ylim(middle[1] - 1.7, middle[1] + 1.7)
        axis.set_xticks([])
        axis.set_yticks([])
    folder.mkdir(parents=True, exist_ok=True)
    panels.savefig(str(folder / "extraction_stages.png"), dpi=90)


def write(path: Path, rows: List[Dict[str, object]]) -> None:
    """Writes the table, with what made it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(str(path), "w", encoding="utf-8", newline="") as file:
        file.write(
            f"# python3 bench/extraction/accuracy.py {' '.join(sys.argv[1:])}; {time.strftime('%Y-%m-%d')}; {revision()}\n"
        )
        table = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(rows)


def main() -> int:
    groups = ["people", *SETTINGS, "disturbances", "speed"]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--strokes", type=int, default=20, help="of the generator per cell")
    parser.add_argument("--draws", type=int, default=3, help="how often each person's stroke is seen")
    parser.add_argument("--judge", action="store_true", help="data that the code was not developed with")
    parser.add_argument("--seed", type=int, help="the first one; 0, or 100000 with --judge")
    parser.add_argument("--against", help="a revision to compare with, on the same strokes")
    parser.add_argument("--methods", nargs="*", help="only these")
    parser.add_argument("--only", nargs="*", choices=groups, default=groups)
    parser.add_argument("--people", type=Path, help="another file of people's strokes, all of it")
    parser.add_argument("--figures", type=Path, help="only draw the stages into this folder")
    parser.add_argument("--out", type=Path, default=TOP / "docs" / "results" / "extraction" / "all.csv")
    arguments = parser.parse_args()
    if arguments.figures:
        figures(arguments.figures)
        return 0
    before: Optional[object] = other_revision(arguments.against) if arguments.against else None
    tools = methods(before)
    tools = {name: tools[name] for name in (arguments.methods or tools)}
    which, base = ("judge", 100_000) if arguments.judge else ("develop", 0)
    base = base if arguments.seed is None else arguments.seed
    rows: List[Dict[str, object]] = []
    for group in arguments.only:
        if group == "people":
            half = "all" if arguments.people else which
            for part in judge_people(half, tools, arguments.draws, base, arguments.people or people.DATA):
                rows += part
                write(arguments.out, rows)
        elif group == "disturbances":
            for name, strokes in disturbed(arguments.strokes, base):
                rows += rows_of(
                    "disturbance", name, {m: [measure(s, e, False) for s in strokes] for m, e in tools.items()}
                )
        elif group == "speed":
            rows += speed({name: tool for name, tool in tools.items() if name != "paper"}) + live(before)
        else:
            rows += judge_generator(group, tools, arguments.strokes, base)
        write(arguments.out, rows)
    print(f"wrote {arguments.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
