"""Carries out the runs of a study, and can be interrupted at any time.

Every run depends on its job and the configuration alone: one worker gets both, and returns the row and the map.
Neither the number of workers nor their order nor an interruption therefore changes a row.
"""

from __future__ import annotations

import datetime
import hashlib
import json
import os
import platform
import sys
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Dict, Mapping, Optional, Sequence, Tuple

import joblib
import numpy as np
from rich.console import Console
from rich.progress import track
from shapely.geometry import Point, Polygon

from vb_core.errors import CodedError
from vb_core.files import write_atomically
from vb_core.grid_map import FREE, GridMap
from vb_core.map_files import read_map, write_map
from vb_evaluation import metrics
from vb_evaluation.repository_revision import repository_root, revision
from vb_evaluation.report import study_files
from vb_evaluation.report.map_figures import write_truths
from vb_evaluation.report.study_files import DRAWS, META, REQUIRED, RUNS, WORLDS, read_meta, write_table
from vb_evaluation.simulated_study.config import Study, study_from_mapping
from vb_evaluation.simulated_study.run_plan import Job, draw_worlds
from vb_sim import floor_plan

if TYPE_CHECKING:  # a study can be read without ROS, which only running it needs
    from vb_evaluation.simulated_study.live_run import LiveRun

AREAS, ROWS = "areas.npz", "rows"
_EXTRAS = "outcome reason seed_is_right pointed_right tries spots robot_collisions jaccard_enclosed too_bright".split()
COLUMNS = (*study_files.MEASURES, *_EXTRAS)


@dataclass(frozen=True)
class Outcome:
    """A worker's result: a row and, for a main run, the map, or else the program's error."""

    job: Job
    row: Optional[Dict[str, Any]] = None
    grid: Optional[GridMap] = None
    fault: str = ""


def columns(file: str) -> Tuple[str, ...]:
    """Lists the columns of one of a study's CSV files. What was varied comes first, where readers look for it."""
    draw = ("draw",) if file == WORLDS else ()
    order = ("order", "map") if file == RUNS else ()
    return (*draw, *REQUIRED, *(name for name in COLUMNS if name not in REQUIRED), *order, "revision")


def run_jobs(study: Study, jobs: Sequence[Job], folder: Path, console: Console, processes: int = 1) -> int:
    """Carries out the remaining runs. Returns how many failed because of a fault in the program.

    Raises:
        CodedError: "other_study".
        KeyboardInterrupt: after printing what is done.
    """
    metadata = study_metadata(study)
    open_folder(folder, configuration_hash(study), metadata)
    _write_inputs(study, jobs, folder)
    remaining = [job for job in jobs if not _row_file(folder, job).exists()]
    if len(remaining) < len(jobs):
        console.print(f"{len(jobs) - len(remaining)} of {len(jobs)} runs are done already")
    failed = 0
    parallel = joblib.Parallel(n_jobs=processes, return_as="generator_unordered", batch_size=1)
    try:
        outcomes = parallel(joblib.delayed(_work)(study.document, study.sources, job) for job in remaining)
        for outcome in track(outcomes, "study", len(remaining), console=console):
            if outcome.row is None:
                failed += 1
                console.print(f"failed: {outcome.job.name}: {outcome.fault}", markup=False)
            else:
                _store(outcome, folder, metadata["revision"])
    except KeyboardInterrupt:
        done = sum(_row_file(folder, job).exists() for job in jobs)
        console.print(
            f"interrupted: {done} of {len(jobs)} runs are done and kept in {folder}; the same command goes on from there"
        )
        raise
    finally:
        for file in dict.fromkeys(job.file for job in jobs):
            paths = sorted((folder / ROWS).glob(f"{Path(file).stem}_*.json"))
            write_table(folder / file, columns(file), [json.loads(path.read_text()) for path in paths])
        pack_areas(folder)
    return failed


def _write_inputs(study: Study, jobs: Sequence[Job], folder: Path) -> None:
    """Writes what the runs are measured against, and the factors of the plausible worlds if there are any."""
    world = study.world
    scenarios = [world.scenario(key) for key in study.design.scenarios]
    truths = {scenario.key: floor_plan.ground_truth(world, scenario) for scenario in scenarios}
    write_truths(folder, floor_plan.physical_map(world), truths)
    if any(job.file == WORLDS for job in jobs):
        rows = [{"draw": draw, **factors} for draw, factors in enumerate(draw_worlds(study), 1)]
        write_table(folder / DRAWS, list(rows[0]), rows)


def _store(outcome: Outcome, folder: Path, revision: str) -> None:
    """Keeps a run's map, if it has one, and then its row, which says that the run is done."""
    if outcome.grid is not None and outcome.row.get("map"):
        write_map(folder / outcome.row["map"][: -len(".yaml")], outcome.grid)
    row = {**outcome.row, "revision": revision}
    write_atomically(_row_file(folder, outcome.job), json.dumps(row, default=lambda value: value.item()).encode())


def _row_file(folder: Path, job: Job) -> Path:
    """Returns the file of a run's row. It exists only once the run is done, so that nothing is ever half written."""
    return folder / ROWS / f"{job.name}.json"


