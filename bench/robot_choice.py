#!/usr/bin/env python3
"""What choosing a place to look from costs, by the size of the map.

    python3 bench/robot_choice.py

A room of 6 m x 5 m with furniture, in the middle of a building of free floor and walls; a line half drawn, a robot 3 m away,
and one 60 m away. Each time a fresh window, then ranking. Writes docs/results/robots_choice.md.
"""
import subprocess
import time
from pathlib import Path

import numpy as np

from vb_core.grid_map import GridMap
from vb_robot.dispatcher import Grounds
from vb_robot.terrain import TerrainParams
from vb_robot.view import FloorView, ViewParams
from vb_robot.viewpoint import Drawing, ViewpointParams, rank_viewpoints

TOP = Path(__file__).resolve().parent.parent
TABLE = TOP / "docs" / "results" / "robots_choice.md"
TIMES = 15


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


def main() -> None:
    view, params = FloorView.at(ViewParams()), ViewpointParams()
    revision = subprocess.run(["git", "describe", "--always", "--dirty"], cwd=str(TOP), stdout=subprocess.PIPE,
                              universal_newlines=True).stdout.strip()
    lines = ["# What choosing a place to look from costs", "", f"`python3 bench/robot_choice.py`, {time.strftime('%Y-%m-%d', time.gmtime())}, "
             f"revision {revision}. Processor time of one choice, the window cut and prepared anew each time; medians of {TIMES}.", "",
             "| map | cells | robot | window and ranking | ranking alone |", "|---|---|---|---|---|"]
    chain = np.array([[1.0, 1.5], [2.0, 1.5], [2.5, 2.0]])
    for cells, resolution in ((320, 0.025), (1000, 0.05), (4000, 0.05)):
        grid = building(cells, resolution)
        for distance in (3.0, 60.0):
            if distance > 0.4 * cells * resolution:
                continue
            robot = (2.5 - distance, 1.3, 0.0)
            drawing = Drawing(chain[-1], chain, np.array([0.7, 0.7]))
            whole, rank = [], []
            grounds = Grounds(TerrainParams())
            for _ in range(TIMES):
                grounds.set_map(grid, False)  # forgets the window
                began = time.process_time()
                terrain = grounds.terrain(drawing, robot)
                middle = time.process_time()
                rank_viewpoints(terrain, view, robot, drawing, params)
                end = time.process_time()
                whole.append(1e3 * (end - began))
                rank.append(1e3 * (end - middle))
            lines.append(f"| {cells} x {cells} at {resolution} m | {cells * cells / 1e6:.1f} million | {distance:.0f} m away | "
                         f"{np.median(whole):.0f} ms | {np.median(rank):.0f} ms |")
            print(lines[-1], flush=True)
    TABLE.parent.mkdir(parents=True, exist_ok=True)
    TABLE.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
