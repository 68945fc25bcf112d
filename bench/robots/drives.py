#!/usr/bin/env python3
"""Drives with the real move_base: round a border, into it, with a border right in front, with a box on the path.

    make navigation                                                     once
    python3 bench/robots/drives.py --robot turtlebot2                    all drives of a seed, for hours
    python3 bench/robots/drives.py --drives 10 --kinds nose              ten, of one kind

A robot type drives in the simulated lab (no cameras, no display) with move_base and AMCL as they are shipped here,
through its driver. Drives are judged by the robot's true position. Goals are drawn by a seed: in each scenario a chain
of places chosen so that, where possible, the straight line from one to the next crosses the border's area, driven forth
and back to cover both directions.

Simulated time waits for the driving nodes and for AMCL (the simulator's ~lockstep), so that it runs as fast as this
computer allows, and a busy computer makes drives last longer without changing them. A border is put in front of the
robot while time runs slowly, because the services that put it there take real time; the row says how much simulated
time passed.

Each drive is a row.
"""

import functools
import itertools
import math
from collections import Counter

import numpy as np

from bench.harness import Table, arguments, share
from bench.robots.drive_surprises import drive_box, drive_nose
from bench.robots.drive_lab import WORLDS, Lab
from vb_core.grid_map import distance_to, sample
from vb_core.navigation_parameters import PATH_MARGIN
from vb_map_integration.border import VirtualBorder as Border
from vb_map_integration.integration import integrate
from vb_robot.clearance_map import STOP_MARGIN, ClearanceMap
from vb_sim.room.floor_plan import physical_map
from vb_sim.room.world import load_world

WANTED = {
    "round": ("reached",),
    "inside": ("refused",),
    "nose": ("reached", "refused", "time_is_up"),
    "box": ("reached", "refused"),
}
SURPRISES = {"nose": drive_nose, "box": drive_box}
STUCK = 60.0  # [s] without moving, with a goal
SCENARIOS = ("carpet", "corner", "room")
RADIUS = 0.18  # [m] of the larger robot: both drive to the same places
ROUNDS, NOSES = 40, 20  # goals round each border; borders put in front of the robot, and as many boxes on the path
INSIDE = 2  # goals inside each border
MIN_LEG = 0.6  # [m] at least, between two poses


@functools.lru_cache(maxsize=None)
def places(scenario: str, seed: int):
    """Returns poses (x, y, yaw) [m, m, deg]: a chain round a scenario's border, and some inside the restricted area.

    In the chain a robot of RADIUS has the room that the dispatcher requires, and a path from each pose to the next.
    """
    world = load_world(str(WORLDS / "lab.yaml"))
    what, grid = world.scenarios[scenario], physical_map(world)
    posterior = integrate(grid, Border(np.array(what.border), np.array(what.seed), 1.0, what.closed)).posterior
    restricted = posterior.data > np.maximum(grid.data, 0)
    rng = np.random.default_rng([seed, SCENARIOS.index(scenario)])
    clearance_map = ClearanceMap(posterior, RADIUS + PATH_MARGIN)
    cells = posterior.cell_to_world(np.argwhere(clearance_map.clearance >= RADIUS + STOP_MARGIN))
    yaws = rng.integers(-180, 180, 1000)
    chain = [(*cells[rng.integers(len(cells))], 0)]
    if scenario == "corner":  # the unrestricted floor may have other parts, such as behind furniture
        chain = [(6.8, 4.2, 0)]
    while len(chain) <= ROUNDS // 2:
        here = np.array(chain[-1][:2])
        drawn = cells[rng.integers(len(cells), size=300)]
        drawn = drawn[
            (np.linalg.norm(drawn - here, axis=1) >= MIN_LEG) & np.isfinite(clearance_map.path_lengths(here, drawn))
        ]
        if not len(drawn):
            chain[-1] = (*cells[rng.integers(len(cells))], 0)  # no path leads on from here
            continue
        lines = here + np.linspace(0.0, 1.0, 100)[None, :, None] * (drawn - here)[:, None, :]
        through = sample(posterior, restricted, lines.reshape(-1, 2)).reshape(len(drawn), -1).any(axis=1)
        chain.append((*drawn[int(np.argmax(through))], int(yaws[len(chain)])))
    inside = posterior.cell_to_world(
        np.argwhere(restricted & (distance_to(~restricted) * posterior.resolution > RADIUS))
    )
    inside = [(*inside[rng.integers(len(inside))], 0) for _ in range(INSIDE)]
    return [tuple(float(round(value, 3)) for value in place) for place in (*chain, *inside)]


