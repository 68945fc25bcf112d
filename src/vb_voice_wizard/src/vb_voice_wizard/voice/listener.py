"""From a microphone's samples to commands: one stream, from the first sample to the last.

The node and the bench drive the same object in the same way, so that what is measured is what runs. Nothing is left out
of the stream and nothing is reset: people are heard even while one of the system's own sounds plays. An utterance is
judged by when it was heard, however late it is processed: one that lies entirely within an own sound may be that sound.
No own sound resembles *stop*, so a *stop* always counts.
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

_MUTE_MARGIN = 0.3  # [s] how much later a sound may end: delay of the sound card, and echoes


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
        recognizer: how commands are recognised.
    """

    def __init__(self, recognizer: CommandRecognizer) -> None:
        self._recognizer = recognizer
        self._endpointer = Endpointer()
        # more sounds than can play during the audio that may wait to be processed
        self._played: Deque[Tuple[float, float]] = deque(maxlen=100)

    def play(self, sound: str, when: float) -> None:
        """Records that one of the system's sounds begins at a time [s]; an unknown one is ignored."""
        if sound in SOUNDS and sound != TICK:  # too short for an utterance
            self._played.append((when, when + SOUNDS[sound].seconds + _MUTE_MARGIN))

    def push(self, pcm: np.ndarray, when: float) -> List[Heard]:
        """Adds the stream's next samples, (N,) int16 at 16 kHz; returns the results for utterances that ended in them.

        Args:
            when: [s] when the last of these samples arrived.
        """
        utterances = self._endpointer.push(pcm)
        began = when - self._endpointer.length
        return [self._judge(utterance, began) for utterance in utterances]

    def _judge(self, utterance: Utterance, began: float) -> Heard:
        result = self._recognizer.classify(utterance)
        start, end = began + utterance.start, began + utterance.end
        if result.command != STOP and any(begin <= start and end <= over for begin, over in list(self._played)):
            result = result.refused("muted")
        return Heard(result, start, end)
