#!/usr/bin/env python3
"""Integration and changes beside an older revision's, in turns, so that what else the computer does meets both.

    git archive REVISION src | tar -x -C before
    . scripts/env.sh && python3 bench/maps/speed.py --before before

One process of each revision does the same operation, now the one, now the other; the ratio is that of the medians of
wall time. Writes docs/results/maps/speed.csv.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, Dict, List

import numpy as np

from vb_evaluation.provenance import revision
from vb_evaluation.result_table import write_table

TOP = Path(__file__).resolve().parents[2]
OPERATIONS = ("integrate", "add", "undo", "redo", "rename", "remove", "start")
WORKER = """
import json, sys, tempfile, time
sys.path.insert(0, {bench!r})
from pathlib import Path
import numpy as np
from integration_scene import house, polygon
from vb_map_integration.integration import integrate
from vb_map_integration.integrator import IntegratorParams, MapIntegrator

width, height, there = {width}, {height}, {there}
random = np.random.default_rng(1)
grid = house(width, height)
folder = Path(tempfile.mkdtemp())

def open_keeper():
    keeper = MapIntegrator(IntegratorParams(), folder)
    keeper.set_map(grid)
    return keeper

def close(keeper):
    if hasattr(keeper, "close"):
        keeper.close()

fast = MapIntegrator(IntegratorParams(check_reachability=False), folder)
fast.set_map(grid)
for number in range(there):
    fast.add(polygon(grid, random, 0.1), 1.0 + number)
close(fast)
keeper = open_keeper()
keeper.add(polygon(grid, random, 0.1), 1.0)
print("ready", flush=True)
for line in sys.stdin:
    what = line.strip()
    border = polygon(grid, random, 0.1)
    last = keeper.borders[-1]
    if what == "start":
        close(keeper)
    started = time.perf_counter()
    if what == "integrate":
        integrate(grid, border)
    elif what == "add":
        keeper.add(border, 5.0)
    elif what == "rename" and hasattr(keeper, "rename"):
        keeper.rename(last.id, "name", 6.0)
    elif what == "rename":
        keeper.update(last.replace(name="name"), 6.0)
    elif what == "remove":
        keeper.remove(last.id)
    elif what == "start":
        keeper = open_keeper()
    else:
        getattr(keeper, what)()
    print(1e3 * (time.perf_counter() - started), flush=True)
"""


class Runner:
    """A process of one revision."""

    def __init__(self, source: Path, width: int, height: int, there: int) -> None:
        paths = [str(source / "src" / package / "src") for package in ("vb_map_integration", "vb_core")]
        environment = {**os.environ, "PYTHONPATH": ":".join([*paths, os.environ.get("PYTHONPATH", "")])}
        code = WORKER.format(bench=str(TOP / "bench" / "maps"), width=width, height=height, there=there)
        self._process = subprocess.Popen(
            [sys.executable, "-c", code],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            universal_newlines=True,
        )
        assert self._process.stdout is not None and self._process.stdout.readline().strip() == "ready"

    def time(self, what: str) -> float:
        """Times one operation [ms]."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(f"{what}\n")
        self._process.stdin.flush()
        return float(self._process.stdout.readline())

    def close(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(20.0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", type=Path, required=True)
    parser.add_argument("--rounds", type=int, default=15)
    options = parser.parse_args()
    rows: List[Dict[str, Any]] = []
    made_by = revision()
    for width, height, there in ((320, 200, 10), (320, 200, 500), (1000, 1000, 10), (4000, 4000, 10)):
        rounds = options.rounds if width < 4000 else max(5, options.rounds // 3)
        runners = [Runner(source, width, height, there) for source in (options.before, TOP)]
        times: Dict[str, List[List[float]]] = {what: [[], []] for what in OPERATIONS}
        for number in range(rounds):
            for what in OPERATIONS:
                if what == "start" and number % 5:
                    continue
                for index in (0, 1) if number % 2 else (1, 0):
                    times[what][index].append(runners[index].time(what))
        for runner in runners:
            runner.close()
        for what in OPERATIONS:
            before, now = (float(np.median(some)) for some in times[what])
            row = {"cells": f"{width} x {height}", "borders_there": there, "operation": what}
            figures = {"before_ms": round(before, 2), "now_ms": round(now, 2)}
            figures["now_over_before"] = round(now / before, 2)
            rows.append({**row, "rounds": len(times[what][0]), **figures})
        path = write_table("maps/speed", "maps/speed.py", f"{made_by}, load {os.getloadavg()[0]:.0f}", rows)
    print(path.read_text())
    return 0


if __name__ == "__main__":
    sys.exit(main())
