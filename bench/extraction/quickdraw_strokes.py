#!/usr/bin/env python3
"""Measures how people move when they draw, and writes what the simulated hand draws with (src/vb_sim/config/strokes.json).

    python3 bench/extraction/quickdraw_strokes.py quickdraw_strokes.json

A stroke of the raw Quick, Draw! data is cut at its corners. Of each side remain, at equal times from corner to corner,
the share of the side that is done and the deviation from the straight line as a share of its length: corner stops, peak
speeds and uneven sides are in these two curves. Beside them: the tempo of each side, how far a corner is overshot (or
cut, negative), and how far a closed figure's end lies beyond its start (or short of it, negative). Nothing is fitted.
The strokes were made on screens: they say nothing about a laser pointer's tremor, and their scale is none of a floor's.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any, Dict, List, Optional

import numpy as np
from shapely.geometry import LineString

OUT = Path(__file__).resolve().parents[2] / "src" / "vb_sim" / "config" / "strokes.json"
CORNERS = {"rectangle": 3, "triangle": 2, "hexagon": 5, "octagon": 7, "zigzag": None, "line": 0}  # None: any number
SAMPLES = 17
TOLERANCE, TURN = 0.06, math.radians(30.0)  # [diagonal] and angle from which a bend is a corner
LONGEST_STEP = 0.25  # [diagonal] beyond which a part of the stroke is missing in the data (the data's own note)
SHORTEST_SIDE = 0.12  # [diagonal] shorter ones are the hook of a pen
ATTRIBUTION = (
    "Derived from the Quick, Draw! dataset, (c) Google, Inc., CC BY 4.0 "
    "(https://creativecommons.org/licenses/by/4.0/): cut into sides, resampled in time, scaled to unit length"
)


def main() -> None:
    """Reads the strokes, writes the resource and prints what is in it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("strokes", type=Path)
    parser.add_argument("--out", type=Path, default=OUT)
    given = parser.parse_args()
    known = [stroke for stroke in json.loads(given.strokes.read_text()) if stroke["shape"] in CORNERS]
    people = [person for person in map(measure, known) if person is not None]
    text = json.dumps(
        {
            "attribution": ATTRIBUTION,
            "command": f"python3 bench/extraction/quickdraw_strokes.py {given.strokes.name}",
            "strokes": len(known),
            "people": people,
        },
        separators=(",", ":"),
    )
    given.out.write_text(text.replace('{"id"', '\n{"id"') + "\n")
    print(
        f"{len(people)} of {len(known)} polygonal strokes taken, the others have other corners than their shape or lack a part"
    )


def measure(stroke: Dict[str, Any]) -> Optional[Dict[str, Any]]:
    """Measures what one person's stroke says; None if it is not the figure that it should be."""
    samples = np.array(stroke["points"], dtype=float)
    stamps, points = samples[:, 0], samples[:, 1:] * (1.0, -1.0)
    diagonal = float(np.linalg.norm(np.ptp(points, axis=0)))
    if stroke.get("max_inner_step_rel_diag", 0.0) > LONGEST_STEP:
        return None
    corners = _corners(points, diagonal)
    wanted = CORNERS[stroke["shape"]]
    if wanted is not None and len(corners) != wanted + 2:
        return None
    sides, overshoots = [], []
    lengths = [float(np.linalg.norm(points[end] - points[begin])) for begin, end in zip(corners, corners[1:])]
    tempo = [(stamps[end] - stamps[begin]) / length for begin, end, length in zip(corners, corners[1:], lengths)]
    for begin, end, length, slowness in zip(corners, corners[1:], lengths, tempo):
        direction = (points[end] - points[begin]) / length
        offset = points[begin : end + 1] - points[begin]
        times = np.linspace(stamps[begin], stamps[end], SAMPLES)
        along, lateral = (
            np.interp(times, stamps[begin : end + 1], values / length)
            for values in (offset @ direction, offset @ np.array([-direction[1], direction[0]]))
        )
        sides.append(
            {
                "along": _rounded(along),
                "lateral": _rounded(lateral),
                "tempo": round(float(np.sum(lengths) / np.dot(tempo, lengths) * slowness), 3),
            }
        )
    for before, corner, after in zip(corners, corners[1:], corners[2:]):
        found = _overshoot(points[before : corner + 1], points[corner : after + 1])
        overshoots += [found] if found is not None else []
    return {
        "id": stroke["id"],
        "shape": stroke["shape"],
        "gap": _gap(points, corners, diagonal) if stroke["closed"] else None,
        "overshoot": _rounded(overshoots),
        "sides": sides,
    }


def _corners(points: np.ndarray, diagonal: float) -> List[int]:
    """Indices of the stroke's ends and of the bends between straight sides."""
    kept = np.array(LineString(points).simplify(TOLERANCE * diagonal, preserve_topology=False).coords)
    found, start = [], 0
    for place in kept:
        start += int(np.argmin(np.linalg.norm(points[start:] - place, axis=1)))
        found.append(start)
    changed = True
    while changed and len(found) > 2:
        changed = False
        for index in range(1, len(found) - 1):
            a, b = points[found[index]] - points[found[index - 1]], points[found[index + 1]] - points[found[index]]
            sizes = np.linalg.norm(a), np.linalg.norm(b)
            turn = math.acos(float(np.clip(a @ b / max(sizes[0] * sizes[1], 1e-9), -1.0, 1.0)))
            if turn < TURN or min(sizes) < SHORTEST_SIDE * diagonal:
                # a hook at the very end is the end; elsewhere the bend is no corner
                del found[index]
                changed = True
                break
    return found


def _overshoot(incoming: np.ndarray, outgoing: np.ndarray) -> Optional[float]:
    """How far the hand went beyond where the two sides' straight middles meet, as a share of the incoming side."""
    lines = []
    for side in (incoming, outgoing):
        middle = side[len(side) // 5 : max(len(side) - len(side) // 5, len(side) // 5 + 2)]
        if len(middle) < 3:
            return None
        center = middle.mean(axis=0)
        direction = np.linalg.svd(middle - center)[2][0]
        lines.append((center, direction * math.copysign(1.0, direction @ (side[-1] - side[0]))))
    (a, u), (b, v) = lines
    cross = u[0] * v[1] - u[1] * v[0]
    if abs(cross) < 0.3:
        return None
    meeting = a + u * ((b - a)[0] * v[1] - (b - a)[1] * v[0]) / cross
    near = np.vstack([incoming[-max(len(incoming) // 3, 2) :], outgoing[: max(len(outgoing) // 3, 2)]])
    return float(np.clip(np.max((near - meeting) @ u) / np.linalg.norm(incoming[-1] - incoming[0]), -0.4, 0.4))


def _gap(points: np.ndarray, corners: List[int], diagonal: float) -> float:
    """How far the end lies beyond the start along the last side; negative: short of it."""
    along = points[-1] - points[corners[-2]]
    offset = points[-1] - points[0]
    return round(float(math.copysign(np.linalg.norm(offset), offset @ along) / diagonal), 4)


def _rounded(values: Any) -> List[float]:
    return [round(float(value), 4) for value in values]


if __name__ == "__main__":
    main()
