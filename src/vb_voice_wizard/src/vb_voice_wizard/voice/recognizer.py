"""Recognises the spoken commands and rejects everything else.

`endpointing` finds the speech. A network trained on human speech then scores each command: how much more probable is it
after this utterance than after silence (`speech_model`)? Several variants of the sound are scored, and the result is
compared with the scores that other speech reaches. Two words are hardly ever recognised by mistake, but one syllable is.
Even odds are enough to accept a command, but not to be certain of it. If an uncertain command would move a robot, change
the map or lose a drawing, people must confirm it with another phrase, "yes, save" (interaction.py). If somebody talks
and then shouts *stop*, that is one utterance. Therefore the end of an utterance that is not a command counts as a *stop*
if it is one beyond doubt. Nothing is trained here; bench/voice/command_recognition.py measures the results.

Use this module to find out which command, if any, a piece of speech is. `endpointing` cuts a stream into such pieces.

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

# what people say to give each command, and to confirm it
PHRASES = {name: [words_of_name(name), *command.phrases] for name, command in COMMANDS.items()}
PHRASES.update({answer: ["yes, " + words_of_name(command)] for answer, command in YES_ANSWERS.items()})
# Evidence (log likelihood ratio) at which the odds are even. In the development group, about as many commands of one
# word are then missed as are accepted by mistake; no other speech comes near those of two words (docs/results/voice).
_EVEN_ONE_WORD = -3.5
_EVEN_TWO_WORDS = -6.0
# Lowest odds of a command that is beyond doubt: nearly three times the highest odds that other speech of the development
# group reached for a command with consequences.
CERTAIN_ODDS = 10.0
THRESHOLD = 0.5  # lowest confidence of an accepted command: even odds
_ENDINGS = (0.4, 0.6, 0.8)  # [s] lengths of an utterance's end that may be a "stop", from the shortest to the longest
_STOP_AT_END = -0.7  # lowest evidence of a "stop" at the end; high, because an hour of talk has many ends
_STOP_WHOLE = -3.7  # lowest evidence of a "stop" alone; low, because a false stop does less harm than a missed one
_MIN_LENGTH = 0.2  # [s] shortest length of a word with its padding


class _Variant(NamedTuple):
    """A change of an utterance: its speed, and the silence [s] added before and after it. Below 0, sound is removed."""

    speed: float = 1.0
    before: float = 0.0
    after: float = 0.0


# Averaged over these variants: if noise or a breath hides a word in one of them, the network recognises it in another.
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
_CLOSEST = 4  # number of phrases that are scored in every variant, those with the highest score in the first
_MUTE_MARGIN = 0.3  # [s] by which the sound card's delay and echoes may prolong a sound


@dataclass(frozen=True)
class RecognitionResult:
    """The outcome for one utterance.

    Attributes:
        command: the accepted command, or None.
        best: the command that fits best, whether accepted or not, or "" if no command was scored.
        confidence: 0 .. 1.
        certain: whether the utterance is a command beyond doubt.
        reason: "ok", or why it is not accepted: "unlike_a_command", "too_long", "too_short", "muted" or "busy".
        start, end: [s] times at which the speech began and ended, on the clock of `CommandListener.push`.
    """

    command: Optional[str] = None
    best: str = ""
    confidence: float = 0.0
    certain: bool = False
    reason: str = "ok"
    start: float = 0.0
    end: float = 0.0

    def refuse(self, reason: str) -> "RecognitionResult":
        """Returns the same result, but with the command refused for a reason."""
        return replace(self, command=None, certain=False, reason=reason)


class CommandRecognizer:
    """Recognises commands. For one thread at a time. Raises CodedError if a file of the speech model is missing."""

    def __init__(self) -> None:
        phrases = [(command, text) for command, texts in PHRASES.items() for text in texts]
        self._commands = np.array([command for command, _ in phrases])  # each phrase's
        self._even_evidence = np.array([_EVEN_TWO_WORDS if " " in text else _EVEN_ONE_WORD for _, text in phrases])
        self._model = SpeechModel([text.lower() for _, text in phrases])

    def classify(self, utterance: Utterance) -> RecognitionResult:
        """Classifies one utterance. If it is not a command, it or its end is still accepted as a probable "stop"."""
        pcm = utterance.pcm
        if len(pcm) < _MIN_LENGTH * SAMPLE_RATE:
            return RecognitionResult(reason="too_short")
        result = RecognitionResult(reason="too_long")
        pieces = []
        if not utterance.too_long:
            result = self._classify_phrase(pcm)
            pieces = [(pcm, _STOP_WHOLE)]
        if result.command is not None:
            return result
        stops = np.flatnonzero(self._commands == STOP)
        pieces += [(pcm[-int((length + PADDING) * SAMPLE_RATE) :], _STOP_AT_END) for length in _ENDINGS]
        for piece, needed in pieces:
            _, evidence = self._find_best_phrase(piece, stops, _STOP_VARIANTS)
            if evidence >= needed:
                confidence = float(1.0 / (1.0 + np.exp(needed - evidence)))
                return RecognitionResult(STOP, STOP, confidence, certain=True)
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
        """Finds the best of some phrases. Returns its number and its evidence, averaged over the variants."""
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
    # no sound is removed from a word that would then be too short
    if last - first >= _MIN_LENGTH * SAMPLE_RATE:
        played = played[first:last]
    return np.pad(played, (max(0, before), max(0, after)))


class CommandListener:
    """Recognises the commands in one unbroken stream of a microphone's samples.

    `push` and `play` may be called from different threads. The stream has no gaps and is never reset, so that people can
    speak even while the system plays a sound. An utterance that was spoken entirely within such a sound is ignored,
    however late it is processed, because it may be the sound. A *stop* always counts, because no sound resembles it.
    """

    def __init__(self, recognizer: CommandRecognizer) -> None:
        self._recognizer = recognizer
        self._endpointer = Endpointer()
        # start and end [s] of the newest sounds, more than can be played while audio waits to be processed
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
            result = result.refuse("muted")
        return result
