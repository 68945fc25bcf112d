#!/usr/bin/env python3
"""Converts strokes that people drew in the air with a finger into the file that bench/extraction.py reads.

    git clone https://github.com/Mehous/TestingFramework
    python3 bench/strokes_in_air.py TestingFramework/src/datasets air.json
    python3 bench/extraction.py --people air.json --only people --methods robust

The repository holds 3DTCGS (13 people) and 3DMadLabSD (10 people), recorded by a Leap Motion sensor, in one format
(M. Ousmer et al., Proc. ACM Hum.-Comput. Interact. 4, ISS, 2020). It names no licence: nothing of it is kept here. A
finger in the air is nearer to a laser pointer than a mouse is: nothing guides it, and corners are rounded. Of each
person two strokes of each figure are taken that a border may have; what was meant is known from its name.
"""
from __future__ import annotations

import argparse
import json
from collections import Counter
from pathlib import Path

import numpy as np

CLOSED = {"circle", "rectangle", "triangle", "0"}
OPEN = {
    "caret", "check", "v", "zig-zag", "square-braket-left", "square-braket-right", "curly-braket-left",
    "curly-braket-right", "left-swipe", "right-swipe", "1", "2", "3", "5", "7", "c", "j",
}
EACH = 2
SIZE = 200.0  # [px] of a figure's diagonal


def main() -> None:
    """Writes the strokes that can be used."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--people", choices=("all", "develop", "judge"), default="judge",
                        help="develop: people 1 to 5 of 3DMadLabSD, with whom the extraction was looked at; judge: the others")
    given = parser.parse_args()
    taken: Counter = Counter()
    strokes = []
    for dataset in ("3DMadLabSD", "3DTCGS"):
        for file in sorted((given.datasets / dataset).rglob("*.json")):
            looked_at = file.parent.name in {f"Subject{number}" for number in range(1, 6)}
            if given.people != "all" and looked_at != (given.people == "develop"):
                continue
            known = json.loads(file.read_text())
            name = str(known["name"])
            rows = np.array([[spot["t"], spot["x"], spot["y"]] for spot in known["strokes"]], dtype=float)
            rows = rows[np.append(True, np.diff(rows[:, 0]) > 0.0)]
            if name not in CLOSED | OPEN or len(rows) < 5 or taken[file.parent, name] == EACH:
                continue
            taken[file.parent, name] += 1
            diagonal = np.linalg.norm(np.ptp(rows[:, 1:], axis=0))
            step = np.linalg.norm(np.diff(rows[:, 1:], axis=0), axis=1).max() / diagonal
            points = np.column_stack([(rows[:, 0] - rows[0, 0]) / 1000.0, rows[:, 1:] / diagonal * (SIZE, -SIZE)])
            strokes.append({"id": str(file.relative_to(given.datasets)), "shape": name, "closed": name in CLOSED,
                            "max_inner_step_rel_diag": round(float(step), 3), "points": np.round(points, 4).tolist()})
    given.out.write_text(json.dumps(strokes))
    print(f"{len(strokes)} strokes")


if __name__ == "__main__":
    main()
