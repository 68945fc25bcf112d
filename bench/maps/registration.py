#!/usr/bin/env python3
"""How often a registered transform is right, and whether one that is acted on without a person is ever wrong.

    . scripts/env.sh && python3 bench/maps/registration.py --homes corridor --maps 1000 --first-seed 10000

Homes "split" are those that the registration was developed on, "corridor" is the generator that judges. Each home
gives an old map and a new one: turned by up to 180 degrees, shifted, of another resolution, with noise, other furniture
and rooms that one of the maps lacks. As many pairs again show different places: another home, another floor with the
same outer walls, the mirrored flat. Writes docs/results/maps/registration-HOMES.csv (a row per kind) and prints it.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from pathlib import Path
from typing import Any, Dict, List

import numpy as np
from homes import corridor_home, draw_map, furnished, split_home

from vb_evaluation.provenance import revision
from vb_evaluation.result_table import write_table
from vb_evaluation.statistics import proportion
from vb_map_integration.places.registration import IDENTITY, Transform, register

HOMES = {"split": split_home, "corridor": corridor_home}
SAME = ("again", "furniture", "missing_rooms", "grown", "resolution", "all")
OTHER = ("other_home", "other_floor", "mirrored")
RIGHT_M, RIGHT_DEG = 0.05, 1.0
WRONG_M, WRONG_DEG = 0.15, 2.0


def pair(make: Any, kind: str, seed: int, noise: float) -> Any:
    """Makes (old map, new map, true transform or None) of a kind."""
    random = np.random.default_rng(seed)
    home = make(random)
    truth = Transform(*random.uniform(-5.0, 5.0, 2), random.uniform(-math.pi, math.pi))
    start = Transform(*random.uniform(-3.0, 3.0, 2), random.uniform(-math.pi, math.pi))
    start = start if random.random() < 0.5 else IDENTITY
    everything = kind == "all"
    old_missing = 2 if kind == "grown" else int(everything and random.random() < 0.5)
    new_missing = 2 if kind == "missing_rooms" else int(everything and random.random() < 0.5)
    resolution = float(random.choice([0.03, 0.04, 0.06])) if kind == "resolution" or everything else 0.05
    old = draw_map(home, random, start, 0.05, old_missing, noise)
    other = home
    if kind == "furniture" or everything:
        other = furnished(home, random, kept=float(random.uniform(0.0, 0.6)))
    elif kind == "other_home":
        other = make(random)
    elif kind == "other_floor":
        other = make(random, tuple(home.outline.max(axis=0)))
    elif kind == "mirrored":
        other = home.mirrored()
    new = draw_map(other, random, truth, resolution, new_missing, noise)
    return old, new, truth.after(start.inverse) if kind in SAME else None


def judge(make: Any, kind: str, seed: int, noise: float = 1.0) -> Dict[str, Any]:
    """Says what became of one pair."""
    old, new, truth = pair(make, kind, seed, noise)
    started = time.process_time()
    found = register(old, new)
    row: Dict[str, Any] = {"kind": kind, "seed": seed, "s": time.process_time() - started, "m": math.inf, "deg": 180.0}
    row["sure"] = bool(found and found.is_unambiguous)
    if found is not None:
        row.update(agreement=found.agreement, overlap=found.overlap, walls_m=found.walls_m, margin=found.margin)
        if truth is not None:
            middle = np.mean(old.corners(), axis=0)
            apart, turned = found.transform.distance(truth, middle)
            row.update(m=apart, deg=math.degrees(turned))
    row["right"] = row["m"] <= RIGHT_M and row["deg"] <= RIGHT_DEG
    row["wrong"] = row["sure"] and (row["m"] > WRONG_M or row["deg"] > WRONG_DEG)
    return row


def interval(hits: int, n: int) -> str:
    """Returns the 95 % interval of a share, in percent."""
    share = proportion(hits, n)
    return f"{100 * share.low:.1f} .. {100 * share.high:.1f}"


def summary(kind: str, rows: List[Dict[str, Any]]) -> Dict[str, Any]:
    """Makes one line of the table."""
    n, same = len(rows), kind in SAME or kind == "all same"
    errors = [row["m"] for row in rows]
    right, wrong = (sum(row[key] for row in rows) for key in ("right", "wrong"))
    late = float(np.quantile(errors, 0.95, method="nearest"))
    return {
        "kind": kind,
        "pairs": n,
        "right_percent": round(100 * right / n, 1) if same else "",
        "right_95": interval(right, n) if same else "",
        "acts_alone_percent": round(100 * sum(row["sure"] for row in rows) / n, 1),
        "wrongly_sure": wrong,
        "wrongly_sure_95": interval(wrong, n),
        "sure_but_over_5_cm_or_1_deg": sum(row["sure"] and not row["right"] for row in rows) if same else "",
        "median_error_mm": round(1e3 * float(np.median(errors)), 1) if same else "",
        "p95_error_mm": round(1e3 * late) if same and late < 1e3 else "",
        "cpu_s": round(float(np.mean([row["s"] for row in rows])), 2),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--homes", choices=sorted(HOMES), default="corridor")
    parser.add_argument("--maps", type=int, default=120, help="how many pairs of the same place")
    parser.add_argument("--others", type=int, default=-1, help="how many pairs of different places; -1: as many")
    parser.add_argument("--first-seed", type=int, default=10000)
    parser.add_argument("--noise", type=float, default=1.0, help="times as much of it, for instance bends of 3 cm")
    parser.add_argument("--show", action="store_true", help="prints every pair")
    options = parser.parse_args()
    make = HOMES[options.homes]
    others = options.maps if options.others < 0 else options.others
    todo = [(SAME[k % len(SAME)], options.first_seed + k) for k in range(options.maps)]
    todo += [(OTHER[k % len(OTHER)], options.first_seed + 500_000 + k) for k in range(others)]
    rows: List[Dict[str, Any]] = []
    # alternating, so that a run that is ended early has both
    todo = sorted(todo, key=lambda one: one[1] % 500_000)
    made_by = revision()
    for number, (kind, seed) in enumerate(todo, 1):
        rows.append(judge(make, kind, seed, options.noise))
        if options.show or rows[-1]["wrong"]:
            row = rows[-1].items()
            print({key: round(value, 3) if isinstance(value, float) else value for key, value in row}, flush=True)
        if number % 50 == 0 or number == len(todo):
            path = write(rows, options.homes, options.noise, made_by)
    print(path.read_text())
    return 0


def write(rows: List[Dict[str, Any]], homes: str, noise: float, made_by: str) -> Path:
    """Writes the table as far as it goes."""
    kinds = [kind for kind in SAME + OTHER if any(row["kind"] == kind for row in rows)]
    table = [summary(kind, [row for row in rows if row["kind"] == kind]) for kind in kinds]
    for name, members in (("all same", SAME), ("all different", OTHER)):
        chosen = [row for row in rows if row["kind"] in members]
        if chosen:
            table.append(summary(name, chosen))
    name = f"maps/registration-{homes}" + ("" if noise == 1.0 else f"-noise-{noise:g}")
    return write_table(name, f"maps/registration.py --homes {homes} --noise {noise:g}", made_by, table)


if __name__ == "__main__":
    sys.exit(main())
