"""The wizard console's keys."""
from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vb_voice_wizard.console_keys import COMMAND_KEYS, KEY_HELP, LONGEST_NAME, Action, BorderRow, Controls, KeyReader
from vb_voice_wizard.interaction import COMMANDS

BORDERS = [BorderRow("b1", "Nursery", 8.0, True), BorderRow("b2", "Carpet", 1.0, False), BorderRow("b3", "Door", 2.0, True)]


def pressed(controls, keys, borders=BORDERS):
    return [action for action in (controls.press(key, borders) for key in keys) if action is not None]


# ------------------------------------------------------------------ what a terminal sends
@pytest.mark.parametrize(
    "typed, keys",
    [
        (["b"], ["b"]),
        (["\x1b[As"], ["up", "s"]),
        (["\x1bOBq"], ["down", "q"]),
        (["\x1b[15~\x1b[1;5Cg"], ["g"]),
        (["\x1b[3", "~g"], ["g"]),
        (["\x1b", "[A"], ["up"]),
        (["\x1b", ""], ["escape"]),
        (["\x1b[", ""], ["escape", "["]),
        (["\r\n\x7f\x08\x01"], ["enter", "enter", "backspace", "backspace"]),
        (["\u00fc"], ["\u00fc"]),
    ],
)
def test_keys_are_told_apart(typed, keys):
    reader = KeyReader()
    assert [key for piece in typed for key in reader.feed(piece)] == keys


@given(st.text(max_size=30), st.integers(1, 29))
def test_a_slow_line_gives_the_same_keys(text, cut):
    whole, pieces = KeyReader(), KeyReader()
    assert whole.feed(text) + whole.feed("") == pieces.feed(text[:cut]) + (
        pieces.feed(text[cut:]) if text[cut:] else []
    ) + pieces.feed("")


# ------------------------------------------------------------------ what they mean
def test_every_command_is_one_key():
    assert sorted(COMMAND_KEYS.values()) == sorted(COMMANDS)
    help_keys = [key for key, _ in KEY_HELP]
    assert len(set([*COMMAND_KEYS, *help_keys])) == len(COMMAND_KEYS) + len(help_keys)
    for key, command in COMMAND_KEYS.items():
        assert pressed(Controls(), [key, key.upper()]) == [Action("command", text=command)] * 2
    assert [action.what for action in pressed(Controls(), "q")] == ["quit"]


def test_the_newest_border_is_chosen_until_another_one_is():
    controls = Controls()
    assert controls.chosen(BORDERS).id == "b3"
    assert controls.chosen([]) is None
    pressed(controls, ["up"])
    assert controls.chosen(BORDERS).id == "b2"
    pressed(controls, ["up", "up", "up"])
    assert controls.chosen(BORDERS).id == "b1"
    pressed(controls, ["down"] * 5)
    assert controls.chosen(BORDERS).id == "b3"
    # one that was removed by somebody else gives way to the newest
    assert controls.chosen(BORDERS[:2]).id == "b2"


def test_a_border_is_turned_on_and_off():
    controls = Controls()
    assert pressed(controls, "e") == [Action("disable", "b3")]
    assert pressed(controls, ["up", "e"]) == [Action("enable", "b2")]


def test_a_border_is_renamed_by_typing():
    controls = Controls()
    assert pressed(controls, ["n", *"Carpes", "backspace", *"t q", "up", "enter"]) == [Action("rename", "b3", "Carpet q")]
    assert controls.mode == "keys"
    assert [action.what for action in pressed(controls, ["n", *"abc", "escape", "n", " ", "enter"])] == ["note", "note"]
    # a border that comes meanwhile is not the one that was meant
    pressed(controls, "nab")
    more = [*BORDERS, BorderRow("b4", "New", 1.0, True)]
    assert pressed(controls, ["enter"], more) == [Action("rename", "b3", "ab")]
    pressed(controls, "n" + "x" * 100)
    assert len(controls.text) == LONGEST_NAME


def test_removing_takes_a_yes():
    controls = Controls()
    for key in ("n", "enter", "escape", "x", "s", "q"):
        assert [action.what for action in pressed(controls, ["x", key])] == ["note"]
    for key in "yY":
        assert pressed(controls, ["x", key]) == [Action("remove", "b3")]


def test_without_a_border_there_is_nothing_to_change():
    for key in ("n", "e", "x", "up", "down"):
        controls = Controls()
        assert [action.what for action in pressed(controls, [key], [])] == ["note"]
        assert controls.mode == "keys"


def test_other_keys_are_answered_and_change_nothing():
    controls = Controls()
    assert pressed(controls, ["z"]) == [Action("note", text="console_key_unknown", key="z")]
    assert pressed(controls, ["enter", "escape", "backspace"]) == []
