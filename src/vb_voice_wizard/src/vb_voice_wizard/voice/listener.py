"""Recognises the commands in one unbroken stream of a microphone's samples.

The node and the bench use the same object in the same way, so that the bench measures what runs. The stream has no gaps
and is never reset, so that people can speak even while the system plays a sound. An utterance that lies entirely within
such a sound is ignored, because it may be the sound; the time that counts is when it was spoken, however late it is
processed. None of the sounds resembles *stop*, so a *stop* always counts.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Deque, List, Tuple

import numpy as np

from vb_core.sounds import SOUNDS, TICK
from vb_core.vocabulary import STOP

from vb_voice_wizard.recognizer import CommandRecognizer, RecognitionResult
from vb_voice_wizard.voice.endpointing import Endpointer, Utterance

_MUTE_MARGIN = 0.3  # [s] how much later a sound may end, through the sound card's delay and echoes


@dataclass(frozen=True)
class Heard:
    """The result and the time of one utterance.

    Attributes:
        start, end: [s] when the speech began and ended, on the clock of `CommandListener.push`.
    """

    result: RecognitionResult
    start: float
    end: float


class CommandListener:
    """Recognises the commands in a stream of sound. `push` and `play` may be called from different threads.

    Args:
        recognizer: classifies the utterances.
    """

    def __init__(self, recognizer: CommandRecognizer) -> None:
        self._recognizer = recognizer
        self._endpointer = Endpointer()
        # more sounds than can play while audio waits to be processed
        self._played: Deque[Tuple[float, float]] = deque(maxlen=100)

    def play(self, sound: str, when: float) -> None:
        """Records that one of the system's sounds begins at time `when` [s]; an unknown sound is ignored."""
        if sound in SOUNDS and sound != TICK:  # too short for an utterance
            self._played.append((when, when + SOUNDS[sound].seconds + _MUTE_MARGIN))

    def push(self, pcm: np.ndarray, when: float) -> List[Heard]:
        """Adds the stream's next samples, (N,) int16 at 16 kHz, and returns the results for utterances ending in them.

        Args:
            when: [s] when the last of these samples arrived.
        """
        utterances = self._endpointer.push(pcm)
        stream_start = when - self._endpointer.length
        return [self._classify(utterance, stream_start) for utterance in utterances]

    def _classify(self, utterance: Utterance, stream_start: float) -> Heard:
        result = self._recognizer.classify(utterance)
        start, end = stream_start + utterance.start, stream_start + utterance.end
        if result.command != STOP and any(first <= start and end <= last for first, last in list(self._played)):
            result = result.refused("muted")
        return Heard(result, start, end)
