#!/usr/bin/env python3
"""How well spoken commands are recognised, in one unbroken stream, by the object that the node runs.

    python3 bench/voice/recognition.py FOLDER --half development     the speakers that choices were made with
    python3 bench/voice/recognition.py FOLDER --half judging         the other speakers
    python3 bench/voice/recognition.py FOLDER --talk                 hours of talk: what is taken for a command

FOLDER has people's recordings of "stop" in stop/, of other words and sentences in other folders, and a kitchen's noise in
kitchen.flac; with --talk, recordings in which nobody says a command, at any depth. Speakers are told by their file's name
and split by its checksum. All of it goes through one CommandListener as a microphone's samples do: in pieces, with a clock,
beside our own sounds, and never reset. The last rows are what was taken for a command that was not meant.
"""

from __future__ import annotations

import re
import sys
import zlib
from collections import Counter, defaultdict
from pathlib import Path
from typing import Dict, Iterable, List, NamedTuple

import av
import numpy as np
import soxr

from bench.frame import Table, arguments, share
from vb_core.sounds import SOUNDS
from vb_feedback.sound.tone_synthesis import RATE as TONE_RATE
from vb_feedback.sound.tone_synthesis import synthesize
from vb_voice_wizard.confirmation import ANSWERS
from vb_voice_wizard.recognizer import PHRASES, CommandRecognizer
from vb_voice_wizard.voice.listener import CommandListener, Heard

RATE = 16000
PIECE = RATE // 20  # a microphone's samples come in such pieces
PEAK = 8000.0  # of a voice's loudest sample
SNR_DB = 10.0  # of the kitchen
HALVES = ("development", "judging")
# what would move a robot, change a map or lose a drawing, if it were done at once
CONSEQUENT = tuple(command for command in PHRASES if command != "stop" and command not in ANSWERS)
AFTER = 1.2  # [s] of quiet after each utterance: more than ends it


class Clip(NamedTuple):
    """One recording: (N,) float64 at 16 kHz."""

    kind: str
    name: str
    speaker: str
    pcm: np.ndarray


def load(path: Path) -> np.ndarray:
    """Reads a recording as (N,) float64 at 16 kHz."""
    resampler = av.AudioResampler(format="s16", layout="mono", rate=RATE)
    with av.open(str(path), format="g722" if path.suffix == ".g722" else None) as file:
        frames = [one for frame in [*file.decode(audio=0), None] for one in resampler.resample(frame)]
    return np.concatenate([frame.to_ndarray()[0] for frame in frames]).astype(float)


def speaker(path: Path) -> str:
    """Names who speaks, by the habits of Speech Commands (a checksum) and the digits (a first name), else the file itself."""
    hashed = re.search(r"([0-9a-f]{8})_nohash", path.name)
    named = re.fullmatch(r"\d_([a-z]+)_\d+", path.stem)
    return hashed.group(1) if hashed else named.group(1) if named else path.name


def read_people(folder: Path, half: str) -> List[Clip]:
    """Reads the recordings of one half of the speakers."""
    number = HALVES.index(half)
    return [
        Clip(path.parent.name, path.stem, speaker(path), load(path))
        for path in sorted(folder.glob("*/*"))
        if zlib.crc32(speaker(path).encode()) % 2 == number
    ]


def trimmed(pcm: np.ndarray) -> np.ndarray:
    """Returns a recording without the silence before and after it."""
    loudness = np.convolve(np.abs(pcm), np.ones(320) / 320, "same")
    loud = np.flatnonzero(loudness > 0.08 * loudness.max())
    return pcm[loud[0] : loud[-1] + 1]


