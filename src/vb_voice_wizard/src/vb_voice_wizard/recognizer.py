"""Recognises the spoken commands and rejects everything else.

The idea: endpointing finds the speech, and a network that knows people's speech says how much more probable the
utterance makes each command than silence does (speech_model). Even odds against a word that sounds like it are enough
to take a command, but not to be certain of it: what would move a robot, change the map or lose a drawing is then asked
about, and answered with another phrase, "yes, save" (interaction.py). Who talks and then shouts *stop* makes one
utterance of both: the end of what is no command is a *stop*, too, if it is one beyond doubt. Nothing is trained;
bench/voice/recognition.py measures.

Use it to tell which command, if any, a piece of speech is; `voice.endpointing` cuts a microphone's stream into pieces.

>>> import numpy as np
>>> recognizer = CommandRecognizer()
>>> silence = Utterance(np.zeros(16000, np.int16), start=0.0, end=1.0)
>>> recognizer.classify(silence).reason
'unlike_a_command'
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Optional

import numpy as np

from vb_core.errors import ParameterError
from vb_core.parameters import Parameters, param
from vb_core.vocabulary import COMMANDS, STOP, spoken_form

from vb_voice_wizard.voice.audio_sources import SAMPLE_RATE
from vb_voice_wizard.voice.endpointing import PADDING, Utterance
from vb_voice_wizard.confirmation import ANSWERS
from vb_voice_wizard.voice.speech_model import SpeechModel

# what people say for each command, and for the answer to the question whether it was meant
PHRASES = {name: [spoken_form(name), *command.phrases] for name, command in COMMANDS.items()}
PHRASES.update({answer: ["yes, " + spoken_form(command)] for answer, command in ANSWERS.items()})
# Evidence with which an utterance is as probably a command as a word that sounds like one: with it as many commands are
# missed as near misses are taken in the development group (docs/results/voice/README.md).
EVEN_LOG_ODDS = -3.7
# Odds from which a command is beyond doubt: one and a half times those of the most deceptive of the development
# speakers' other words, one in a kitchen for *pause* (docs/results/voice/README.md).
CERTAIN_ODDS = 20.0
THRESHOLD = 0.5  # confidence from which a command is taken: even odds
# [s] of speech at an utterance's end that may be a "stop", as short and as long as people say it
_ENDINGS = (0.4, 0.6, 0.8)
_MIN_LENGTH = 0.2  # [s] with its padding: less is no word
# Each utterance is heard at these speeds, and what is found is averaged: what noise hides at one of them, another
# shows.
_SPEEDS = (1.0, 0.94, 1.07)


@dataclass(frozen=True)
class RecognizerParams(Parameters):
    """Parameters of the recogniser; config/voice_commands.yaml says why."""

    phrases: dict = param({})

    def __post_init__(self) -> None:
        super().__post_init__()
        for command, texts in self.phrases.items():
            if command not in PHRASES:
                raise ParameterError(f"phrases/{command}", f"unknown command; known are {', '.join(PHRASES)}")
            if (
                not isinstance(texts, list)
                or not texts
                or not all(isinstance(text, str) and text.strip() for text in texts)
            ):
                raise ParameterError(f"phrases/{command}", f"expected a list of phrases, got {texts!r}")


@dataclass(frozen=True)
class RecognitionResult:
    """The outcome for one utterance.

    Attributes:
        command: the command that was understood, or None.
        best: the command that fits best, understood or not; empty if none was looked for.
        confidence: 0 .. 1.
        certain: whether it is a command beyond doubt.
        reason: "ok", or why not: "unlike_a_command", "too_long", "too_short", or a node's own.
    """

    command: Optional[str] = None
    best: str = ""
    confidence: float = 0.0
    certain: bool = False
    reason: str = "ok"

    def refused(self, reason: str) -> "RecognitionResult":
        """Returns the same result, but not accepted."""
        return replace(self, command=None, certain=False, reason=reason)


class CommandRecognizer:
    """Recognises commands; calls may come from one thread at a time.

    Args:
        params: see RecognizerParams; None for the defaults.

    Raises:
        ParameterError: for a bad parameter.
        CodedError: if a file of the speech model is missing.
    """

    def __init__(self, params: Optional[RecognizerParams] = None) -> None:
        phrases = {**PHRASES, **(params or RecognizerParams()).phrases}
        said = [(command, text) for command, texts in phrases.items() for text in texts]
        self._meanings = np.array([command for command, _ in said])
        self._model = SpeechModel([text.lower() for _, text in said])

    def classify(self, utterance: Utterance) -> RecognitionResult:
        """Classifies one utterance: as a whole, and if that is no command, by its end."""
        if len(utterance.pcm) < _MIN_LENGTH * SAMPLE_RATE:
            return RecognitionResult(reason="too_short")
        result = RecognitionResult(reason="too_long") if utterance.too_long else self._judge(utterance.pcm)
        if result.command is None:
            endings = [utterance.pcm[-int((seconds + PADDING) * SAMPLE_RATE) :] for seconds in _ENDINGS]
            stops = [self._judge(pcm, self._meanings == STOP) for pcm in endings]
            result = next((stop for stop in stops if stop.certain), result)
        return result

    def _judge(self, pcm: np.ndarray, which: Optional[np.ndarray] = None) -> RecognitionResult:
        """Classifies sound as one of the phrases, or of some of them."""
        evidence = np.array([self._model.log_likelihood_ratios(_played(pcm, speed), which) for speed in _SPEEDS])
        odds = np.mean(np.exp(evidence - EVEN_LOG_ODDS), axis=0)
        number = int(odds.argmax())
        meanings = self._meanings if which is None else self._meanings[which]
        best, confidence = str(meanings[number]), float(odds[number] / (1.0 + odds[number]))
        if confidence < THRESHOLD:
            return RecognitionResult(best=best, confidence=confidence, reason="unlike_a_command")
        return RecognitionResult(best, best, confidence, bool(odds[number] >= CERTAIN_ODDS))


def _played(pcm: np.ndarray, speed: float) -> np.ndarray:
    """Returns an utterance played at another speed."""
    return np.interp(np.arange(0.0, len(pcm) - 1, speed), np.arange(len(pcm)), pcm).astype(np.int16)