def tasks(seed: int):
    """Yields the drives, (kind, scenario, number, from, to), in turns, so that each part of them covers all."""
    for begin in range(0, ROUNDS, 10):
        for scenario in SCENARIOS:
            chain, inside = places(scenario, seed)[:-INSIDE], places(scenario, seed)[-INSIDE:]
            both = chain + chain[-2::-1]
            yield from (("round", scenario, i, both[i], both[i + 1]) for i in range(begin, begin + 10))
            if begin == 0:
                yield from (("inside", scenario, i, both[10], goal) for i, goal in enumerate(inside))
        share = NOSES * 10 // ROUNDS
        for kind in ("nose", "box"):
            numbers = range(begin // 10 * share, (begin // 10 + 1) * share)
            yield from ((kind, "", i, (7.0, 0.9, 180), None) for i in numbers)


def drive_scenario(lab, scenario, todo, keep) -> None:
    """Brings the robot to the start of the first drive, adds the border, and does the drives."""
    what, start = lab.world.scenarios[scenario], todo[0][3]
    if math.dist(lab.pose()[:2], start[:2]) > 0.2:
        lab.drive(start)
    border = lab.add(what.border, what.seed, what.closed)
    try:
        for kind, _, number, _, goal in todo:
            keep(kind, scenario, number, lab.drive(goal)[1])
    finally:
        lab.remove(border)


def main() -> None:
    parser = arguments(__doc__, seed=2)
    parser.add_argument("--robot", default="turtlebot2", choices=("turtlebot2", "turtlebot3_burger"))
    parser.add_argument("--kinds", nargs="+", default=list(WANTED), choices=list(WANTED), help="of drives")
    parser.add_argument("--first", type=int, default=0, help="leave out so many of these drives, to go on with a seed")
    parser.add_argument("--drives", type=int, default=1000, help="how many at most")
    given = parser.parse_args()
    table, counts = Table(given.csv, given.seed), Counter()
    todo = [task for task in tasks(given.seed) if task[0] in given.kinds][given.first :][: given.drives]
    if not todo:
        parser.error("no drives are left")
    lab = Lab(given.robot, todo[0][3], given.seed)

    def keep(kind, scenario, number, run) -> None:
        entered, added = (run["entered_m"] or -1.0) > 0.0, run.get("border", "added") == "added"
        good = run["outcome"] in WANTED[kind] and not entered and run["still_s"] <= STUCK
        counts[kind, "done"] += added
        counts[kind, "as wanted"] += added and good
        table.add(robot=given.robot, kind=kind, scenario=scenario, number=number, **run, as_wanted=good)

    try:
        for scenario, part in itertools.groupby(todo, key=lambda task: task[1]):
            if scenario:
                drive_scenario(lab, scenario, list(part), keep)
                continue
            for kind, _, number, _, _ in part:
                keep(kind, scenario, number, SURPRISES[kind](lab, number, given.seed))
    finally:
        lab.child.stop()
    for kind in given.kinds:
        as_wanted = share(counts[kind, "as wanted"], counts[kind, "done"])
        table.add(robot=given.robot, kind=f"each {kind}", as_wanted=as_wanted)


if __name__ == "__main__":
    main()
