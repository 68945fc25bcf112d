"""Scores how well a piece of speech fits a phrase, compared with anything else that could have been said.

A phrase is a chain of phones in context, a competitor is a loop over all phones. Both are scored on the
same likelihoods (acoustic_model), frame by frame, so that their difference means something: the grammar
alone finds a command in every sentence.
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import List, Optional, Sequence, Tuple

import numpy as np

from vb_voice_wizard.acoustic_model import SILENCE, STATES, AcousticModel

_NEVER = -1e10
_FILLERS = (SILENCE, "+NSN+", "+SPN+")
_NOISES = (SILENCE, "+NSN+")


@dataclass(frozen=True)
class Likelihoods:
    """Log likelihoods of one piece of speech of T frames.

    Attributes:
        senones: (T, S) of every senone of the model.
        best: (T,) of the best one.
        silence: (T,) of the best state of silence or noise.
        phones: (T, P, 3) of the best senone, in any context, of each speech phone's three states.
    """

    senones: np.ndarray
    best: np.ndarray
    silence: np.ndarray
    phones: np.ndarray


class PhoneSet:
    """The speech phones of a model, and the likelihoods of all that is compared."""

    def __init__(self, model: AcousticModel) -> None:
        self.model = model
        self.names = [name for name in model.phones if name not in _FILLERS]
        self.index = {name: number for number, name in enumerate(self.names)}
        self._noise = np.concatenate([model.phone_states(name) for name in _NOISES])
        # columns in an order that keeps those of one phone and place together
        group = np.full(model.senones, -1, dtype=np.int64)
        for name, number in self.index.items():
            mine = model.codebook == model.number[name]
            group[mine] = number * STATES + model.place[mine]
        self._order = np.argsort(group, kind="stable")
        self._order = self._order[group[self._order] >= 0]
        self._starts = np.searchsorted(group[self._order], np.arange(len(self.names) * STATES))
        # each senone's class in a phone network: its phone, or silence behind the last phone
        self._class = np.where(group >= 0, group // STATES, len(self.names))
        self.loop_stay, self.loop_leave = self._transitions()

    def _transitions(self) -> Tuple[np.ndarray, np.ndarray]:
        stay, leave = [], []
        for name in self.names:
            matrix = self.model.phone_transitions(name)
            for place in range(STATES):
                stay.append(matrix[place, place])
                leave.append(matrix[place, place + 1])
        return np.array(stay), np.array(leave)

    def likelihoods(self, features: np.ndarray, weight: float = 1.0, network: Optional[np.ndarray] = None) -> Likelihoods:
        """Scores features against the whole model.

        Args:
            features: (3, T, 13) from speech_features.dynamic.
            weight: of the Gaussian model's log likelihoods. Gaussians take neighbouring frames for
                independent, so beside a second opinion theirs must be toned down.
            network: (T, P + 1) log likelihoods of the phones and of silence to add, or None.
        """
        scores = self.model.score(features, np.arange(self.model.senones))
        if weight != 1.0:
            scores *= np.float32(weight)
        if network is not None:
            scores += network.astype(np.float32)[:, self._class]
        phones = np.maximum.reduceat(scores[:, self._order], self._starts, axis=1)
        return Likelihoods(
            senones=scores,
            best=scores.max(axis=1),
            silence=scores[:, self._noise].max(axis=1),
            phones=phones.reshape(len(scores), len(self.names), STATES),
        )


@dataclass(frozen=True)
class Alignment:
    """Where a phrase's phones are.

    Attributes:
        score: log likelihood of the whole piece, silence before and after included.
        phones: (name, first frame, frame after the last) of each phone.
        own: (T,) log likelihood of the aligned state per frame.
    """

    score: float
    phones: List[Tuple[str, int, int]]
    own: np.ndarray

    @property
    def start(self) -> int:
        return self.phones[0][1]

    @property
    def end(self) -> int:
        return self.phones[-1][2]


class PhraseScorer:
    """Aligns all phrases with a piece of speech at once.

    Args:
        phones: the phone set.
        phrases: for each one its words, each word a list of phones.
    """

    def __init__(self, phones: PhoneSet, phrases: Sequence[Sequence[Sequence[str]]]) -> None:
        self._phones = phones
        chains = [self._chain(phrase) for phrase in phrases]
        longest = max(len(chain) for chain in chains)
        shape = (len(chains), longest)
        # senone -1 is silence, -2 is beyond the chain's end
        self._senone = np.full(shape, -2, dtype=np.int64)
        self._stay = np.full(shape, _NEVER)
        self._enter = np.full(shape, _NEVER)
        self._skip = np.full(shape, _NEVER)
        self._last = np.array([len(chain) - 1 for chain in chains])
        self._names: List[List[Tuple[int, str]]] = []
        for row, chain in enumerate(chains):
            names, number = [], -1
            for column, (name, place, senone, stay, _) in enumerate(chain):
                self._senone[row, column] = senone
                self._stay[row, column] = stay
                if column:
                    self._enter[row, column] = chain[column - 1][4]
                if column >= 2 and chain[column - 1][2] == -1:
                    # the pause between two words may be left out
                    self._skip[row, column] = chain[column - 2][4]
                number += place == 0
                names.append((number, name))
            self._names.append(names)

    def _chain(self, phrase: Sequence[Sequence[str]]) -> List[Tuple[str, int, int, float, float]]:
        """(phone, place, senone, log P(stay), log P(leave)) per state, with silence round every word."""
        quiet = (SILENCE, 0, -1, float(np.log(0.9)), float(np.log(0.1)))
        flat = [SILENCE] + [phone for word in phrase for phone in word] + [SILENCE]
        chain, at = [quiet], 1
        model = self._phones.model
        for word in phrase:
            for index, phone in enumerate(word):
                position = "s" if len(word) == 1 else "b" if index == 0 else "e" if index == len(word) - 1 else "i"
                states = model.triphone_states(phone, flat[at - 1], flat[at + 1], position)
                matrix = model.phone_transitions(phone)
                for place in range(STATES):
                    chain.append((phone, place, int(states[place]), matrix[place, place], matrix[place, place + 1]))
                at += 1
            chain.append(quiet)
        return chain

    def align(self, likelihoods: Likelihoods) -> "Alignments":
        """The best alignment of each phrase."""
        emission = np.where(
            self._senone[None] >= 0, likelihoods.senones[:, np.maximum(self._senone, 0)], likelihoods.silence[:, None, None]
        ).astype(np.float64)
        emission[:, self._senone == -2] = _NEVER
        count, rows, columns = emission.shape
        value = np.full((rows, columns), _NEVER)
        value[:, :2] = emission[0, :, :2]
        back = np.zeros((count, rows, columns), dtype=np.int8)
        candidates = np.full((3, rows, columns), _NEVER)
        for frame in range(1, count):
            np.add(value, self._stay, out=candidates[0])
            np.add(value[:, :-1], self._enter[:, 1:], out=candidates[1, :, 1:])
            np.add(value[:, :-2], self._skip[:, 2:], out=candidates[2, :, 2:])
            back[frame] = candidates.argmax(axis=0)
            value = candidates.max(axis=0) + emission[frame]
        # the last state is silence, which may be missing at the end of the piece
        every = np.arange(rows)
        ends = np.where(value[every, self._last - 1] > value[every, self._last], self._last - 1, self._last)
        return Alignments(value[every, ends], ends, back, emission, self._names)


@dataclass(frozen=True)
class Alignments:
    """Every phrase's best alignment with one piece of speech: all scores, and on request where its phones are."""

    scores: np.ndarray  # (phrases,)
    _ends: np.ndarray
    _back: np.ndarray
    _emission: np.ndarray
    _names: List[List[Tuple[int, str]]]

    def trace(self, row: int) -> Alignment:
        """The alignment of one phrase."""
        count = len(self._back)
        path = np.zeros(count, dtype=np.int64)
        column = int(self._ends[row])
        for frame in range(count - 1, -1, -1):
            path[frame] = column
            column -= int(self._back[frame, row, column])
        names, phones, current = self._names[row], [], None
        for frame, column in enumerate(path):
            if names[column] != current:
                current = names[column]
                phones.append((current[1], frame, frame + 1))
            else:
                phones[-1] = (phones[-1][0], phones[-1][1], frame + 1)
        spoken = [phone for phone in phones if phone[0] != SILENCE] or [(SILENCE, 0, len(path))]
        return Alignment(float(self.scores[row]), spoken, self._emission[np.arange(count), row, path])


