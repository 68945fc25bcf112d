"""The kit's commands; docs/how-to/run-a-study.md walks through them.

rosrun vb_evaluation study_kit plan --participants 15 --out ~/study/protocol.csv
rosrun vb_evaluation study_kit forms ~/study/forms
rosrun vb_evaluation study_kit run p01 --protocol ~/study/protocol.csv
rosrun vb_evaluation study_kit measure ~/study/protocol.csv --ground-truth ~/study/ground_truth --out ~/study/results
rosrun vb_evaluation study_kit replay ~/study/p01_1_nrs_carpet
rosrun vb_evaluation study_kit questionnaire ~/study/questionnaire.csv
rosrun vb_evaluation study_kit report ~/study/results
"""
from __future__ import annotations

import argparse
import csv
import dataclasses
import math
import sys
from pathlib import Path
from typing import Dict, List, Optional

from rich.console import Console

from vb_core.errors import CodedError
from vb_core.map_files import read_map
from vb_evaluation.report import questionnaire
from vb_evaluation.kit import conduct, forms, measure, protocol
from vb_evaluation.kit.ground_truth import read_ground_truth
from vb_evaluation.kit.recording import Recording
from vb_evaluation.report import write_report

_console = Console(highlight=False, soft_wrap=True)


def main(arguments: Optional[List[str]] = None) -> int:
    """Runs a command; 0 if it worked, 2 with one line if not."""
    parser = argparse.ArgumentParser(
        prog="study_kit", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    _add_plan(commands)
    _add_forms(commands)
    _add_run(commands)
    _add_measure(commands)
    _add_replay(commands)
    _add_questionnaire(commands)
    command = commands.add_parser("report", help="write the report of a study's folder")
    command.add_argument("folder", type=_path)
    command.set_defaults(run=lambda given: print(write_report(given.folder)))
    given = parser.parse_args(arguments)
    try:
        given.run(given)
    except CodedError as error:
        print(f"study_kit: {error}", file=sys.stderr)
        return 2
    return 0


def _path(text: str) -> Path:
    return Path(text).expanduser()


# ------------------------------------------------------------------ plan
def _add_plan(commands) -> None:
    command = commands.add_parser("plan", help="draw the order of methods and scenarios and write an empty protocol")
    command.add_argument("--participants", type=int, default=15)
    command.add_argument("--scenarios", nargs="+", default=["room", "carpet", "corner"])
    command.add_argument("--methods", nargs="+", default=["nrs", "robot_only"])
    command.add_argument("--seed", type=int, default=1)
    command.add_argument("--out", type=_path, default=Path("protocol.csv"))
    command.set_defaults(run=_plan)


def _plan(given: argparse.Namespace) -> None:
    protocol.write(given.out, protocol.plan(given.participants, given.scenarios, given.methods, given.seed))
    conduct.write_template(given.out.parent)
    print(given.out)


# ------------------------------------------------------------------ forms
def _add_forms(commands) -> None:
    command = commands.add_parser("forms", help="write information, consent, demographics and questionnaire to be printed")
    command.add_argument("folder", type=_path)
    command.set_defaults(run=lambda given: [print(path) for path in forms.write(given.folder)])


# ------------------------------------------------------------------ run
def _add_run(commands) -> None:
    command = commands.add_parser("run", help="do a participant's next run: starts the system in the planned condition")
    command.add_argument("participant")
    command.add_argument("--protocol", type=_path, default=Path("protocol.csv"))
    command.add_argument("--scenario", help="refuses unless it is the planned one")
    command.add_argument("--method", help="refuses unless it is the planned one")
    command.add_argument("--again", action="store_true", help="do the last run again, in another folder")
    command.add_argument("--rehearse", action="store_true", help="a simulated person in one process, without ROS and people")
    command.set_defaults(run=_run)


def _run(given: argparse.Namespace) -> None:
    planned = conduct.next_run(given.protocol, given.participant, given.again, scenario=given.scenario, method=given.method)
    say = lambda words: _console.print(words, markup=False)  # noqa: E731
    if given.rehearse:
        # only here: the rest of the kit knows no simulator
        from vb_evaluation.study import rehearsal

        outcomes: List[bool] = []
        start, keys = rehearsal.person(rehearsal.default_study(), outcomes), ("b" if key else ("c" if outcomes[-1] else "f") for key in (1, 0))
    else:
        start, keys = conduct.roslaunch, conduct.read_keys()
    run = conduct.conduct(planned, start, keys, say)
    if "ended" not in run:
        raise CodedError("unfinished", f"the run was not ended: {planned.folder} is kept, --again does the run again")
    print(planned.folder)


# ------------------------------------------------------------------ measure
def _add_measure(commands) -> None:
    command = commands.add_parser("measure", help="compute the measures of all recordings and the report")
    command.add_argument("protocol", type=_path)
    command.add_argument("--ground-truth", type=_path, required=True, help="folder of <scenario>.png")
    command.add_argument(
        "--map", type=_path, help="map_server's YAML of the physical map; without it that of the first recording"
    )
    command.add_argument("--out", type=_path, default=Path("out/study_people"))
    command.set_defaults(run=_measure)


def _measure(given: argparse.Namespace) -> None:
    for note in measure.measure(
        given.protocol, given.ground_truth, given.out, read_map(given.map) if given.map else None
    ):
        _console.print(f"look at this: {note}", markup=False)
    print(write_report(given.out))


# ------------------------------------------------------------------ replay
def _add_replay(commands) -> None:
    command = commands.add_parser("replay", help="put a recording through today's code and compare")
    command.add_argument("recordings", type=_path, nargs="+")
    command.add_argument("--images", action="store_true", help="find the spots again in the recorded images")
    command.add_argument(
        "--ground-truth", type=_path, help="the picture of what was asked for: says which of both is better"
    )
    command.add_argument("--out", type=_path, help="a CSV file for the comparison")
    command.set_defaults(run=_replay)


def _replay(given: argparse.Namespace) -> None:
    # only here: the rest of the kit works on a computer without ROS
    from vb_evaluation.kit import replay

    rows: List[Dict[str, object]] = []
    for folder in given.recordings:
        recording = Recording(folder)
        physical = replay.physical_map(recording) or recording.physical()
        today = replay.replay(recording, given.images)
        for camera, count in today.cameras.items():
            _console.print(f"{folder.name}: camera {camera}: {count.images} images, spot in {count.today} today, "
                           f"{count.recorded} recorded")
        truths = {}
        if given.ground_truth:
            truth = read_ground_truth(given.ground_truth, physical)
            truths = {interaction.id: truth for interaction in recording.interactions}
        for found in replay.compare(recording, today, physical, truths):
            rows.append({"recording": folder.name, **dataclasses.asdict(found)})
    if not rows:
        raise CodedError("bad_recording", "no interaction has ended in these recordings")
    for row in rows:
        _console.print(_sentence(row), markup=False)
    if given.out:
        with open(str(given.out), "w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


def _sentence(row: Dict[str, object]) -> str:
    """The outcome of one interaction."""
    words = [f"{row['recording']}, interaction {row['interaction']} ({row['outcome']}): {row['spots']} spots"]
    if row["code"] != "ok":
        return f"{words[0]}; no border today: {row['message']} [{row['code']}]"
    known = {name: value for name, value in row.items() if isinstance(value, float) and not math.isnan(value)}
    if "agreement" in known:
        words.append(
            f"today's area agrees with the recorded one: Jaccard index {known['agreement']:.3f}, "
            f"chains at most {known['chain_distance_m']:.3f} m apart"
        )
    if "today" in known:
        words.append(
            "against the ground truth: "
            + ", ".join(f"{name} {known[name]:.3f}" for name in ("recorded", "today") if name in known)
        )
    return "; ".join(words)


# ------------------------------------------------------------------ questionnaire
def _add_questionnaire(commands) -> None:
    command = commands.add_parser("questionnaire", help="the paper's Wilcoxon table of the answers")
    command.add_argument("answers", type=_path)
    command.add_argument("--empty", action="store_true", help="write an empty form instead")
    command.add_argument("--out", type=_path, help="a CSV file for the table")
    command.set_defaults(run=_questionnaire)


def _questionnaire(given: argparse.Namespace) -> None:
    if given.empty:
        try:
            with open(str(given.answers), "x", encoding="utf-8") as stream:
                stream.write(",".join(questionnaire.columns() + questionnaire.ueq_columns()) + "\n")
        except OSError as error:
            raise CodedError("cannot_write", f"cannot write {given.answers}: {error.strerror}") from None
        print(given.answers)
        return
    found = questionnaire.read(given.answers)
    for line in questionnaire.lines(found):
        _console.print(line, markup=False)
    if given.out:
        questionnaire.write(given.out, questionnaire.table(found))


if __name__ == "__main__":
    sys.exit(main())