def power(pcm: np.ndarray) -> float:
    """Computes the mean power of where there is speech: of frames that are not 15 dB below the loudest."""
    frames = pcm[: len(pcm) // 320 * 320].reshape(-1, 320)
    powers = np.mean(frames**2, axis=1)
    return float(powers[powers >= 0.03 * powers.max()].mean()) if len(powers) else 1.0


class Room:
    """A place with a background, in which one listener hears one thing after the other."""

    def __init__(self, recognizer: CommandRecognizer, noise: Iterable[np.ndarray] = (), seed: int = 1) -> None:
        self._listener = CommandListener(recognizer)
        self._noise = list(noise)
        self._random = np.random.default_rng(seed)
        self._now = self.seconds = 0.0  # of what was played, without pauses between

    def hear(self, clips: Iterable[np.ndarray], before: float = 0.5, sound: str = "", at: float = 0.0) -> List[Heard]:
        """Streams recordings without a pause between them, then quiet; returns what became of each utterance.

        Args:
            before: [s] of quiet before.
            sound: one of ours that plays too, [s] `at` from the beginning of the recordings, half as loud as they are.
        """
        spoken = np.concatenate([clip * (PEAK / max(1.0, np.abs(clip).max())) for clip in clips])
        self.seconds += len(spoken) / RATE
        pcm = np.concatenate([np.zeros(int(before * RATE)), spoken, np.zeros(int(AFTER * RATE))])
        pcm += self._background(len(pcm), power(spoken))
        plays = {}
        if sound:
            begin = max(0, int((before + at) * RATE))
            tone = soxr.resample(synthesize(sound).astype(float), TONE_RATE, RATE)[: len(pcm) - begin]
            pcm[begin : begin + len(tone)] += tone * (0.5 * PEAK / np.abs(tone).max())
            plays[begin // PIECE] = sound
        found = []
        whole = np.pad(pcm, (0, -len(pcm) % PIECE)).clip(-32768, 32767).astype(np.int16)
        for number, piece in enumerate(whole.reshape(-1, PIECE)):
            if number in plays:
                self._listener.play(plays[number], self._now)
            self._now += PIECE / RATE
            found += self._listener.push(piece, self._now)
        return found

    def _background(self, count: int, loudness: float) -> np.ndarray:
        sound = self._random.normal(size=count) * 12.0  # the microphone's own
        if self._noise:
            others = np.zeros(count)
            for one in self._noise:
                others += np.resize(np.roll(one, -int(self._random.integers(len(one)))), count) / one.std()
            sound += others * np.sqrt(loudness / 10 ** (SNR_DB / 10) / np.mean(others**2))
        return sound


def commands(found: List[Heard]) -> List[str]:
    """Lists the commands that were taken."""
    return [heard.result.command for heard in found if heard.result.command]


class Tally:
    """Counts what became of what was said, figure by figure, and notes what was taken wrongly."""

    def __init__(self) -> None:
        self.figures: Dict[str, List[bool]] = defaultdict(list)
        self.wrong: List[str] = []

    def other(self, where: str, clip: Clip, found: List[Heard]) -> None:
        """Counts something that is no command, and whether it would be done at once or was only asked about."""
        taken = [heard.result for heard in found if heard.result.command]
        self.figures[f"other speech taken, {where}"].append(bool(taken))
        self.figures["other speech done at once, that matters"].append(
            any(one.certain and one.command in CONSEQUENT for one in taken)
        )
        for one in taken:
            self.wrong.append(f"{clip.kind}/{clip.name}, {where}: {one.command}, confidence {one.confidence:.2f}")


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
        for where, room in (("quiet", quiet), ("kitchen", noisy)):
            tally.other(where, between, room.hear([between.pcm]))
            tally.figures[f"stop, {where}"].append("stop" in commands(room.hear([clip.pcm])))
            after = [trimmed(between.pcm), np.zeros(RATE // 10), trimmed(clip.pcm)]
            tally.figures[f"stop, 0.1 s after other speech, {where}"].append("stop" in commands(room.hear(after)))
        sound, at = str(random.choice([name for name in SOUNDS if name != "tick"])), float(random.uniform(-0.8, 1.2))
        beside = "stop" in commands(quiet.hear([clip.pcm], before=1.0, sound=sound, at=at))
        if "stop" in commands(quiet.hear([clip.pcm], before=1.0)):
            tally.figures["stop, beside a sound of ours"].append(beside)
        if number % 5 == 0:
            quiet.hear([talk[(number + index) % len(talk)] for index in range(20)])
            tally.figures["stop, after a minute of talk"].append("stop" in commands(quiet.hear([clip.pcm], before=2.0)))
        tally.figures["stop, four people talking"].append("stop" in commands(crowd.hear([clip.pcm])))
    for clip in others[len(stops) :]:
        tally.other("quiet", clip, quiet.hear([clip.pcm]))
        tally.other("kitchen", clip, noisy.hear([clip.pcm]))


def judge_talk(folder: Path, tally: Tally) -> float:
    """Plays recordings one after the other, with short pauses; returns how long they are [h]."""
    room, random = Room(CommandRecognizer()), np.random.default_rng(1)
    for path in sorted(path for path in folder.rglob("*") if path.suffix in (".g722", ".flac", ".wav", ".ogg")):
        clip = Clip(path.parent.name, path.stem, "", load(path))
        tally.other("talk", clip, room.hear([clip.pcm], before=float(random.uniform(0.0, 0.5))))
    return room.seconds / 3600.0


def main() -> int:
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
    for what, value in {**shares, **Counter(tally.wrong)}.items():
        table.add(half=given.half, what=what, share=value)
    return 0


if __name__ == "__main__":
    sys.exit(main())
