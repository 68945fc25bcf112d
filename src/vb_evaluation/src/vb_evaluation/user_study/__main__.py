"""Plans, runs, measures and reports a study with people; docs/how-to/run-a-study.md shows how."""

from __future__ import annotations

import argparse
import secrets
import sys
from pathlib import Path
from typing import Any, Callable, Iterable, Iterator, List, Optional

from vb_core.errors import CodedError
from vb_core.map_files import read_map
from vb_evaluation.report import document
from vb_evaluation.user_study import blind_judging, conduct_run, forms, privacy, protocol, recording_measures


def main(arguments: Optional[List[str]] = None) -> int:
    """Runs a command and prints its output. Returns 0 if it worked, 2 and one line on stderr if not."""
    options = _parser().parse_args(arguments)
    try:
        for line in options.run(options):
            print(line)
    except CodedError as error:
        print(f"study_kit: {error}", file=sys.stderr)
        return 2
    return 0


def _path(text: str) -> Path:
    return Path(text).expanduser()


def _parser() -> argparse.ArgumentParser:
    """Makes the parser. It sets `run` to the chosen command's function, which yields the lines to print."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog="study_kit", description=__doc__, formatter_class=formatter)
    commands = parser.add_subparsers(dest="command", required=True)

    def command(name: str, run: Callable[[argparse.Namespace], Iterable[Any]], words: str) -> Callable[..., Any]:
        sub = commands.add_parser(name, help=words)
        sub.set_defaults(run=run)
        return sub.add_argument

    argument = command("plan", _plan, "draw the order of methods and scenarios and write an empty protocol")
    argument("--participants", type=int, default=15)
    argument("--scenarios", nargs="+", default=["room", "carpet", "corner"])
    argument("--methods", nargs="+", default=["nrs", "robot_only"])
    argument("--seed", type=int, help="of the order; default: drawn, so that nobody can foresee it")
    argument("--out", type=_path, default=Path("protocol.csv"))
    argument = command("forms", _forms, "write information, consent, demographics and questionnaire to be printed")
    argument("folder", type=_path)
    argument = command("run", _run, "do a participant's next run: starts the system in the planned condition")
    argument("participant")
    argument("--protocol", type=_path, default=Path("protocol.csv"))
    argument("--again", action="store_true", help="do the last run again, in another folder")
    argument = command("measure", _measure, "compute the measures of all recordings and the report")
    argument("protocol", type=_path)
    argument("--ground-truth", type=_path, required=True, help="folder of <scenario>.png")
    argument("--map", type=_path, help="map_server's YAML of the physical map; default: the first recording's")
    argument("--out", type=_path, default=Path("out/study_people"))
    argument = command("report", _report, "write the report of a study's folder")
    argument("folder", type=_path)
    argument("--page", type=_path, help="a Markdown page that gets the report between its two marks")
    argument = command("judge", _judge, "write pictures of what was drawn, for somebody who does not know the method")
    argument("results", type=_path)
    argument("--study", type=_path, help="the protocol's folder; default: the one that holds the results")
    argument = command("export", _export, "write a copy without anything that tells who somebody is")
    argument("results", type=_path)
    argument("--out", type=_path, required=True)
    argument = command("delete", _delete, "delete a participant's recordings and answers for good")
    argument("participant")
    argument("--protocol", type=_path, default=Path("protocol.csv"))
    return parser


def _report(options: argparse.Namespace) -> Iterator[Any]:
    yield document.write_report(options.folder)
    if options.page:
        document.write_page(options.folder, options.page)


def _forms(options: argparse.Namespace) -> Iterator[Any]:
    yield from forms.write_forms(options.folder)


def _judge(options: argparse.Namespace) -> Iterator[Any]:
    yield blind_judging.write_judging_sheet(options.study or options.results.parent, options.results)


def _export(options: argparse.Namespace) -> Iterator[Any]:
    yield from privacy.export(options.results, options.out)


def _delete(options: argparse.Namespace) -> Iterator[Any]:
    yield from (f"deleted: {words}" for words in privacy.delete(options.protocol, options.participant))
    yield "measure the study again: its results still contain the participant"


def _plan(options: argparse.Namespace) -> Iterator[Any]:
    seed = secrets.randbelow(10**9) if options.seed is None else options.seed
    rows = protocol.plan_runs(options.participants, options.scenarios, options.methods, seed)
    protocol.write_protocol(options.out, rows)
    conduct_run.write_template(options.out.parent)
    yield options.out


def _run(options: argparse.Namespace) -> Iterator[Any]:
    next_run = conduct_run.find_next_run(options.protocol, options.participant, options.again)
    run = conduct_run.conduct_run(next_run, conduct_run.roslaunch, conduct_run.read_keys(), print)
    if next_run.last:
        yield f"that was the last run: hand out questionnaire_{next_run.questionnaire}_first.html"
    if "ended" not in run:
        raise CodedError("unfinished", f"the run was not ended: {next_run.folder} is kept, --again does the run again")
    yield next_run.folder


def _measure(options: argparse.Namespace) -> Iterator[Any]:
    physical = read_map(options.map) if options.map else None
    for note in recording_measures.measure_study(options.protocol, options.ground_truth, options.out, physical):
        yield f"look at this: {note}"
    yield document.write_report(options.out)


if __name__ == "__main__":
    sys.exit(main())
