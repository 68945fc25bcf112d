"""The wizard console's screen, drawn into a text."""
from __future__ import annotations

import io

import pytest
from rich.console import Console

from vb_voice_wizard.console_view import BAD, COMMAND_KEYS, GOOD, View, keys_typed, render
from vb_voice_wizard.interaction import COMMANDS


def screen(view, width=80, height=24):
    output = io.StringIO()
    Console(file=output, width=width, height=height, force_terminal=False).print(render(view, height))
    lines = output.getvalue().splitlines()
    assert len(lines) == height and max(map(len, lines)) <= width
    return "\n".join(lines)


def drawing():
    view = View("http://here:11311", True, "border", True, "ab12", (1.0, 72.3, 0.0), ("define_seed", "cancel"))
    view.border_spots, view.seed_spots, view.ignored_spots, view.chain_points, view.closed = 120, 3, 7, 9, True
    view.seeing, view.cameras = ("red",), ("red", "robot")
    view.borders = (("Nursery", 8.0, True), ("Old carpet", 1.0, False))
    view.say("10:00:00", "wizard, define border: Draw the border.", GOOD)
    return view


@pytest.mark.parametrize("width, height", [(80, 24), (120, 40), (200, 60)])
def test_everything_is_on_the_screen(width, height):
    text = screen(drawing(), width, height)
    for word in ("BORDER", "1:13", "ab12", "120 border, 3 seed", "9 points, polygon", "red, robot", "Nursery", "off",
                 "Draw the border", "borders (2)", "72.3", "quit"):
        assert word in text, word


def test_every_command_has_a_key():
    assert sorted(COMMAND_KEYS.values()) == sorted(COMMANDS)
    assert len(set(COMMAND_KEYS)) == len(COMMANDS)


def test_what_is_away_is_said():
    assert "waiting for the ROS master at http://here" in screen(View("http://here"))
    assert "waiting for the interaction manager" in screen(View("http://here", True))
    view = drawing()
    view.manager_present = False
    assert "interaction manager is away" in screen(view)


def test_markup_in_names_is_only_text():
    view = drawing()
    view.borders = (("[red]x[/red] [/", 1.0, True),)
    view.say("10:00:01", "[bold]y", BAD)
    text = screen(view, 120)
    assert "[red]x[/red] [/" in text and "[bold]y" in text


def test_messages_do_not_grow_for_ever_nor_repeat():
    view = View()
    for number in range(500):
        view.say("10:00:00", f"message {number // 2}", GOOD)
    assert len(view.messages) == 50 and view.messages[-1][1] == "message 249"
    assert "message 249" in screen(view)


@pytest.mark.parametrize(
    "typed, keys",
    [
        ("b", "b"), ("BS", "bs"), ("\x1b[As", "s"), ("\x1bOPq", "q"), ("\x1b[15~\x1b[1;5Cg", "g"), ("\x1b", ""),
        ("\x1bx", ""),
    ],
)
def test_arrow_and_function_keys_are_no_commands(typed, keys):
    assert keys_typed(typed) == keys
