"""Conducts one run of a study with people: in the right condition, in the planned order, with notes.

The experimenter names the participant. Which run comes next, and how the system is started for it, follow from the
protocol and from kit.yaml next to it. Nothing is typed twice or overwritten: a repeated run gets a separate folder.
"""

from __future__ import annotations

import datetime
import json
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Mapping, Tuple

import yaml

from vb_core.child_processes import ChildProcess
from vb_core.errors import CodedError
from vb_core.files import write_atomically
from vb_evaluation.repository_revision import revision
from vb_evaluation.user_study import protocol
from vb_evaluation.user_study.recording import BAGS, EVENTS, RUN, Recording
from vb_evaluation.user_study.recording_measures import deviations, last_attempt

SETTINGS = "kit.yaml"
TEMPLATE = """# How study_kit run starts the system. Arguments are those of the launch file; record:= comes from the protocol.
launch: [vb_bringup, lab.launch]     # or a lab's own: [~/my_lab/lab.launch]
arguments: {}                       # for all runs, for instance {map: ~/study/map.yaml, voice: true}
methods:                            # for each method of the protocol
  nrs: {cameras: red green blue, method: nrs}
  robot_only: {cameras: none, method: robot_only, buttons: true}
"""
KEYS = {
    "b": "begins",
    "h": "help was given",
    "p": "a problem of the system",
    "d": "distracted",
    "n": "note",
    "c": "completed",
    "f": "not completed",
}
END_KEYS = {"c": True, "f": False}


@dataclass(frozen=True)
class NextRun:
    """The run to do now.

    Attributes:
        folder: for its recording; does not exist yet.
        command: starts the system.
        cameras: ceiling cameras of this condition.
        last: whether it is the participant's last run.
        questionnaire: the method that the participant began with; the questionnaire begins with it too, so that its order
            is as balanced as that of the methods.
    """

    entry: protocol.Entry
    folder: Path
    command: Tuple[str, ...]
    cameras: Tuple[str, ...]
    last: bool = False
    questionnaire: str = ""


def write_template(folder: Path) -> None:
    """Puts kit.yaml beside a protocol, unless there is one."""
    if not (folder / SETTINGS).exists():
        write_atomically(folder / SETTINGS, TEMPLATE.encode("utf-8"))


def find_next_run(path: Path, participant: str, again: bool = False) -> NextRun:
    """Finds the participant's next run: the first one in the planned order that has no finished recording.

    Args:
        again: repeats the last run that was begun, in a separate folder.

    Raises:
        CodedError: "no_participant", "all_done", "unfinished", "bad_protocol".
    """
    entries = protocol.read_protocol(path)
    own = sorted((entry for entry in entries if entry.participant == participant), key=lambda entry: entry.order)
    if not own:
        people = ", ".join(dict.fromkeys(entry.participant for entry in entries))
        reason = f"{path} has no participant '{participant}'; there are {people}"
        raise CodedError("no_participant", reason, participant=participant)
    begun = [entry for entry in own if entry.folder(path).exists()]
    unfinished = [entry for entry in begun if "ended" not in Recording(last_attempt(entry.folder(path))).run]
    if again and begun:
        entry = (unfinished or begun)[-1]
    elif unfinished:
        name = unfinished[0].recording
        reason = f"{name} was begun and not finished: --again does it again in another folder, and keeps what is there"
        raise CodedError("unfinished", reason, recording=name)
    else:
        remaining = [entry for entry in own if entry not in begun]
        if not remaining:
            raise CodedError("all_done", f"{participant} has done all runs", participant=participant)
        entry = remaining[0]
    planned = entry.folder(path)
    number = 2
    folder = planned
    while folder.exists():
        folder = planned.with_name(f"{planned.name}_{number}")
        number += 1
    launch, arguments = _settings(path.parent / SETTINGS, entry.method)
    cameras = tuple(name for name in arguments.get("cameras", "").split() if name != "none")
    launch_arguments = (f"{key}:={value}" for key, value in sorted(arguments.items()))
    command = ("roslaunch", *launch, f"record:={folder}", *launch_arguments)
    return NextRun(entry, folder, command, cameras, last=entry == own[-1], questionnaire=own[0].method)


