"""Reads and evaluates PocketSphinx's phonetically tied acoustic model in numpy.

The library scores each frame relative to the best of the states that its search happens to visit, so
the scores of two searches cannot be compared. Here every wanted state is scored on one scale.
"""
from __future__ import annotations

import struct
from pathlib import Path
from typing import Dict, List, Tuple

import numpy as np

from vb_core.errors import CodedError

STATES = 3
SILENCE = "SIL"
_LOG_BASE = np.log(1.0001)
_WEIGHT_STEP = 1024 * _LOG_BASE
_VARIANCE_FLOOR = 1e-4
_POSITIONS = {"i": 0, "b": 1, "e": 2, "s": 3}


def embedded_model() -> Path:
    """The folder of the US English model inside the PocketSphinx package.

    Raises:
        CodedError: "no_speech_model" if the package is not installed.
    """
    try:
        import pocketsphinx
    except ImportError as error:
        raise CodedError("no_speech_model", "the Python package pocketsphinx is missing: run scripts/setup") from error
    return Path(pocketsphinx.get_model_path("en-us/en-us"))


class AcousticModel:
    """Phones, their context-dependent states (senones), and the states' likelihoods.

    Args:
        folder: of the model; it has mdef, means, variances, sendump and transition_matrices.

    Raises:
        CodedError: "bad_speech_model" if a file is missing or not in the expected form.
    """

    def __init__(self, folder: Path) -> None:
        try:
            self._read_definition((folder / "mdef").read_bytes())
            means = _read_gaussians((folder / "means").read_bytes())
            variances = np.maximum(_read_gaussians((folder / "variances").read_bytes()), _VARIANCE_FLOOR)
            self._weights = self._read_weights((folder / "sendump").read_bytes(), means.shape)
            self.transitions = _read_transitions((folder / "transition_matrices").read_bytes())
        except (OSError, ValueError, struct.error, IndexError) as error:
            raise CodedError("bad_speech_model", f"{folder} is no phonetically tied model: {error}") from error
        if means.shape != variances.shape or means.shape[0] != len(self.phones):
            raise CodedError("bad_speech_model", f"{folder}: means, variances and phones do not fit together")
        # log N(x) = x^2 . a + x . b + c, with a, b (codebooks, streams, densities, 13)
        self._square = (-0.5 / variances).astype(np.float32)
        self._linear = (means / variances).astype(np.float32)
        self._constant = (-0.5 * (means**2 / variances + np.log(2 * np.pi * variances)).sum(axis=-1)).astype(np.float32)

    # ------------------------------------------------------------------ reading
    def _read_definition(self, data: bytes) -> None:
        if data[:4] != b"BMDF":
            raise ValueError("mdef is not a binary model definition")
        _version, skip = struct.unpack_from("<ii", data, 4)
        at = 12 + skip
        counts = struct.unpack_from("<10i", data, at)
        at += 40
        phones, everything, states, ci_senones, senones, _tmats, _sequences, _contexts, tree, _silence = counts
        if states != STATES:
            raise ValueError(f"{states} states per phone instead of {STATES}")
        names: List[str] = []
        start = at
        for _ in range(phones):
            end = data.index(b"\0", at)
            names.append(data[at:end].decode())
            at = end + 1
        at = start + (at - start + 3) // 4 * 4
        at += 8 * tree
        table = np.frombuffer(data, dtype=[("ssid", "<i4"), ("tmat", "<i4"), ("info", "u1", 4)], count=everything, offset=at)
        at += 12 * everything
        (length,) = struct.unpack_from("<i", data, at)
        sequences = np.frombuffer(data, "<u2", count=length, offset=at + 4).reshape(-1, STATES)
        self.phones = names
        self.number: Dict[str, int] = {name: index for index, name in enumerate(names)}
        self._ci = sequences[table["ssid"][:phones]].astype(np.int64)
        self._tmat = table["tmat"][:phones].astype(np.int64)
        contextual = table[phones:]
        self._triphones: Dict[Tuple[int, int, int, int], int] = {
            (int(info[0]), int(info[1]), int(info[2]), int(info[3])): int(ssid)
            for ssid, info in zip(contextual["ssid"], contextual["info"])
        }
        self._sequences = sequences.astype(np.int64)
        self.senones = senones
        # which codebook, that is which phone, a senone's mixture is over
        self.codebook = np.zeros(senones, dtype=np.int64)
        base = np.concatenate([np.arange(phones), contextual["info"][:, 1].astype(np.int64)])
        self.codebook[sequences[table["ssid"]]] = base[:, None]
        # a senone's place in its phone: 0, 1 or 2
        self.place = np.zeros(senones, dtype=np.int64)
        for place in range(STATES):
            self.place[sequences[table["ssid"], place]] = place
        if ci_senones != phones * STATES:
            raise ValueError("states without context are missing")

    def _read_weights(self, data: bytes, shape: tuple) -> np.ndarray:
        """Mixture weights (streams, densities, senones) float32, linear."""
        at, order = 0, "<"
        if struct.unpack_from("<i", data, 0)[0] > 1 << 16:
            order = ">"
        while True:
            (length,) = struct.unpack_from(order + "i", data, at)
            at += 4 + length
            if length == 0:
                break
        rows, columns = struct.unpack_from(order + "ii", data, at) if len(data) - at > _size(shape, self.senones) else (0, 0)
        if (rows, columns) == (shape[2], self.senones):
            at += 8
        elif len(data) - at != _size(shape, self.senones):
            raise ValueError("sendump has an unknown form")
        steps = np.frombuffer(data, "u1", count=_size(shape, self.senones), offset=at)
        return np.exp(-_WEIGHT_STEP * steps.astype(np.float32)).reshape(shape[1], shape[2], self.senones)

    # ------------------------------------------------------------------ structure
    def phone_states(self, phone: str) -> np.ndarray:
        """The three senones of a phone without context."""
        return self._ci[self.number[phone]]

    def triphone_states(self, phone: str, left: str, right: str, position: str) -> np.ndarray:
        """The three senones of a phone between two others; position in its word "b", "i", "e" or "s"ingle.

        A context that the model never saw is replaced by the same one elsewhere in a word, then by none.
        """
        numbers = self.number[phone], self.number[left], self.number[right]
        for place in (position, "i", "b", "e", "s"):
            found = self._triphones.get((_POSITIONS[place], *numbers))
            if found is not None:
                return self._sequences[found]
        return self.phone_states(phone)

    def phone_transitions(self, phone: str) -> np.ndarray:
        """(3, 4) log probabilities from each state to each and to the end."""
        return self.transitions[self._tmat[self.number[phone]]]

    # ------------------------------------------------------------------ likelihoods
    def score(self, features: np.ndarray, senones: np.ndarray) -> np.ndarray:
        """Log likelihoods of senones.

        Args:
            features: (3, T, 13) from speech_features.dynamic.
            senones: (S,) numbers of the senones wanted.

        Returns:
            (T, S) float32, natural logarithm.
        """
        streams, count = features.shape[0], features.shape[1]
        result = np.zeros((count, len(senones)), dtype=np.float32)
        values = features.astype(np.float32)
        squares = values**2
        codebooks = self.codebook[senones]
        for codebook in np.unique(codebooks):
            columns = np.flatnonzero(codebooks == codebook)
            for stream in range(streams):
                density = squares[stream] @ self._square[codebook, stream].T
                density += values[stream] @ self._linear[codebook, stream].T
                density += self._constant[codebook, stream]
                best = density.max(axis=1, keepdims=True)
                mixed = np.exp(density - best) @ self._weights[stream][:, senones[columns]]
                result[:, columns] += np.log(mixed + 1e-30) + best
        return result


