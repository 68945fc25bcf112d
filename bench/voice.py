#!/usr/bin/env python3
"""How well spoken commands are recognised: writes out/bench/voice_GROUP.json and docs/results/voice.md.

    bench/voice.py                         every command by every voice, every sentence once, in each kind of noise
    bench/voice.py --share 0.3             a random part of it, the same each time
    bench/voice.py --group development     the same with what the thresholds were chosen with

Commands, other sentences and near misses are said by synthetic voices and streamed as from a microphone, at 10 dB: in steady
noise, half of it with reverberation; over music; while eight people talk. Neither voices nor sentences, noises and styles of
music of the evaluation were used in training or to choose anything.
Needs espeak-ng, flite, festival and the recordings of bench/voice_recordings.py; voices that are missing are left out.
"""
from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections import Counter, defaultdict
from multiprocessing import Pool
from typing import Dict, List, Optional, Sequence, Tuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import voice_speech as speech
from voice_speech import ASKED_ABOUT, MUSIC, NOISES, RATE, TOP

from vb_voice_wizard.voice.endpointing import Endpointer, EndpointParams
from vb_voice_wizard.recognizer import CommandRecognizer, RecognizerParams

MAY_BE_SURE = ("save", "cancel", "undo", "redo")  # resume is asked about always

_recognizer: Optional[CommandRecognizer] = None
_talkers: List[np.ndarray] = []


def _setup(params: RecognizerParams, talkers: List[np.ndarray]) -> None:
    global _recognizer
    _recognizer = CommandRecognizer(params)
    _talkers[:] = talkers


