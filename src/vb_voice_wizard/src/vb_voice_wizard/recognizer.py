"""Recognises the spoken commands and rejects everything else.

The idea: endpointing finds the speech, a network that knows people's speech says how it would go on after each beginning of a
command (speech_model), and a small network says which command that is, or none. Only the small one is ours:
bench/voice_training.py trains it on many synthetic voices that say the commands, and what sounds nearly like them, in noise.

>>> import numpy as np
>>> recognizer = CommandRecognizer()
>>> silence = np.zeros(16000, np.int16)                             # one second at 16 kHz
>>> recognizer.recognize(silence) is None
True
"""
from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import List, Optional

import numpy as np

from vb_core.errors import ParameterError
from vb_core.parameters import Parameters, param

from vb_voice_wizard.voice.audio_sources import SAMPLE_RATE
from vb_voice_wizard.voice.endpointing import EndpointParams, Utterance, utterances
from vb_voice_wizard.interaction import COMMANDS, RESUME
from vb_voice_wizard.voice.speech_model import Beginnings, SpeechModel

# one spoken word never lets robots drive again
ALWAYS_UNCLEAR = (RESUME,)
_SHORTEST_S = 0.2  # with its padding: less is no word
# Each utterance is heard at these speeds, and what is found is averaged: what noise hides at one of them, another shows.
_SPEEDS = (1.0, 0.94, 1.07)


@dataclass(frozen=True)
class RecognizerParams(Parameters):
    """Parameters of the recogniser; config/voice_commands.yaml says why."""

    threshold: float = param(0.0, "", low=0.0, high=1.0)
    model: str = param("")


@dataclass(frozen=True)
class RecognitionResult:
    """The outcome for one utterance.

    Attributes:
        command: the command that was understood, or None.
        best: the command that fits best, understood or not; empty if none was looked for.
        confidence: 0 .. 1.
        reason: "ok", or why not: "unlike_a_command", "too_long", "too_short", or a node's own.
        unclear: understood, but not surely: what cannot be undone has to be confirmed.
    """

    command: Optional[str] = None
    best: str = ""
    confidence: float = 0.0
    reason: str = "ok"
    unclear: bool = False

    def refused(self, reason: str) -> "RecognitionResult":
        """The same, not accepted after all."""
        return replace(self, command=None, reason=reason)


class CommandNetwork:
    """The small network: from continuations to the probability of each command.

    Args:
        path: an .npz file by bench/voice_training.py, with commands, texts and tokens (what it wants to know of the
            continuations), threshold, sure, and weights0, bias0, weights1 ...

    Raises:
        ParameterError: if it is none.
    """

    def __init__(self, path: Path) -> None:
        try:
            with np.load(str(path), allow_pickle=False) as file:
                self.commands = [str(command) for command in file["commands"]]
                self.beginnings = Beginnings.read(file["texts"])
                self._tokens = file["tokens"].astype(np.int64)
                self.threshold, self.sure = float(file["threshold"]), float(file["sure"])
                count = sum(name.startswith("weights") for name in file.files)
                self._layers = [
                    (file[f"weights{index}"].astype(np.float32), file[f"bias{index}"].astype(np.float32))
                    for index in range(count)
                ]
        except (OSError, KeyError, ValueError) as error:
            raise ParameterError("model", f"{path} is not a network of commands: {error}") from error
        unknown = sorted(set(self.commands) - set(COMMANDS))
        if unknown:
            raise ParameterError("model", f"{path}: unknown commands: {', '.join(unknown)}")

    def probabilities(self, continuations: np.ndarray) -> np.ndarray:
        """(C,) of the commands, for what the speech model says after `beginnings`; what is missing to 1 is that of none."""
        values = np.take_along_axis(continuations, self._tokens, axis=1).reshape(-1)
        for weights, bias in self._layers[:-1]:
            values = np.maximum(values @ weights + bias, 0.0)
        weights, bias = self._layers[-1]
        values = values @ weights + bias
        values = np.exp(values - values.max())
        return values[1:] / values.sum()  # the first one is none


class CommandRecognizer:
    """Recognises commands; calls may come from one thread at a time.

    Args:
        params: see RecognizerParams; None for the defaults.
        endpointing: when speech starts and ends, for whole recordings; None for the defaults.

    Raises:
        ParameterError: for a bad parameter or network.
        CodedError: if a file of the speech model is missing.
    """

    def __init__(
        self, params: Optional[RecognizerParams] = None, endpointing: Optional[EndpointParams] = None
    ) -> None:
        params = params if params is not None else RecognizerParams()
        self.endpointing = endpointing if endpointing is not None else EndpointParams()
        self._network = CommandNetwork(Path(params.model).expanduser() if params.model else _own_network())
        self.threshold = params.threshold or self._network.threshold
        self._model = SpeechModel()

    def recognize(self, pcm: np.ndarray) -> Optional[str]:
        """The first command in a recording.

        Args:
            pcm: (N,) int16, 16 kHz, mono.

        Returns:
            The command's name, or None if there is none.
        """
        return next((result.command for result in self.examine(pcm) if result.command), None)

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
        if len(utterance.pcm) < _SHORTEST_S * SAMPLE_RATE:
            return RecognitionResult(reason="too_short")
        found = np.mean([self._hear(utterance.pcm, speed) for speed in _SPEEDS], axis=0)
        best, confidence = self._network.commands[int(found.argmax())], float(found.max())
        if confidence < self.threshold:
            return RecognitionResult(best=best, confidence=confidence, reason="unlike_a_command")
        unclear = confidence < self._network.sure or best in ALWAYS_UNCLEAR
        return RecognitionResult(best, best, confidence, unclear=unclear)

    def _hear(self, pcm: np.ndarray, speed: float) -> np.ndarray:
        """(C,) probabilities of the commands, for an utterance played at another speed."""
        if speed != 1.0:
            pcm = np.interp(np.arange(0.0, len(pcm) - 1, 1.0 / speed), np.arange(len(pcm)), pcm).astype(np.int16)
        return self._network.probabilities(self._model.continuations(self._model.moments(pcm), self._network.beginnings))


def _own_network() -> Path:
    """The package's network, in the source tree or where the workspace is installed."""
    name = Path("config") / "voice" / "commands.npz"
    source = Path(__file__).resolve().parents[2] / name
    prefixes = filter(None, os.environ.get("CMAKE_PREFIX_PATH", "").split(os.pathsep))
    installed = [Path(prefix) / "share" / "vb_voice_wizard" / name for prefix in prefixes]
    return next((path for path in (source, *installed) if path.is_file()), source)
