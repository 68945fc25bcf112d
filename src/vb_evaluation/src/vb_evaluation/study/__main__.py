"""The simulated study: python3 -m vb_evaluation.study COMMAND

    all     every run that has not been done yet, on all cores; make study does this
    run     one run alone: the row that it has in runs.csv
    agree   the same runs through ROS and in one process, beside each other
"""
from __future__ import annotations

import argparse
import csv
import os
import sys
from pathlib import Path
from typing import List, Optional

from rich.console import Console

from vb_core.errors import CodedError
from vb_evaluation.study import agree, alone, campaign, config, plan, sweeps
from vb_evaluation.study.cameras import Room
from vb_evaluation.study.config import Study
from vb_evaluation.study.runner import Task

# names in study.json
RERUNS = {"rerun": plan.RUNS, "rerun_curves": plan.CURVES, "rerun_sensitivity": plan.SENSITIVITY}


def main(arguments: Optional[List[str]] = None) -> int:
    """Runs a command; 0 if all went well, 1 if runs failed, 2 for a mistake (one line), 130 after an interruption."""
    given = _parser().parse_args(arguments)
    console = Console(highlight=False, soft_wrap=True)
    try:
        return int(given.command(given, console))
    except CodedError as error:
        Console(stderr=True, highlight=False, soft_wrap=True).print(f"study: {error}", markup=False, style="bold red")
        return 2
    except KeyboardInterrupt:
        console.print("interrupted: what was finished is kept, the same command goes on from there")
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="vb_evaluation.study", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="name", required=True)

    def command(name: str, function, words: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=words)
        sub.set_defaults(command=function)
        sub.add_argument("--config", type=Path, default=None, help="a configuration of your own (YAML)")
        sub.add_argument("--seed", type=int, default=None, help="instead of the configuration's")
        return sub

    out = str(config.top() / "out" / "study")
    every = command("all", _all, "every run that has not been done yet")
    every.add_argument("--out", type=Path, default=Path(out))
    every.add_argument("--quick", action="store_true", help="fewer participants, little or no curves and sensitivity")
    every.add_argument("--only", choices=("runs", "curves", "sensitivity"), help="one part alone")
    every.add_argument("--participants", type=int, default=None, help="instead of the configuration's number")
    every.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    every.add_argument("--fresh", action="store_true", help="throws away what is in the folder")
    one = command("run", _run, "one run alone")
    one.add_argument("--participant", type=int, required=True)
    one.add_argument("--scenario", required=True)
    one.add_argument("--method", required=True)
    varied = one.add_mutually_exclusive_group()
    varied.add_argument("--sweep", help="with --value: a row of curves.csv")
    varied.add_argument("--parameter", help="with --factor: a row of sensitivity.csv")
    one.add_argument("--value", "--factor", dest="amount", type=float, help="that row's column of this name")
    one.add_argument("--compare", type=Path, help="the study's CSV file: says whether its row is the same")
    both = command("agree", _agree, "some runs through ROS, beside the same runs in one process")
    both.add_argument("--out", type=Path, default=Path(out))
    both.add_argument("--count", type=int, default=None, help="only the first so many of the configuration's")
    return parser


def _agree(given: argparse.Namespace, console: Console) -> int:
    study = config.load(given.config, given.seed)
    given.out.mkdir(parents=True, exist_ok=True)
    return agree.agree(study, given.out, given.count, console)


def _all(given: argparse.Namespace, console: Console) -> int:
    study = config.load(given.config, given.seed)
    design = study.design
    participants = given.participants or (design.quick_participants if given.quick else design.participants)
    jobs = plan.main_jobs(study, participants)
    jobs += sweep_jobs(study, given.quick)
    if given.only:
        jobs = [job for job in jobs if job.file == f"{given.only}.csv"]
    counts = {name: sum(job.file == name for job in jobs) for name in (plan.RUNS, plan.CURVES, plan.SENSITIVITY)}
    console.print(
        f"{participants} participants, {len(design.scenarios)} scenarios, {len(design.methods)} methods: "
        f"{counts[plan.RUNS]} runs; {counts[plan.CURVES]} for curves, {counts[plan.SENSITIVITY]} for sensitivity; "
        f"{given.processes} processes"
    )
    if given.quick:
        some = counts[plan.CURVES] + counts[plan.SENSITIVITY] > 0
        console.print(f"QUICK: {'only a small part of' if some else 'without'} curves and sensitivity")
    own = f" --config {given.config}" if given.config else ""
    again = {key: alone.COMMANDS[file] + own for key, file in RERUNS.items()}
    facts = {"quick": given.quick, **again}
    failed = campaign.conduct(study, jobs, given.out, max(1, given.processes), given.fresh, facts, console)
    console.print(f"written to {given.out}")
    return 1 if failed else 0


def sweep_jobs(study: Study, quick: bool) -> List[plan.Job]:
    """The runs of curves and sensitivity; a quick study has those that the configuration names, or none."""
    found: List[plan.Job] = []
    for section, make in (("curves", sweeps.curve_jobs), ("sensitivity", sweeps.sensitivity_jobs)):
        settings = study.document.get(section) or {}
        if not quick:
            found += make(study, int(settings.get("participants", 1)))
        elif settings.get("quick"):
            found += make(study, 1, settings["quick"])
    return found


def _run(given: argparse.Namespace, console: Console) -> int:
    study = config.load(given.config, given.seed)
    task = Task(given.participant, given.scenario, given.method)
    job = alone.find(study, task, given.sweep, given.parameter, given.amount)
    row = campaign.row_of(study, job, Room(), None)
    writer = csv.DictWriter(sys.stdout, campaign.columns(study, job.file), lineterminator="\n", extrasaction="ignore")
    writer.writeheader()
    writer.writerow(row)
    if given.compare is None:
        return 0
    same, differing = alone.compare(given.compare, job, row, study.design.seed)
    console.print("the row is the same" if same else f"the row in {given.compare} differs: {differing}")
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
