#!/usr/bin/env python3
"""Measures the memory of every process of a running lab, as one table.

    bench/lab/memory.py                        # starts the simulated lab with three cameras and a robot, writes docs/results
    bench/lab/memory.py --label before --out before.csv

RSS counts pages that processes share once for each of them, PSS in equal parts: the sum of the PSS is what the computer
must have. The simulator's nodes and RViz are listed, but no part of the sum: a real lab does not have the first, and
the second depends on the graphics driver.
"""

from __future__ import annotations

import argparse
import csv
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Dict, List

import psutil

from vb_evaluation.processes import roslaunch

TOP = Path(__file__).resolve().parents[2]
SIMULATOR = ("map_server", "lab_simulator", "ceiling_cameras", "robot_camera", "move_base", "participant", "rviz")
QUIET_S = 15.0  # [s] that every node has been up before it is measured: by then images and maps have passed through


def memory(process: psutil.Process) -> Dict[str, float]:
    """Returns the process's resident, proportional and private memory [MiB]."""
    found = process.memory_full_info()
    return {"rss": found.rss / 2**20, "pss": found.pss / 2**20, "private": found.uss / 2**20}


def session(leader: int) -> Dict[str, psutil.Process]:
    """Finds everything below the process, name to process: nodes by their ROS names, others by their programs'."""
    found, first = {}, psutil.Process(leader)
    for process in (first, *first.children(recursive=True)):
        try:
            words = process.cmdline()
        except psutil.NoSuchProcess:  # it has just ended
            continue
        names = [word.partition(":=")[2] for word in words if word.startswith("__name:=")]
        programs = [Path(word).name for word in words if word and not word.startswith("-") and "python" not in word]
        found[(names or programs or words or [""])[0]] = process
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=TOP / "docs" / "results" / "lab" / "memory.csv")
    parser.add_argument("--label", default="", help="a first column, to tell runs apart")
    parser.add_argument("--port", type=int, default=12811)
    options = parser.parse_args()
    folder = tempfile.mkdtemp(prefix="lab_memory_")
    environment = {**os.environ, "ROS_MASTER_URI": f"http://127.0.0.1:{options.port}", "ROS_LOG_DIR": folder}
    arguments = {"rviz": False, "page_port": 0, "state": f"{folder}/state"}
    file, log = TOP / "launch" / "simulation.launch", Path(folder, "roslaunch.txt")
    lab = roslaunch([file], log, options.port, environment, **arguments)
    try:
        before: List[str] = []
        quiet_since = time.monotonic()
        while time.monotonic() - quiet_since < QUIET_S or len(before) < 5:
            now = sorted(session(lab.pid))
            if now != before:
                before, quiet_since = now, time.monotonic()
            time.sleep(1.0)
        rows = []
        for name, process in sorted(session(lab.pid).items()):
            rows.append({"process": name, "part": "simulator" if name in SIMULATOR else "lab", **memory(process)})
    finally:
        lab.stop(40.0)
    rows.sort(key=lambda row: (row["part"], -row["pss"]))
    for part in ("lab", "simulator"):
        own = [row for row in rows if row["part"] == part]
        rows.append(
            {
                "process": f"all {len(own)}",
                "part": part,
                **{key: sum(row[key] for row in own) for key in ("rss", "pss", "private")},
            }
        )
    options.out.parent.mkdir(parents=True, exist_ok=True)
    with open(str(options.out), "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(
            (["run"] if options.label else []) + ["process", "part", "RSS [MiB]", "PSS [MiB]", "private [MiB]"]
        )
        for row in rows:
            line = [row["process"], row["part"]] + [f"{row[key]:.1f}" for key in ("rss", "pss", "private")]
            writer.writerow(([options.label] if options.label else []) + line)
            print("{:28} {:10} {:>8} {:>8} {:>8}".format(*line))
    return 0


if __name__ == "__main__":
    sys.exit(main())
