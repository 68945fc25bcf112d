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

import itertools
import math
import sys
from collections import Counter

from bench.harness import Table, arguments, share
from bench.robots.drive_tasks import tasks
from bench.robots.drive_surprises import drive_box, drive_nose
from bench.robots.drive_lab import Lab

WANTED = {
    "round": ("reached",),
    "inside": ("refused",),
    "nose": ("reached", "refused", "time_is_up"),
    "box": ("reached", "refused"),
}
SURPRISES = {"nose": drive_nose, "box": drive_box}
STUCK = 60.0  # [s] without moving, with a goal


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


def main() -> int:
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
    return 0


if __name__ == "__main__":
    sys.exit(main())
