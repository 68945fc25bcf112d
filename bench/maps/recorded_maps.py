#!/usr/bin/env python3
"""Measures how borders are transferred when a newer recording of a place replaces the map that a robot recorded.

    python3 bench/maps/recorded_maps.py FOLDER [--half development|judging] [--csv FILE]

FOLDER contains map_server's files, NAME.yaml and an image each. Its pairs.json lists pairs of maps of one place, every
second one for development: {"old": NAME, "new": NAME, "transform": [x, y, yaw]}. The transform, judged by eye, leads
from the old map's frame to the new one's. The borders are a square where the old map has the largest clearance, and
lines across its doorways. A line is *the same* if the area that it restricted and the area that it restricts after the
right transform overlap by half of their union; a square, if the new map knows three quarters of its floor. *Without a
word* means without a question about the border itself. The last rows list such errors.
"""

from __future__ import annotations

import json
import tempfile
from collections import defaultdict
from contextlib import suppress
from pathlib import Path
from typing import Any, Dict, Iterator, List, Sequence, Tuple

import numpy as np

from bench.harness import HALVES, ResultTable, arguments, share
from vb_core.grid_map import OCCUPIED_THRESHOLD, GridMap, Transform, clearance_grid, sample
from vb_core.map_files import read_map
from vb_evaluation.metrics import free_cells, jaccard
from vb_map_integration.border import IntegrationError, VirtualBorder
from vb_map_integration.borders_in_force import BorderStatus
from vb_map_integration.border_region import compute_region
from vb_map_integration.map_integrator import MapIntegrator
from vb_map_integration.region import apply_regions

SILENT = "lines that closed off something else without a word"
CaseOutcome = Tuple[str, bool, str]  # the figure, whether the case counts for it, and the case to inspect if it does


def replace_map(old: GridMap, new: GridMap, borders: Sequence[VirtualBorder]) -> Tuple[bool, List[BorderStatus]]:
    """Returns whether it is asked which place the new map shows, and the statuses of borders drawn on the old map."""
    with tempfile.TemporaryDirectory() as folder:
        keeper = MapIntegrator(Path(folder))
        keeper.set_map(old)
        ids = [keeper.add(border, 1.0 + number).ids[0] for number, border in enumerate(borders)]
        keeper.set_map(new)
        keeper.close()
    asks = any(notice.code == "borders_unconfirmed" for notice in keeper.notices)
    return asks, [keeper.borders_in_force.statuses[id] for id in ids]


def draw_borders(grid: GridMap, random: np.random.Generator) -> List[VirtualBorder]:
    """Draws a square, and up to 8 lines, 1 m apart. Each restricts its smaller side, over 2 m^2, without a warning."""
    clearance = clearance_grid(~free_cells(grid), grid.resolution)
    roomiest = grid.cell_to_world(np.argwhere(clearance == clearance.max())[:1])[0]
    corners = roomiest + 0.4 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    borders = [VirtualBorder(corners, roomiest, closed=True)]
    min_width, max_width = 0.65, 1.5  # [m] width of a doorway
    centers = random.permutation(np.argwhere((clearance > 0.4 * min_width) & (clearance < 0.5 * max_width)))
    angles, steps = np.arange(48) * np.pi / 24.0, np.arange(0.0, max_width, 0.5 * grid.resolution)
    rays = np.column_stack([np.cos(angles), np.sin(angles)])
    for center in grid.cell_to_world(centers[:1500]):
        to_lines = [np.linalg.norm(line.points.mean(axis=0) - center) for line in borders[1:]]
        if len(to_lines) == 8 or min(to_lines, default=np.inf) < 1.0:
            continue
        along_rays = center + steps[:, None, None] * rays
        cells = sample(grid, grid.data, along_rays.reshape(-1, 2), -1.0).reshape(-1, 48)
        ends = np.argmax((cells < 0) | (cells >= OCCUPIED_THRESHOLD), axis=0)
        distances = np.where(cells[ends, range(48)] >= OCCUPIED_THRESHOLD, steps[ends], np.inf)
        best = int(np.argmin(distances[:24] + distances[24:]))
        if not min_width < distances[best] + distances[best + 24] < max_width:
            continue
        points = [center + rays[ray] * (distances[ray] - 0.05) for ray in (best, best + 24)]
        sides = {}
        for side in (rays[best + 12], -rays[best + 12]):
            line = VirtualBorder(points, center + 0.25 * side, closed=False)
            with suppress(IntegrationError):  # it does not separate anything, or this side has no floor
                integrated = compute_region(grid, line)
                if integrated.area_m2 > 2.0 and not integrated.issues:
                    sides[integrated.area_m2] = line
        if sides:
            borders.append(sides[min(sides)])
    return borders


