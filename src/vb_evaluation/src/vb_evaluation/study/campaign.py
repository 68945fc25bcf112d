"""Carries out the runs of a study, on this computer or on a cluster, and can be interrupted at any time.

Every run is a function of its job alone: it is computed by one worker, which gets the configuration with it and returns
the row and the map. So neither the number of workers nor their order nor an interruption changes a row, and workers
need no shared disk. joblib distributes the jobs, to processes or to the workers of a Dask scheduler.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import sys
import traceback
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Mapping, Optional, Sequence, Tuple

import joblib
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
from vb_core.grid_map import OCCUPIED, GridMap
from vb_core.map_files import write_map
from vb_evaluation.provenance import repository_top, revision
from vb_evaluation.report.data import CONDITIONS, DRAWS, KEY, REQUIRED, RUNS, WORLDS, write_table
from vb_evaluation.study import assumptions
from vb_evaluation.study.config import Study, study_from_mapping
from vb_evaluation.study.plan import Job
from vb_evaluation.study.result import COLUMNS, measure
from vb_evaluation.study.store import RowFile, open_folder
from vb_sim.room import floor_plan

# what a run's result depends on
PACKAGES = (
    "vb_core",
    "vb_laser_detect",
    "vb_fusion",
    "vb_map_integration",
    "vb_msgs",
    "vb_robot",
    "vb_voice_wizard",
    "vb_sim",
)
CAVEATS = (
    "Simulated people know the system and its commands from the first run; they neither learn nor tire.",
    "How unevenly people draw is taken from strokes that people drew freely on screens. Nobody has measured it with a laser pointer "
    "on a floor. Along a visible edge people may be more accurate, or, because of the distance, less accurate.",
    "Room exclusion is more optimistic than the paper: with the hand alone and perfect cameras the median index is .996; the paper's "
    "people had .971. That would be an error of some 30 cm along the doorway, or a hand-drawn ground truth that ends 1 cm before the "
    "walls: one cell (2.5 cm) along all walls costs .07 (bench/extraction/hand.py). Both methods had nearly the same index "
    "(.971, .974), which makes the ground truth the likelier cause.",
    "Spot cleaning is more optimistic than the paper: its people had a heap of paper snippets in front of them and no line; these "
    "people see marks on the floor. The paper's .878 and .906 are 8 to 12 cm along the whole line; here people are 2 cm off.",
    "Marks on the floor, the map, the cameras' calibration and the localisation are wrong by assumed amounts.",
    "Ceiling cameras and the robot's camera send only images in which the true spot can be, and some others.",
    "The live system's own nodes run, with the launch file's parameters. Processor and network are represented by fixed delays of "
    "commands, spots, saving and extraction, and take no other time.",
    "The lab is one room, rebuilt from the paper's description. What the description leaves open is assumed and not varied.",
)


@dataclass(frozen=True)
class Outcome:
    """A worker's result: a row, and the map of a main run; or the program's error."""

    job: Job
    row: Optional[Dict[str, Any]] = None
    grid: Optional[GridMap] = None
    fault: str = ""


# a study's document and sources, and a job, to its outcome
Work = Callable[[Mapping[str, Any], Mapping[str, Any], Job], Outcome]


def columns(file: str) -> Tuple[str, ...]:
    """Lists the columns of one of a study's CSV files; what was varied comes first, as readers look for it."""
    order = ("order", "map") if file == RUNS else ()
    return (*CONDITIONS[file], *REQUIRED, *(name for name in COLUMNS if name not in REQUIRED), *order)


def row_of(study: Study, job: Job) -> Tuple[Dict[str, Any], GridMap]:
    """Carries out one run: its row and the resulting map."""
    # only running needs ROS: reading a study does not
    from vb_evaluation.study.runner import run

    varied = study.changed(job.changes) if job.changes else study
    result = run(varied, job.task, thorough=job.thorough)
    row = {**job.columns(study.design.seed), **measure(result)}
    if job.file == RUNS:
        name = f"maps/p{job.task.participant:02d}_{job.task.scenario}_{job.task.method}.yaml"
        row.update(order=job.order, map=name if result.saved else "")
    return row, result.posterior


