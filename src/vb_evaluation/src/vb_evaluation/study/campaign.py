"""Carries out all runs of a study on all cores, and can be interrupted at any time."""
from __future__ import annotations

import hashlib
import multiprocessing
import os
import signal
import traceback
from functools import lru_cache
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from vb_core.errors import CodedError
from vb_core.grid_map import OCCUPIED
from vb_evaluation.study import measures, plan
from vb_evaluation.study.cameras import Room
from vb_evaluation.study.config import Study, top
from vb_evaluation.study.plan import TASK, Job
from vb_evaluation.study.runner import run
from vb_evaluation.study.store import RowFile, claim
from vb_map_integration.map_files import write_map
from vb_sim import floor_plan

CONDITIONS = {
    plan.RUNS: (),
    plan.CURVES: ("sweep", "value"),
    plan.SENSITIVITY: ("parameter", "factor", "value", "unit"),
}

# what a run's result hangs on
PACKAGES = ("vb_core", "vb_laser_detect", "vb_fusion", "vb_map_integration", "vb_robot", "vb_voice_wizard", "vb_sim",
            "vb_evaluation/study")

_study: Optional[Study] = None
_room = Room()
_folder: Optional[Path] = None


def columns(study: Study, file: str) -> Tuple[str, ...]:
    """The columns of one of a study's CSV files."""
    order = ("order",) if file == plan.RUNS else ()
    conditions = CONDITIONS[file]
    if file != plan.RUNS:
        # what was varied comes first, as everybody looks for it
        return (*conditions, *TASK, *measures.PAPER, *measures.FURTHER, *study.extra_measures)
    return (*TASK, *measures.PAPER, *order, *measures.FURTHER, *study.extra_measures)


def row_of(study: Study, job: Job, room: Room, folder: Optional[Path]) -> Dict[str, Any]:
    """Carries out one run; its row.

    Args:
        folder: of the study, for maps of the main runs; None stores none.
    """
    varied = study.changed(job.changes) if job.changes else study
    result = run(varied, job.task, room)
    maps = folder / "maps" if folder is not None and job.file == plan.RUNS else None
    row = {**job.columns(study.design.seed), **measures.measure(result, maps, study.extra_measures)}
    return {**row, "order": job.order} if job.file == plan.RUNS else row


def conduct(study: Study, jobs: Sequence[Job], folder: Path, processes: int, fresh: bool, facts: Mapping[str, Any],
            console: Optional[Console] = None) -> int:
    """Carries out what has not been done yet; gives the number of runs that failed for a fault of the program.

    Raises:
        CodedError: "other_study", "other_columns".
    """
    console = console or Console(highlight=False, soft_wrap=True)
    claim(folder, configuration(study), fresh, {**facts, **about(study)})
    write_truth(study, folder)
    names = list(dict.fromkeys(job.file for job in jobs))
    files = {name: RowFile(folder / name, columns(study, name), (*CONDITIONS[name], *TASK)) for name in names}
    done = {name: set(file.done) for name, file in files.items()}
    order: Dict[str, Dict[Tuple[str, ...], int]] = {name: {} for name in files}
    waiting = []
    for job in jobs:
        name = files[job.file].name_of(job.columns(study.design.seed))
        order[job.file].setdefault(name, len(order[job.file]))
        if name not in done[job.file]:
            waiting.append(job)
    if len(waiting) < len(jobs):
        console.print(f"{len(jobs) - len(waiting)} of {len(jobs)} runs are there already")
    # where a curve or a sensitivity changes nothing, the run is one of the study itself
    main = {_task(job): job for job in jobs if job.file == plan.RUNS}
    repeated = [job for job in waiting if job.file != plan.RUNS and not job.changes and _task(job) in main]
    failed = _carry_out(study, [job for job in waiting if job not in repeated], folder, processes, files, console)
    for job in repeated:
        _repeat(study, job, files)
    for name, file in files.items():
        file.sort(order[name])
    return failed


def _task(job: Job) -> Tuple[int, str, str]:
    return job.task.participant, job.task.scenario, job.task.method