def judge_pair(name: str, pair: Dict[str, Any], folder: Path, random: np.random.Generator) -> Iterator[CaseOutcome]:
    """Draws borders on a map, replaces it by the newer map, and yields the outcomes."""
    old, new = (read_map(folder / f"{pair[key]}.yaml") for key in ("old", "new"))
    truth, borders = Transform(*pair["transform"]), draw_borders(old, random)
    asks, statuses = replace_map(old, new, borders)
    yield "pairs about which it asked which place it is", asks, ""
    free = free_cells(new)
    floor = truth.inverse.apply(new.cell_to_world(np.argwhere(free)))  # of the newer map, in the older map's frame
    for border, status in zip(borders, statuses):
        restricted = compute_region(old, border).restricted_cells
        silent, same = not status.code, False
        if border.closed:
            error = float(np.linalg.norm(status.map_border.seed - truth.apply(border.seed)[0]))
            case = f"{name}: the square is {error:.2f} m off" if silent else ""
            yield "squares in the wrong place, by over 0.25 m, certain or while it asked", error > 0.25, case
            moved_floor = truth.apply(old.cell_to_world(np.argwhere(restricted)))
            same = sample(new, new.data >= 0, moved_floor).mean() >= 0.75
        else:
            old_cells = sample(old, restricted, floor) > 0
            regions_in_force = [status.region] if silent else []
            new_cells = apply_regions(new.with_data(0 * new.data), regions_in_force).data[free] > 0
            overlap = jaccard(old_cells, new_cells)
            yield SILENT, silent and overlap < 0.5, f"{name}: line at {border.seed.round(1)}, {overlap:.2f} in common"
            with suppress(IntegrationError):
                expected = compute_region(new, border.transform(truth)).restricted_cells[free]
                same = old_cells.any() and jaccard(old_cells, expected) >= 0.5
        yield "borders that are the same on the newer map", same, ""
        if same:
            yield "the same borders, in force without a question about anything", silent and not asks, ""
            yield "the same borders, in force without a question about the border itself", silent, ""


def main() -> None:
    parser = arguments(__doc__, seed=1)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--half", choices=HALVES, default=HALVES[0])
    options = parser.parse_args()
    table = ResultTable(options.csv, options.seed)
    pairs = json.loads((options.folder / "pairs.json").read_text(encoding="utf-8"))
    selected = list(enumerate(pairs, 1))[HALVES.index(options.half) :: 2]
    outcomes: List[CaseOutcome] = []
    for number, pair in selected:
        outcomes += judge_pair(f"pair {number}", pair, options.folder, np.random.default_rng([options.seed, number]))
    trials: Dict[str, List[bool]] = defaultdict(list)
    for figure, holds, _ in outcomes:
        trials[figure].append(bool(holds))
    rows: Dict[str, Any] = {"pairs of maps": len(selected), "lines across doorways": len(trials[SILENT])}
    rows.update({figure: share(sum(holds_list), len(holds_list)) for figure, holds_list in trials.items()})
    for figure, value in rows.items():
        table.add(half=options.half, what=figure, share=value)
    for case in (case for _, holds, case in outcomes if holds and case):
        table.add(half=options.half, what="went wrong without a word", share=1, case=case)


if __name__ == "__main__":
    main()
