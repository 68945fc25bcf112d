"""Scores texts with a speech network: how much more probable is a text after an utterance than after silence?

A network trained on a great deal of human speech recognises more than one that a laboratory can train on synthetic
voices. This network is Moonshine (tiny, English, MIT licence), whose files scripts/setup takes from the package
moonshine-voice. It transcribes speech token by token (a token is a word or a part of one), but does not know which
phrases are commands: it transcribes *guide robot* as "guide robots". Therefore not its transcript is used, but its
probability for each phrase. Because some phrases are rare in any speech, a part of a phrase's score for silence is
subtracted. Nothing is trained here, and any English phrase can be a command.
"""

from __future__ import annotations

import io
import sys
from pathlib import Path
from typing import Dict, List, Sequence

import numpy as np
import onnxruntime
from scipy.special import log_softmax, logsumexp

from vb_core.errors import CodedError

MODEL_FOLDER = Path(sys.prefix) / "share" / "moonshine"
_START = 1  # the token before a text
# tokens that may follow a whole text: the end and four punctuation marks
_END_TOKENS = np.array([2, 29889, 29892, 29991, 29973])
_PEAK = 0.5  # utterances are normalised to this share of full scale, because loudness is not part of a word
# Share of a text's score for silence that is subtracted. If all of it were, noise would be recognised as rare texts.
# Chosen with the development group, where 0.1 to 0.3 do equally well.
_RARITY = 0.2


class SpeechModel:
    """Runs Moonshine, in only one thread, because the cameras' detectors need the other processor cores.

    Args:
        texts: the texts to recognise, in lower case.
        folder: contains encoder_model.ort, decoder_model_merged.ort and tokenizer.bin.

    Raises:
        CodedError: "no_speech_model" if a file is missing or unusable.
    """

    def __init__(self, texts: Sequence[str], folder: Path = MODEL_FOLDER) -> None:
        self._encoder = _load_network(folder / "encoder_model.ort")
        self._decoder = _load_network(folder / "decoder_model_merged.ort")
        # the cache of earlier tokens stays empty, as all tokens are given at once
        self._past = {}
        for tensor in self._decoder.get_inputs():
            if tensor.name.startswith("past"):
                self._past[tensor.name] = (tensor.shape[1], tensor.shape[3])
        tokens = _read_tokens(folder / "tokenizer.bin")
        rows = [_tokenise(text, tokens) for text in texts]
        self._lengths = np.array([len(row) for row in rows])
        # the start, then each text's tokens, then ends up to the length of the longest text
        self._tokens = np.full((len(rows), 1 + self._lengths.max()), _END_TOKENS[0], np.int64)
        self._tokens[:, 0] = _START
        for number, row in enumerate(rows):
            self._tokens[number, 1 : 1 + len(row)] = row
        silence = np.zeros(16000, np.int16)
        self._rarity = _RARITY * self._log_probabilities(silence, np.arange(len(rows)))

    def log_likelihood_ratios(self, pcm: np.ndarray, indices: np.ndarray) -> np.ndarray:
        """Returns the log likelihood ratios (M,) of some of the texts, given an utterance.

        Args:
            pcm: (N,) int16 at 16 kHz, at least a tenth of a second.
            indices: (M,) int, positions of these texts among all of them.
        """
        return self._log_probabilities(pcm, indices) - self._rarity[indices]

    def _log_probabilities(self, pcm: np.ndarray, indices: np.ndarray) -> np.ndarray:
        """Returns for each of some texts the log probability (M,) that it is exactly the network's transcript."""
        samples = np.asarray(pcm, dtype=np.float32)[None]
        samples = samples * (_PEAK / max(1.0, float(np.abs(samples).max())))
        audio = {"input_values": samples, "attention_mask": np.ones(samples.shape, np.int64)}
        count = len(indices)
        states = np.repeat(self._encoder.run(None, audio)[0], count, axis=0)
        tokens, lengths = self._tokens[indices], self._lengths[indices]
        feed = {name: np.zeros((count, heads, 0, size), np.float32) for name, (heads, size) in self._past.items()}
        feed.update(
            input_ids=tokens,
            encoder_hidden_states=states,
            encoder_attention_mask=np.ones(states.shape[:2], np.int64),
            use_cache_branch=np.array([False]),
        )
        # (M, L, number of tokens) log probabilities of the token after each token
        log_p = log_softmax(self._decoder.run(["logits"], feed)[0].astype(np.float64), axis=2)
        token_scores = np.take_along_axis(log_p[:, :-1], tokens[:, 1:, None], axis=2)[..., 0]
        is_after_text = np.arange(token_scores.shape[1]) >= lengths[:, None]
        token_scores[is_after_text] = 0.0
        end_scores = log_p[np.arange(count)[:, None], lengths[:, None], _END_TOKENS]
        return token_scores.sum(axis=1) + logsumexp(end_scores, axis=1)


def _tokenise(text: str, tokens: Dict[bytes, int]) -> List[int]:
    """Capitalises a text and splits it into Moonshine's tokens, by merging pairs in the order of its token list."""
    numbers = []
    for word in (text[:1].upper() + text[1:]).split():
        pieces = [letter.encode() for letter in "\u2581" + word]
        while True:
            ranks = [tokens.get(left + right, len(tokens)) for left, right in zip(pieces, pieces[1:])]
            if not ranks or min(ranks) == len(tokens):
                break
            index = int(np.argmin(ranks))
            pieces[index : index + 2] = [pieces[index] + pieces[index + 1]]
        numbers += [tokens[piece] for piece in pieces]
    return numbers


def _read_tokens(path: Path) -> Dict[bytes, int]:
    """Reads the numbers of Moonshine's tokens. In the file, each token follows its length, which has one or two bytes."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise CodedError("no_speech_model", file=path, reason=error.strerror) from error
    tokens: Dict[bytes, int] = {}
    number = 0
    stream = io.BytesIO(data)
    while head := stream.read(1):
        length = head[0]
        if length >= 128:
            length += 128 * (stream.read(1)[0] - 1)
        # a single letter occurs twice, the first time as a raw byte, which no text contains
        tokens[stream.read(length)] = number
        number += 1
    return tokens


def _load_network(path: Path) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime raises its own errors for a missing and an unusable file
        raise CodedError("no_speech_model", file=path, reason=" ".join(str(error).split())) from error