def _size(shape: tuple, senones: int) -> int:
    return shape[1] * shape[2] * senones


def _s3_body(data: bytes) -> Tuple[int, str]:
    """Offset behind the text header and the byte-order mark, and the byte order."""
    end = data.index(b"endhdr\n") + len(b"endhdr\n")
    order = "<" if struct.unpack_from("<I", data, end)[0] == 0x11223344 else ">"
    return end + 4, order


def _read_gaussians(data: bytes) -> np.ndarray:
    """Means or variances, (codebooks, streams, densities, 13) float64."""
    at, order = _s3_body(data)
    codebooks, streams, densities = struct.unpack_from(order + "3i", data, at)
    lengths = struct.unpack_from(f"{order}{streams}i", data, at + 12)
    if len(set(lengths)) != 1:
        raise ValueError("streams of different lengths")
    at += 12 + 4 * streams + 4
    count = codebooks * densities * sum(lengths)
    values = np.frombuffer(data, order + "f4", count=count, offset=at).astype(np.float64)
    return values.reshape(codebooks, streams, densities, lengths[0])


def _read_transitions(data: bytes) -> np.ndarray:
    """(matrices, 3, 4) log probabilities; what is impossible is -1e10."""
    at, order = _s3_body(data)
    matrices, sources, targets = struct.unpack_from(order + "3i", data, at)
    values = np.frombuffer(data, order + "f4", count=matrices * sources * targets, offset=at + 16)
    values = values.reshape(matrices, sources, targets).astype(np.float64)
    values = values / values.sum(axis=-1, keepdims=True)
    return np.where(values > 0, np.log(np.maximum(values, 1e-30)), -1e10)
