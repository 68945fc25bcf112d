#!/usr/bin/env python3
"""Integration, commit, store and message times over map sizes and numbers of borders.

    . scripts/env.sh && python3 bench/map_integration.py [--quick]

Writes out/bench/map_integration.json. Every time is a median over several borders [ms]. No ROS master is needed;
what a commit takes up to the published message is integration, store, composition and serialisation together.
"""
from __future__ import annotations

import argparse
import io
import json
import os
import platform
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import rospy
from vb_core.grid_map import GridMap
from vb_core.ros.messages import message_from_grid
from vb_map_integration.border import VirtualBorder
from vb_map_integration.integration import integrate
from vb_map_integration.integrator import IntegratorParams, MapIntegrator

SIZES = [(320, 200), (1000, 1000), (2000, 2000), (4000, 4000), (8000, 8000)]
COUNTS = [1, 10, 100, 500]


def house(width: int, height: int) -> GridMap:
    """Rooms of 160 x 100 cells, with doors and table legs."""
    data = np.zeros((height, width), np.int8)
    data[::100] = 100
    data[:, ::160] = 100
    data[[-1]] = 100
    data[:, [-1]] = 100
    for row in range(50, height - 1, 100):
        data[row : row + 30, 160 : width - 1 : 160] = 0
    for column in range(80, width - 1, 160):
        data[100 : height - 1 : 100, column : column + 30] = 0
    data[40::100, 40::160] = 100
    return GridMap(data, 0.025, (-10.0, -5.0, 0.0))


def polygon(grid: GridMap, random: np.random.Generator, share: float) -> VirtualBorder:
    """A polygon with 100 points; its diameter is a share of the map's shorter side."""
    height, width = grid.shape
    radius = 0.5 * share * min(height, width)
    centre = random.uniform((radius, radius), (width - radius, height - radius))
    angles = np.linspace(0.0, 2.0 * np.pi, 100, endpoint=False)
    points = centre + radius * (0.9 + 0.1 * np.cos(7 * angles))[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    seed = centre
    while grid.data[int(round(seed[1])), int(round(seed[0]))] != 0:
        seed = centre + random.uniform(-0.5, 0.5, 2) * radius
    return VirtualBorder(grid.grid_to_world(points), grid.grid_to_world(seed)[0], closed=True)


def curve(grid: GridMap, random: np.random.Generator) -> VirtualBorder:
    """A drawn curve of 100 points across half of the map: its extensions go through rooms and doors."""
    height, width = grid.shape
    x = width * random.uniform(0.3, 0.7)
    rows = np.linspace(0.25, 0.75, 100) * height
    points = np.column_stack([x + 3.0 * np.sin(rows / 20.0), rows])
    seed = np.array([x - 0.2 * width, 0.5 * height])
    while grid.data[int(round(seed[1])), int(round(seed[0]))] != 0:
        seed += 3.0
    return VirtualBorder(grid.grid_to_world(points), grid.grid_to_world(seed)[0], closed=False)


def timed(action) -> float:
    """[ms] that an action takes."""
    started = time.perf_counter()
    action()
    return 1e3 * (time.perf_counter() - started)


def median(actions) -> float:
    """[ms], after one that is not counted."""
    times = [timed(action) for action in actions]
    return round(float(np.median(times[1:] or times)), 3)


def serialise(grid: GridMap) -> None:
    """What publishing does up to the socket."""
    message_from_grid(grid, rospy.Time(0)).serialize(io.BytesIO())


def run(size, counts, repeats) -> dict:
    """All figures of one map size."""
    random = np.random.default_rng(1)
    grid = house(*size)
    small = [polygon(grid, random, 0.1) for _ in range(max(counts) + 1)]
    large = [polygon(grid, random, 0.7) for _ in range(repeats)]
    curves = [curve(grid, random) for _ in range(repeats)]
    result = {
        "width_cells": size[0],
        "height_cells": size[1],
        "integrate_small_polygon_ms": median([lambda b=b: integrate(grid, b) for b in small[:repeats]]),
        "integrate_large_polygon_ms": median([lambda b=b: integrate(grid, b) for b in large]),
        "integrate_curve_ms": median([lambda b=b: integrate(grid, b) for b in curves]),
        "serialise_ms": median([lambda: serialise(grid)] * 3),
        "borders": [],
    }
    with tempfile.TemporaryDirectory() as folder:
        keeper = MapIntegrator(IntegratorParams(), Path(folder))
        result["take_map_ms"] = round(timed(lambda: keeper.set_map(grid)), 3)
        plain = MapIntegrator(IntegratorParams(check_ways=False), None)
        plain.set_map(grid)
        added = 0
        for count in counts:
            last = []
            while added < count:
                last.append(timed(lambda: keeper.add(small[added], 1.0 + added)))
                plain.add(small[added], 1.0 + added)
                added += 1
            tail = last[-5:]
            store = timed(lambda: keeper._folder.write(keeper.borders, 10**6, 1))  # noqa: SLF001
            memory = timed(lambda: plain.add(small[-1], 1e4))
            result["borders"].append({
                "borders": count,
                "commit_ms": round(float(np.median(tail)), 3),
                "commit_without_store_and_check_ms": round(memory, 3),
                "store_write_ms": round(store, 3),
                "undo_ms": round(timed(keeper.undo), 3),
                "redo_ms": round(timed(keeper.redo), 3),
            })
            plain.undo()
    return result


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="only the smallest map, up to 10 borders")
    arguments = parser.parse_args()
    sizes, counts = (SIZES[:1], COUNTS[:2]) if arguments.quick else (SIZES, COUNTS)
    path = Path(__file__).resolve().parent.parent / "out" / "bench" / "map_integration.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    results = []
    for size in sizes:
        # 500 borders on the largest maps would only repeat what the smaller ones show
        here = [count for count in counts if count * size[0] * size[1] <= 2_000_000_000]
        results.append(run(size, here, 7))
        last = results[-1]
        print(f"{size[0]} x {size[1]}: polygon {last['integrate_large_polygon_ms']} ms, curve {last['integrate_curve_ms']} ms, "
              f"commit {[entry['commit_ms'] for entry in last['borders']]} ms with {here} borders", flush=True)
    document = {"python": platform.python_version(), "cores": os.cpu_count(), "load_1min": os.getloadavg()[0], "sizes": results}
    path.write_text(json.dumps(document, indent=2) + "\n")
    print(f"wrote {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
