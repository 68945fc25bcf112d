"""The wizard console's text and keys."""

from io import StringIO

import pytest
import rospy
from rich.console import Console

from vb_core import sentences
from vb_core.interaction_tables import COMMANDS
from vb_core.notices import Notice, Severity
from vb_msgs.msg import BorderIssue, BorderPreview, BorderProgress, InteractionState
from vb_voice_wizard.wizard_console import COMMAND_KEYS, QUIT_KEY, ERROR_STYLE, ConsoleContent, extract_keys, safe_text


def content_while_drawing(language="en"):
    """Returns the console's content while somebody draws a border that has a preview with an issue."""
    state = InteractionState(name="border", interaction_id="ab12", guide_s=1.0, border_s=72.3)
    progress = BorderProgress(interaction_id="ab12", border_spots=120, seed_spots=3, ignored_spots=7)
    progress.cameras_seeing_spot = ["south"]
    preview = BorderPreview(available=True, success=True, area_m2=2.5)
    preview.issues = [BorderIssue(severity=BorderIssue.WARNING, message="The robot stands inside the new border.")]
    return ConsoleContent(state, progress, preview, language=language)


def text_shown(content, now=0.0, width=300):
    """Returns what the console shows at a ROS time [s] on a terminal of this width."""
    console = Console(file=StringIO(), width=width)
    console.print(*content.lines(now), sep="\n")
    return console.file.getvalue()


@pytest.mark.parametrize(
    "words", ["BORDER", "1:13", "120 border, 3 seed, 7 ignored", "south", "restrict 2.50 m\u00b2", "! The robot stands"]
)
def test_the_console_shows_state_time_spots_cameras_and_preview(words):
    assert words in text_shown(content_while_drawing())


@pytest.mark.parametrize("parts, is_told", [(0, False), (1, False), (2, True)])
def test_the_console_shows_in_how_many_parts_a_border_would_leave_the_floor(parts, is_told):
    content = content_while_drawing()
    content.preview.free_parts = parts
    assert (content.translate("preview_parts", parts=parts) in text_shown(content)) is is_told


@pytest.mark.parametrize("words", ["STOPPED", "voice", "ends in 0:45", "save again to confirm", "! Look!"])
def test_the_console_shows_a_stop_the_end_a_question_and_notices(words):
    content = content_while_drawing()
    content.state.stopped, content.state.stopped_by, content.state.confirm_save = True, "voice", True
    content.state.ends_at = rospy.Time(145)
    content.notices = (Notice("of_a_newer_version", Severity.ERROR, message="Look!"),)
    assert words in text_shown(content, 100.0)


def test_the_notice_of_a_stop_is_shown_only_if_the_state_is_not_known():
    content = content_while_drawing()
    content.state.stopped = True
    content.notices = (Notice("stopped", Severity.WARNING),)
    assert "! Stopped: no robot drives" not in text_shown(content)
    content.state = None
    assert "! Stopped: no robot drives" in text_shown(content)


def test_an_earlier_drawing_is_not_shown_in_a_new_interaction():
    content = content_while_drawing()
    content.state.interaction_id = "cd34"
    assert "120 border" not in text_shown(content)


def test_what_two_messages_say_is_shown_once():
    content = content_while_drawing()
    content.preview.issues[0].code = "robot_inside"
    content.notices = (Notice("robot_inside", Severity.WARNING),)
    assert text_shown(content).count(f"! {sentences.translate('robot_inside')}") == 1
    # the reason of a refused preview is both its sentence and its first issue
    why = BorderIssue(severity=BorderIssue.ERROR, message="It separates nothing.")
    content.preview = BorderPreview(available=True, message="It separates nothing.", issues=[why])
    assert [text_shown(content).count(words) for words in ("It separates nothing.", "restrict")] == [1, 0]
    # an error other than the sentence is shown, as an error
    why.message = "The seed lies in a wall."
    assert [line.style for line in content.lines() if why.message in str(line)] == [ERROR_STYLE]


@pytest.mark.parametrize("escape", ["\x1b[2J", "\x1b]0;title\x07", "\x9b31m", "\x08\x08", "\r", "\n"])
def test_no_control_character_from_elsewhere_reaches_the_terminal(escape):
    def screen(escape):
        content = content_while_drawing()
        content.state.stopped, content.state.stopped_by = True, f"ada{escape}"
        content.progress.cameras_seeing_spot = [f"red{escape}"]
        content.preview.issues[0].message = f"why{escape}"
        content.notices = (Notice("microphone_missing", Severity.WARNING, values={"why": f"look{escape}"}),)
        return text_shown(content) + safe_text(f"said{escape}").plain

    shown = screen(escape)
    assert [word for word in ("ada", "red", "why", "look", "said") if word not in shown] == []
    assert shown.count("\n") == screen("").count("\n")
    assert not any(ord(letter) < 0x20 or 0x7F <= ord(letter) < 0xA0 for letter in shown.replace("\n", ""))


@pytest.mark.parametrize("language", sentences.languages())
def test_each_command_has_its_key_in_every_language(language):
    content = content_while_drawing(language)
    for width in (300, 30):
        shown = text_shown(content, width=width)
        for command in COMMANDS.values():
            key = content.translate("console_space") if command.key == " " else command.key
            assert f" {key}  {content.translate('command_' + command.name)}" in shown
    assert content.translate("console_quit") in shown
    assert content.translate("state_border").upper() in shown


@pytest.mark.parametrize(
    "typed, keys",
    [("b \u00fc", "b \u00fc"), ("\x1b[A", ""), ("\x1bOS", ""), ("\x1b[As", "s"), ("\x1b[15~\x1b[1;5C ", " ")],
)
def test_keys_are_distinguished_from_escape_sequences(typed, keys):
    assert extract_keys(typed) == keys


def test_every_command_is_one_key_that_no_function_key_ends_with():
    assert sorted(COMMAND_KEYS.values()) == sorted(COMMANDS)
    assert QUIT_KEY not in COMMAND_KEYS
    assert all(len(key) == 1 and key == key.lower() for key in COMMAND_KEYS)
    # on a slow connection the end of a function key's sequence arrives separately
    assert not set("ABCDFHPQRS~0123456789;[") & set(COMMAND_KEYS)
