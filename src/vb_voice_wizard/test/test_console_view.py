"""The wizard console's screen, drawn into a text."""

from __future__ import annotations

import io

import pytest
import rospy
from geometry_msgs.msg import Point
from rich.console import Console

from vb_core import sentences
from vb_core.notices import Notice, Severity
from vb_core.vocabulary import COMMANDS
from vb_msgs.msg import BorderIssue, BorderPreview, BorderProgress, InteractionState, VirtualBorder
from vb_voice_wizard.console.view import BAD, GOOD, ConsoleContent, render


def screen(view, width=80, height=24, now=0.0):
    output = io.StringIO()
    Console(file=output, width=width, height=height, force_terminal=False).print(render(view, now, width, height))
    lines = output.getvalue().splitlines()
    assert len(lines) == height and max(map(len, lines)) <= width
    return "\n".join(lines)


def border(name, area_m2=1.0, **more):
    return VirtualBorder(name=name, area_m2=area_m2, **{"enabled": True, "occupancy": 1.0, **more})


def refused(message, *issues):
    return BorderPreview(
        available=True, message=message, issues=[BorderIssue(severity=BorderIssue.ERROR, message=one) for one in issues]
    )


def drawing():
    view = ConsoleContent()
    view.state = InteractionState(
        name="border", interaction_id="ab12", guide_s=1.0, border_s=72.3, available_commands=["define_seed", "cancel"]
    )
    view.progress = BorderProgress(
        interaction_id="ab12",
        border_spots=120,
        seed_spots=3,
        ignored_spots=7,
        chain=[Point()] * 9,
        closed=True,
        cameras_seeing_spot=["red"],
        cameras=["red", "robot"],
    )
    view.preview = BorderPreview(
        available=True,
        success=True,
        area_m2=2.5,
        issues=[BorderIssue(severity=BorderIssue.WARNING, message="The robot stands inside the new border.")],
    )
    view.borders = [border("Nursery", 8.0), border("Old carpet", enabled=False, occupancy=0.5)]
    view.add_message("10:00:00", "wizard, define border: Draw the border.", GOOD)
    return view


@pytest.mark.parametrize("width, height", [(80, 24), (120, 40), (200, 60)])
def test_everything_is_on_the_screen(width, height):
    text = screen(drawing(), width, height)
    for word in (
        "BORDER",
        "1:13",
        "ab12",
        "120 border, 3 seed, 7 ignored",
        "9 points, polygon",
        "red (before: robot)",
        "Nursery",
        "50% off",
        "resume",
        "stop",
        "Draw the border",
        "borders (2)",
        "72.3",
        "quit",
        "undo",
        "redo",
        "define border",
        "guide robot",
        "restrict 2.50 m\u00b2",
        "stands inside",
    ):
        assert word in text, word


@pytest.mark.parametrize("width, height", [(80, 23), (60, 18), (40, 10), (20, 5), (500, 100)])
def test_any_size_can_be_drawn(width, height):
    view = drawing()
    view.borders = [border(f"border {number}") for number in range(30)]
    assert "BORDER" in screen(view, width, height)


def test_long_answers_are_read_to_their_end():
    view = drawing()
    view.add_message("10:00:01", "word " * 30 + "end", BAD)
    view.preview = refused("It separates nothing: " + "so " * 40 + "redraw")
    text = screen(view)
    assert " end" in text and "redraw" in text and "\u2026" not in text


def test_a_refused_preview_is_not_said_twice():
    view = drawing()
    view.preview = refused("It separates nothing.", "It separates nothing.")
    assert screen(view).count("It separates nothing.") == 1


def test_the_newest_borders_are_on_the_screen():
    view = drawing()
    view.borders = [border(f"border {number} ") for number in range(40)]
    assert "Border 39 " in screen(view) and "Border 0 " not in screen(view)


def test_an_earlier_drawing_is_not_shown_in_a_new_interaction():
    view = drawing()
    view.state.interaction_id = "cd34"
    assert "120 border" not in screen(view) and "0 border, 0 seed, 0 ignored" in screen(view)


def test_a_silent_manager_is_reported():
    assert "waiting for the interaction manager" in screen(ConsoleContent())


def test_markup_in_names_is_only_text():
    view = drawing()
    view.borders = [border("[red]x[/red] [/")]
    view.add_message("10:00:01", "[bold]y", BAD)
    text = screen(view, 120)
    assert "[red]x[/red] [/" in text and "[bold]y" in text


@pytest.mark.parametrize("escape", ["\x1b[2J", "\x1b]0;title\x07", "\x9b31m", "\x08\x08", "\r"])
def test_no_control_character_from_elsewhere_reaches_the_terminal(escape):
    view = drawing()
    view.borders = [border(f"rug{escape}")]
    view.state.stopped_by = f"ada{escape}"
    view.state.stopped = True
    view.preview = refused(f"no{escape}", f"why{escape}")
    view.notices = (Notice("microphone_missing", Severity.WARNING, values={"why": f"look{escape}"}),)
    view.add_message("12:00:00", f"said{escape}", GOOD)
    found = screen(view)
    assert [word for word in ("rug", "ada", "why", "look", "said") if word not in found] == []
    assert not any(ord(letter) < 0x20 or 0x7F <= ord(letter) < 0xA0 for letter in found.replace("\n", ""))


def test_messages_do_not_grow_for_ever_nor_repeat():
    view = ConsoleContent()
    for number in range(500):
        view.add_message("10:00:00", f"message {number // 2}", GOOD)
    assert len(view.messages) == 50 and view.messages[-1][1] == "message 249"
    assert "message 249" in screen(view)


@pytest.mark.parametrize("language", sentences.languages())
def test_a_long_value_leaves_the_labels_their_room(language):
    view = drawing()
    view.language = language
    sentence = "The points do not make a border yet: draw on, slowly, where a camera sees the spot. " * 2
    view.progress = BorderProgress(interaction_id="ab12", code="of_a_newer_version", message=sentence)
    view.add_message("10:00:01", "word " * 60, BAD)
    text = screen(view, 90, 30)
    for label in ("time", "spots", "chain", "seen_by"):
        assert view.words(f"console_{label}") + "  " in text
    assert "\u2026" in text  # and what is cut says so


def test_stop_end_and_notices_are_shown():
    view = drawing()
    view.state.stopped, view.state.stopped_by, view.state.confirm_save = True, "voice", True
    view.state.ends_at = rospy.Time(145)
    view.notices = (Notice("stopped", Severity.WARNING), Notice("of_a_newer_version", Severity.ERROR, message="Look!"))
    text = screen(view, 100, now=100.0)
    for word in (
        "STOPPED",
        "by voice",
        "ends in 0:45",
        "save again to confirm",
        "! Stopped: no robot drives",
        "! Look!",
    ):
        assert word in text, word
    assert "STOPPED" in screen(view, 30)


@pytest.mark.parametrize("language", sentences.languages())
def test_each_command_has_its_key_on_a_small_screen_in_every_language(language):
    view = drawing()
    view.language = language
    text = screen(view, 80, 24)
    for command in COMMANDS.values():
        key = view.words("console_space") if command.key == " " else command.key
        assert f" {key}  {view.words('command_' + command.name)} " in text
    assert view.words("console_quit") in text


def test_everything_is_said_in_the_operators_language():
    english, german = drawing(), drawing()
    german.language = "de"
    german.messages.clear()
    assert "GRENZE" in screen(german) and "Grenze zeichnen" in screen(german) and "anhalten" in screen(german)
    for word in ("define border", "interaction", "messages", "seen by", "ignored", "quit"):
        assert word in screen(english, 120) and word not in screen(german, 120)
