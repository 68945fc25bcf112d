"""Recognises the spoken commands and rejects everything else.

Endpointing finds the speech, and a network trained on people's speech tells how much more probable the utterance makes
each command than silence does (speech_model). Several variants of the sound are scored, and the evidence is weighed
against what else sounds like this command. Two words are hardly ever heard by mistake, but one syllable is. Even odds
are enough to accept a command, but not to be certain of it. An uncertain command that would move a robot, change the map or
lose a drawing is asked about, and confirmed with another phrase, "yes, save" (interaction.py). Talk and then a shouted
*stop* are one utterance, so the end of an utterance that is not a command counts as a *stop* if it is one beyond doubt.
Nothing is trained here; bench/voice/command_recognition.py measures the results.

Use it to tell which command, if any, a piece of speech is; `voice.endpointing` cuts a microphone's stream into pieces.

>>> import numpy as np
>>> recognizer = CommandRecognizer()
>>> silence = Utterance(np.zeros(16000, np.int16), start=0.0, end=1.0)
>>> recognizer.classify(silence).reason
'unlike_a_command'
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import Deque, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from vb_core.interaction_tables import COMMANDS, STOP, YES_ANSWERS
from vb_core.sentences import words_of_name
from vb_core.sounds import SOUNDS, TICK
from vb_voice_wizard.voice.microphone import SAMPLE_RATE
from vb_voice_wizard.voice.endpointing import PADDING, Endpointer, Utterance
from vb_voice_wizard.voice.speech_model import SpeechModel

# what people say for each command, and to confirm it when asked
PHRASES = {name: [words_of_name(name), *command.phrases] for name, command in COMMANDS.items()}
PHRASES.update({answer: ["yes, " + words_of_name(command)] for answer, command in YES_ANSWERS.items()})
# Evidence at which an utterance is as probably a command as something that sounds like it. In the development group,
# about as many single words are then missed as wrongly accepted; nothing comes near two words (docs/results/voice).
_EVEN_ONE_WORD = -3.5
_EVEN_TWO_WORDS = -6.0
# Odds from which a command is beyond doubt: nearly three times the highest that another utterance of the development
# group reached for a command with consequences.
CERTAIN_ODDS = 10.0
THRESHOLD = 0.5  # confidence from which a command is accepted: even odds
_ENDINGS = (0.4, 0.6, 0.8)  # [s] at an utterance's end that may be a "stop", as short and as long as people say it
_STOP_AT_END = -0.7  # evidence from which it is one: there are many ends in an hour of talk
_STOP_WHOLE = -3.7  # evidence from which a whole utterance is one, low as a false stop does less harm than a missed one
_MIN_LENGTH = 0.2  # [s] with its padding: anything shorter is not a word


class _Variant(NamedTuple):
    """How an utterance is changed: its speed, and the silence [s] added before and after. Below 0, sound is removed."""

    speed: float = 1.0
    before: float = 0.0
    after: float = 0.0


# Their evidence is averaged: what noise or a breath before the word hides from the network in one, another shows.
_VARIANTS = (
    _Variant(),
    _Variant(speed=0.94),
    _Variant(speed=1.07),
    _Variant(before=-0.2),
    _Variant(before=-0.2, after=-0.15),
    _Variant(before=0.3),
    _Variant(after=0.3),
)
_STOP_VARIANTS = _VARIANTS[:3]
_CLOSEST = 4  # phrases that are scored in every variant
_MUTE_MARGIN = 0.3  # [s] how much later a sound may end, through the sound card's delay and echoes


@dataclass(frozen=True)
class RecognitionResult:
    """The outcome for one utterance.

    Attributes:
        command: the command that was understood, or None.
        best: the command that fits best, understood or not, or "" if none was sought.
        confidence: 0 .. 1.
        certain: whether the utterance is a command beyond doubt.
        reason: "ok", or why it is no command: "unlike_a_command", "too_long", "too_short", or a node's own reason.
        start, end: [s] when the speech began and ended, on the clock of `CommandListener.push`.
    """

    command: Optional[str] = None
    best: str = ""
    confidence: float = 0.0
    certain: bool = False
    reason: str = "ok"
    start: float = 0.0
    end: float = 0.0

    def refused(self, reason: str) -> "RecognitionResult":
        """Returns the same result, but refused for a reason."""
        return replace(self, command=None, certain=False, reason=reason)


class CommandRecognizer:
    """Recognises commands. For one thread at a time.

    Raises:
        CodedError: if a file of the speech model is missing.
    """

    def __init__(self) -> None:
        phrases = [(command, text) for command, texts in PHRASES.items() for text in texts]
        self._commands = np.array([command for command, _ in phrases])  # each phrase's
        self._even_evidence = np.array([_EVEN_TWO_WORDS if " " in text else _EVEN_ONE_WORD for _, text in phrases])
        self._model = SpeechModel([text.lower() for _, text in phrases])

    def classify(self, utterance: Utterance) -> RecognitionResult:
        """Classifies one utterance. If it is not a command as a whole, it or its end may still be a "stop"."""
        if len(utterance.pcm) < _MIN_LENGTH * SAMPLE_RATE:
            return RecognitionResult(reason="too_short")
        result = RecognitionResult(reason="too_long") if utterance.too_long else self._classify_phrase(utterance.pcm)
        if result.command is None:
            stops = np.flatnonzero(self._commands == STOP)
            pieces = [] if utterance.too_long else [(utterance.pcm, _STOP_WHOLE)]
            pieces += [(utterance.pcm[-int((end + PADDING) * SAMPLE_RATE) :], _STOP_AT_END) for end in _ENDINGS]
            for pcm, needed in pieces:
                _, evidence = self._find_best_phrase(pcm, stops, _STOP_VARIANTS)
                if evidence >= needed:
                    return RecognitionResult(STOP, STOP, float(1.0 / (1.0 + np.exp(needed - evidence))), True)
        return result

    def _classify_phrase(self, pcm: np.ndarray) -> RecognitionResult:
        phrase, evidence = self._find_best_phrase(pcm, np.arange(len(self._commands)), _VARIANTS)
        best = str(self._commands[phrase])
        odds = float(np.exp(evidence - self._even_evidence[phrase]))
        confidence = odds / (1.0 + odds)
        if confidence < THRESHOLD:
            return RecognitionResult(best=best, confidence=confidence, reason="unlike_a_command")
        return RecognitionResult(best, best, confidence, odds >= CERTAIN_ODDS)

    def _find_best_phrase(
        self, pcm: np.ndarray, phrases: np.ndarray, variants: Sequence[_Variant]
    ) -> Tuple[int, float]:
        """Returns the number of the best of some phrases, and its log likelihood ratio, averaged over the variants."""
        first = self._model.log_likelihood_ratios(_make_variant(pcm, variants[0]), phrases)
        closest = np.argsort(-first)[:_CLOSEST]
        ratios = [first[closest]]
        for variant in variants[1:]:
            ratios.append(self._model.log_likelihood_ratios(_make_variant(pcm, variant), phrases[closest]))
        evidence = np.log(np.mean(np.exp(ratios), axis=0))
        best = int(evidence.argmax())
        return int(phrases[closest[best]]), float(evidence[best])


def _make_variant(pcm: np.ndarray, variant: _Variant) -> np.ndarray:
    times = np.arange(0.0, len(pcm) - 1, variant.speed)
    played = np.interp(times, np.arange(len(pcm)), pcm).astype(np.int16)
    before = int(variant.before * SAMPLE_RATE)
    after = int(variant.after * SAMPLE_RATE)
    first = max(0, -before)
    last = len(played) + min(0, after)
    # a word that is nearly too short loses no sound
    if last - first >= _MIN_LENGTH * SAMPLE_RATE:
        played = played[first:last]
    return np.pad(played, (max(0, before), max(0, after)))


class CommandListener:
    """Recognises the commands in one unbroken stream of a microphone's samples.

    `push` and `play` may be called from different threads. The stream has no gaps and is never reset, so that people can
    speak even while the system plays a sound. An utterance that lies entirely within such a sound is ignored, because it
    may be the sound. The time that counts is when it was spoken, however late it is processed. None of the sounds
    resembles *stop*, so a *stop* always counts.

    Args:
        recognizer: classifies the utterances.
    """

    def __init__(self, recognizer: CommandRecognizer) -> None:
        self._recognizer = recognizer
        self._endpointer = Endpointer()
        # start and end [s]; more sounds than can play while audio waits to be processed
        self._played: Deque[Tuple[float, float]] = deque(maxlen=100)

    def play(self, sound: str, start: float) -> None:
        """Records that one of the system's sounds begins at time `start` [s]. An unknown sound is ignored."""
        if sound in SOUNDS and sound != TICK:  # too short for an utterance
            self._played.append((start, start + SOUNDS[sound].seconds + _MUTE_MARGIN))

    def push(self, pcm: np.ndarray, now: float) -> List[RecognitionResult]:
        """Adds the stream's next samples, (N,) int16 at 16 kHz, and returns the results for utterances ending in them.

        Args:
            now: [s] when the last of these samples arrived.
        """
        utterances = self._endpointer.push(pcm)
        stream_start = now - self._endpointer.stream_length
        return [self._classify(utterance, stream_start) for utterance in utterances]

    def _classify(self, utterance: Utterance, stream_start: float) -> RecognitionResult:
        start = stream_start + utterance.start
        end = stream_start + utterance.end
        result = replace(self._recognizer.classify(utterance), start=start, end=end)
        is_muted = any(first <= start and end <= last for first, last in list(self._played))
        if is_muted and result.command != STOP:
            result = result.refused("muted")
        return result
