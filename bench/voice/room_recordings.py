"""Reads people's recordings, and plays them in simulated rooms; for command_recognition.py."""

from __future__ import annotations

import re
import zlib
from pathlib import Path
from typing import Any, Iterable, List, NamedTuple

import av
import numpy as np
import soxr

from bench.harness import HALVES
from vb_feedback.sound.sound_output import SAMPLE_RATE as TONE_RATE, synthesize
from vb_core.interaction_tables import STOP
from vb_voice_wizard.voice.recognizer import CommandListener, CommandRecognizer, RecognitionResult

RATE = 16000
PIECE = RATE // 20  # samples that a microphone delivers at a time
PEAK = 8000.0  # of a voice's loudest sample
SNR_DB = 10.0  # of the kitchen
AFTER = 1.2  # [s] of silence after each utterance, more than ends it


class Clip(NamedTuple):
    """One recording: (N,) float64 at 16 kHz."""

    kind: str
    name: str
    pcm: np.ndarray


def load_sound(path: Path) -> np.ndarray:
    """Reads a recording as (N,) float64 at 16 kHz."""
    resampler = av.AudioResampler(format="s16", layout="mono", rate=RATE)
    with av.open(str(path), format="g722" if path.suffix == ".g722" else None) as file:
        frames = [resampled for frame in [*file.decode(audio=0), None] for resampled in resampler.resample(frame)]
    return np.concatenate([frame.to_ndarray()[0] for frame in frames]).astype(float)


def speaker(path: Path) -> str:
    """Returns the speaker by file name: Speech Commands' checksum, the digits' first name, otherwise the whole name."""
    match = re.search(r"([0-9a-f]{8})_nohash", path.name) or re.fullmatch(r"\d_([a-z]+)_\d+", path.stem)
    return match.group(1) if match else path.name


def read_people(folder: Path, half: str) -> List[Clip]:
    """Reads the recordings of one half of the speakers."""
    return [
        Clip(path.parent.name, path.stem, load_sound(path))
        for path in sorted(folder.glob("*/*"))
        if zlib.crc32(speaker(path).encode()) % 2 == HALVES.index(half)
    ]


def trim_silence(pcm: np.ndarray) -> np.ndarray:
    """Returns a recording without the silence before and after it."""
    loudness = np.convolve(np.abs(pcm), np.ones(320) / 320, "same")
    loud = np.flatnonzero(loudness > 0.08 * loudness.max())
    return pcm[loud[0] : loud[-1] + 1]


def power(pcm: np.ndarray) -> float:
    """Computes the mean power of the speech, from frames at most 15 dB below the loudest."""
    frames = pcm[: len(pcm) // 320 * 320].reshape(-1, 320)
    powers = np.mean(frames**2, axis=1)
    return float(powers[powers >= 0.03 * powers.max()].mean()) if len(powers) else 1.0


class RecordedRoom:
    """A room with background noise, in which one listener processes one recording after another."""

    def __init__(self, recognizer: CommandRecognizer, noise: Iterable[np.ndarray] = ()) -> None:
        self._listener = CommandListener(recognizer)
        self._noise = list(noise)
        self._random = np.random.default_rng(1)
        self._now = self.seconds = 0.0  # [s] the clock, and the total length of the recordings without pauses

    def hear(
        self, *clips: np.ndarray, before: float = 0.5, sound: str = "", at: float = 0.0
    ) -> List[RecognitionResult]:
        """Streams recordings without pauses between them, then silence; returns the accepted commands.

        Args:
            before: [s] of silence before.
            sound: one of the system's sounds, which starts `at` [s] after the recordings, half as loud as they are.
        """
        spoken = np.concatenate([clip * (PEAK / max(1.0, np.abs(clip).max())) for clip in clips])
        self.seconds += len(spoken) / RATE
        pcm = np.concatenate([np.zeros(int(before * RATE)), spoken, np.zeros(int(AFTER * RATE))])
        pcm += self._background(len(pcm), power(spoken))
        sound_index = max(0, int((before + at) * RATE))
        if sound:
            tone = soxr.resample(synthesize(sound).astype(float), TONE_RATE, RATE)[: len(pcm) - sound_index]
            pcm[sound_index : sound_index + len(tone)] += tone * (0.5 * PEAK / np.abs(tone).max())
        results = []
        samples = np.pad(pcm, (0, -len(pcm) % PIECE)).clip(-32768, 32767).astype(np.int16)
        for number, piece in enumerate(samples.reshape(-1, PIECE)):
            if sound and number == sound_index // PIECE:
                self._listener.play(sound, self._now)
            self._now += PIECE / RATE
            results += [heard for heard in self._listener.push(piece, self._now) if heard.command]
        return results

    def hears_stop(self, *clips: np.ndarray, **more: Any) -> bool:
        """Returns whether a *stop* was heard in the recordings."""
        return any(result.command == STOP for result in self.hear(*clips, **more))

    def _background(self, count: int, loudness: float) -> np.ndarray:
        sound = self._random.normal(size=count) * 12.0  # the microphone's noise
        if self._noise:
            others = np.zeros(count)
            for clip in self._noise:
                others += np.resize(np.roll(clip, -int(self._random.integers(len(clip)))), count) / clip.std()
            sound += others * np.sqrt(loudness / 10 ** (SNR_DB / 10) / np.mean(others**2))
        return sound