def run_jobs(
    study: Study,
    jobs: Sequence[Job],
    folder: Path,
    processes: int = 1,
    fresh: bool = False,
    facts: Optional[Mapping[str, Any]] = None,
    console: Optional[Console] = None,
    scheduler: str = "",
    work: Optional[Work] = None,
) -> int:
    """Carries out the remaining runs; returns how many failed because of a fault in the program.

    Args:
        processes: of this computer; with a scheduler how many runs are handed out ahead.
        fresh: throws away what is in the folder.
        facts: for study.json.
        scheduler: address of a Dask scheduler; its workers must have this project.
        work: what a worker does with a job, instead of a run.

    Raises:
        CodedError: "other_study", "other_columns", "no_scheduler".
        KeyboardInterrupt: after it was said what is done.
    """
    console = console or Console(highlight=False, soft_wrap=True)
    open_folder(folder, configuration(study), fresh, {**(facts or {}), **about(study)})
    write_truths(study, folder / "maps" / "physical", folder / "maps" / "truth_{}")
    if any(job.file == WORLDS for job in jobs):
        drawn = assumptions.draw_worlds(study, study.design.worlds, study.design.seed)
        write_table(
            folder / DRAWS, ["draw", *drawn[0]], [{"draw": draw, **factors} for draw, factors in enumerate(drawn, 1)]
        )
    results = _Results(study, jobs, folder)
    waiting = [job for job in jobs if not results.has(job)]
    if len(waiting) < len(jobs):
        console.print(f"{len(jobs) - len(waiting)} of {len(jobs)} runs are there already")
    # the few longest first, as others would wait for one that came last; then the study itself, person by person, so
    # that what an interrupted study has is balanced
    waiting.sort(key=lambda job: (not job.thorough, job.file != RUNS, job.file))
    # where a curve changes nothing, its run is one of the study itself
    alike: Dict[str, List[Job]] = {}
    for job in waiting:
        alike.setdefault(job.run, []).append(job)
    failed = 0
    try:
        with _progress(console) as bar:
            ticker = bar.add_task("study", total=len(alike))
            for outcome in _carry_out(study, [one[0] for one in alike.values()], processes, scheduler, work or _work):
                if outcome.row is None:
                    failed += 1
                    console.print(f"failed: {outcome.job.words}: {outcome.fault}", markup=False)
                else:
                    results.keep(outcome, alike[outcome.job.run])
                bar.update(ticker, advance=1, description=outcome.job.words)
    except KeyboardInterrupt:
        # what is on the disk: an interruption may come while a row is written
        there = _Results(study, jobs, folder)
        console.print(
            f"interrupted: {sum(map(there.has, jobs))} of {len(jobs)} runs are done and kept in {folder}; "
            "the same command goes on from there"
        )
        raise
    results.sort(jobs)
    return failed


class _Results:
    """The CSV files of a study's folder that jobs write to, and the maps of its main runs."""

    def __init__(self, study: Study, jobs: Sequence[Job], folder: Path) -> None:
        self._seed, self._folder = study.design.seed, folder
        self._files = {
            file: RowFile(folder / file, columns(file), (*CONDITIONS[file], *KEY))
            for file in dict.fromkeys(job.file for job in jobs)
        }

    def _name(self, job: Job) -> Tuple[str, ...]:
        return self._files[job.file].name_of(job.columns(self._seed))

    def has(self, job: Job) -> bool:
        """Returns whether a job's row is there."""
        return self._name(job) in self._files[job.file].rows

    def keep(self, outcome: Outcome, jobs: Sequence[Job]) -> None:
        """Writes a run's map and the rows of all jobs that the run belongs to."""
        if outcome.grid is not None and outcome.row.get("map"):
            write_map(self._folder / outcome.row["map"][: -len(".yaml")], outcome.grid)
        for job in jobs:
            self._files[job.file].append({**outcome.row, **job.columns(self._seed)})

    def sort(self, jobs: Sequence[Job]) -> None:
        """Brings each file's rows into the order of the jobs."""
        for file, rows in self._files.items():
            rows.write([self._name(job) for job in jobs if job.file == file])