def _repeat(study: Study, job: Job, files: Mapping[str, RowFile]) -> None:
    """Takes a row over from runs.csv."""
    wanted = tuple(str(value) for value in (*_task(job), study.design.seed))
    for row in files[plan.RUNS].rows:
        if files[plan.RUNS].name_of(row) == wanted:
            files[job.file].append({**row, **job.columns(study.design.seed)})
            return


def _carry_out(
    study: Study, jobs: Sequence[Job], folder: Path, processes: int, files: Mapping[str, RowFile], console: Console
) -> int:
    if not jobs:
        return 0
    failures: List[str] = []
    bar = Progress(
        SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("runs, for"),
        TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(elapsed_when_finished=False), console=console,
    )
    # forked before any thread is there; each run is computed by one process alone, so their number changes nothing
    context = multiprocessing.get_context("fork")
    global _study, _folder
    _study, _folder = study, folder
    _room.prepare(study.world, study.models.cameras)
    with context.Pool(min(processes, len(jobs)), _begin) as pool, bar:
        ticker = bar.add_task("study", total=len(jobs))
        for job, row, fault in pool.imap_unordered(_work, _ordered(jobs)):
            if row is None:
                failures.append(f"{_words(job)}: {fault}")
                console.print(f"failed: {_words(job)}: {fault}", markup=False)
            else:
                files[job.file].append(row)
            bar.update(ticker, advance=1, description=_words(job))
    return len(failures)


def _ordered(jobs: Sequence[Job]) -> List[Job]:
    """The study itself first; the longest runs of each part early, so that no core waits for a last long one."""
    return sorted(jobs, key=lambda job: (job.file != plan.RUNS, job.file == plan.RUNS and job.task.method != "robot_only"))


def _begin() -> None:
    # the parent alone reacts to an interruption, and ends the workers
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ["OMP_NUM_THREADS"] = "1"


def _work(job: Job) -> Tuple[Job, Optional[Dict[str, Any]], str]:
    assert _study is not None
    try:
        return job, row_of(_study, job, _room, _folder), ""
    except CodedError as error:
        return job, None, str(error)
    except Exception:
        return job, None, traceback.format_exc()


def _words(job: Job) -> str:
    task = job.task
    changed = [str(value) for value in job.conditions.values()]
    return ", ".join([f"participant {task.participant}", task.scenario, task.method, *changed[:2]])


# ---------------------------------------------------------------- what belongs to the runs
def configuration(study: Study) -> str:
    """What tells studies apart whose rows must not be mixed: configuration and program.

    How many participants there are, and which curves, is left out: rows of some are rows of all.
    """
    parts = [study.hash, *(_fingerprint(package) for package in PACKAGES)]
    return hashlib.sha256("".join(parts).encode()).hexdigest()[:12]


@lru_cache(maxsize=None)
def _fingerprint(package: str) -> str:
    """Of the pure modules of a package: nodes, and whoever only looks on, do not take part."""
    name, _, below = package.partition("/")
    folder = top() / "src" / name / "src" / name / below
    digest = hashlib.sha256()
    for path in sorted(folder.glob("*.py")):
        if not path.name.endswith("_node.py"):
            digest.update(path.read_bytes())
    return digest.hexdigest()


def about(study: Study) -> Dict[str, Any]:
    """Facts about a study that its rows do not tell."""
    return {
        "seed": study.design.seed,
        "world": study.world.name,
        "robot_start": study.world.robots[0].start_pose(),
        "scenarios": {key: study.world.scenario(key).title for key in study.design.scenarios},
        "participants": study.document["participants"],
        "timing": study.document["timing"],
    }


def write_truth(study: Study, folder: Path) -> None:
    """Writes maps/physical and maps/truth_<scenario>, as map_server files."""
    prior = floor_plan.physical_map(study.world)
    maps = folder / "maps"
    maps.mkdir(parents=True, exist_ok=True)
    write_map(maps / "physical", prior)
    for key in study.design.scenarios:
        truth = floor_plan.ground_truth(study.world, study.world.scenario(key))
        write_map(maps / f"truth_{key}", prior.with_data(np.where(truth, np.int8(OCCUPIED), prior.data)))
