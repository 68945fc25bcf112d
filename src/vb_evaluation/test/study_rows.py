"""A made-up study for tests of the report: rows drawn at random, maps of a world, no simulation."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np

from vb_core.map_files import write_map
from vb_evaluation import metrics
from vb_evaluation.report.data import KEY, MEASURES
from vb_evaluation.report.maps import write_truths
from vb_sim.room import floor_plan
from vb_sim.room.world import load_world

WORLD = Path(__file__).resolve().parents[2] / "vb_sim" / "worlds" / "lab.yaml"
RUN_COLUMNS = [*KEY, *MEASURES, "order", "map"]
_BORDER_M = {"room": 0.7, "carpet": 6.5, "corner": 3.6}
_PATH_M = {"room": 5.4, "carpet": 2.5, "corner": 3.0}


def run(random, participant, scenario, method, order=1, speed=1.0):
    """One row: longer borders take longer, the baseline first guides the robot."""
    slow = method == "robot_only"
    states = {
        "guide": 3.0 + _PATH_M[scenario] / 0.19 + random.gamma(2.0, 0.7) if slow else 0.0,
        "border": 3.0 + _BORDER_M[scenario] / (0.19 if slow else 0.45 * speed) + random.gamma(2.0, 0.6),
        "seed": 3.0 + (4.0 if slow else 0.0) + random.gamma(2.0, 0.5),
    }
    completed, error = random.random() > 0.08, random.gamma(4.0, 0.8)
    row = {
        "participant": participant,
        "scenario": scenario,
        "method": method,
        "seed": 1,
        "completed": int(completed),
        "order": order,
        "jaccard": f"{random.normal(0.93, 0.02):.4f}" if completed else "",
    }
    row.update({f"time_{state}_s": f"{value:.2f}" for state, value in states.items()})
    row["time_total_s"] = f"{sum(float(row[f'time_{state}_s']) for state in states):.2f}"
    if completed:
        row.update(error_mean_cm=f"{error:.2f}", error_p95_cm=f"{2.5 * error:.2f}", error_max_cm=f"{4 * error:.2f}")
    return row


def write(path, columns, rows, others="raise"):
    with open(str(path), "w", newline="") as stream:
        writer = csv.DictWriter(stream, columns, restval="", extrasaction=others)
        writer.writeheader()
        writer.writerows(rows)


def every(participants, methods=("nrs", "robot_only"), scenarios=("room", "carpet", "corner")):
    """(participant, scenario, method, order), who begins with which method in turn."""
    found = []
    for number in range(1, participants + 1):
        turned = methods if number % 2 else methods[::-1]
        found += [
            (f"p{number:02d}", scenario, method, 1 + 3 * place + index)
            for place, method in enumerate(turned)
            for index, scenario in enumerate(scenarios)
        ]
    return found


def make_study(folder, participants=15, sweeps=True, maps=True, seed=1, people=False):
    """Writes a whole study's folder."""
    random = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    rows = [run(random, *who) for who in every(participants)]
    if maps:
        world = load_world(str(WORLD))
        prior = floor_plan.physical_map(world)
        truths = {key: floor_plan.ground_truth(world, scenario) for key, scenario in world.scenarios.items()}
        write_truths(folder, prior, truths)
        for key, truth in truths.items():
            for row in rows:
                if row["scenario"] == key and row["completed"]:
                    drawn = np.roll(truth, tuple(random.integers(-2, 3, 2)), (0, 1)) & (prior.data == 0)
                    name = f"{row['participant']}_{key}_{row['method']}"
                    write_map(folder / "maps" / name, prior.with_data(np.where(drawn, 100, prior.data).astype(np.int8)))
                    row["map"] = f"maps/{name}.yaml"
                    row["jaccard"] = f"{metrics.jaccard(truth, drawn):.4f}"
    write(folder / "runs.csv", RUN_COLUMNS, rows)
    meta = {"world": "lab", "seed": seed, "size": "full", "people": people, "revision": "abc1234"}
    (folder / "study.json").write_text(json.dumps(meta))
    if sweeps:
        write_worlds(folder, random)
    return folder


def write_worlds(folder, random, draws=60):
    """Draws of three assumptions, of which only the hand's speed decides."""
    inputs = [
        {"draw": draw, **{key: f"{random.random():.4f}" for key in ("hand/speed", "hand/tremor", "lens/blur")}}
        for draw in range(1, draws + 1)
    ]
    write(folder / "draws.csv", list(inputs[0]), inputs)
    rows = []
    for entry in inputs:
        scenario = ("room", "carpet", "corner")[entry["draw"] % 3]
        for method in ("nrs", "robot_only"):
            speed = 0.5 + float(entry["hand/speed"]) if method == "nrs" else 1.0
            rows.append(dict(run(random, entry["draw"], scenario, method, speed=speed), draw=entry["draw"]))
    write(folder / "worlds.csv", ["draw", *RUN_COLUMNS], rows)
