#!/usr/bin/env python3
"""Measures what becomes of borders on a map that a robot recorded when a newer recording of the place replaces it.

    python3 bench/maps/recorded_maps.py FOLDER [--half development|judging] [--csv FILE]

FOLDER has map_server's files, NAME.yaml with a picture each, and pairs.json, a list of pairs of one place, every second
for development: {"old": NAME, "new": NAME, "transform": [x, y, yaw]}, from the old map's frame to the new one's, judged
by eye. On the older map are a square, where the most floor is round it, and lines across doorways. A line is *the same*
if what it closed off, as free floor of the newer map, and what it closes off there when moved by the right transform
have half of their union in common; a square, if three quarters of its floor are known there. *Without a word*: with no
question about the border itself, even if it is asked which place it is. The last rows list what went wrong that way.
"""

from __future__ import annotations

import json
import tempfile
from collections import defaultdict
from contextlib import suppress
from pathlib import Path
from typing import Any, Dict, Iterator, List, Sequence, Tuple

import numpy as np

from bench.harness import HALVES, Table, arguments, share
from vb_core.grid_map import OCCUPIED_THRESHOLD, GridMap, clearance_grid, sample
from vb_core.map_files import read_map
from vb_evaluation.metrics import free_cells, jaccard
from vb_map_integration.border import IntegrationError, VirtualBorder
from vb_map_integration.borders_in_force import Verdict
from vb_map_integration.integration import apply_regions, integrate
from vb_map_integration.map_integrator import MapIntegrator
from vb_map_integration.places.registration import Transform

SILENT = "lines that closed off something else without a word"
Outcome = Tuple[str, bool, str]  # the figure, whether it holds, and the case to look at if it does


def replace_map(old: GridMap, new: GridMap, borders: Sequence[VirtualBorder]) -> Tuple[bool, List[Verdict]]:
    """Returns whether it is asked which place the new map shows, and the verdicts on borders drawn on the old one."""
    with tempfile.TemporaryDirectory() as folder:
        keeper = MapIntegrator(Path(folder))
        keeper.set_map(old)
        ids = [keeper.add(border, 1.0 + number).ids[0] for number, border in enumerate(borders)]
        keeper.set_map(new)
        keeper.close()
    asks = any(notice.code == "borders_unconfirmed" for notice in keeper.notices)
    return asks, [keeper.in_force.verdicts[one] for one in ids]


def draw_borders(grid: GridMap, random: np.random.Generator) -> List[VirtualBorder]:
    """Draws a square, and up to 8 lines, 1 m apart, that close off the smaller side, over 2 m^2, without a warning."""
    clearance = clearance_grid(~free_cells(grid), grid.resolution)
    roomiest = grid.cell_to_world(np.argwhere(clearance == clearance.max())[:1])[0]
    corners = roomiest + 0.4 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    found = [VirtualBorder(corners, roomiest, closed=True)]
    least, most = 0.65, 1.5  # [m] width of a doorway
    middles = random.permutation(np.argwhere((clearance > 0.4 * least) & (clearance < 0.5 * most)))
    angles, steps = np.arange(48) * np.pi / 24.0, np.arange(0.0, most, 0.5 * grid.resolution)
    rays = np.column_stack([np.cos(angles), np.sin(angles)])
    for middle in grid.cell_to_world(middles[:1500]):
        if len(found) == 9 or any(np.linalg.norm(one.points.mean(axis=0) - middle) < 1.0 for one in found[1:]):
            continue
        cells = sample(grid, grid.data, (middle + steps[:, None, None] * rays).reshape(-1, 2), -1.0).reshape(-1, 48)
        ends = np.argmax((cells < 0) | (cells >= OCCUPIED_THRESHOLD), axis=0)
        reach = np.where(cells[ends, range(48)] >= OCCUPIED_THRESHOLD, steps[ends], np.inf)
        best = int(np.argmin(reach[:24] + reach[24:]))
        if not least < reach[best] + reach[best + 24] < most:
            continue
        points, sides = [middle + rays[one] * (reach[one] - 0.05) for one in (best, best + 24)], {}
        for beside in (rays[best + 12], -rays[best + 12]):
            line = VirtualBorder(points, middle + 0.25 * beside, closed=False)
            with suppress(IntegrationError):  # it separates nothing, or there is no floor on this side
                closed = integrate(grid, line)
                if closed.area_m2 > 2.0 and not closed.issues:
                    sides[closed.area_m2] = line
        found += [sides[min(sides)]] if sides else []
    return found


def judge_pair(name: str, pair: Dict[str, Any], folder: Path, random: np.random.Generator) -> Iterator[Outcome]:
    """Draws borders on a map, replaces it by the newer one, and yields the outcomes."""
    old, new = (read_map(folder / f"{pair[key]}.yaml") for key in ("old", "new"))
    truth, borders = Transform(*pair["transform"]), draw_borders(old, random)
    asks, verdicts = replace_map(old, new, borders)
    yield "pairs about which it asked which place it is", asks, ""
    free = free_cells(new)
    floor = truth.inverse.apply(new.cell_to_world(np.argwhere(free)))  # the newer map's, in the older one's frame
    for border, verdict in zip(borders, verdicts):
        closed, silent, same = integrate(old, border).restricted_cells, not verdict.code, False
        if border.closed:
            off = float(np.linalg.norm(verdict.border.seed - truth.apply(border.seed)[0]))
            case = f"{name}: the square is {off:.2f} m off" if silent else ""
            yield "squares in the wrong place, by over 0.25 m, certain or while it asked", off > 0.25, case
            same = sample(new, new.data >= 0, truth.apply(old.cell_to_world(np.argwhere(closed)))).mean() >= 0.75
        else:
            before = sample(old, closed, floor) > 0
            now = apply_regions(new.with_data(0 * new.data), [verdict.region] if silent else []).data[free] > 0
            common = jaccard(before, now)
            yield SILENT, silent and common < 0.5, f"{name}: line at {border.seed.round(1)}, {common:.2f} in common"
            with suppress(IntegrationError):
                after = integrate(new, border.moved(truth)).restricted_cells[free]
                same = before.any() and jaccard(before, after) >= 0.5
        yield "borders that are the same on the newer map", same, ""
        if same:
            yield "the same borders, in force without a question about anything", silent and not asks, ""
            yield "the same borders, in force without a question about the border itself", silent, ""


def main() -> None:
    parser = arguments(__doc__, seed=1)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--half", choices=HALVES, default=HALVES[0])
    given = parser.parse_args()
    table, half, outcomes = Table(given.csv, given.seed), HALVES.index(given.half), []
    pairs = json.loads((given.folder / "pairs.json").read_text(encoding="utf-8"))
    for number, pair in list(enumerate(pairs, 1))[half::2]:
        outcomes += judge_pair(f"pair {number}", pair, given.folder, np.random.default_rng([given.seed, number]))
    trials: Dict[str, List[bool]] = defaultdict(list)
    for what, holds, _ in outcomes:
        trials[what].append(bool(holds))
    rows: Dict[str, Any] = {"pairs of maps": len(pairs[half::2]), "lines across doorways": len(trials[SILENT])}
    rows.update({what: share(sum(some), len(some)) for what, some in trials.items()})
    for what, value in rows.items():
        table.add(half=given.half, what=what, share=value)
    for case in (case for _, holds, case in outcomes if holds and case):
        table.add(half=given.half, what="went wrong without a word", share=1, case=case)


if __name__ == "__main__":
    main()