def _settings(path: Path, method: str) -> Tuple[List[str], Dict[str, str]]:
    """Reads from kit.yaml the launch file, and its arguments for a method."""
    try:
        settings = yaml.safe_load(path.read_text(encoding="utf-8"))
        chosen = {**(settings.get("arguments") or {}), **settings["methods"][method]}
        launch = [os.path.expanduser(str(part)) for part in settings["launch"]]
    except (OSError, yaml.YAMLError) as error:
        raise CodedError("bad_protocol", f"cannot read {path}: {error}") from None
    except (KeyError, TypeError, AttributeError):
        raise CodedError("bad_protocol", f"{path} does not say how to start the method '{method}'") from None
    return launch, {
        key: str(value).lower() if isinstance(value, bool) else os.path.expanduser(str(value))
        for key, value in chosen.items()
    }


def conduct_run(
    next_run: NextRun, start: Callable[[NextRun], Callable[[], None]], keys: Iterator[str], say: Callable[[str], None]
) -> Mapping[str, Any]:
    """Starts the system, notes events by key press, and ends with "completed" or "not completed".

    Args:
        start: starts the system for the run and returns what stops it.
        keys: what the experimenter types; a note is a separate line after "n". If they end, the run stays unfinished.

    Returns:
        The content of run.yaml.
    """
    next_run.folder.mkdir(parents=True)
    entry = next_run.entry
    run: Dict[str, Any] = {name: getattr(entry, name) for name in ("participant", "order", "method", "scenario")}
    run.update(cameras=list(next_run.cameras), revision=revision(), command=list(next_run.command), started=_now())
    _write(next_run.folder, run)
    stop = start(next_run)
    cameras = " ".join(next_run.cameras) or "none"
    say(f"{entry.participant}, run {entry.order}: {entry.scenario} with {entry.method}, cameras {cameras}")
    say("keys: " + ", ".join(f"{key} {words}" for key, words in KEYS.items()))
    try:
        for key in keys:
            if key not in KEYS:
                say(f"'{key}' means nothing")
                continue
            event = {"time": time.time(), "key": key, "event": KEYS[key], "text": next(keys, "") if key == "n" else ""}
            with open(str(next_run.folder / EVENTS), "a", encoding="utf-8") as stream:
                stream.write(json.dumps(event) + "\n")
            say(f"noted: {KEYS[key]}")
            if key in END_KEYS:
                run.update(completed=END_KEYS[key], ended=_now())
                break
    finally:
        stop()
        # a system that did not start, or not as planned, is reported now and not by the analysis a week later
        run["recorded"] = any((next_run.folder / BAGS).glob("*.bag*"))
        _write(next_run.folder, run)
    if not run["recorded"]:
        say(f"nothing was recorded: see {next_run.folder / 'launch.log'}")
    for words in deviations(entry, Recording(next_run.folder)):
        say(f"not as planned: {words}")
    return run


def _now() -> str:
    return datetime.datetime.now().astimezone().isoformat(timespec="seconds")


def _write(folder: Path, run: Mapping[str, Any]) -> None:
    write_atomically(folder / RUN, yaml.safe_dump(dict(run), sort_keys=False).encode("utf-8"))


def read_keys() -> Iterator[str]:
    """Yields a terminal's key presses, without Return, and a line after "n"; if stdin is no terminal, its lines."""
    import sys
    import termios
    import tty

    if not sys.stdin.isatty():
        yield from (line.strip() for line in sys.stdin)
        return
    attributes = termios.tcgetattr(sys.stdin)
    try:
        while True:
            tty.setcbreak(sys.stdin)
            key = sys.stdin.read(1)
            yield key
            if key == "n":
                termios.tcsetattr(sys.stdin, termios.TCSADRAIN, attributes)
                yield sys.stdin.readline().strip()
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, attributes)


def roslaunch(next_run: NextRun) -> Callable[[], None]:
    """Starts the system as planned. Returns what stops it."""
    return ChildProcess(list(next_run.command), next_run.folder / "launch.log").stop
