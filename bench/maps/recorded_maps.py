#!/usr/bin/env python3
"""Measures how borders are transferred when a newer recording of a place replaces the map that a robot recorded.

    python3 bench/maps/recorded_maps.py FOLDER [--half development|judging] [--csv FILE]

FOLDER contains map_server's files, NAME.yaml and an image each. Its pairs.json lists pairs of maps of one place, every
second one for development: {"old": NAME, "new": NAME, "transform": [x, y, yaw]}. The transform, judged by eye, leads
from the old map's frame to the new one's. The borders are a square where the old map has the largest clearance, and
lines across its doorways. A line counts as *the same* if the area that it restricted, and the area that it restricts
on the new map after the right transform, have an IoU of at least 0.5; a square, if at least 75 % of its floor is known
in the new map. *Silently* means without a question about the border itself. The last rows list such errors.
"""

from __future__ import annotations

import json
import tempfile
from collections import defaultdict
from contextlib import suppress
from pathlib import Path
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from bench.harness import HALVES, ResultTable, arguments, share
from vb_core.grid_map import OCCUPIED_THRESHOLD, GridMap, Transform, clearance_grid, sample
from vb_core.map_files import read_map
from vb_evaluation.metrics import free_cells, jaccard
from vb_map_integration.border import IntegrationError, VirtualBorder
from vb_map_integration.borders_in_force import BorderStatus
from vb_map_integration.border_region import compute_region
from vb_map_integration.map_integrator import MapIntegrator
from vb_map_integration.restricted_cells import apply_regions

SILENT = "lines that silently closed off something else"
MIN_DOORWAY, MAX_DOORWAY = 0.65, 1.5  # [m] widths
MAX_LINES = 8  # on one map
MAX_TRIED = 1500  # places in doorways
MIN_APART = 1.0  # [m] between two lines
HALF_TURN = 24  # rays
_ANGLES = np.arange(2 * HALF_TURN) * np.pi / HALF_TURN
RAYS = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])


class Outcome(NamedTuple):
    """Whether a case counts for a figure; `error` describes the case if it is an error to inspect."""

    figure: str
    counts: bool
    error: str = ""


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


def place_borders(grid: GridMap, random: np.random.Generator) -> List[VirtualBorder]:
    """Returns a square of 0.8 m in the roomiest place, and up to MAX_LINES lines across doorways, MIN_APART apart."""
    clearance = clearance_grid(~free_cells(grid), grid.resolution)
    roomiest = grid.cell_to_world(np.argwhere(clearance == clearance.max())[:1])[0]
    corners = roomiest + 0.4 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    borders = [VirtualBorder(corners, roomiest, closed=True)]
    centers = random.permutation(np.argwhere((clearance > 0.4 * MIN_DOORWAY) & (clearance < 0.5 * MAX_DOORWAY)))
    for center in grid.cell_to_world(centers[:MAX_TRIED]):
        to_lines = [np.linalg.norm(line.points.mean(axis=0) - center) for line in borders[1:]]
        if len(to_lines) == MAX_LINES or min(to_lines, default=np.inf) < MIN_APART:
            continue
        passage = _narrowest_passage(grid, center)
        line = None if passage is None else _smaller_side(grid, center, *passage)
        if line is not None:
            borders.append(line)
    return borders


