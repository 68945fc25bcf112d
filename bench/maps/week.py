#!/usr/bin/env python3
"""A week of changing maps: is a room ever open that was closed, without the state saying so?

    . scripts/env.sh && python3 bench/maps/week.py --homes 12

Each home has two floors with the same outer walls. In 15 starts of the integrator the map is static, made by SLAM from
nothing (growing map by map, at any pose), recorded again, shifted, turned, with other furniture, or that of the other
floor. Two rooms of the ground floor are closed at the first start, one upstairs when it is first seen. At each
published map every border of the floor that is truly shown is looked up where it truly lies, wherever the map has free
floor. When the state asks for confirmation, somebody answers truly every other time.
Writes docs/results/maps/week.csv, a row per kind of map; --label names the program that ran.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from collections import defaultdict
from pathlib import Path
from typing import Any, Dict, List, Tuple

import numpy as np
from homes import Home, corridor_home, draw_map, furnished

from vb_core.errors import CodedError
from vb_evaluation.provenance import revision
from vb_evaluation.result_table import write_table
from vb_map_integration.border import VirtualBorder
from vb_map_integration.integrator import IntegratorParams, MapIntegrator
from vb_map_integration.places.registration import IDENTITY, Transform

WEEK = (
    "static",
    "slam",
    "static",
    "recorded again",
    "furniture",
    "upstairs",
    "static",
    "shifted 0.3 m",
    "recorded again",
    "upstairs again",
    "slam",
    "turned 3 degrees",
    "upstairs",
    "furniture and recorded again",
    "static",
)


def pose(random: np.random.Generator) -> Transform:
    return Transform(*random.uniform(-5.0, 5.0, 2).tolist(), float(random.uniform(-math.pi, math.pi)))


def maps_of(
    kind: str, ground: Home, upstairs: Home, random: np.random.Generator, seed: int
) -> List[Tuple[str, Any, Transform]]:
    """Lists (floor, map, from the floor's frame to the map's) of one start, one after the other."""
    fixed = np.random.default_rng(seed)  # what was recorded once stays as it was
    if kind == "static":
        return [("ground", draw_map(ground, fixed), IDENTITY)]
    if kind == "upstairs":
        return [("upstairs", draw_map(upstairs, fixed), IDENTITY)]
    if kind == "upstairs again":
        truth = pose(random)
        return [("upstairs", draw_map(upstairs, random, truth), truth)]
    if kind == "slam":
        truth, grown = pose(random), []
        state = int(random.integers(1 << 30))
        for missing in (99, len(ground.rooms) // 2, 1, 0):
            grown.append(("ground", draw_map(ground, np.random.default_rng(state), truth, missing=missing), truth))
        return grown
    home = furnished(ground, random, kept=0.4) if "furniture" in kind else ground
    known = {"furniture": IDENTITY, "shifted 0.3 m": Transform(0.3), "turned 3 degrees": Transform(yaw=math.radians(3))}
    truth = known[kind] if kind in known else pose(random)
    return [("ground", draw_map(home, random, truth), truth)]


def border_of(home: Home, index: int) -> VirtualBorder:
    """Makes a border: a room, half a metre within its walls."""
    room = home.rooms[index]
    low, high = room.min(axis=0) + 0.5, room.max(axis=0) - 0.5
    corners = np.array([low, (high[0], low[1]), high, (low[0], high[1])])
    return VirtualBorder(corners, (low + high) / 2.0, closed=True)


def looked_up(keeper: MapIntegrator, borders: List[VirtualBorder], truth: Transform) -> Tuple[int, int]:
    """Counts (closed, open) of the places inside borders where the map has free floor."""
    shut = wide = 0
    for border in borders:
        low, high = border.points.min(axis=0) + 0.2, border.points.max(axis=0) - 0.2
        lattice = np.meshgrid(np.linspace(low[0], high[0], 5), np.linspace(low[1], high[1], 5))
        places = truth.apply(np.stack(lattice, -1).reshape(-1, 2))
        free = keeper.physical.values_at(places) == 0
        values = keeper.map_with_borders.values_at(places)[free]
        if len(values) and (values == 100).mean() >= 0.5:
            shut += 1
        elif len(values):
            wide += 1
    return shut, wide


def week(seed: int, rows: Dict[str, Dict[str, int]]) -> None:
    random = np.random.default_rng(seed)
    ground = corridor_home(random)
    upstairs = corridor_home(random, tuple(ground.outline.max(axis=0)))
    borders: Dict[str, List[VirtualBorder]] = {"ground": [], "upstairs": []}
    with tempfile.TemporaryDirectory() as folder:
        asked = 0
        for kind in WEEK:
            keeper = MapIntegrator(IntegratorParams(check_reachability=False), Path(folder))
            for floor, grid, truth in maps_of(kind, ground, upstairs, random, seed):
                keeper.set_map(grid)
                row = rows[kind]
                row["maps"] += 1
                says = bool(getattr(keeper, "needs_confirmation", False))
                shut, wide = looked_up(keeper, borders[floor], truth)
                other = borders["upstairs" if floor == "ground" else "ground"]
                restricts = bool((keeper.map_with_borders.data != keeper.physical.data).any())
                foreign = bool(other) and not borders[floor] and restricts
                row["in_doubt"] += says
                row["rooms_closed"] += shut
                row["rooms_open_and_said"] += wide if says else 0
                row["rooms_open_without_a_word"] += 0 if says else wide
                row["borders_of_the_other_floor_without_a_word"] += foreign and not says
                if says:
                    asked += 1
                    if asked % 2 == 0:
                        answer(keeper, floor, truth, borders)
                if not borders[floor] and not getattr(keeper, "needs_confirmation", False) and not keeper.borders:
                    for index in (1, 3) if floor == "ground" else (2,):
                        border = border_of(ground if floor == "ground" else upstairs, index)
                        moved = VirtualBorder(truth.apply(border.points), truth.apply(border.seed)[0], closed=True)
                        try:
                            keeper.add(moved, 1.0)
                            borders[floor].append(border)
                        except CodedError as error:
                            print(seed, kind, error)
            if hasattr(keeper, "close"):
                keeper.close()


def answer(keeper: MapIntegrator, floor: str, truth: Transform, borders: Dict[str, List[VirtualBorder]]) -> None:
    """Answers truly, as somebody who looks at the proposal's picture."""
    if not borders[floor]:
        keeper.confirm(False, floor, 2.0)
        return
    ours = {len(borders["ground"]): "ground", len(borders["upstairs"]): "upstairs"}.get(len(keeper.borders))
    if ours != floor:
        return
    proposal = keeper.propose_transfer("")
    apart, _ = proposal.transform.distance(truth, (4.0, 4.0))
    if apart < 0.15:
        keeper.transfer(proposal, 2.0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--homes", type=int, default=12)
    parser.add_argument("--seed", type=int, default=300)
    parser.add_argument("--label", default="")
    options = parser.parse_args()
    rows: Dict[str, Dict[str, int]] = {kind: defaultdict(int) for kind in WEEK}
    columns = (
        "maps",
        "in_doubt",
        "rooms_closed",
        "rooms_open_and_said",
        "rooms_open_without_a_word",
        "borders_of_the_other_floor_without_a_word",
    )
    name = f"maps/week-{options.label}" if options.label else "maps/week"
    made_by = revision()
    for number in range(options.homes):
        week(options.seed + number, rows)
        rows["all"] = {column: sum(rows[kind][column] for kind in dict.fromkeys(WEEK)) for column in columns}
        table = [{"kind": kind, **{column: rows[kind][column] for column in columns}} for kind in rows]
        path = write_table(name, f"maps/week.py --homes {number + 1}", f"{made_by} {options.label}", table)
    print(path.read_text())
    return 0


if __name__ == "__main__":
    sys.exit(main())
