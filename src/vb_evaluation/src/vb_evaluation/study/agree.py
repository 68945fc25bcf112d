"""Some runs of the study through ROS: the same person, scenario and lab in the live system and in one process."""
from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, Dict, List, Mapping

import yaml
from rich.console import Console
from rich.table import Table

from vb_core.errors import CodedError
from vb_evaluation.report.data import KEY, write_table
from vb_evaluation.study import measures, plan
from vb_evaluation.study.cameras import Room
from vb_evaluation.study.config import Study, top
from vb_evaluation.study.runner import Simulation, Task

AGREEMENT = "agreement.csv"
ROS, IN_PROCESS = "ros", "in_process"


RUNS = (Task(1, "room", "nrs"), Task(1, "carpet", "robot_only"), Task(2, "corner", "nrs"))
TIMEOUT_S = 600.0  # wall time of one run through ROS
SHOWN = ("time_guide_s", "time_border_s", "time_seed_s", "time_total_s", "jaccard")


def agree(study: Study, folder: Path, console: Console) -> int:
    """Runs each pair, writes agreement.csv and prints both beside each other; how near is near is for the reader to say."""
    table = Table("participant", "scenario", "method", "runner", *SHOWN)
    rows, room = [], Room()
    for task in RUNS:
        simulation = Simulation(study, task, room)
        for runner, found in ((IN_PROCESS, measures.measure(simulation.run())),
                              (ROS, through_ros(study, simulation, folder, TIMEOUT_S))):
            row = {"runner": runner, **plan.Job(task).columns(study.design.seed), **found}
            rows.append(row)
            table.add_row(str(task.participant), task.scenario, task.method, runner, *(str(row[key]) for key in SHOWN))
    write_table(folder / AGREEMENT, ("runner", *KEY, "completed", *SHOWN, "outcome", "real_time_factor"), rows)
    console.print(table)
    console.print(f"written to {folder / AGREEMENT}")
    return 0


def through_ros(study: Study, simulation: Simulation, folder: Path, timeout_s: float) -> Dict[str, Any]:
    """Measures of a run with the live nodes, by the demonstration's machinery.

    Raises:
        CodedError: "ros_run_failed".
    """
    task = simulation.task
    place = folder / "agreement" / f"p{task.participant:02d}_{task.scenario}_{task.method}"
    place.mkdir(parents=True, exist_ok=True)
    world, models = write_inputs(study, simulation, place)
    summary = place / "summary.json"
    if summary.exists():
        summary.unlink()
    seed = str(study.run_seed(task.participant))
    command = [
        sys.executable, str(top() / "scripts" / "demo"), "--no-rviz", "--scenario", task.scenario, "--method", task.method,
        "--world", str(world), "--models", str(models), "--seed", seed, "--out", str(place),
    ]
    with open(str(place / "output.txt"), "w") as output:
        try:
            subprocess.run(command, stdout=output, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, timeout=timeout_s,
                           env=dict(os.environ), cwd=str(top()))
        except subprocess.TimeoutExpired:
            reason = f"the run through ROS took longer than {timeout_s:g} s: see {place}/output.txt"
            raise CodedError("ros_run_failed", reason) from None
    if not summary.exists():
        raise CodedError("ros_run_failed", f"the run through ROS left no summary: see {place}/output.txt")
    found = json.loads(summary.read_text(encoding="utf-8"))
    times = {f"time_{key}_s": value for key, value in found["time_s"].items()}
    return {"completed": int(found["completed"] and found["jaccard"] > 0.5), **times, "jaccard": found["jaccard"],
            "outcome": "saved" if found["completed"] else "not_saved", "real_time_factor": found["real_time_factor"]}


def write_inputs(study: Study, simulation: Simulation, place: Path) -> List[Path]:
    """Writes world and models with which the nodes have the run's person and lab; gives both files."""
    world = dict(study.sources["world"])
    world["scenarios"] = {key: dict(entry) for key, entry in world["scenarios"].items()}
    world["scenarios"][simulation.task.scenario]["stand"] = [float(value) for value in simulation.scenario.stand]
    models = dict(study.sources["models"])
    models["participant"] = _plain(dataclasses.asdict(simulation.traits.model))
    models["body"] = _plain(dataclasses.asdict(simulation.traits.body))
    files = []
    for name, document in (("world", world), ("models", models)):
        files.append(place / f"{name}.yaml")
        files[-1].write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
    return files


def _plain(values: Mapping[str, Any]) -> Dict[str, Any]:
    return {key: list(value) if isinstance(value, tuple) else value for key, value in values.items()}
