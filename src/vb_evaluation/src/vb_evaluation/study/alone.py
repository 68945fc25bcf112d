"""One run of a study alone: finding it, and comparing its row with the one in a file."""
from __future__ import annotations

import csv
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Tuple

from vb_core.errors import CodedError
from vb_evaluation.study import plan, sweeps
from vb_evaluation.study.config import Study
from vb_evaluation.study.plan import Job
from vb_evaluation.study.runner import Task

COMMAND = ("python3 -m vb_evaluation.study run --participant {participant} --scenario {scenario} --method {method} "
           "--seed {seed}")
# how a row of each file is made again; its columns stand in place of the names in braces
COMMANDS = {
    plan.RUNS: COMMAND,
    plan.CURVES: f"{COMMAND} --sweep {{sweep}} --value {{value}}",
    plan.SENSITIVITY: f"{COMMAND} --parameter {{parameter}} --factor {{factor}}",
}


def find(
    study: Study, task: Task, sweep: Optional[str] = None, parameter: Optional[str] = None,
    amount: Optional[float] = None,
) -> Job:
    """The job that makes a row of runs.csv or, with a sweep or a parameter, of curves.csv or sensitivity.csv.

    Args:
        amount: the column `value` of a sweep's row, `factor` of a parameter's.

    Raises:
        CodedError: "no_such_run" naming what there is.
    """
    study.world.scenario(task.scenario)
    if sweep is None and parameter is None:
        return next((job for job in plan.main_jobs(study, task.participant) if job.task == task), Job(task))
    if sweep is not None:
        jobs, key = sweeps.curve_jobs(study, task.participant, [sweep]), "value"
    else:
        only = [] if parameter == sweeps.NOMINAL else [parameter]
        jobs, key = sweeps.sensitivity_jobs(study, task.participant, only), "factor"
        jobs = [job for job in jobs if job.conditions["parameter"] == parameter]
    alike = [job for job in jobs if job.task == task]
    for job in alike:
        if amount is not None and abs(float(job.conditions[key]) - amount) < 1e-9:
            return job
    known = ", ".join(dict.fromkeys(str(job.conditions[key]) for job in alike)) or "none"
    which = f"no run of {sweep or parameter} in {task.scenario} with {task.method}"
    raise CodedError("no_such_run", f"{which} has the {key} {amount}: there are {known}")


def compare(path: Path, job: Job, row: Mapping[str, Any], seed: int) -> Tuple[bool, str]:
    """(whether a file has the same row, which columns differ)."""
    conditions = {key: str(value) for key, value in job.columns(seed).items()}
    with open(str(path), newline="", encoding="utf-8") as stream:
        rows: List[Dict[str, str]] = list(csv.DictReader(stream))
    for other in rows:
        if all(other.get(key) == value for key, value in conditions.items()):
            # only a study stores maps
            differing = [key for key in other if key != "map" and other[key] != str(row.get(key, ""))]
            return not differing, ", ".join(f"{key} {other[key]} instead of {row.get(key)}" for key in differing)
    return False, "there is no such row"
