#!/usr/bin/env python3
"""Measures drives with the real move_base: round a border, into it, with a new border in front, or a box on the path.

    make navigation                                                     once
    python3 bench/robots/drives.py --robot turtlebot2                    all drives of a seed, for hours
    python3 bench/robots/drives.py --drives 10 --kinds nose              ten, of one kind

A robot drives in the simulated lab (without cameras and display) with its driver, and move_base and AMCL as configured
here. Drives are judged by the robot's true position. Goals are random, determined by the seed: in each scenario they
form a chain in which, if possible, the straight line from one goal to the next crosses the border's area. The chain is
driven in both directions.

Each drive is a row. Simulated time runs as fast as possible, but waits for the driving nodes and for AMCL (the
simulator's ~lockstep): on a busy computer a drive takes longer, but does not change. A border is added in front of the
robot while time runs slowly, because the services take real time; the row gives the simulated time that passed.
"""

import itertools
import math
from collections import Counter
from typing import Callable, Iterator, List, NamedTuple, Optional, Tuple

import numpy as np

from bench.harness import ResultTable, arguments, share
from bench.robots.drive_disturbances import measure_drive_past_box, measure_drive_with_border_ahead
from bench.robots.drive_lab import WORLDS, Lab, PoseInDegrees, Row
from vb_core.grid_map import distance_transform, sample
from vb_core.navigation_parameters import PATH_MARGIN
from vb_map_integration.border import VirtualBorder as Border
from vb_map_integration.border_region import compute_region
from vb_robot.clearance_map import STOP_MARGIN, ClearanceMap
from vb_sim.floor_plan import physical_map
from vb_sim.world import load_world

WANTED = {
    "round": ("reached",),
    "inside": ("refused",),
    "nose": ("reached", "refused", "time_is_up"),
    "box": ("reached", "refused"),
}
DISTURBED = {"nose": measure_drive_with_border_ahead, "box": measure_drive_past_box}
STUCK = 60.0  # [s] without moving, with a goal
SCENARIOS = ("carpet", "corner", "room")
RADIUS = 0.18  # [m] of the larger robot, as both drive to the same goals
ROUNDS = 40  # goals round each border
NOSES = 20  # borders added in front of the robot's nose; as many boxes are put on its path
INSIDE = 2  # goals inside each border
MIN_LEG = 0.6  # [m] minimum between two poses


class Drive(NamedTuple):
    """A drive of a kind in WANTED. A disturbed one has neither scenario nor goal."""

    kind: str
    scenario: str
    number: int
    start: PoseInDegrees
    goal: Optional[PoseInDegrees] = None


def choose_poses(scenario: str, seed: int) -> Tuple[List[PoseInDegrees], List[PoseInDegrees]]:
    """Chooses a chain of poses round a scenario's border, and INSIDE poses in the restricted area.

    At each pose of the chain, a robot of RADIUS has the clearance that the dispatcher requires, and a path to the next.
    """
    world = load_world(str(WORLDS / "lab.yaml"))
    task, grid = world.scenarios[scenario], physical_map(world)
    posterior = compute_region(grid, Border(np.array(task.border), np.array(task.seed), 1.0, task.closed)).posterior
    restricted = posterior.data > np.maximum(grid.data, 0)
    rng = np.random.default_rng([seed, SCENARIOS.index(scenario)])
    clearance_map = ClearanceMap(posterior, RADIUS + PATH_MARGIN)
    cells = posterior.cell_to_world(np.argwhere(clearance_map.clearance >= RADIUS + STOP_MARGIN))
    yaws = rng.integers(-180, 180, 1000)
    chain = [(*cells[rng.integers(len(cells))], 0)]
    if scenario == "corner":  # starts in the main part of the unrestricted floor, not behind furniture
        chain = [(6.8, 4.2, 0)]
    while len(chain) <= ROUNDS // 2:
        start = np.array(chain[-1][:2])
        ends = cells[rng.integers(len(cells), size=300)]
        is_far = np.linalg.norm(ends - start, axis=1) >= MIN_LEG
        ends = ends[is_far & np.isfinite(clearance_map.path_lengths(start, ends))]
        if not len(ends):
            chain[-1] = (*cells[rng.integers(len(cells))], 0)  # replaces the pose, from which no path leads on
            continue
        lines = start + np.linspace(0.0, 1.0, 100)[None, :, None] * (ends - start)[:, None, :]
        crosses = sample(posterior, restricted, lines.reshape(-1, 2)).reshape(len(ends), -1).any(axis=1)
        chain.append((*ends[int(np.argmax(crosses))], int(yaws[len(chain)])))
    is_deep = distance_transform(~restricted) * posterior.resolution > RADIUS
    deep_cells = posterior.cell_to_world(np.argwhere(restricted & is_deep))
    inside = [(*deep_cells[rng.integers(len(deep_cells))], 0) for _ in range(INSIDE)]
    chain, inside = ([tuple(float(round(value, 3)) for value in pose) for pose in poses] for poses in (chain, inside))
    return chain, inside


