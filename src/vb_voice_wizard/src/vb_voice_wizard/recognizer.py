"""Recognises the spoken commands and rejects everything else.

1. endpointing finds the speech.
2. Every phrase of the grammar is aligned with it (phone_scoring.PhraseScorer); the best one is the candidate.
3. The candidate is compared with what else it could have been: the words of the dictionary that sound most like it
   (rivals) and the other commands, a loop over all phones, its rhythm, speech left over beside it. A logistic function of these measures, with weights made by bench/voice_training.py, gives the confidence.
4. What is doubtful is examined again as if said by a shorter vocal tract, a child's for instance.

>>> import numpy as np
>>> recognizer = CommandRecognizer()
>>> silence = np.zeros(16000, np.int16)                             # one second at 16 kHz
>>> recognizer.recognize(silence) is None
True
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Dict, List, Optional, Sequence

import numpy as np
import yaml

from vb_core.errors import ParameterError
from vb_core.parameters import Parameters, param

from vb_voice_wizard import command_grammar
from vb_voice_wizard.acoustic_model import SILENCE, AcousticModel, embedded_model
from vb_voice_wizard.endpointing import EndpointParams, Utterance, utterances
from vb_voice_wizard.interaction import RESUME
from vb_voice_wizard.phone_network import PhoneNetwork
from vb_voice_wizard.phone_scoring import Alignment, PhoneSet, PhraseScorer, phone_loop
from vb_voice_wizard.rivals import Lexicon
from vb_voice_wizard.speech_features import FRAMES_PER_SECOND, cepstra, clean_spectrum, dynamic

MEASURES = (
    "whole",  # command minus phone loop over the whole utterance, per frame: leftover speech counts too
    "posterior",  # log posterior of the command's phones, mean over phones
    "posterior_worst",  # the same, mean of the two worst phones
    "rival",  # command minus what it is most easily mistaken for (rivals): what differs counts, however long the rest
    "edit",  # edit distance from the phone loop's phones to the command's, per phone of the command
    "pace",  # frames per phone / 10
    "unevenness",  # longest phone / mean phone
    "left_over",  # [s] speech, after the network, outside the command
)
_FEWEST_FRAMES = 12
_RIVALS = 24  # of each phrase: what comes after them in the dictionary is hardly ever the best one


# one spoken word never lets robots drive again: "resumed" sounds too much like it
ALWAYS_UNCLEAR = (RESUME,)


@dataclass(frozen=True)
class Decision:
    """What is accepted, and what is accepted without asking; made by bench/voice_training.py.

    Attributes:
        weights: of MEASURES.
        offset: added to their weighted sum; the logistic function of that is the confidence.
        sure: confidence that no near miss of the calibration reached.
    """

    weights: np.ndarray
    offset: float
    sure: float

    def confidence(self, measures: Sequence[float]) -> float:
        """0 .. 1."""
        return float(1.0 / (1.0 + np.exp(-np.clip(np.asarray(measures) @ self.weights + self.offset, -50.0, 50.0))))

    @classmethod
    def read(cls, path: Path) -> "Decision":
        """A decision from a YAML file.

        Raises:
            ParameterError: if it is none.
        """
        try:
            content = yaml.safe_load(path.read_text(encoding="utf-8"))
            weights = np.array([float(content["weights"][name]) for name in MEASURES])
            decision = cls(weights, float(content["offset"]), float(content["sure"]))
        except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError, ValueError) as error:
            what = f"{path}: expected offset, sure, and a weight for each measure: {error!r}"
            raise ParameterError("decision", what) from error
        if len(content["weights"]) != len(MEASURES):
            raise ParameterError("decision", f"{path}: known measures are {', '.join(MEASURES)}")
        return decision


@dataclass(frozen=True)
class RecognizerParams(Parameters):
    """Parameters of the recogniser; config/voice_commands.yaml says why. Empty files are the package's own."""

    grammar: str = param("")
    dictionary: str = param("")
    wake_word: str = param("")
    threshold: float = param(0.3, "", low=0.0, high=1.0)
    decision: str = param("")
    network: str = param("")
    rescore_threshold: float = param(0.0025, "", low=0.0, high=1.0)
    rescore_warp: float = param(1.18, "", low=0.7, high=1.4)
    gaussian_weight: float = param(0.4, "", low=0.0, high=5.0)
    phone_penalty: float = param(-5.0, "", low=-100.0, high=0.0)


