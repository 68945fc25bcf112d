"""How well each continuation of a command explains an utterance, as numbers that say little of voice, room and noise.

The idea: a network that its authors trained on very many hours of people's speech hears better than what one laboratory can
train on synthetic voices. This is Moonshine (tiny, English; MIT licence); scripts/setup takes its files out of the package
moonshine-voice. Its decoder writes text, one token (a word or a part of one) after the other, but it does not know what people
may say here: for *guide robot* it writes "five robot". Therefore it is not asked to write: it is asked how it would go on after
each beginning of a command ("", "Guide", "Guide robot"). How probable it finds "robot" after "Guide" says whether *robot* was
heard, whatever it would have written first.
"""
from __future__ import annotations

import sys
from pathlib import Path
from typing import Dict, Sequence, Tuple

import numpy as np
import onnxruntime

from vb_core.errors import CodedError

FOLDER = Path(sys.prefix) / "share" / "moonshine"
FEATURES = 288  # numbers for each moment, about 41 moments a second
START, END = 1, 2  # tokens: before a text, and behind it
_PEAK = 0.5  # of full scale: loudness is no part of a word
_IMPROBABLE = -12.0  # natural logarithm: what is less probable than this is all the same


class Beginnings:
    """All different beginnings of some texts, the empty one first.

    Args:
        texts: tokens of each.

    Attributes:
        texts: (M, L) int64, START before each text, filled up with END.
        at: rows and columns in `texts` of each beginning's last token.
    """

    def __init__(self, texts: Sequence[Sequence[int]]) -> None:
        self.texts = np.full((len(texts), 1 + max(map(len, texts))), END, np.int64)
        self.texts[:, 0] = START
        places: Dict[Tuple[int, ...], Tuple[int, int]] = {}
        for row, text in enumerate(texts):
            self.texts[row, 1 : 1 + len(text)] = text
            for length in range(len(text) + 1):
                places.setdefault(tuple(text[:length]), (row, length))
        self.at = tuple(np.array(list(places.values())).T)

    @classmethod
    def read(cls, texts: np.ndarray) -> "Beginnings":
        """From the attribute `texts` of others."""
        return cls([tuple(int(token) for token in row[1:] if token != END) for row in texts])


class SpeechModel:
    """Moonshine; one thread, since each camera's detector wants its own core.

    Args:
        folder: with encoder_model.ort and decoder_model_merged.ort.

    Raises:
        CodedError: "no_speech_model" if a file is missing or unusable.
    """

    def __init__(self, folder: Path = FOLDER) -> None:
        self._encoder = _session(folder / "encoder_model.ort")
        self._decoder = _session(folder / "decoder_model_merged.ort")
        # what earlier tokens left behind: nothing, as all are given at once
        self._past = {one.name: (one.shape[1], one.shape[3]) for one in self._decoder.get_inputs() if one.name.startswith("past")}

    def moments(self, pcm: np.ndarray) -> np.ndarray:
        """How each moment of an utterance sounds: (N,) int16 at 16 kHz, a tenth of a second at least, to (T, FEATURES) float32."""
        samples = np.asarray(pcm, dtype=np.float32)[None]
        samples = samples * (_PEAK / max(1.0, float(np.abs(samples).max())))
        return self._encoder.run(None, {"input_values": samples, "attention_mask": np.ones(samples.shape, np.int64)})[0][0]

    def continuations(self, moments: np.ndarray, beginnings: Beginnings) -> np.ndarray:
        """How the decoder would go on after each beginning: logarithms of the probabilities of all tokens.

        Args:
            moments: (T, FEATURES).

        Returns:
            (B, tokens there are) float32, nothing below a limit.
        """
        rows = len(beginnings.texts)
        given = {name: np.zeros((rows, heads, 0, size), np.float32) for name, (heads, size) in self._past.items()}
        given.update(
            input_ids=beginnings.texts, encoder_hidden_states=np.repeat(moments[None], rows, axis=0),
            encoder_attention_mask=np.ones((rows, len(moments)), np.int64), use_cache_branch=np.array([False]),
        )
        found = self._decoder.run(["logits"], given)[0][beginnings.at]
        found = found - found.max(axis=1, keepdims=True)
        return np.maximum(found - np.log(np.exp(found).sum(axis=1, keepdims=True)), _IMPROBABLE)


def _session(path: Path) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime has its own kinds of errors for a missing file and for a bad one
        raise CodedError("no_speech_model", file=path, reason=" ".join(str(error).split())) from error
