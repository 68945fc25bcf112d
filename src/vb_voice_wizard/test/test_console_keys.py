"""The wizard console's keys."""

from __future__ import annotations

import pytest

from vb_core.vocabulary import COMMANDS
from vb_voice_wizard.console.keys import COMMAND_KEYS, QUIT_KEY, letters


@pytest.mark.parametrize(
    "typed, keys",
    [
        ("b", "b"),
        ("b \u00fc", "b \u00fc"),
        ("\x1b[A", ""),
        ("\x1bOS", ""),
        ("\x1b[As", "s"),  # typed at once, read at once
        ("\x1b[15~\x1b[1;5C", ""),
        ("\r\n\x7f\x08\x01", ""),
    ],
)
def test_letters_are_told_from_other_keys(typed, keys):
    assert letters(typed) == keys


def test_the_end_of_a_function_key_on_a_slow_line_is_no_command():
    assert not set("ABCDFHPQRS~0123456789;[") & set(COMMAND_KEYS)


def test_every_command_is_one_key():
    assert sorted(COMMAND_KEYS.values()) == sorted(COMMANDS)
    assert QUIT_KEY not in COMMAND_KEYS and all(len(key) == 1 and key == key.lower() for key in COMMAND_KEYS)