def _work(document: Mapping[str, Any], sources: Mapping[str, Any], job: Job) -> Outcome:
    """Carries out one run of the study that a document and the files named in it describe."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    try:
        from vb_evaluation.simulated_study.live_run import LiveRun

        study = study_from_mapping(document, sources)
        ended = LiveRun(study.changed(job.changes) if job.changes else study, job).run()
        row = {**job.columns(study.design.seed), **measure_run(ended)}
        if job.file != RUNS:
            return Outcome(job, row)
        map_file = f"maps/p{job.participant:02d}_{job.scenario}_{job.method}.yaml" if ended.saved_seed else ""
        return Outcome(job, {**row, "order": job.order, "map": map_file}, ended.posterior)
    except Exception as error:
        return Outcome(job, fault=str(error) if isinstance(error, CodedError) else traceback.format_exc())


def measure_run(run: LiveRun) -> Dict[str, object]:
    """Computes all columns of a run except those that identify it: measures (paper, Sect. 5.5), and what explains them."""
    restricted = metrics.restricted_cells(run.prior, run.posterior)
    floor = run.prior.data == FREE
    # in spot cleaning the paper's people drew around 3.2 m2 and restricted the rest, which hides the drawing's errors
    enclosed = (metrics.enclosed_cells(floor, cells & floor, run.truth) for cells in (run.truth, restricted))
    # over every interaction of the run: cancelled ones took time too
    times = [sum(float(record[f"{state}_s"]) for record in run.records) for state in study_files.STATES]
    saved = run.saved_seed is not None
    requested_area = Polygon(run.scenario.region)
    script = run.script
    seed_is_right = int(saved and requested_area.contains(Point(run.saved_seed)))
    return {
        # border points and a seed on the right side, whatever the accuracy (paper, Sect. 5.5)
        "completed": seed_is_right,
        **{column: round(value, 2) for column, value in zip(study_files.TIMES, (*times, sum(times)))},
        **metrics.accuracy(run.prior, run.truth, restricted),
        "outcome": "saved" if saved else (script.outcome or "time_is_up"),
        "reason": "" if saved else script.reason,
        "seed_is_right": seed_is_right,
        # 0: the person was drawn to point at the wrong side
        "pointed_right": int(requested_area.contains(Point(script.person.seed))),
        "tries": script.tries,
        "spots": len(run.spots),
        "robot_collisions": sum(robot.collisions for robot in run.lab.robots),
        "jaccard_enclosed": round(metrics.jaccard(*enclosed), 4),
        "too_bright": int(run.too_bright),
    }


# ---------------------------------------------------------------- metadata of the runs
def open_folder(folder: Path, configuration: str, metadata: Mapping[str, Any]) -> None:
    """Makes sure that a folder's contents belong to a configuration, and records which.

    Args:
        configuration: the study's hash.
        metadata: for study.json.

    Raises:
        CodedError: "other_study".
    """
    present = read_meta(folder / META).get("configuration", "unknown")
    is_used = (folder / META).exists() or (folder / RUNS).exists()
    if is_used and present != configuration:
        reason = f"{folder} holds runs of another configuration or program ({present}, this is {configuration})"
        hint = "they cannot be mixed. Delete it, or let OUT=folder put the new ones elsewhere"
        raise CodedError("other_study", f"{reason}: {hint}")
    document = {**metadata, "configuration": configuration}
    text = json.dumps(document, indent=2, sort_keys=True, default=str)
    write_atomically(folder / META, f"{text}\n".encode())


def configuration_hash(study: Study) -> str:
    """Returns a hash of configuration and program, without its tests: rows with different hashes must not be mixed.

    It does not depend on which of the study's runs are asked for.
    """
    digest = hashlib.sha256(study.hash.encode())
    for folder in ("src", "launch", "robots"):
        for path in sorted((repository_root() / folder).rglob("*")):
            if path.suffix in (".py", ".yaml", ".json", ".msg", ".srv", ".launch") and "test" not in path.parts:
                digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def study_metadata(study: Study) -> Dict[str, Any]:
    """Returns what a study's rows lack: what it is, and what produced it."""
    return {
        "seed": study.design.seed,
        "world": study.world.name,
        "scenarios": {key: study.world.scenario(key).title for key in study.design.scenarios},
        "revision": revision(),
        "command": " ".join(["python3 -m vb_evaluation.simulated_study", *sys.argv[1:]]),
        "machine": f"{os.cpu_count()} processors, {platform.machine()}, Python {platform.python_version()}",
        "date": datetime.date.today().isoformat(),
    }


def pack_areas(folder: Path) -> None:
    """Writes areas.npz: the free floor, each ground truth, and each main run's restricted cells, (H, W) bool by name.

    It is small enough to publish beside the rows, so that others can recompute every index without this program.
    """
    physical = read_map(folder / "maps" / "physical.yaml")
    map_files = sorted(path for path in (folder / "maps").glob("*.yaml") if path.stem != "physical")
    areas = {path.stem: metrics.restricted_cells(physical, read_map(path)) for path in map_files}
    np.savez_compressed(folder / AREAS, floor=physical.data == FREE, **areas)
