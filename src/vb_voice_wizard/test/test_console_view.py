"""The wizard console's screen, drawn into a text."""
from __future__ import annotations

import io

import pytest
from rich.console import Console

from vb_core import sentences
from vb_core.notices import Notice, Severity
from vb_voice_wizard.console.view import BAD, GOOD, BorderRow, View, render


def screen(view, width=80, height=24):
    output = io.StringIO()
    Console(file=output, width=width, height=height, force_terminal=False).print(render(view, width, height))
    lines = output.getvalue().splitlines()
    assert len(lines) == height and max(map(len, lines)) <= width
    return "\n".join(lines)


def drawing():
    view = View("http://here:11311", True, "border", (), "ab12", (1.0, 72.3, 0.0), ("define_seed", "cancel"))
    view.border_spots, view.seed_spots, view.ignored_spots, view.chain_points, view.closed = 120, 3, 7, 9, True
    view.seeing, view.cameras = ("red",), ("red", "robot")
    view.robot = "x 2.10 m, y 0.43 m, drives"
    view.preview, view.preview_good = "the border would restrict 2.50 m2", True
    view.issues = (("The robot stands inside the new border.", False),)
    view.borders = (BorderRow("Nursery", 8.0, True), BorderRow("Old carpet", 1.0, False, 0.5))
    view.say("10:00:00", "wizard, define border: Draw the border.", GOOD)
    return view


@pytest.mark.parametrize("width, height", [(80, 24), (120, 40), (200, 60)])
def test_everything_is_on_the_screen(width, height):
    text = screen(drawing(), width, height)
    for word in ("BORDER", "1:13", "ab12", "120 border, 3 seed, 7 ignored", "9 points, polygon", "red (before: robot)", "Nursery",
                 "50% off", "resume", "stop", "Draw the border", "borders (2)", "72.3", "quit", "undo", "redo", "define border",
                 "guide robot", "drives", "restrict 2.50 m2", "stands inside"):
        assert word in text, word


@pytest.mark.parametrize("width, height", [(80, 23), (60, 18), (40, 10), (20, 5), (500, 100)])
def test_any_size_can_be_drawn(width, height):
    view = drawing()
    view.borders = tuple(BorderRow(f"border {number}", 1.0, True) for number in range(30))
    assert "BORDER" in screen(view, width, height)


def test_long_answers_are_read_to_their_end():
    view = drawing()
    view.say("10:00:01", "word " * 30 + "end", BAD)
    view.preview, view.preview_good, view.issues = "It separates nothing: " + "so " * 40 + "redraw", False, ()
    text = screen(view)
    assert " end" in text and "redraw" in text and "\u2026" not in text


def test_a_refused_preview_is_not_said_twice():
    view = drawing()
    view.preview, view.preview_good = "It separates nothing.", False
    view.issues = (("It separates nothing.", True),)
    assert screen(view).count("It separates nothing.") == 1


def test_the_newest_borders_are_on_the_screen():
    view = drawing()
    view.borders = tuple(BorderRow(f"border {number} ", 1.0, True) for number in range(40))
    assert "border 39 " in screen(view) and "border 0 " not in screen(view)


def test_what_is_away_is_said():
    assert "waiting for the ROS master at http://here" in screen(View("http://here"))
    assert "waiting for the interaction manager" in screen(View("http://here", True))
    view = drawing()
    view.away = ("interaction_manager", "border_fusion", "map_integrator")
    assert "away: The interaction manager, The border fusion, The map integrator" in screen(view, 120)


def test_markup_in_names_is_only_text():
    view = drawing()
    view.borders = (BorderRow("[red]x[/red] [/", 1.0, True),)
    view.say("10:00:01", "[bold]y", BAD)
    text = screen(view, 120)
    assert "[red]x[/red] [/" in text and "[bold]y" in text


def test_messages_do_not_grow_for_ever_nor_repeat():
    view = View()
    for number in range(500):
        view.say("10:00:00", f"message {number // 2}", GOOD)
    assert len(view.messages) == 50 and view.messages[-1][1] == "message 249"
    assert "message 249" in screen(view)


@pytest.mark.parametrize("language", sentences.languages())
def test_a_long_value_leaves_the_labels_their_room(language):
    view = drawing()
    view.language, view.chain_points = language, 0
    view.progress_message = "The points do not make a border yet: draw on, slowly, where a camera sees the spot. " * 2
    view.say("10:00:01", "word " * 60, BAD)
    text = screen(view, 90, 30)
    for label in ("time", "spots", "chain", "seen_by", "cameras", "robot", "voice"):
        assert view.words(f"console_{label}") + "  " in text
    assert "\u2026" in text  # and what is cut says so


def test_stop_cameras_notices_and_the_microphone_are_shown():
    view = drawing()
    view.stopped, view.stopped_by, view.ends_in_s, view.confirm_save = True, "voice", 45.0, True
    view.detectors, view.level_db = (("green", 24.6), ("red", 0.0)), -31.7
    view.notices = (Notice("robots_stopped", Severity.WARNING), Notice("of_a_newer_version", Severity.ERROR, message="Look!"))
    text = screen(view, 100)
    for word in ("STOPPED", "by voice", "ends in 0:45", "save again to confirm", "red silent, green 25/s", "-32 dB",
                 "! Robots are stopped.", "! Look!"):
        assert word in text, word
    assert "STOPPED" in screen(view, 30)


def test_everything_is_said_in_the_operators_language():
    english, german = drawing(), drawing()
    german.language = "de"
    german.messages.clear()
    assert "GRENZE" in screen(german) and "Grenze zeichnen" in screen(german) and "anhalten" in screen(german)
    for word in ("define border", "interaction", "messages", "seen by", "ignored", "quit"):
        assert word in screen(english, 120) and word not in screen(german, 120)