def _judge(plan: speech.Plan) -> Optional[dict]:
    """Streams one utterance as a microphone does."""
    pcm = plan.speak(_talkers)
    if pcm is None:
        return None
    started = time.process_time()
    endpointer = Endpointer(_recognizer.endpointing)
    issues, deciding = [], 0.0
    for at in range(0, len(pcm), RATE // 20):
        for utterance in endpointer.push(pcm[at : at + RATE // 20]):
            # CPU time: how busy the machine is with other things is not the recogniser's merit or fault
            before = time.process_time()
            issues.append(_recognizer.classify(utterance))
            deciding = max(deciding, time.process_time() - before)
    return {
        "kind": plan.kind,
        "command": plan.command,
        "text": plan.text,
        "voice": plan.voice[1],
        "noise": plan.noise,
        "found": [(issue.best, issue.confidence, issue.unclear) for issue in issues],
        "answer_s": deciding + _recognizer.endpointing.end_silence,
        "cpu_s": time.process_time() - started,
        "audio_s": len(pcm) / RATE,
    }


def understood(result: dict, threshold: float) -> str:
    """The command that is taken first with this threshold, or ""."""
    return next((best for best, confidence, _ in result["found"] if confidence >= threshold), "")


def interval(count: int, total: int) -> Tuple[float, float]:
    """95 % interval of a share [%] (Wilson)."""
    if not total:
        return 0.0, 100.0
    z, share = 1.96, count / total
    middle = (share + z * z / (2 * total)) / (1 + z * z / total)
    half = z * np.sqrt(share * (1 - share) / total + z * z / (4 * total * total)) / (1 + z * z / total)
    return 100.0 * max(0.0, middle - half), 100.0 * min(1.0, middle + half)


def summarise(results: List[dict], threshold: float) -> Dict[str, Tuple[int, int]]:
    """(how many, of how many) for each figure of one set of results."""
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
        best, _, unclear = next((one for one in result["found"] if one[1] >= threshold), ("", 0.0, False))
        return best in ASKED_ABOUT and not unclear

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


def counted(pairs: List[Tuple[str, int]]) -> str:
    """What occurs how often, in words."""
    return ", ".join(f"{name} {count}" for name, count in pairs) or "none"


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


def main() -> int:
    """See the module's text."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--group", choices=("development", "evaluation"), default="evaluation")
    parser.add_argument("--takes", type=int, default=4, help="how often each command is said by each voice")
    parser.add_argument("--share", type=float, default=1.0, help="of all that could be said")
    parser.add_argument("--snr", type=float, default=10.0, help="[dB]")
    parser.add_argument("--model", default="", help="another commands.npz")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    params, group = RecognizerParams(model=arguments.model), arguments.group
    threshold = CommandRecognizer(params).threshold
    jobs, talkers = speech.everything(group, arguments.takes, arguments.share, arguments.snr)
    styles = MUSIC[group]
    with Pool(arguments.processes, _setup, (params, talkers)) as pool:
        results = []
        try:
            for result in pool.imap(_judge, jobs, chunksize=4):
                if result is not None:
                    results.append(result)
                    print(f"{len(results)} of {len(jobs)}", end="\r", flush=True)
        except KeyboardInterrupt:
            print(f"stopped after {len(results)} of {len(jobs)}")
    if not results:
        print("no voice could be synthesised: install espeak-ng", file=sys.stderr)
        return 1
    music = [result for result in results if result["noise"] in styles]
    babble = [result for result in results if result["noise"] == "babble"]
    steady = [result for result in results if result["noise"] in NOISES[group]]
    columns = {"steady noise": steady, "music": music, "eight people talking": babble}
    figures = {name: summarise(found, threshold) for name, found in columns.items()}
    answer_s = [result["answer_s"] for result in steady if result["kind"] == "command"]
    missed = [r for r in results if r["kind"] == "command" and understood(r, threshold) != r["command"]]
    taken = sorted(
        f"{r['text']} ({r['voice']}, {r['noise']}): {understood(r, threshold)}"
        for r in results if r["kind"] != "command" and understood(r, threshold)
    )
    report = {
        "snr_db": arguments.snr,
        "figures": figures,
        "answer_after_speech_median_s": float(np.median(answer_s)),
        "answer_after_speech_p95_s": float(np.percentile(answer_s, 95)),
        "cpu_share_of_a_core": sum(r["cpu_s"] for r in results) / sum(r["audio_s"] for r in results),
        "missed_by_voice": Counter(r["voice"] for r in missed).most_common(),
        "missed_by_command": Counter(r["command"] for r in missed).most_common(),
        "missed_by_noise": Counter(r["noise"] for r in missed).most_common(),
        "taken": taken,
        "utterances": [{key: r[key] for key in ("kind", "command", "text", "voice", "noise", "found")} for r in results],
    }
    path = TOP / "out" / "bench" / f"voice_{group}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(report, indent=2) + "\n")
    revision = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=str(TOP), stdout=subprocess.PIPE).stdout.decode().strip()
    listed = "\n".join(f"- {line}" for line in taken) or "- none"
    shown = "voice.md" if group == "evaluation" else "voice_development.md"
    (TOP / "docs" / "results" / shown).write_text(f"""# Spoken commands: results

`bench/voice.py {' '.join(sys.argv[1:])}`, {time.strftime('%Y-%m-%d')}, revision {revision}, threshold {threshold:.3f};
{arguments.snr:g} dB, streamed; {len(results)} of {len(jobs)} utterances
(voices that are not installed are left out). In brackets 95 % intervals.

{table(figures)}

Answer {report['answer_after_speech_median_s']:.2f} s (median), {report['answer_after_speech_p95_s']:.2f} s (95th percentile) after the end
of speech, of which {EndpointParams().end_silence:g} s are silence, the rest CPU time. {report['cpu_share_of_a_core']:.3f} of a core.

Missed, by voice: {counted(report['missed_by_voice'])};
by command: {counted(report['missed_by_command'])};
by noise: {counted(report['missed_by_noise'])}.

Taken for a command, before anything is asked:

{listed}
""")
    print(table(figures))
    print(f"written to {path.relative_to(TOP)} and docs/results/{shown}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
