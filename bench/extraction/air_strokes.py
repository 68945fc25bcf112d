#!/usr/bin/env python3
"""Converts strokes that people drew in the air with a finger into the file that bench/extraction/accuracy.py reads.

    git clone https://github.com/Mehous/TestingFramework
    python3 bench/extraction/air_strokes.py TestingFramework/src/datasets air.json
    python3 bench/extraction/accuracy.py --people air.json --only people --methods robust

The repository holds 3DTCGS (13 people), 3DMadLabSD (10 people) and SHREC 2019 (people unnamed), recorded by a Leap
Motion sensor (M. Ousmer et al., Proc. ACM Hum.-Comput. Interact. 4, ISS, 2020). It names no licence: nothing of it is
kept here. A finger in the air is nearer to a laser pointer than a mouse is: nothing guides it, and corners are rounded.
Figures that a border may have are taken, what was meant is known from their names: of each named person two
strokes of each figure (`--rest`: those that are left then), of SHREC 2019 (`--datasets SHREC2019`) all, in
the plane that fits each best.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from pathlib import Path
from typing import Tuple

import numpy as np

CLOSED = {"circle", "rectangle", "square", "triangle", "0"}
OPEN = set(
    (
        "caret check vmark v zig-zag square-braket-left square-braket-right curly-braket-left "
        "curly-braket-right left-swipe right-swipe 1 2 3 5 7 c j"
    ).split()
)
EACH = 2
SIZE = 200.0  # [px] of a figure's diagonal


def read(file: Path) -> Tuple[str, np.ndarray]:
    """Reads the figure's name and its rows t [s], x, y from a stroke's file."""
    known = json.loads(file.read_text())
    if "strokes" in known:
        return str(known["name"]), np.array(
            [[spot["t"] / 1000.0, spot["x"], spot["y"]] for spot in known["strokes"]], float
        )
    tip = known["paths"]["Index_3"]["strokes"]
    times, places = (
        np.array([spot["t"] for spot in tip], float),
        np.array([[spot[axis] for axis in "xyz"] for spot in tip]),
    )
    plane = np.linalg.svd(places - places.mean(axis=0), full_matrices=False)[2][:2]
    return str(known["name"]).lower(), np.column_stack([times, places @ plane.T])


def main() -> None:
    """Writes the strokes that can be used."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--datasets", nargs="+", default=["3DMadLabSD", "3DTCGS"])
    parser.add_argument("--rest", action="store_true", help="those that are not taken without it")
    parser.add_argument(
        "--people",
        choices=("all", "develop", "judge"),
        default="judge",
        help="develop: people 1 to 5 of 3DMadLabSD, with whom the extraction was looked at; judge: the others",
    )
    given = parser.parse_args()
    taken: Counter = Counter()
    strokes = []
    for dataset in given.datasets:
        for file in sorted((given.folder / dataset).rglob("*.json")):
            looked_at = dataset == "3DMadLabSD" and file.parent.name in {f"Subject{number}" for number in range(1, 6)}
            if given.people != "all" and looked_at != (given.people == "develop"):
                continue
            name, rows = read(file)
            rows = rows[np.append(True, np.diff(rows[:, 0]) > 0.0)]
            if name not in CLOSED | OPEN or len(rows) < 5:
                continue
            taken[file.parent, name] += 1
            if dataset != "SHREC2019" and (taken[file.parent, name] > EACH) != given.rest:
                continue
            diagonal = np.linalg.norm(np.ptp(rows[:, 1:], axis=0))
            step = np.linalg.norm(np.diff(rows[:, 1:], axis=0), axis=1).max() / diagonal
            points = np.column_stack([rows[:, 0] - rows[0, 0], rows[:, 1:] / diagonal * (SIZE, -SIZE)])
            strokes.append(
                {
                    "id": str(file.relative_to(given.folder)),
                    "shape": name,
                    "closed": name in CLOSED,
                    "max_inner_step_rel_diag": round(float(step), 3),
                    "points": np.round(points, 4).tolist(),
                }
            )
    given.out.write_text(json.dumps(strokes))
    print(f"{len(strokes)} strokes")


if __name__ == "__main__":
    main()
