"""Recognises the spoken commands and rejects everything else.

Endpointing finds the speech, and a network trained on people's speech tells how much more probable the utterance makes
each command than silence does (speech_model). Several variants of the sound are scored, and the evidence is weighed
against what else sounds like this command: two words are hardly ever heard by mistake, one syllable is. Even odds are
enough to accept a command, but not to be certain of it: one that would move a robot, change the map or lose a drawing
is then asked about, and confirmed with another phrase, "yes, save" (interaction.py). Talk and then a shouted *stop*
are one utterance: so the end of an utterance that is not a command counts as a *stop* if it is one beyond doubt.
Nothing is trained here; bench/voice/command_recognition.py measures the results.

`voice.endpointing` cuts a microphone's stream into the utterances that are classified here.

>>> import numpy as np
>>> recognizer = CommandRecognizer()
>>> silence = Utterance(np.zeros(16000, np.int16), start=0.0, end=1.0)
>>> recognizer.classify(silence).reason
'unlike_a_command'
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Optional, Sequence, Tuple

import numpy as np

from vb_core.sentences import spelled_out
from vb_core.vocabulary import ANSWERS, COMMANDS, STOP

from vb_voice_wizard.voice.audio_sources import SAMPLE_RATE
from vb_voice_wizard.voice.endpointing import PADDING, Utterance
from vb_voice_wizard.voice.speech_model import SpeechModel

# the phrases for each command, and for its confirmation
PHRASES = {name: [spelled_out(name), *command.phrases] for name, command in COMMANDS.items()}
PHRASES.update({answer: ["yes, " + spelled_out(command)] for answer, command in ANSWERS.items()})
# Evidence at which an utterance is as likely the command as something that sounds like it. In the development group,
# single words are then missed about as often as wrongly accepted; nothing resembles two words (docs/results/voice).
_EVEN, _EVEN_TWO_WORDS = -3.5, -6.0
# Odds from which a command is certain: nearly three times the highest odds for a command that matters that any other
# utterance of the development group reached.
CERTAIN_ODDS = 10.0
THRESHOLD = 0.5  # confidence from which a command is accepted: even odds
# [s] of speech at an utterance's end that are tried as a "stop", from the shortest to the longest that people say
_STOP_LENGTHS = (0.4, 0.6, 0.8)
_STOP_AT_END = -0.7  # evidence from which the end is a "stop"; high, as an hour of talk has many ends
_STOP_EVEN = -3.7  # the same for a whole utterance; low, as a missed stop does more harm than a false one
_MIN_LENGTH = 0.2  # [s] with its padding; anything shorter is not a word
# Variants of each utterance: speed, then silence [s] added before and after it (sound is removed if negative). Their
# evidence is averaged, because noise, a breath before the word or chance may hide the word in one of them.
_VARIANTS = (
    (1.0, 0.0, 0.0),
    (0.94, 0.0, 0.0),
    (1.07, 0.0, 0.0),
    (1.0, -0.2, 0.0),
    (1.0, -0.2, -0.15),
    (1.0, 0.3, 0.0),
    (1.0, 0.0, 0.3),
)
_CLOSEST = 4  # phrases that are scored in every variant


@dataclass(frozen=True)
class RecognitionResult:
    """The result for one utterance.

    Attributes:
        command: the accepted command, or None.
        best: the command that fits best, accepted or not; empty if the utterance was not scored.
        confidence: 0 .. 1.
        certain: whether the command is beyond doubt.
        reason: "ok", or why it was rejected: "unlike_a_command", "too_long", "too_short", or a caller's reason.
    """

    command: Optional[str] = None
    best: str = ""
    confidence: float = 0.0
    certain: bool = False
    reason: str = "ok"

    def refused(self, reason: str) -> "RecognitionResult":
        """Returns the same result, but with its command rejected for a reason."""
        return replace(self, command=None, certain=False, reason=reason)


class CommandRecognizer:
    """Recognises commands; calls may come from one thread at a time.

    Raises:
        CodedError: if a file of the speech model is missing.
    """

    def __init__(self) -> None:
        phrases = [(command, text) for command, texts in PHRASES.items() for text in texts]
        self._meanings = np.array([command for command, _ in phrases])
        self._even = np.array([_EVEN_TWO_WORDS if " " in text else _EVEN for _, text in phrases])
        self._model = SpeechModel([text.lower() for _, text in phrases])

    def classify(self, utterance: Utterance) -> RecognitionResult:
        """Classifies one utterance; if as a whole it is no command, checks whether it or its end may be a "stop"."""
        if len(utterance.pcm) < _MIN_LENGTH * SAMPLE_RATE:
            return RecognitionResult(reason="too_short")
        result = RecognitionResult(reason="too_long") if utterance.too_long else self._classify(utterance.pcm)
        if result.command is None:
            stops = np.flatnonzero(self._meanings == STOP)
            pieces = [] if utterance.too_long else [(utterance.pcm, _STOP_EVEN)]
            pieces += [(utterance.pcm[-int((end + PADDING) * SAMPLE_RATE) :], _STOP_AT_END) for end in _STOP_LENGTHS]
            for pcm, threshold in pieces:
                _, evidence = self._find_best(pcm, stops, _VARIANTS[:3])
                if evidence >= threshold:
                    return RecognitionResult(STOP, STOP, float(1.0 / (1.0 + np.exp(threshold - evidence))), True)
        return result

    def _classify(self, pcm: np.ndarray) -> RecognitionResult:
        """Classifies sound as one of the phrases."""
        index, evidence = self._find_best(pcm, np.arange(len(self._meanings)), _VARIANTS)
        odds, best = float(np.exp(evidence - self._even[index])), str(self._meanings[index])
        confidence = odds / (1.0 + odds)
        if confidence < THRESHOLD:
            return RecognitionResult(best=best, confidence=confidence, reason="unlike_a_command")
        return RecognitionResult(best, best, confidence, odds >= CERTAIN_ODDS)

    def _find_best(
        self, pcm: np.ndarray, phrases: np.ndarray, variants: Sequence[Tuple[float, float, float]]
    ) -> Tuple[int, float]:
        """Returns the index of the best of some phrases, and its evidence: the logarithm of its mean odds."""
        ratios = self._model.log_likelihood_ratios(_make_variant(pcm, *variants[0]), phrases)
        closest = np.argsort(-ratios)[:_CLOSEST]
        scores = [ratios[closest]]
        scores += [
            self._model.log_likelihood_ratios(_make_variant(pcm, *variant), phrases[closest])
            for variant in variants[1:]
        ]
        evidence = np.log(np.mean(np.exp(scores), axis=0))
        best = int(evidence.argmax())
        return int(phrases[closest[best]]), float(evidence[best])


def _make_variant(pcm: np.ndarray, speed: float, before: float, after: float) -> np.ndarray:
    """Returns an utterance at another speed, with silence [s] added before and after it (sound removed if negative)."""
    samples = np.interp(np.arange(0.0, len(pcm) - 1, speed), np.arange(len(pcm)), pcm).astype(np.int16)
    head, tail = int(before * SAMPLE_RATE), int(after * SAMPLE_RATE)
    if len(samples) + min(0, head) + min(0, tail) >= _MIN_LENGTH * SAMPLE_RATE:
        samples = samples[max(0, -head) : len(samples) + min(0, tail)]
    return np.pad(samples, (max(0, head), max(0, tail)))
