"""What makes a drawing doubtful: present errors of cameras, those that are over, and what is left out."""
import pytest

from vb_core.notices import Notice, Severity
from vb_voice_wizard.dialogue.doubts import Doubts

SILENT = Notice("camera_silent", Severity.ERROR, camera="south", values={"camera": "south"})
LEFT_OUT = Notice("strokes_left_out", Severity.WARNING, values={"spots": "20"})


def codes(doubts):
    return [(doubt.code, doubt.camera) for doubt in doubts.all]


def test_an_error_of_a_camera_is_remembered_until_the_next_drawing():
    doubts = Doubts()
    doubts.begin()
    doubts.hear([SILENT])
    assert doubts.all == (SILENT,)
    doubts.hear([])
    assert codes(doubts) == [("camera_failed_meanwhile", "south")]
    doubts.hear([SILENT])
    assert doubts.all == (SILENT,)
    doubts.hear([])
    doubts.begin()
    assert not doubts.all


def test_an_error_that_was_there_before_the_drawing_concerns_it_too():
    doubts = Doubts()
    doubts.hear([SILENT])
    doubts.begin()
    doubts.hear([])
    assert codes(doubts) == [("camera_failed_meanwhile", "south")]


def test_what_is_left_out_is_a_doubt_for_as_long_as_it_is_said():
    doubts = Doubts()
    doubts.begin()
    doubts.hear([LEFT_OUT])
    assert doubts.all == (LEFT_OUT,)
    doubts.hear([])
    assert not doubts.all


@pytest.mark.parametrize("notice", [
    Notice("camera_silent", Severity.WARNING, camera="south"), Notice("robot_lost", Severity.ERROR, robot="ada"),
])
def test_other_notices_are_no_doubt(notice):
    doubts = Doubts()
    doubts.begin()
    doubts.hear([notice])
    assert not doubts.all