@dataclass(frozen=True)
class RecognitionResult:
    """The outcome for one utterance.

    Attributes:
        command: the command that was understood, or None.
        best: the command that fits best, understood or not; empty if none was looked for.
        confidence: 0 .. 1.
        reason: "ok", or why not: "unlike_a_command", "too_long", "too_short", or a node's own.
        heard: the recognised phones, for people.
        measures: the values of MEASURES; empty if none was looked for.
        unclear: understood, but not surely: what cannot be undone has to be confirmed.
    """

    command: Optional[str] = None
    best: str = ""
    confidence: float = 0.0
    reason: str = "ok"
    heard: str = ""
    measures: Sequence[float] = ()
    unclear: bool = False

    def refused(self, reason: str) -> "RecognitionResult":
        """The same, not accepted after all."""
        return replace(self, command=None, reason=reason)


class CommandRecognizer:
    """Recognises commands; calls may come from one thread at a time.

    Args:
        params: see RecognizerParams; None for the defaults.
        endpointing: when speech starts and ends, for whole recordings; None for the defaults.

    Raises:
        ParameterError: for a bad parameter, grammar or dictionary; a word without a pronunciation is named.
        CodedError: if the speech model or the network cannot be read.
    """

    def __init__(
        self, params: Optional[RecognizerParams] = None, endpointing: Optional[EndpointParams] = None
    ) -> None:
        self.params = params if params is not None else RecognizerParams()
        self.endpointing = endpointing if endpointing is not None else EndpointParams()
        folder = embedded_model()
        self._phones = PhoneSet(AcousticModel(folder))
        self.phrases = self._read_phrases(folder)
        self._scorer = PhraseScorer(self._phones, [phrase.words for phrase in self.phrases])
        self._rivals = self._find_rivals(folder.parent)
        self._network = PhoneNetwork(command_grammar.find("network", self.params.network, "phones.npz"))
        if self._network.phones != [*self._phones.names, SILENCE]:
            raise ParameterError("network", "its phones are not those of the speech model")
        self._decision = Decision.read(command_grammar.find("decision", self.params.decision, "decision.yaml"))

    def _read_phrases(self, folder: Path) -> List[command_grammar.Phrase]:
        grammar = command_grammar.read_grammar(command_grammar.find("grammar", self.params.grammar, "commands.yaml"))
        dictionaries = [
            command_grammar.find("dictionary", self.params.dictionary, "commands.dict"),
            folder.parent / "cmudict-en-us.dict",
        ]
        return command_grammar.phrases(grammar, self.params.wake_word, dictionaries, self._phones.names)

    def _find_rivals(self, folder: Path) -> List[PhraseScorer]:
        lexicon = Lexicon(folder / "cmudict-en-us.dict", folder / "en-us.lm.bin")
        own = {sum(phrase.words, ()) for phrase in self.phrases}
        scorers = []
        for phrase in self.phrases:
            rivals = [rival.sounds for rival in lexicon.rivals(phrase.text.split(), phrase.words, own, _RIVALS)]
            others = [other.words for other in self.phrases if other.command != phrase.command]
            scorers.append(PhraseScorer(self._phones, rivals + others))
        return scorers

    # ------------------------------------------------------------------ use
    def recognize(self, pcm: np.ndarray) -> Optional[str]:
        """The first command in a recording.

        Args:
            pcm: (N,) int16, 16 kHz, mono.

        Returns:
            The command's name, or None if there is none.
        """
        for issue in self.examine(pcm):
            if issue.command:
                return issue.command
        return None

    def examine(self, pcm: np.ndarray) -> List[RecognitionResult]:
        """What became of each utterance in a recording, (N,) int16, 16 kHz, mono."""
        pcm = np.asarray(pcm)
        if pcm.ndim != 1 or pcm.dtype != np.int16:
            raise ValueError(f"expected (N,) int16 samples, got {pcm.shape} {pcm.dtype}")
        return [self.classify(utterance) for utterance in utterances(pcm, self.endpointing)]

    def classify(self, utterance: Utterance) -> RecognitionResult:
        """What became of one utterance."""
        if utterance.too_long:
            return RecognitionResult(reason="too_long")
        spectrum = clean_spectrum(utterance.pcm)
        if len(spectrum) < _FEWEST_FRAMES:
            return RecognitionResult(reason="too_short")
        issue = self._decide(spectrum)
        if self.params.rescore_threshold <= issue.confidence < self.params.threshold:
            # the models were trained on adults; what is clearly not a command is not worth the time
            again = self._decide(clean_spectrum(utterance.pcm, self.params.rescore_warp))
            # what was doubtful at first may be understood, but is never sure
            issue = max(issue, replace(again, unclear=True), key=lambda one: one.confidence)
        return issue

    def _decide(self, spectrum: np.ndarray) -> RecognitionResult:
        issue = self._measure(spectrum)
        confidence = self._decision.confidence(issue.measures)
        if confidence < self.params.threshold:
            return replace(issue, confidence=confidence, reason="unlike_a_command")
        unclear = confidence < self._decision.sure or issue.best in ALWAYS_UNCLEAR
        return replace(issue, command=issue.best, confidence=confidence, unclear=unclear)

    # ------------------------------------------------------------------ measures
    def _measure(self, spectrum: np.ndarray) -> RecognitionResult:
        posteriors = self._network.log_posteriors(spectrum)
        likelihoods = self._phones.likelihoods(
            dynamic(cepstra(spectrum)), self.params.gaussian_weight, self._network.scaled_likelihoods(posteriors)
        )
        alignments = self._scorer.align(likelihoods)
        row = int(alignments.scores.argmax())
        command = self.phrases[row].command
        if alignments.scores[row] < -1e9:
            # fewer frames than the shortest phrase has states
            return RecognitionResult(best=command, measures=(-100.0,) * len(MEASURES))
        winner = alignments.trace(row)
        margin = winner.score - float(self._rivals[row].align(likelihoods).scores.max())
        loop, heard = phone_loop(self._phones, likelihoods, self.params.phone_penalty)
        measures = _compare(winner, margin, posteriors, loop, heard, self._phones.index)
        names = [name for name, _, _ in heard if name != SILENCE]
        return RecognitionResult(best=command, heard=" ".join(names), measures=tuple(measures))