def _narrowest_passage(grid: GridMap, center: np.ndarray) -> Optional[Tuple[np.ndarray, np.ndarray]]:
    """Returns ends (2, 2) and normal of the shortest line through a point to obstacles; None if it is no doorway's."""
    steps = np.arange(0.0, MAX_DOORWAY, 0.5 * grid.resolution)
    along_rays = center + steps[:, None, None] * RAYS
    cells = sample(grid, grid.data, along_rays.reshape(-1, 2), -1.0).reshape(len(steps), len(RAYS))
    ends = np.argmax((cells < 0) | (cells >= OCCUPIED_THRESHOLD), axis=0)
    distances = np.where(cells[ends, range(len(RAYS))] >= OCCUPIED_THRESHOLD, steps[ends], np.inf)
    widths = distances[:HALF_TURN] + distances[HALF_TURN:]
    ray = int(np.argmin(widths))
    if not MIN_DOORWAY < widths[ray] < MAX_DOORWAY:
        return None
    both_ways = [ray, ray + HALF_TURN]
    points = center + RAYS[both_ways] * (distances[both_ways, None] - 0.05)  # ends a little before the walls
    return points, RAYS[ray + HALF_TURN // 2]


def _smaller_side(grid: GridMap, center: np.ndarray, ends: np.ndarray, normal: np.ndarray) -> Optional[VirtualBorder]:
    """Returns the line that restricts its smaller side over 2 m^2, without a warning; None if neither side is so."""
    lines = {}
    for side in (normal, -normal):
        line = VirtualBorder(ends, center + 0.25 * side, closed=False)
        with suppress(IntegrationError):  # it does not separate anything, or this side has no floor
            integrated = compute_region(grid, line)
            if integrated.area_m2 > 2.0 and not integrated.issues:
                lines[integrated.area_m2] = line
    return lines[min(lines)] if lines else None


def judge_pair(name: str, pair: Dict[str, Any], folder: Path, random: np.random.Generator) -> Iterator[Outcome]:
    """Places borders on a map, replaces it by the newer map, and yields the outcomes."""
    old, new = (read_map(folder / f"{pair[key]}.yaml") for key in ("old", "new"))
    truth = Transform(*pair["transform"])
    borders = place_borders(old, random)
    asks, statuses = replace_map(old, new, borders)
    yield Outcome("pairs about which it asked which place it is", asks)
    free = free_cells(new)
    floor = truth.inverse.apply(new.cell_to_world(np.argwhere(free)))  # of the newer map, in the older map's frame
    for border, status in zip(borders, statuses):
        restricted = compute_region(old, border).restricted_cells
        silent, same = not status.code, False
        if border.closed:
            distance = float(np.linalg.norm(status.map_border.seed - truth.apply(border.seed)[0]))
            is_off = distance > 0.25
            error = f"{name}: the square is {distance:.2f} m off" if is_off and silent else ""
            yield Outcome("squares in the wrong place, by over 0.25 m, certain or while it asked", is_off, error)
            moved_floor = truth.apply(old.cell_to_world(np.argwhere(restricted)))
            same = sample(new, new.data >= 0, moved_floor).mean() >= 0.75
        else:
            old_cells = sample(old, restricted, floor) > 0
            regions_in_force = [status.region] if silent else []
            new_cells = apply_regions(new.with_data(0 * new.data), regions_in_force).data[free] > 0
            overlap = jaccard(old_cells, new_cells)
            is_wrong = silent and overlap < 0.5
            error = f"{name}: line at {border.seed.round(1)}, {overlap:.2f} in common" if is_wrong else ""
            yield Outcome(SILENT, is_wrong, error)
            with suppress(IntegrationError):
                expected = compute_region(new, border.transform(truth)).restricted_cells[free]
                same = old_cells.any() and jaccard(old_cells, expected) >= 0.5
        yield Outcome("borders that are the same on the newer map", same)
        if same:
            yield Outcome("the same borders, in force without a question about anything", silent and not asks)
            yield Outcome("the same borders, in force without a question about the border itself", silent)


def main() -> None:
    parser = arguments(__doc__, seed=1)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--half", choices=HALVES, default=HALVES[0])
    options = parser.parse_args()
    table = ResultTable(options.csv, options.seed)
    pairs = json.loads((options.folder / "pairs.json").read_text(encoding="utf-8"))
    selected = list(enumerate(pairs, 1))[HALVES.index(options.half) :: 2]
    outcomes: List[Outcome] = []
    for number, pair in selected:
        outcomes += judge_pair(f"pair {number}", pair, options.folder, np.random.default_rng([options.seed, number]))
    trials: Dict[str, List[bool]] = defaultdict(list)
    for outcome in outcomes:
        trials[outcome.figure].append(bool(outcome.counts))
    rows: Dict[str, Any] = {"pairs of maps": len(selected), "lines across doorways": len(trials[SILENT])}
    rows.update({figure: share(sum(counted), len(counted)) for figure, counted in trials.items()})
    for figure, value in rows.items():
        table.add(half=options.half, what=figure, share=value)
    for error in (outcome.error for outcome in outcomes if outcome.error):
        table.add(half=options.half, what="went wrong silently", share=1, case=error)


if __name__ == "__main__":
    main()