def _carry_out(study: Study, jobs: Sequence[Job], processes: int, scheduler: str, work: Work) -> Iterator[Outcome]:
    """Yields the outcomes, as they come."""
    if not jobs:
        return
    with contextlib.ExitStack() as stack:
        if scheduler:
            try:
                from distributed import Client

                stack.enter_context(Client(scheduler, timeout="20s"))
            except (ImportError, OSError, ValueError) as error:
                raise CodedError("no_scheduler", f"there is no Dask scheduler at {scheduler}: {error}") from None
            stack.enter_context(joblib.parallel_config(backend="dask"))
        parallel = joblib.Parallel(n_jobs=processes, return_as="generator_unordered", batch_size=1)
        yield from parallel(joblib.delayed(work)(study.document, study.sources, job) for job in jobs)


def _work(document: Mapping[str, Any], sources: Mapping[str, Any], job: Job) -> Outcome:
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    try:
        row, grid = row_of(study_from_mapping(document, sources), job)
        return Outcome(job, row, grid if job.file == RUNS else None)
    except Exception as error:
        return Outcome(job, fault=str(error) if isinstance(error, CodedError) else traceback.format_exc())


def _progress(console: Console) -> Progress:
    return Progress(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("runs, for"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(elapsed_when_finished=False),
        console=console,
    )


# ---------------------------------------------------------------- metadata of the runs
def configuration(study: Study) -> str:
    """Returns what identifies studies whose rows must not be mixed: configuration and program.

    How many participants there are, and which curves, is left out: rows of some are rows of all.
    """
    parts = [
        study.hash,
        *(
            _fingerprint(folder)
            for folder in (
                *(f"src/{package}" for package in PACKAGES),
                "src/vb_evaluation/src/vb_evaluation/study",
                "src/vb_evaluation/src/vb_evaluation/virtual_ros",
                "launch",
                "robots",
            )
        ),
    ]
    return hashlib.sha256("".join(parts).encode()).hexdigest()[:12]


@lru_cache(maxsize=None)
def _fingerprint(folder: str) -> str:
    """Computes a fingerprint of all that is run: nodes, parameters, interfaces; not of the tests."""
    digest = hashlib.sha256()
    for path in sorted((repository_top() / folder).rglob("*")):
        if path.suffix in (".py", ".yaml", ".json", ".msg", ".srv", ".launch") and "test" not in path.parts:
            digest.update(path.read_bytes())
    return digest.hexdigest()


def about(study: Study) -> Dict[str, Any]:
    """Facts about a study that its rows lack."""
    return {
        "seed": study.design.seed,
        "world": study.world.name,
        "robot_start": study.world.robots[0].start_pose(),
        "scenarios": {key: study.world.scenario(key).title for key in study.design.scenarios},
        "assumptions": assumptions.table(study),
        "caveats": list(CAVEATS),
    }


def made_by() -> Dict[str, str]:
    """Returns revision, command and machine, for study.json."""
    return {
        "revision": revision(),
        "command": " ".join(["python3 -m vb_evaluation.study", *sys.argv[1:]]),
        "machine": f"{os.cpu_count()} processors, {platform.machine()}, Python {platform.python_version()}",
    }


def write_truths(study: Study, physical: Path, truth: Path) -> None:
    """Writes the physical map, and each scenario's ground truth for "{}" in a name, as map_server files."""
    prior = floor_plan.physical_map(study.world)
    physical.parent.mkdir(parents=True, exist_ok=True)
    truth.parent.mkdir(parents=True, exist_ok=True)
    write_map(physical, prior)
    for key in study.design.scenarios:
        cells = floor_plan.ground_truth(study.world, study.world.scenario(key))
        write_map(Path(str(truth).format(key)), prior.with_data(np.where(cells, np.int8(OCCUPIED), prior.data)))
