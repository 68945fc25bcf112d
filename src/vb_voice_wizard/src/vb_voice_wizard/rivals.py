"""Finds what a phrase is most easily mistaken for: words of the dictionary that sound nearly like it.

The idea: "council" fits "cancel" well, and any loop over phones worse than either, since the loop pays for every phone. What
tells them apart is the other word itself. So every phrase gets rivals, the commonest words and pairs of words at a small
phonetic distance, and has to beat them on the same likelihoods (recognizer). No list is written by hand, and phrases of
one's own get rivals as well.
"""
from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Callable, Dict, Iterable, List, Sequence, Tuple

import numpy as np

Pronunciation = Tuple[str, ...]

# (height, back, rounded, long) of vowels, diphthongs by where they begin and end
_VOWELS = {
    "IY": (3, 0, 0, 1), "IH": (2.5, 0, 0, 0), "EH": (1.5, 0, 0, 0), "AE": (0.7, 0, 0, 0), "AA": (0, 2, 0, 1), "AO": (1, 2, 1, 1),
    "UH": (2.5, 2, 1, 0), "UW": (3, 2, 1, 1), "AH": (1.2, 1.2, 0, 0), "ER": (1.5, 1, 0, 1), "EY": (2.2, 0, 0, 1),
    "AY": (1.4, 0.8, 0, 1), "OY": (1.9, 1, 0.5, 1), "AW": (1.4, 1.5, 0.5, 1), "OW": (2, 2, 1, 1),
}
# (voiced, place from lips to throat, kind: 0 stop, 1 affricate, 2 fricative, 3 nasal, 4 approximant)
_CONSONANTS = {
    "P": (0, 0, 0), "B": (1, 0, 0), "T": (0, 2, 0), "D": (1, 2, 0), "K": (0, 4, 0), "G": (1, 4, 0), "CH": (0, 3, 1), "JH": (1, 3, 1),
    "F": (0, 0.5, 2), "V": (1, 0.5, 2), "TH": (0, 1, 2), "DH": (1, 1, 2), "S": (0, 2, 2), "Z": (1, 2, 2), "SH": (0, 3, 2),
    "ZH": (1, 3, 2), "HH": (0, 5, 2), "M": (1, 0, 3), "N": (1, 2, 3), "NG": (1, 4, 3), "L": (1, 2, 4), "R": (1, 3, 4),
    "W": (1, 0, 4), "Y": (1, 3.5, 4),
}
PHONES = (*_VOWELS, *_CONSONANTS)
_NUMBER = {name: number for number, name in enumerate(PHONES)}
_EXTRA = 0.7  # one phone more or less; two phones that have nothing in common cost 1
_FARTHEST = 1.6  # phonetic distance of a rival: two phones that differ somewhat, or one more and one that differs
_LONGEST = 12  # phones of a word
# a word ten times as rare is a rival as good as one that sounds this much less alike
_RARITY = 0.15
_WORDS = 20000  # the commonest ones; rarer ones are names, mostly
_PIECES = 12  # words that are tried as the first and the second half of a word


def _phone_costs() -> np.ndarray:
    """(P, P): 0 for the same phone, from 0.3 for similar ones to 1 for phones that have nothing in common."""
    costs = np.ones((len(PHONES), len(PHONES)))
    for group, scale in ((_VOWELS, (3.0, 2.0, 1.0, 1.0)), (_CONSONANTS, (1.0, 5.0, 2.0))):
        names = list(group)
        features = np.array([group[name] for name in names]) / np.array(scale)
        apart = np.minimum(np.abs(features[:, None] - features[None]), 1.0).mean(axis=2)
        rows = [_NUMBER[name] for name in names]
        costs[np.ix_(rows, rows)] = np.minimum(0.3 + 1.4 * apart, 1.0)
    np.fill_diagonal(costs, 0.0)
    return costs


_COSTS = _phone_costs()


@dataclass(frozen=True)
class Rival:
    """What a phrase may be mistaken for: its words, how each of them sounds, and the phonetic distance."""

    words: Tuple[str, ...]
    sounds: Tuple[Pronunciation, ...]
    distance: float