def plan_drives(seed: int) -> Iterator[Drive]:
    """Yields the drives, with kinds and scenarios alternating."""
    poses = {scenario: choose_poses(scenario, seed) for scenario in SCENARIOS}
    for first in range(0, ROUNDS, 10):
        for scenario, (chain, inside) in poses.items():
            there_and_back = chain + chain[-2::-1]
            legs = list(zip(there_and_back, there_and_back[1:]))
            for number in range(first, first + 10):
                yield Drive("round", scenario, number, *legs[number])
            if first == 0:
                yield from (Drive("inside", scenario, i, there_and_back[10], goal) for i, goal in enumerate(inside))
        batch = NOSES * 10 // ROUNDS
        for kind in ("nose", "box"):
            numbers = range(first // 10 * batch, (first // 10 + 1) * batch)
            yield from (Drive(kind, "", i, (7.0, 0.9, 180)) for i in numbers)


def drive_scenario(lab: Lab, scenario: str, drives: List[Drive], record: Callable[[Drive, Row], None]) -> None:
    """Drives to the start of the first drive, adds the border, and does the drives."""
    task_scenario, start = lab.world.scenarios[scenario], drives[0].start
    if math.dist(lab.pose()[:2], start[:2]) > 0.2:
        lab.drive(start)
    border = lab.add(task_scenario.border, task_scenario.seed, task_scenario.closed)
    try:
        for drive in drives:
            record(drive, lab.drive(drive.goal)[1])
    finally:
        lab.remove(border)


def main() -> None:
    parser = arguments(__doc__, seed=2)
    parser.add_argument("--robot", default="turtlebot2", choices=("turtlebot2", "turtlebot3_burger"))
    parser.add_argument("--kinds", nargs="+", default=list(WANTED), choices=list(WANTED), help="of drives")
    parser.add_argument("--first", type=int, default=0, help="skip this number of drives, to continue a seed")
    parser.add_argument("--drives", type=int, default=1000, help="maximum number")
    options = parser.parse_args()
    table, counts = ResultTable(options.csv, options.seed), Counter()
    drives = [drive for drive in plan_drives(options.seed) if drive.kind in options.kinds]
    drives = drives[options.first :][: options.drives]
    if not drives:
        parser.error("no drives are left")
    lab = Lab(options.robot, drives[0].start, options.seed)

    def record(drive: Drive, row: Row) -> None:
        entered = (row["entered_m"] or -1.0) > 0.0
        added = row.get("border", "added") == "added"
        good = row["outcome"] in WANTED[drive.kind] and not entered and row["still_s"] <= STUCK
        counts[drive.kind, "done"] += added
        counts[drive.kind, "as wanted"] += added and good
        names = {"kind": drive.kind, "scenario": drive.scenario, "number": drive.number}
        table.add(robot=options.robot, **names, **row, as_wanted=good)

    try:
        for scenario, group in itertools.groupby(drives, key=lambda drive: drive.scenario):
            if scenario:
                drive_scenario(lab, scenario, list(group), record)
                continue
            for drive in group:
                record(drive, DISTURBED[drive.kind](lab, drive.number, options.seed))
    finally:
        lab.child.stop()
    for kind in options.kinds:
        as_wanted = share(counts[kind, "as wanted"], counts[kind, "done"])
        table.add(robot=options.robot, kind=f"each {kind}", as_wanted=as_wanted)


if __name__ == "__main__":
    main()
