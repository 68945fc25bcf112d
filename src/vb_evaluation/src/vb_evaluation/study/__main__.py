"""The simulated study: python3 -m vb_evaluation.study COMMAND

all     every run that has not been done yet; make study does this
run     one run alone: the row that it has in its file
"""

from __future__ import annotations

import argparse
import csv
import datetime
import os
import signal
import sys
from pathlib import Path
from typing import List, Optional

from rich.console import Console

from vb_core.errors import CodedError
from vb_evaluation.provenance import repository_top
from vb_evaluation.report.data import RUNS, WORLDS
from vb_evaluation.study import campaign, config, plan

SIGNALS = (signal.SIGINT, signal.SIGTERM)
RERUN = (
    "python3 -m vb_evaluation.study run --participant {participant} --scenario {scenario} --method {method} --seed {seed}; "
    "for worlds.csv with --draw {draw}"
)


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

    out = repository_top() / "out" / "study"
    every = command("all", _all, "every run that has not been done yet")
    every.add_argument("--out", type=Path, default=out)
    every.add_argument("--quick", action="store_true", help="only the first person, to see that all works")
    every.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    one = command("run", _run, "one run alone")
    one.add_argument("--participant", type=int, required=True)
    one.add_argument("--scenario", required=True)
    one.add_argument("--method", required=True)
    one.add_argument("--draw", type=int, help="a row of worlds.csv")
    one.add_argument("--compare", type=Path, help="the study's CSV file: says whether its row is the same")
    return parser


def _interrupt(_number: int, _frame: object) -> None:
    """Interrupts once: from then on workers are being ended."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


def _all(given: argparse.Namespace, console: Console) -> int:
    for number in SIGNALS:
        # a shell starts what runs in the background with interruptions switched off, and Python leaves them so
        signal.signal(number, _interrupt)
    study = config.load(given.config, given.seed)
    jobs = plan.jobs(study, given.quick)
    counts = {file: sum(job.file == file for job in jobs) for file in (RUNS, WORLDS)}
    console.print(", ".join(f"{count} runs for {file}" for file, count in counts.items()))
    facts = {
        **campaign.made_by(),
        "date": datetime.date.today().isoformat(),
        "rerun": RERUN + (f" --config {given.config}" if given.config else ""),
    }
    failed = campaign.run_jobs(study, jobs, given.out, max(1, given.processes), facts, console)
    console.print(f"written to {given.out}")
    return 1 if failed else 0


def _run(given: argparse.Namespace, console: Console) -> int:
    study = config.load(given.config, given.seed)
    among = plan.main_jobs(study, given.participant) if given.draw is None else plan.world_jobs(study)
    job = plan.find(among, participant=given.participant, scenario=given.scenario, method=given.method, draw=given.draw)
    row, _ = campaign.row_of(study, job)
    writer = csv.DictWriter(sys.stdout, campaign.columns(job.file), lineterminator="\n")
    writer.writeheader()
    writer.writerow(row)
    if given.compare is None:
        return 0
    key = job.columns(study.design.seed)
    with open(str(given.compare), newline="", encoding="utf-8") as stream:
        found = [
            line for line in csv.DictReader(stream) if all(line[name] == str(value) for name, value in key.items())
        ]
    # a file that an earlier version wrote may lack a column
    differing = [name for name, value in row.items() if not found or found[0].get(name, str(value)) != str(value)]
    console.print(f"the row in {given.compare} differs: {', '.join(differing)}" if differing else "the row is the same")
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