def phone_loop(phones: PhoneSet, likelihoods: Likelihoods, penalty: float) -> Tuple[np.ndarray, List[Tuple[str, int, int]]]:
    """The best sequence of any phones and silence.

    Args:
        penalty: log probability of starting a phone.

    Returns:
        (T,) log likelihood per frame along the path, transitions included, and (phone, first frame, frame
        behind the last) for each of its phones, silence included.
    """
    count = len(likelihoods.best)
    states = len(phones.names) * STATES
    emission = np.concatenate([likelihoods.phones.reshape(count, states), likelihoods.silence[:, None]], axis=1).astype(np.float64)
    stay = np.append(phones.loop_stay, np.log(0.9))
    leave = np.append(phones.loop_leave, np.log(0.1))
    firsts = np.append(np.arange(0, states, STATES), states)
    lasts = np.append(np.arange(STATES - 1, states, STATES), states)
    inner = np.setdiff1d(np.arange(states), firsts)
    value = np.full(states + 1, _NEVER)
    value[firsts] = emission[0, firsts]
    back = np.zeros((count, states + 1), dtype=np.int32)
    here = np.arange(states + 1)
    for frame in range(1, count):
        staying = value + stay
        exits = value[lasts] + leave[lasts]
        best = int(exits.argmax())
        entering = np.full(states + 1, _NEVER)
        entering[inner] = value[inner - 1] + leave[inner - 1]
        entering[firsts] = exits[best] + penalty
        source = here - 1
        source[firsts] = lasts[best]
        moves = entering > staying
        back[frame] = np.where(moves, source, here)
        value = np.where(moves, entering, staying) + emission[frame]
    path = np.zeros(count, dtype=np.int64)
    column = int(value.argmax())
    for frame in range(count - 1, -1, -1):
        path[frame] = column
        column = int(back[frame, column])
    scores = emission[np.arange(count), path]
    found: List[Tuple[str, int, int]] = []
    for frame, column in enumerate(path):
        name = SILENCE if column == states else phones.names[column // STATES]
        fresh = frame == 0 or column != path[frame - 1]
        if fresh and (frame == 0 or column in firsts):
            found.append((name, frame, frame + 1))
            scores[frame] += penalty
        else:
            found[-1] = (found[-1][0], found[-1][1], frame + 1)
    return scores, found
