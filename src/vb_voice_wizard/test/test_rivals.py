"""What a phrase is most easily mistaken for."""
from __future__ import annotations

import numpy as np
import pytest

from vb_voice_wizard.acoustic_model import AcousticModel, embedded_model
from vb_voice_wizard.rivals import PHONES, Lexicon

SAVE, CANCEL, REDO = ("S", "EY", "V"), ("K", "AE", "N", "S", "AH", "L"), ("R", "IY", "D", "UW")


@pytest.fixture(scope="module")
def lexicon():
    folder = embedded_model().parent
    return Lexicon(folder / "cmudict-en-us.dict", folder / "en-us.lm.bin")


def test_every_phone_of_the_model_has_a_place():
    assert set(PHONES) == {name for name in AcousticModel(embedded_model()).phones if name.isalpha() and name != "SIL"}


def test_distances(lexicon):
    whole = lexicon.distances(SAVE)
    rows = {word: lexicon.words.index(word) for word in ("save", "safe", "saves", "table")}
    assert whole.shape == (len(lexicon.words), 4)
    assert whole[rows["save"], -1] == 0.0
    # one phone that is nearly the same, one phone more, another word
    assert 0.0 < whole[rows["safe"], -1] <= 1.0 and 0.0 < whole[rows["saves"], -1] <= 1.0 < whole[rows["table"], -1]
    # to nothing at all: all phones are too many; and from the end, to the last phones only
    assert np.allclose(whole[:, 0] / whole[rows["save"], 0] * 3, [len(sound) for sound in lexicon.sounds])
    ends = lexicon.distances(SAVE, from_end=True)
    assert np.allclose(ends[:, -1], whole[:, -1])
    assert ends[lexicon.words.index("save"), 2] == whole[lexicon.words.index("save"), 2]


@pytest.mark.parametrize("words, sounds, expected", [
    (["save"], [SAVE], {"say", "same", "safe", "saved", "saves"}),
    (["cancel"], [CANCEL], {"castle", "cancelled", "council"}),
    (["redo"], [REDO], {"we do", "read", "read you"}),
    (["guide", "robot"], [("G", "AY", "D"), ("R", "OW", "B", "AA", "T")], {"good robot", "guy robot"}),
])
def test_what_sounds_alike_is_found_and_the_phrase_itself_is_not(lexicon, words, sounds, expected):
    own = {sum(sounds, ())}
    found = lexicon.rivals(words, sounds, own, 24)
    texts = {" ".join(rival.words) for rival in found}
    assert expected <= texts and " ".join(words) not in texts
    assert len(found) == 24 and all(rival.distance > 0.0 and sum(rival.sounds, ()) not in own for rival in found)
    # what is longer by whole words is another matter: "ah, undo" is the command
    assert not any(set(words) <= set(rival.words) for rival in found)
