"""Scores how much more probable an utterance makes a text than silence does: a likelihood ratio from a speech network.

A network trained on a great deal of human speech recognises more than one that a laboratory can train on synthetic
voices. This is Moonshine (tiny, English; MIT licence); scripts/setup takes its files from the package moonshine-voice.
It writes text, token by token (a word or a part of one), but does not know what people may say here: for *guide robot*
it writes "guide robots". Therefore it is not asked to write, but how probable it finds exactly this text. As some texts
are rare in any speech, a part of each text's score for silence is subtracted. Nothing is trained here, and any English
phrase can be a command.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Dict, List, Sequence

import numpy as np
import onnxruntime
from scipy.special import log_softmax, logsumexp

from vb_core.errors import CodedError

FOLDER = Path(sys.prefix) / "share" / "moonshine"
_START = 1  # the token before a text
_ENDS = np.array([2, 29889, 29892, 29991, 29973])  # what may follow a whole text: the end, or . , ! ?
_PEAK = 0.5  # of full scale: loudness is not part of a word
# Share of a text's own rarity that is taken off. All of it would let rare texts win in noise. Chosen with the
# development group, where 0.1 to 0.3 do equally well.
_RARITY = 0.2


class SpeechModel:
    """Moonshine; one thread, since each camera's detector needs its own core.

    Args:
        texts: the texts to recognise, in lower case.
        folder: with encoder_model.ort, decoder_model_merged.ort and tokenizer.bin.

    Raises:
        CodedError: "no_speech_model" if a file is missing or unusable.
    """

    def __init__(self, texts: Sequence[str], folder: Path = FOLDER) -> None:
        self._encoder = _session(folder / "encoder_model.ort")
        self._decoder = _session(folder / "decoder_model_merged.ort")
        # the cache of earlier tokens: empty, as all are given at once
        self._past = {
            one.name: (one.shape[1], one.shape[3]) for one in self._decoder.get_inputs() if one.name.startswith("past")
        }
        tokens = _read_tokens(folder / "tokenizer.bin")
        rows = [_tokenise(text, tokens) for text in texts]
        self._length = np.array([len(row) for row in rows])
        self._given = np.array(
            [[_START, *row] + [_ENDS[0]] * (max(map(len, rows)) - len(row)) for row in rows], np.int64
        )
        self._rarity = _RARITY * self._log_probabilities(np.zeros(16000, np.int16), np.arange(len(rows)))

    def log_likelihood_ratios(self, pcm: np.ndarray, which: np.ndarray) -> np.ndarray:
        """Returns for some of the texts the logarithm (M,) of how much more probable an utterance makes each.

        Args:
            pcm: (N,) int16 at 16 kHz, a tenth of a second at least.
            which: (M,) int, the texts' numbers.
        """
        return self._log_probabilities(pcm, which) - self._rarity[which]

    def _log_probabilities(self, pcm: np.ndarray, which: np.ndarray) -> np.ndarray:
        """Returns the log probability (M,) that the network writes exactly this text, for some of the texts."""
        samples = np.asarray(pcm, dtype=np.float32)[None]
        samples = samples * (_PEAK / max(1.0, float(np.abs(samples).max())))
        heard = {"input_values": samples, "attention_mask": np.ones(samples.shape, np.int64)}
        states = np.repeat(self._encoder.run(None, heard)[0], len(which), axis=0)
        tokens, length = self._given[which], self._length[which]
        given = {name: np.zeros((len(which), heads, 0, size), np.float32) for name, (heads, size) in self._past.items()}
        given.update(
            input_ids=tokens,
            encoder_hidden_states=states,
            encoder_attention_mask=np.ones(states.shape[:2], np.int64),
            use_cache_branch=np.array([False]),
        )
        # the log probabilities of what follows each token: (M, L, number of tokens)
        found = log_softmax(self._decoder.run(["logits"], given)[0].astype(np.float64), axis=2)
        steps = np.take_along_axis(found[:, :-1], tokens[:, 1:, None], axis=2)[..., 0]
        steps[np.arange(steps.shape[1]) >= length[:, None]] = 0.0
        ends = found[np.arange(len(which))[:, None], length[:, None], _ENDS]
        return steps.sum(axis=1) + logsumexp(ends, axis=1)


def _tokenise(text: str, tokens: Dict[bytes, int]) -> List[int]:
    """Splits a text, with a capital first, into Moonshine's tokens, by joining pairs in the order of its list."""
    found = []
    for word in (text[:1].upper() + text[1:]).split():
        pieces = [letter.encode() for letter in "\u2581" + word]
        while True:
            joined = [tokens.get(first + second, len(tokens)) for first, second in zip(pieces, pieces[1:])]
            if not joined or min(joined) == len(tokens):
                break
            at = int(np.argmin(joined))
            pieces[at : at + 2] = [pieces[at] + pieces[at + 1]]
        found += [tokens[piece] for piece in pieces]
    return found


def _read_tokens(path: Path) -> Dict[bytes, int]:
    """Reads the number of each of Moonshine's tokens; in the file each follows its length, two bytes if it is long."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise CodedError("no_speech_model", file=path, reason=error.strerror) from error
    at, found, number = 0, {}, 0
    while at < len(data):
        length, at = data[at], at + 1
        if length >= 128:
            length, at = length - 128 + 128 * data[at], at + 1
        # a single letter occurs twice: first as a mere byte, which is never written
        found[data[at : at + length]] = number
        at, number = at + length, number + 1
    return found


def _session(path: Path) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime has its own kinds of errors for a missing file and for a bad one
        raise CodedError("no_speech_model", file=path, reason=" ".join(str(error).split())) from error
