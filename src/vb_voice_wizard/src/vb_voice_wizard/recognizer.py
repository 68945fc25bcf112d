"""Recognises the spoken commands, and says no to everything else.

1. endpointing finds where somebody speaks.
2. Every phrase of the grammar is aligned with it (phone_scoring.PhraseScorer); the best one is the candidate.
3. The candidate is compared with what else it could have been: a loop over all phones, the best phone at
   each of its phones, the next best command, its rhythm, speech left over beside it. A logistic function
   of these measures, with weights made by bench/voice_training.py, gives the confidence.
4. What is doubted is looked at once more as if said by a shorter vocal tract, a child's for instance.
"""
from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Dict, List, Optional, Sequence

import numpy as np
import yaml

from vb_core.errors import ParameterError
from vb_core.parameters import Parameters, param

from vb_voice_wizard import wording
from vb_voice_wizard.acoustic_model import SILENCE, AcousticModel, embedded_model
from vb_voice_wizard.endpointing import EndpointParams, Utterance, utterances
from vb_voice_wizard.interaction import RESUME
from vb_voice_wizard.phone_network import PhoneNetwork
from vb_voice_wizard.phone_scoring import Alignment, Likelihoods, PhoneSet, PhraseScorer, phone_loop
from vb_voice_wizard.speech_features import FRAMES_PER_SECOND, cepstra, clean_spectrum, dynamic

MEASURES = (
    "loop",  # command minus phone loop, per frame of the command
    "whole",  # command minus phone loop over the whole utterance, per frame: what is left over counts too
    "posterior",  # log posterior of the command's phones, mean over phones
    "posterior_worst",  # the same, mean of the two worst phones
    "phone",  # command's phone minus the best phone in its place, mean over phones
    "phone_worst",  # the same, mean of the two worst phones
    "quarter_worst",  # command minus phone loop in the worst quarter of its frames
    "runner_up",  # command minus the next best command, per frame
    "edit",  # edit distance from the phone loop's phones to the command's, per phone of the command
    "pace",  # frames per phone / 10
    "unevenness",  # longest phone / mean phone
    "left_over",  # [s] speech, after the network, outside the command
)
_FEWEST_FRAMES = 12


# what lets robots drive again is never done at one spoken word: "resumed" sounds too much like it
ALWAYS_UNCLEAR = (RESUME,)


def is_unclear(command: str, confidence: float, sure: float) -> bool:
    """Whether a command that was understood has to be confirmed before it does what cannot be taken back."""
    return confidence < sure or command in ALWAYS_UNCLEAR


@dataclass(frozen=True)
class RecognizerParams(Parameters):
    """Parameters of the recogniser; config/voice_commands.yaml says why. Empty files are the package's own."""

    grammar: str = param("")
    dictionary: str = param("")
    wake_word: str = param("")
    threshold: float = param(0.5, "", low=0.0, high=1.0)
    sure: float = param(0.995, "", low=0.0, high=1.0)
    decision: str = param("")
    network: str = param("")
    second_look: float = param(0.0025, "", low=0.0, high=1.0)
    second_warp: float = param(1.18, "", low=0.7, high=1.4)
    gaussian_weight: float = param(0.4, "", low=0.0, high=5.0)
    phone_penalty: float = param(-5.0, "", low=-100.0, high=0.0)


