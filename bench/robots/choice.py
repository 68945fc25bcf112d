#!/usr/bin/env python3
"""What choosing a place to look from costs, by the size of the map.

    python3 bench/robots/choice.py

Rooms of 6 m with doors, furniture in some of them, on maps of several sizes; in each place a line half drawn, and a
robot some metres away in the same room or the next one, or 40 m away. Each time the window is cut out and prepared
again: the worst case, since it serves for as long as the spot stays in it. Writes docs/results/robots/choice.md.
"""

import time
from pathlib import Path

import numpy as np

from vb_core.grid_map import GridMap
from vb_evaluation.provenance import revision
from vb_robot.dispatching.dispatch_policy import RobotStatus
from vb_robot.dispatching.dispatcher import RobotMap
from vb_robot.dispatching.drawing import DrawingState
from vb_robot.floor_view import FloorView

TOP = Path(__file__).resolve().parents[2]
TABLE = TOP / "docs" / "results" / "robots" / "choice.md"
TIMES = 40


def building(cells: int, resolution: float) -> GridMap:
    """Corridors 3 m wide between rooms, a wall each 6 m with doors of 1 m, its middle at (0, 0)."""
    data = np.zeros((cells, cells), dtype=np.int8)
    step, door = int(6.0 / resolution), int(1.0 / resolution)
    data[::step], data[:, ::step] = 100, 100
    for offset in range(door, 2 * door):
        data[offset::step] = np.where(data[offset::step] == 100, 0, data[offset::step])
        data[:, offset::step] = np.where(data[:, offset::step] == 100, 0, data[:, offset::step])
    half = 0.5 * cells * resolution
    return GridMap(data, resolution, (-half, -half, 0.0))


def choice(grid: GridMap, rng: np.random.Generator, far: bool, view: FloorView) -> float:
    """Times one choice: [ms] of processor time."""
    half = 0.5 * min(grid.shape) * grid.resolution - 4.0
    spot = rng.uniform(-0.5 * half, 0.5 * half, 2)
    direction = np.array([np.cos(rng.uniform(0, 6.28)), np.sin(rng.uniform(0, 6.28))])
    direction /= np.linalg.norm(direction)
    side = np.array([-direction[1], direction[0]])
    chain = spot - np.linspace(2.0, 0.0, 30)[:, None] * direction + 0.4 * np.sin(np.linspace(0, 3, 30))[:, None] * side
    place = spot + (40.0 if far else rng.uniform(1.5, 5.0)) * np.array([np.cos(rng.uniform(0, 6.28)), 0.3])
    robot = (float(place[0]), float(place[1]), float(rng.uniform(-3, 3)))
    grounds = RobotMap(0.18)
    grounds.view = view
    grounds.set_map(grid)
    began = time.process_time()
    outlook = grounds.make_planner(DrawingState(chain[-1], chain, 0.4 * direction), RobotStatus(robot), None, [])
    outlook.best_viewpoint(robot)
    return 1e3 * (time.process_time() - began)


def main() -> None:
    view = FloorView.usual()
    lines = [
        "# What choosing a place to look from costs",
        "",
        f"`python3 bench/robots/choice.py`, {time.strftime('%Y-%m-%d', time.gmtime())}, "
        f"revision {revision()}. Processor time of one choice with a window that is cut and prepared again; {TIMES} lines and "
        "robots at random. On a computer that is busy with other things processor time grows, too.",
        "",
        "| map | cells | robot | median | 95 % | longest |",
        "|---|---|---|---|---|---|",
    ]
    for cells, resolution in ((480, 0.025), (1000, 0.05), (4000, 0.05)):
        grid = building(cells, resolution)
        for far in (False, True):
            if far and 40.0 > 0.4 * cells * resolution:
                continue
            rng = np.random.default_rng(1)
            times = [choice(grid, rng, far, view) for _ in range(TIMES + 1)][1:]  # the first one loads libraries
            lines.append(
                f"| {cells} x {cells} at {resolution} m | {cells * cells / 1e6:.1f} million | {'40 m' if far else '1.5 to 5 m'} away | "
                f"{np.median(times):.0f} ms | {np.quantile(times, 0.95):.0f} ms | {max(times):.0f} ms |"
            )
            print(lines[-1], flush=True)
    TABLE.parent.mkdir(parents=True, exist_ok=True)
    TABLE.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
