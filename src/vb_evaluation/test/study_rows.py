"""A made-up study for tests of the report: rows drawn at random, maps of a world, no simulation."""
from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np

from vb_evaluation import metrics
from vb_map_integration.map_files import write_map
from vb_sim import floor_plan
from vb_sim.world import load_world

WORLD = Path(__file__).resolve().parents[2] / "vb_sim" / "worlds" / "lab.yaml"
RUN_COLUMNS = [
    "participant",
    "scenario",
    "method",
    "seed",
    "completed",
    "time_guide_s",
    "time_border_s",
    "time_seed_s",
    "time_total_s",
    "jaccard",
    "map",
]
_BORDER_M = {"room": 0.7, "carpet": 6.5, "corner": 3.6}
_WAY_M = {"room": 5.4, "carpet": 2.5, "corner": 3.0}


def run(random, participant, scenario, method, speed=1.0, coverage=1.0, distance=None, length=None):
    """One row: longer borders take longer, the baseline first guides the robot."""
    length = _BORDER_M[scenario] if length is None else length
    distance = _WAY_M[scenario] if distance is None else distance
    slow = method == "robot_only" or random.random() > coverage
    guide = 3.0 + distance / (0.19 * speed) + random.gamma(2.0, 0.7) if method == "robot_only" else 0.0
    border = 3.0 + length / ((0.19 if slow else 0.45) * speed) + random.gamma(2.0, 0.6)
    seed_s = 3.0 + (4.0 if slow else 0.0) + random.gamma(2.0, 0.5)
    completed = random.random() > 0.08
    times = {
        "time_guide_s": guide,
        "time_border_s": border,
        "time_seed_s": seed_s,
        "time_total_s": guide + border + seed_s,
    }
    row = {
        "participant": participant,
        "scenario": scenario,
        "method": method,
        "seed": int(random.integers(1, 1_000_000)),
        "completed": int(completed),
        "jaccard": f"{random.normal(0.93, 0.02):.4f}" if completed else "",
    }
    row.update({key: f"{value:.2f}" for key, value in times.items()})
    return row


def write(path, columns, rows):
    with open(str(path), "w", newline="") as stream:
        writer = csv.DictWriter(stream, columns, restval="")
        writer.writeheader()
        writer.writerows(rows)


def every(participants, methods=("nrs", "robot_only"), scenarios=("room", "carpet", "corner")):
    return [
        (f"p{number:02d}", scenario, method)
        for number in range(1, participants + 1)
        for scenario in scenarios
        for method in methods
    ]


def make_study(folder, participants=15, sweeps=True, maps=True, seed=1):
    """Writes a whole study's folder."""
    random = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    rows = [run(random, *who) for who in every(participants)]
    if maps:
        world = load_world(str(WORLD))
        prior = floor_plan.physical_map(world)
        (folder / "maps").mkdir(exist_ok=True)
        write_map(folder / "maps" / "physical", prior)
        for key, scenario in world.scenarios.items():
            truth = floor_plan.ground_truth(world, scenario)
            write_map(
                folder / "maps" / f"truth_{key}", prior.with_data(np.where(truth, 100, prior.data).astype(np.int8))
            )
            for row in rows:
                if row["scenario"] == key and row["completed"]:
                    drawn = np.roll(truth, tuple(random.integers(-2, 3, 2)), (0, 1)) & (prior.data == 0)
                    name = f"{row['participant']}_{key}_{row['method']}"
                    write_map(folder / "maps" / name, prior.with_data(np.where(drawn, 100, prior.data).astype(np.int8)))
                    row["map"] = f"maps/{name}.yaml"
                    row["jaccard"] = f"{metrics.jaccard(truth, drawn):.4f}"
    write(folder / "runs.csv", RUN_COLUMNS, rows)
    (folder / "study.json").write_text(
        json.dumps(
            {
                "world": "lab",
                "seed": seed,
                "quick": participants < 15,
                "robot_start": [7.6, 0.4, 2.618],
                "rerun": "make study ROW='{participant} {scenario} {method} {seed}'",
            }
        )
    )
    if sweeps:
        few = every(min(participants, 5))
        curves = [
            dict(run(random, *who, **{argument: value}), sweep=sweep, value=value)
            for sweep, argument, values in (
                ("coverage", "coverage", (0.0, 0.5, 1.0)),
                ("distance", "distance", (1.0, 4.0, 8.0)),
                ("border_length", "length", (0.7, 4.0, 9.0)),
            )
            for value in values
            for who in few
        ]
        write(folder / "curves.csv", ["sweep", "value", *RUN_COLUMNS], curves)
        parameters = [
            "participant/speed",
            *(f"participant/parameter_{number}" for number in range(3)),
            "sensor/pixel_noise",
        ]
        settings = [
            dict(
                run(random, *who, speed=factor if name.endswith("/speed") else 1.0),
                parameter=name,
                factor=factor,
                value=0.3 * factor,
            )
            for name in parameters
            for factor in (0.5, 2)
            for who in few
        ]
        write(folder / "sensitivity.csv", ["parameter", "factor", "value", *RUN_COLUMNS], settings)
        through = [dict(run(random, *who), runner=runner) for who in every(1) for runner in ("fast", "ros")]
        write(folder / "agreement.csv", ["runner", *RUN_COLUMNS], through)
    return folder