@dataclass(frozen=True)
class Finding:
    """What became of one utterance.

    Attributes:
        command: the command that was understood, or None.
        best: the command that fits best, understood or not; empty if none was looked for.
        confidence: 0 .. 1.
        reason: "ok", or why not: "unlike_a_command", "too_long", "too_short", or a node's own.
        heard: the phones that were heard, for people.
        measures: the values of MEASURES; empty if none was looked for.
        unclear: understood, but not surely: what cannot be taken back has to be confirmed.
    """

    command: Optional[str] = None
    best: str = ""
    confidence: float = 0.0
    reason: str = "ok"
    heard: str = ""
    measures: Sequence[float] = ()
    unclear: bool = False

    def refused(self, reason: str) -> "Finding":
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
        self._network = PhoneNetwork(wording.find("network", self.params.network, "phones.npz"))
        if self._network.phones != [*self._phones.names, SILENCE]:
            raise ParameterError("network", "its phones are not those of the speech model")
        self._weights, self._offset = _read_decision(wording.find("decision", self.params.decision, "decision.yaml"))

    def _read_phrases(self, folder: Path) -> List[wording.Phrase]:
        grammar = wording.read_grammar(wording.find("grammar", self.params.grammar, "commands.yaml"))
        dictionaries = [
            wording.find("dictionary", self.params.dictionary, "commands.dict"),
            folder.parent / "cmudict-en-us.dict",
        ]
        return wording.phrases(grammar, self.params.wake_word, dictionaries, self._phones.names)

    # ------------------------------------------------------------------ use
    def recognize(self, pcm: np.ndarray) -> Optional[str]:
        """The first command in a recording.

        Args:
            pcm: (N,) int16, 16 kHz, mono.

        Returns:
            The command's name, or None if there is none.
        """
        for finding in self.examine(pcm):
            if finding.command:
                return finding.command
        return None

    def examine(self, pcm: np.ndarray) -> List[Finding]:
        """What became of each utterance in a recording, (N,) int16, 16 kHz, mono."""
        pcm = np.asarray(pcm)
        if pcm.ndim != 1 or pcm.dtype != np.int16:
            raise ValueError(f"expected (N,) int16 samples, got {pcm.shape} {pcm.dtype}")
        return [self.classify(utterance) for utterance in utterances(pcm, self.endpointing)]

    def classify(self, utterance: Utterance) -> Finding:
        """What became of one utterance."""
        if utterance.too_long:
            return Finding(reason="too_long")
        spectrum = clean_spectrum(utterance.pcm)
        if len(spectrum) < _FEWEST_FRAMES:
            return Finding(reason="too_short")
        finding = self._decide(spectrum)
        if self.params.second_look <= finding.confidence < self.params.threshold:
            # the models were trained on grown-ups; what is clearly no command is not worth the time
            again = self._decide(clean_spectrum(utterance.pcm, self.params.second_warp))
            finding = max(finding, again, key=lambda one: one.confidence)
        return finding

    def _decide(self, spectrum: np.ndarray) -> Finding:
        finding = self._measure(spectrum)
        values = np.asarray(finding.measures)
        confidence = float(1.0 / (1.0 + np.exp(-np.clip(values @ self._weights + self._offset, -50.0, 50.0))))
        if confidence < self.params.threshold:
            return replace(finding, confidence=confidence, reason="unlike_a_command")
        return replace(finding, command=finding.best, confidence=confidence, unclear=is_unclear(finding.best, confidence, self.params.sure))

    # ------------------------------------------------------------------ measures
    def _measure(self, spectrum: np.ndarray) -> Finding:
        posteriors = self._network.log_posteriors(spectrum)
        likelihoods = self._phones.likelihoods(
            dynamic(cepstra(spectrum)), self.params.gaussian_weight, self._network.scaled_likelihoods(posteriors)
        )
        best: Dict[str, Alignment] = {}
        for phrase, alignment in zip(self.phrases, self._scorer.align(likelihoods)):
            if phrase.command not in best or alignment.score > best[phrase.command].score:
                best[phrase.command] = alignment
        ranking = sorted(best, key=lambda command: -best[command].score)
        winner = best[ranking[0]]
        if winner.score < -1e9:
            # fewer frames than the shortest phrase has states
            return Finding(best=ranking[0], measures=(-100.0,) * len(MEASURES))
        margin = winner.score - best[ranking[1]].score if len(ranking) > 1 else 0.0
        loop, heard = phone_loop(self._phones, likelihoods, self.params.phone_penalty)
        measures = _compare(winner, margin, likelihoods, posteriors, loop, heard, self._phones.index)
        names = [name for name, _, _ in heard if name != SILENCE]
        return Finding(best=ranking[0], heard=" ".join(names), measures=tuple(measures))


def _compare(
    winner: Alignment,
    margin: float,
    likelihoods: Likelihoods,
    posteriors: np.ndarray,
    loop: np.ndarray,
    heard: list,
    index: Dict[str, int],
) -> List[float]:
    """The values of MEASURES."""
    start, end = winner.start, winner.end
    count = end - start
    spoken = [phone for phone in winner.phones if phone[0] != SILENCE]
    difference = winner.own - loop
    competitors = likelihoods.phones.max(axis=2).astype(np.float64)
    phone, posterior = [], []
    for name, first, behind in spoken:
        phone.append(winner.own[first:behind].mean() - competitors[first:behind].mean(axis=0).max())
        posterior.append(posteriors[first:behind, index[name]].mean())
    phone, posterior = np.sort(phone), np.sort(posterior)
    lengths = np.array([behind - first for _, first, behind in spoken])
    wanted = [name for name, _, _ in spoken]
    got = [name for name, _, _ in heard if name != SILENCE]
    outside = np.concatenate([posteriors[:start, -1], posteriors[end:, -1]])
    return [
        difference[start:end].mean(),
        (winner.score - loop.sum()) / len(loop),
        posterior.mean(),
        posterior[:2].mean(),
        phone.mean(),
        phone[:2].mean(),
        np.sort(difference[start:end])[: max(1, count // 4)].mean(),
        margin / count,
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


def _read_decision(path: Path) -> "tuple[np.ndarray, float]":
    """Weights in the order of MEASURES, and the offset."""
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        weights = [float(content["weights"][name]) for name in MEASURES]
        offset = float(content["offset"])
    except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError, ValueError) as error:
        raise ParameterError("decision", f"{path}: expected an offset and a weight for each measure: {error!r}") from error
    if len(content["weights"]) != len(MEASURES):
        raise ParameterError("decision", f"{path}: known measures are {', '.join(MEASURES)}")
    return np.array(weights), offset
