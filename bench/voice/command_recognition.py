#!/usr/bin/env python3
"""Measures how well the node's recogniser recognises spoken commands in an unbroken stream.

    python3 bench/voice/command_recognition.py FOLDER --half development     the speakers used for development
    python3 bench/voice/command_recognition.py FOLDER --half judging         the other speakers
    python3 bench/voice/command_recognition.py FOLDER --talk                 hours of talk without any command

FOLDER contains people's recordings of "stop" in stop/, of other words and sentences in other folders, and a kitchen's
noise in kitchen.flac; with --talk, recordings without commands, also in subfolders. Speakers are identified by file
name and split by a checksum. In each room, one CommandListener hears all recordings as it hears a microphone: in
pieces, with a clock, together with the system's sounds, and without a reset. The last rows list the utterances that were
mistaken for a command.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Dict, List

import numpy as np

from bench.harness import HALVES, ResultTable, arguments, share
from bench.voice.room_recordings import RATE, Clip, RecordedRoom, load_sound, read_people, trim_silence
from vb_core.interaction_tables import YES_ANSWERS
from vb_core.sounds import SOUNDS, TICK
from vb_voice_wizard.voice.recognizer import CommandRecognizer, RecognitionResult


class Tally:
    """Counts the outcomes of utterances for each figure, and lists the utterances that were mistaken for commands."""

    def __init__(self) -> None:
        self.figures: Dict[str, List[bool]] = defaultdict(list)
        self.wrong: List[str] = []

    def count_other_speech(self, place: str, clip: Clip, results: List[RecognitionResult]) -> None:
        """Counts an utterance that is not a command, and whether it was accepted as one or carried out as one."""
        mattering = [r for r in results if r.certain and r.command in YES_ANSWERS.values()]
        self.figures[f"other speech taken, {place}"].append(bool(results))
        self.figures["other speech done at once, that matters"].append(bool(mattering))
        for result in results:
            heard_as = f"{result.command}, confidence {result.confidence:.2f}"
            self.wrong.append(f"{clip.kind}/{clip.name}, {place}: {heard_as}")


def judge_people(folder: Path, half: str, tally: Tally) -> None:
    """Plays people's recordings in rooms."""
    clips = read_people(folder, half)
    random = np.random.default_rng(1)
    kitchen = np.array_split(load_sound(folder / "kitchen.flac"), 2)[HALVES.index(half)]
    stops = [clip for clip in clips if clip.kind == "stop"]
    others = [clip for clip in clips if clip.kind != "stop"]
    others = [others[index] for index in random.permutation(len(others))]
    talk = [clip.pcm for clip in others if clip.kind == "sentences"]
    recognizer = CommandRecognizer()
    quiet, noisy, crowd = (RecordedRoom(recognizer, noise) for noise in ([], [kitchen], talk[:4]))
    for number, clip in enumerate(stops):
        other_clip = others[number % len(others)]
        recordings = [trim_silence(other_clip.pcm), np.zeros(RATE // 10), trim_silence(clip.pcm)]
        for place, room in (("quiet", quiet), ("kitchen", noisy)):
            tally.count_other_speech(place, other_clip, room.hear(other_clip.pcm))
            tally.figures[f"stop, {place}"].append(room.hears_stop(clip.pcm))
            tally.figures[f"stop, 0.1 s after other speech, {place}"].append(room.hears_stop(*recordings))
        sound = str(random.choice([name for name in SOUNDS if name != TICK]))
        start = float(random.uniform(-0.8, 1.2))
        heard = quiet.hears_stop(clip.pcm, before=1.0, sound=sound, at=start)
        if quiet.hears_stop(clip.pcm, before=1.0):
            tally.figures["stop, beside a sound of ours"].append(heard)
        if number % 5 == 0:
            quiet.hear(*(talk[(number + index) % len(talk)] for index in range(20)))
            tally.figures["stop, after a minute of talk"].append(quiet.hears_stop(clip.pcm, before=2.0))
        tally.figures["stop, four people talking"].append(crowd.hears_stop(clip.pcm))
    for clip in others[len(stops) :]:
        tally.count_other_speech("quiet", clip, quiet.hear(clip.pcm))
        tally.count_other_speech("kitchen", clip, noisy.hear(clip.pcm))


def judge_talk(folder: Path, tally: Tally) -> float:
    """Plays recordings one after another, with short pauses; returns their total length [h]."""
    room = RecordedRoom(CommandRecognizer())
    random = np.random.default_rng(1)
    for path in sorted(path for path in folder.rglob("*") if path.suffix in (".g722", ".flac", ".wav", ".ogg")):
        clip = Clip(path.parent.name, path.stem, load_sound(path))
        tally.count_other_speech("talk", clip, room.hear(clip.pcm, before=float(random.uniform(0.0, 0.5))))
    return room.seconds / 3600.0


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--half", choices=HALVES, default=HALVES[0])
    parser.add_argument("--talk", action="store_true")
    options = parser.parse_args()
    tally, table = Tally(), ResultTable(options.csv)
    if options.talk:
        table.add(what="hours of talk", share=judge_talk(options.folder, tally))
    else:
        judge_people(options.folder, options.half, tally)
    for figure, trials in tally.figures.items():
        table.add(half=options.half, what=figure, share=share(sum(trials), len(trials)))
    for case in tally.wrong:
        table.add(half=options.half, what="taken for a command", share=1, case=case)


if __name__ == "__main__":
    main()