class Lexicon:
    """The commonest words of a dictionary, and what sounds like a phrase among them.

    Args:
        dictionary: in CMU's form.
        language_model: a binary one for PocketSphinx; it says how common words are.
    """

    def __init__(self, dictionary: Path, language_model: Path) -> None:
        from pocketsphinx import Config, LogMath, NGramModel

        log = LogMath()
        model = NGramModel(Config(lm=None, loglevel="FATAL"), log, str(language_model))
        entries = []
        for line in dictionary.read_text(encoding="utf-8").splitlines():
            head, *phones = line.split()
            word = head.split("(")[0]
            # letters are spelled names in the model; only "a" and "i" are said alone
            if len(phones) <= _LONGEST and word[0].isalpha() and "." not in word and (len(word) > 1 or word in "ai"):
                entries.append((-log.log_to_log10(model.prob([word])), word, tuple(phones)))
        entries.sort()
        del entries[_WORDS:]
        self.words = [word for _, word, _ in entries]
        self.sounds: List[Pronunciation] = [sound for _, _, sound in entries]
        self._rarity = _RARITY * np.array([rarity for rarity, _, _ in entries])
        self._lengths = np.array([len(sound) for sound in self.sounds])
        self._phones = np.zeros((len(entries), _LONGEST), dtype=np.int8)
        for row, sound in enumerate(self.sounds):
            self._phones[row, : len(sound)] = [_NUMBER[phone] for phone in sound]
        self._tables: Dict[Tuple[Pronunciation, bool], np.ndarray] = {}

    def distances(self, target: Pronunciation, from_end: bool = False) -> np.ndarray:
        """Phonetic distances of every word to the target's first 0, 1 ... all phones: (words, len(target) + 1).

        With `from_end` to its last ones instead.
        """
        if (target, from_end) not in self._tables:
            self._tables[target, from_end] = self._edit_distances(target, from_end)
        return self._tables[target, from_end]

    def _edit_distances(self, target: Pronunciation, from_end: bool) -> np.ndarray:
        mine = self._phones
        if from_end:
            columns = (self._lengths[:, None] - 1 - np.arange(_LONGEST)) % _LONGEST
            mine = np.take_along_axis(mine, columns, axis=1)
        everyone = np.arange(len(mine))
        # one row per phone of the word, so that each step is one operation for all words
        row = np.repeat(_EXTRA * np.arange(_LONGEST + 1)[:, None], len(mine), axis=1)
        found = [row[self._lengths, everyone]]
        for phone in reversed(target) if from_end else target:
            above, row = row, np.empty_like(row)
            row[0] = above[0] + _EXTRA
            same = above[:-1] + _COSTS[_NUMBER[phone]][mine.T]
            for column in range(_LONGEST):
                row[column + 1] = np.minimum(np.minimum(same[column], above[column + 1] + _EXTRA), row[column] + _EXTRA)
            found.append(row[self._lengths, everyone])
        return np.stack(found, axis=1)

    # ------------------------------------------------------------------ rivals
    def rivals(self, words: Sequence[str], sounds: Sequence[Pronunciation], own: Iterable[Pronunciation], most: int) -> List[Rival]:
        """The `most` likeliest things to be mistaken for a phrase.

        Args:
            words: the phrase.
            sounds: how each of its words is pronounced.
            own: phone sequences of all that counts as a command, and is therefore not a rival.
        """
        best: Dict[Pronunciation, Tuple[float, Rival]] = {}
        known = set(own)

        def consider(place: float, rival: Rival) -> None:
            flat = sum(rival.sounds, ())
            said = set(words) <= set(rival.words)  # "ah, undo" is the command
            if not said and flat not in known and rival.distance <= _FARTHEST and (flat not in best or place < best[flat][0]):
                best[flat] = (place, rival)

        for index, sound in enumerate(sounds):
            whole = self.distances(sound)[:, -1]
            for row in np.flatnonzero(whole <= _FARTHEST):
                changed = Rival(
                    (*words[:index], self.words[row], *words[index + 1 :]),
                    (*sounds[:index], self.sounds[row], *sounds[index + 1 :]),
                    float(whole[row]),
                )
                consider(whole[row] + self._rarity[row], changed)
        if len(sounds) == 1:
            self._consider_pairs(sounds[0], consider)
        ranked = sorted(best.values(), key=lambda one: (one[0], one[1].words))
        return [rival for _, rival in ranked[:most]]

    def _consider_pairs(self, sound: Pronunciation, consider: Callable[[float, Rival], None]) -> None:
        """Two words that sound like one: "we do" like "redo"."""
        heads, tails = self.distances(sound), self.distances(sound, from_end=True)
        for at in range(1, len(sound)):
            pieces = []
            for distances in (heads[:, at], tails[:, len(sound) - at]):
                rows = np.flatnonzero(distances <= _FARTHEST / 2)
                places = distances[rows] + self._rarity[rows]
                chosen = np.argsort(places, kind="stable")[:_PIECES]
                pieces.append([(places[one], rows[one], distances[rows[one]]) for one in chosen])
            for (place, row, distance), (other_place, other, other_distance) in itertools.product(*pieces):
                pair = Rival(
                    (self.words[row], self.words[other]),
                    (self.sounds[row], self.sounds[other]),
                    float(distance + other_distance),
                )
                consider(place + other_place, pair)