def _compare(
    winner: Alignment,
    margin: float,
    posteriors: np.ndarray,
    loop: np.ndarray,
    heard: list,
    index: Dict[str, int],
) -> List[float]:
    """The values of MEASURES."""
    start, end = winner.start, winner.end
    count = end - start
    spoken = [phone for phone in winner.phones if phone[0] != SILENCE]
    posterior = np.sort([posteriors[first:behind, index[name]].mean() for name, first, behind in spoken])
    lengths = np.array([behind - first for _, first, behind in spoken])
    wanted = [name for name, _, _ in spoken]
    got = [name for name, _, _ in heard if name != SILENCE]
    outside = np.concatenate([posteriors[:start, -1], posteriors[end:, -1]])
    return [
        (winner.score - loop.sum()) / len(loop),
        posterior.mean(),
        posterior[:2].mean(),
        margin,
        _edit_distance(got, wanted) / len(wanted),
        count / len(wanted) / 10.0,
        lengths.max() / lengths.mean(),
        float((1.0 - np.exp(outside)).sum()) / FRAMES_PER_SECOND,
    ]


def _edit_distance(first: Sequence[str], second: Sequence[str]) -> int:
    row = list(range(len(second) + 1))
    for item in first:
        above, row = row, [row[0] + 1]
        for column, other in enumerate(second):
            row.append(min(above[column] + (item != other), above[column + 1] + 1, row[column] + 1))
    return row[-1]
