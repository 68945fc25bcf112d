"""Runs the simulated study (see `make study`): all runs not done yet, or only those of them that are asked for."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from pathlib import Path
from typing import List, Optional

from rich.console import Console

from vb_core.errors import CodedError
from vb_evaluation.repository_revision import repository_root
from vb_evaluation.report.study_files import RUNS, WORLDS
from vb_evaluation.simulated_study import campaign, config, run_plan

SIGNALS = (signal.SIGINT, signal.SIGTERM)
ONLY = {"participant": int, "scenario": str, "method": str, "draw": int}


def main(arguments: Optional[List[str]] = None) -> int:
    """Runs the study. Returns 0 if all went well, 1 if runs failed, 2 for an error (one line), 130 if interrupted."""
    options = _parser().parse_args(arguments)
    console = Console(highlight=False, soft_wrap=True)
    try:
        return _run(options, console)
    except CodedError as error:
        Console(stderr=True, highlight=False, soft_wrap=True).print(f"study: {error}", markup=False, style="bold red")
        return 2
    except KeyboardInterrupt:
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="vb_evaluation.simulated_study", description=__doc__)
    parser.add_argument("--config", type=Path, default=None, help="a configuration of your own (YAML)")
    parser.add_argument("--seed", type=int, default=None, help="instead of the configuration's")
    parser.add_argument("--out", type=Path, default=repository_root() / "out" / "study")
    parser.add_argument("--quick", action="store_true", help="only the first person, to see that all works")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    for name, kind in ONLY.items():
        parser.add_argument(f"--{name}", type=kind, help="only runs with this value of the column")
    return parser


def _interrupt(_number: int, _frame: object) -> None:
    """Interrupts once. Ignores further signals while the workers end."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


def _run(options: argparse.Namespace, console: Console) -> int:
    for number in SIGNALS:
        # a shell starts background jobs with interrupts ignored, and Python leaves that so
        signal.signal(number, _interrupt)
    study = config.load(options.config, options.seed)
    wanted = {name: getattr(options, name) for name in ONLY}
    jobs = run_plan.select_jobs(run_plan.plan_jobs(study, options.quick), **wanted)
    counts = {file: sum(job.file == file for job in jobs) for file in (RUNS, WORLDS)}
    console.print(", ".join(f"{count} runs for {file}" for file, count in counts.items()))
    failed = campaign.run_jobs(study, jobs, options.out, console, max(1, options.processes))
    console.print(f"written to {options.out}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
