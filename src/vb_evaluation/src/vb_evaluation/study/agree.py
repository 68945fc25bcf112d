"""Some runs of the study through ROS: the same person, scenario and lab in the live system and in one process."""
from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional

import yaml
from rich.console import Console
from rich.table import Table

from vb_core.errors import CodedError
from vb_core.parameters import Parameters, param
from vb_evaluation.study import measures, plan
from vb_evaluation.study.cameras import Room
from vb_evaluation.study.config import Study, top
from vb_evaluation.study.runner import Simulation, Task
from vb_evaluation.study.store import RowFile

AGREEMENT = "agreement.csv"
ROS, IN_PROCESS = "ros", "in_process"


@dataclass(frozen=True)
class AgreementParams(Parameters):
    """Which runs, and what agreement is; the limits allow for the live system's computer being busy."""

    runs: list = param(
        [[1, "room", "nrs"], [1, "carpet", "robot_only"], [2, "corner", "nrs"]], doc="[participant, scenario, method]"
    )
    time_share: float = param(0.2, low=0.0, high=1.0, doc="of the whole time by which the two may differ ...")
    time_s: float = param(3.0, "s", low=0.0, doc="... or this, whatever is more")
    jaccard: float = param(0.05, low=0.0, high=1.0)
    timeout_s: float = param(600.0, "s", above=0.0, doc="wall time of one run through ROS")


def agree(study: Study, folder: Path, count: Optional[int], console: Console) -> int:
    """Runs each pair, writes agreement.csv, prints both beside each other; 0 if they agree."""
    params = AgreementParams.from_mapping(study.document.get("agreement"), "agreement")
    tasks = [Task(int(number), str(scenario), str(method)) for number, scenario, method in params.runs][:count]
    columns = ("runner", *plan.TASK, *measures.PAPER, "outcome", "real_time_factor")
    path = folder / AGREEMENT
    if path.exists():
        path.unlink()
    rows = RowFile(path, columns, ("runner", *plan.TASK))
    shown = ("time_guide_s", "time_border_s", "time_seed_s", "time_total_s", "jaccard")
    table = Table("participant", "scenario", "method", "", "guide [s]", "border [s]", "seed [s]", "total [s]", "Jaccard",
                  "agree")
    room, disagreeing = Room(), 0
    for task in tasks:
        console.print(f"participant {task.participant}, {task.scenario}, {task.method}: in one process, then through ROS")
        simulation = Simulation(study, task, room)
        here = _row(study, task, IN_PROCESS, measures.measure(simulation.run(), None))
        live = _row(study, task, ROS, through_ros(study, simulation, folder, params.timeout_s))
        same = alike(here, live, params)
        disagreeing += not same
        for row, verdict in ((here, ""), (live, "yes" if same else "NO")):
            rows.append(row)
            numbers = [str(row[key]) for key in shown]
            table.add_row(str(task.participant), task.scenario, task.method, str(row["runner"]), *numbers, verdict)
    console.print(table)
    console.print(
        f"they agree if both were completed or neither, the times differ by no more than {params.time_share:.0%} or "
        f"{params.time_s:g} s, and the Jaccard indices by no more than {params.jaccard:g}; written to {path}"
    )
    return 1 if disagreeing else 0


def _row(study: Study, task: Task, runner: str, columns: Mapping[str, Any]) -> Dict[str, Any]:
    return {"runner": runner, **plan.Job(task).columns(study.design.seed), **columns}


def alike(a: Mapping[str, Any], b: Mapping[str, Any], params: AgreementParams) -> bool:
    """Whether two rows of the same run agree."""
    allowed = max(params.time_s, params.time_share * float(a["time_total_s"]))
    near = abs(float(a["time_total_s"]) - float(b["time_total_s"])) <= allowed
    as_accurate = abs(float(a["jaccard"]) - float(b["jaccard"])) <= params.jaccard
    return bool(a["completed"] == b["completed"] and near and as_accurate)


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
