"""The wizard console's keys."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vb_core.vocabulary import COMMANDS
from vb_voice_wizard.console.keys import COMMAND_KEYS, QUIT_KEY, KeyReader


@pytest.mark.parametrize(
    "typed, keys",
    [
        (["b"], "b"),
        (["B \u00fc"], "b \u00fc"),
        (["\x1b[As"], "s"),
        (["\x1bOBq"], "q"),
        (["\x1b[15~\x1b[1;5Cg"], "g"),
        (["\x1b[3", "~g"], "g"),
        (["\x1b", "[A"], ""),
        (["\x1b", ""], ""),
        (["\r\n\x7f\x08\x01"], ""),
    ],
)
def test_letters_are_told_from_other_keys(typed, keys):
    reader = KeyReader()
    assert "".join(reader.feed(piece) for piece in typed) == keys


@given(st.text(max_size=30), st.integers(1, 29))
def test_a_slow_line_gives_the_same_keys(text, cut):
    whole, pieces = KeyReader(), KeyReader()
    second = pieces.feed(text[:cut]) + (pieces.feed(text[cut:]) if text[cut:] else "") + pieces.feed("")
    assert whole.feed(text) + whole.feed("") == second


def test_every_command_is_one_key():
    assert sorted(COMMAND_KEYS.values()) == sorted(COMMANDS)
    assert QUIT_KEY not in COMMAND_KEYS and all(len(key) == 1 and key == key.lower() for key in COMMAND_KEYS)
