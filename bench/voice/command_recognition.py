#!/usr/bin/env python3
"""Measures how well the object that the node runs recognises spoken commands in an unbroken stream.

    python3 bench/voice/command_recognition.py FOLDER --half development     the speakers used for development
    python3 bench/voice/command_recognition.py FOLDER --half judging         the other speakers
    python3 bench/voice/command_recognition.py FOLDER --talk                 hours of talk: what is taken for a command

FOLDER has people's recordings of "stop" in stop/, of other words and sentences in other folders, and a kitchen's noise
in kitchen.flac; with --talk, recordings in which nobody says a command, at any depth. Speakers are identified by file
name and split by a checksum. In each room everything goes through one CommandListener as a microphone's samples do: in
pieces, with a clock, beside our own sounds, and never reset. The last rows list what was wrongly taken for a command.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Dict, List

import numpy as np

from bench.harness import HALVES, Table, arguments, share
from bench.voice.room_recordings import RATE, Clip, Room, load, read_people, trimmed
from vb_core.sounds import SOUNDS, TICK
from vb_core.vocabulary import ANSWERS
from vb_voice_wizard.recognizer import CommandRecognizer, RecognitionResult


class Tally:
    """Counts the outcomes of utterances, figure by figure, and lists those wrongly taken for commands."""

    def __init__(self) -> None:
        self.figures: Dict[str, List[bool]] = defaultdict(list)
        self.wrong: List[str] = []

    def other(self, where: str, clip: Clip, taken: List[RecognitionResult]) -> None:
        """Counts an utterance that is no command, and whether it was taken for one that matters and is done at once."""
        matters = [one for one in taken if one.certain and one.command in ANSWERS.values()]
        self.figures[f"other speech taken, {where}"].append(bool(taken))
        self.figures["other speech done at once, that matters"].append(bool(matters))
        self.wrong += [
            f"{clip.kind}/{clip.name}, {where}: {one.command}, confidence {one.confidence:.2f}" for one in taken
        ]


def judge_people(folder: Path, half: str, tally: Tally) -> None:
    """Plays people's recordings through rooms."""
    clips, random = read_people(folder, half), np.random.default_rng(1)
    kitchen = np.array_split(load(folder / "kitchen.flac"), 2)[HALVES.index(half)]
    stops, others = ([clip for clip in clips if (clip.kind == "stop") == stop] for stop in (True, False))
    others = [others[index] for index in random.permutation(len(others))]
    talk = [clip.pcm for clip in others if clip.kind == "sentences"]
    recognizer = CommandRecognizer()
    quiet, noisy, crowd = (Room(recognizer, noise) for noise in ([], [kitchen], talk[:4]))
    for number, clip in enumerate(stops):
        between = others[number % len(others)]
        after = [trimmed(between.pcm), np.zeros(RATE // 10), trimmed(clip.pcm)]
        for where, room in (("quiet", quiet), ("kitchen", noisy)):
            tally.other(where, between, room.hear(between.pcm))
            tally.figures[f"stop, {where}"].append(room.hears_stop(clip.pcm))
            tally.figures[f"stop, 0.1 s after other speech, {where}"].append(room.hears_stop(*after))
        sound, at = str(random.choice([name for name in SOUNDS if name != TICK])), float(random.uniform(-0.8, 1.2))
        beside = quiet.hears_stop(clip.pcm, before=1.0, sound=sound, at=at)
        if quiet.hears_stop(clip.pcm, before=1.0):
            tally.figures["stop, beside a sound of ours"].append(beside)
        if number % 5 == 0:
            quiet.hear(*(talk[(number + index) % len(talk)] for index in range(20)))
            tally.figures["stop, after a minute of talk"].append(quiet.hears_stop(clip.pcm, before=2.0))
        tally.figures["stop, four people talking"].append(crowd.hears_stop(clip.pcm))
    for clip in others[len(stops) :]:
        tally.other("quiet", clip, quiet.hear(clip.pcm))
        tally.other("kitchen", clip, noisy.hear(clip.pcm))


def judge_talk(folder: Path, tally: Tally) -> float:
    """Plays recordings one after the other, with short pauses; returns their total length [h]."""
    room, random = Room(CommandRecognizer()), np.random.default_rng(1)
    for path in sorted(path for path in folder.rglob("*") if path.suffix in (".g722", ".flac", ".wav", ".ogg")):
        clip = Clip(path.parent.name, path.stem, load(path))
        tally.other("talk", clip, room.hear(clip.pcm, before=float(random.uniform(0.0, 0.5))))
    return room.seconds / 3600.0


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--half", choices=HALVES, default=HALVES[0])
    parser.add_argument("--talk", action="store_true")
    given = parser.parse_args()
    tally, table = Tally(), Table(given.csv)
    if given.talk:
        table.add(what="hours of talk", share=judge_talk(given.folder, tally))
    else:
        judge_people(given.folder, given.half, tally)
    shares = {figure: share(sum(trials), len(trials)) for figure, trials in tally.figures.items()}
    for what, value in shares.items():
        table.add(half=given.half, what=what, share=value)
    for case in tally.wrong:
        table.add(half=given.half, what="taken for a command", share=1, case=case)


if __name__ == "__main__":
    main()
