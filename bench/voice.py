#!/usr/bin/env python3
"""How well spoken commands are recognised: writes out/bench/voice.json and prints a table.

    bench/voice.py             every voice and sentence; some minutes
    bench/voice.py --takes 1   a quarter of it

Commands, other sentences and near misses ("save the date", "cancels") are said by synthetic voices in
room noise at 10 dB, then once more while eight people talk. None of the voices, accents and sentences was used in training (bench/voice_training.py).
Needs espeak-ng, flite and festival (see bench/voice_speech.py); voices that are not installed are left out.
"""
from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections import Counter, defaultdict
from multiprocessing import Pool
from typing import List, Optional

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import voice_speech as speech
from voice_speech import EVALUATION_VOICES, NOISES, RATE, TOP

from vb_voice_wizard.endpointing import Endpointer
from vb_voice_wizard.recognizer import CommandRecognizer, RecognizerParams

THRESHOLDS = (0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95)
# distorted on purpose: cartoon voices with formants a third higher or lower than anybody's
EXTREME = ("zac", "Alicia", "Lee")

_recognizer: Optional[CommandRecognizer] = None
_talkers: List[np.ndarray] = []


def _setup(params: RecognizerParams, talkers: List[np.ndarray]) -> None:
    global _recognizer
    _recognizer = CommandRecognizer(params)
    _talkers[:] = talkers


def _judge(plan: speech.Plan) -> Optional[dict]:
    """Streams one utterance as a microphone does, and asks for it as a whole too."""
    spoken = plan.speak(_talkers)
    if spoken is None:
        return None
    findings = _recognizer.examine(spoken.pcm)
    started = time.process_time()
    endpointer = Endpointer(_recognizer.endpointing)
    answers, deciding = [], 0.0
    for at in range(0, len(spoken.pcm), RATE // 20):
        for utterance in endpointer.push(spoken.pcm[at : at + RATE // 20]):
            # CPU time: how busy the machine is with other things is not the recogniser's merit or fault
            before = time.process_time()
            answers.append(_recognizer.classify(utterance).command)
            deciding = max(deciding, time.process_time() - before)
    return {
        "kind": plan.kind,
        "command": plan.command,
        "text": plan.text,
        "voice": plan.voice[1],
        "noise": plan.noise,
        "found": [(finding.best, finding.confidence) for finding in findings],
        "streamed": next((answer for answer in answers if answer), None),
        "answer_s": deciding + _recognizer.params.end_silence,
        "cpu_s": time.process_time() - started,
        "audio_s": len(spoken.pcm) / RATE,
    }


def understood(result: dict, threshold: float) -> str:
    """The command that `recognize` gives with this threshold, or ""."""
    return next((best for best, confidence in result["found"] if confidence >= threshold), "")


def share(results: List[dict], condition) -> float:
    """Percentage of results that fulfil a condition."""
    return 100.0 * sum(map(condition, results)) / max(1, len(results))


def summarise(results: List[dict], threshold: float) -> dict:
    """The figures of one set of results."""
    by_kind = defaultdict(list)
    for result in results:
        by_kind[result["kind"]].append(result)
    commands = by_kind["command"]

    def right(result: dict) -> bool:
        return understood(result, threshold) == result["command"]

    return {
        "commands": len(commands),
        "others": len(by_kind["other"]),
        "near_misses": len(by_kind["near_miss"]),
        "recall_percent": share(commands, right),
        "recall_streamed_percent": share(commands, lambda result: result["streamed"] == result["command"]),
        "wrong_command_percent": share(commands, lambda result: understood(result, threshold) not in ("", result["command"])),
        "false_accept_percent": share(by_kind["other"], lambda result: bool(understood(result, threshold))),
        "false_accept_streamed_percent": share(by_kind["other"], lambda result: bool(result["streamed"])),
        "near_miss_accept_percent": share(by_kind["near_miss"], lambda result: bool(understood(result, threshold))),
    }


def main() -> int:
    """See the module's text."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--takes", type=int, default=4, help="how often each command is said by each voice")
    parser.add_argument("--snr", type=float, default=10.0, help="[dB]")
    parser.add_argument("--network", default="", help="another phones.npz")
    parser.add_argument("--decision", default="", help="another decision.yaml")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    params = RecognizerParams(network=arguments.network, decision=arguments.decision)
    texts = speech.sentences("evaluation_others")
    talkers = [
        speech.synthesise(EVALUATION_VOICES[index % 20], f"{texts[index]}, {texts[-index - 1]}") for index in range(0, 40, 2)
    ]
    jobs = speech.plans("evaluation", EVALUATION_VOICES, arguments.takes, NOISES, arguments.snr)
    jobs += speech.plans("evaluation", EVALUATION_VOICES, 1, ("babble",), arguments.snr)
    with Pool(arguments.processes, _setup, (params, talkers)) as pool:
        found = pool.imap(_judge, jobs, chunksize=10)
        everything = [result for result in found if result is not None]
    results = [result for result in everything if result["noise"] != "babble"]
    babble = [result for result in everything if result["noise"] == "babble"]
    if not results:
        print("no voice could be synthesised: install espeak-ng", file=sys.stderr)
        return 1
    everyday = [result for result in results if not result["voice"].endswith(EXTREME)]
    answer_s = [result["answer_s"] for result in results if result["kind"] == "command"]
    missed = [r for r in results if r["kind"] == "command" and understood(r, params.threshold) != r["command"]]
    report = {
        "snr_db": arguments.snr,
        "noises": list(NOISES),
        "all_voices": summarise(results, params.threshold),
        "without_extreme_voices": summarise(everyday, params.threshold),
        "eight_people_talking": summarise(babble, params.threshold),
        "answer_after_speech_median_s": float(np.median(answer_s)),
        "answer_after_speech_p95_s": float(np.percentile(answer_s, 95)),
        "cpu_share_of_a_core": sum(r["cpu_s"] for r in results) / sum(r["audio_s"] for r in results),
        "curve": {
            str(threshold): {
                key: summarise(results, threshold)[key]
                for key in ("recall_percent", "false_accept_percent", "near_miss_accept_percent")
            }
            for threshold in THRESHOLDS
        },
        "missed_by_voice": Counter(r["voice"] for r in missed).most_common(),
        "missed_by_command": Counter(r["command"] for r in missed).most_common(),
        "missed_by_noise": Counter(r["noise"] for r in missed).most_common(),
        "accepted_others": sorted(
            (r["text"], r["voice"], understood(r, params.threshold))
            for r in results
            if r["kind"] == "other" and understood(r, params.threshold)
        ),
    }
    path = TOP / "out" / "bench" / "voice.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(report, indent=2) + "\n")
    print(f"{'':30} {'all voices':>12} {'without ' + '/'.join(EXTREME):>24} {'while 8 talk':>14}")
    for key, value in report["all_voices"].items():
        others = report["without_extreme_voices"][key], report["eight_people_talking"][key]
        print(f"{key:30} {value:12.5g} {others[0]:24.5g} {others[1]:14.5g}")
    for key in ("answer_after_speech_median_s", "answer_after_speech_p95_s", "cpu_share_of_a_core"):
        print(f"{key:28} {report[key]:12.3f}")
    print("threshold: recall, false accepts, near misses accepted [%]")
    for threshold, row in report["curve"].items():
        print(f"{threshold:>9}: " + ", ".join(f"{value:.1f}" for value in row.values()))
    print("missed by voice:", report["missed_by_voice"][:8])
    print("missed by command:", report["missed_by_command"], "by noise:", report["missed_by_noise"])
    print("accepted:", report["accepted_others"])
    print(f"written to {path.relative_to(TOP)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
