"""What makes a drawing doubtful: present errors of cameras, those that are over, and what is left out."""

import pytest

from vb_core.notices import Notice, Severity
from vb_voice_wizard.dialogue.drawing_warnings import DrawingWarnings

SILENT = Notice("camera_silent", Severity.ERROR, camera="south", values={"camera": "south"})


def codes(warnings):
    return [(warning.code, warning.camera) for warning in warnings.all]


def test_an_error_of_a_camera_is_remembered_until_the_next_drawing():
    warnings = DrawingWarnings()
    warnings.start()
    warnings.update([SILENT])
    assert warnings.all == (SILENT,)
    warnings.update([])
    assert codes(warnings) == [("camera_failed_meanwhile", "south")]
    warnings.update([SILENT])
    assert warnings.all == (SILENT,)
    warnings.update([])
    warnings.start()
    assert not warnings.all


def test_an_error_that_was_there_before_the_drawing_concerns_it_too():
    warnings = DrawingWarnings()
    warnings.update([SILENT])
    warnings.start()
    warnings.update([])
    assert codes(warnings) == [("camera_failed_meanwhile", "south")]


@pytest.mark.parametrize("code", ["strokes_left_out", "piece_unseen", "seed_held_elsewhere"])
def test_what_is_left_out_is_a_doubt_for_as_long_as_it_is_said(code):
    warnings = DrawingWarnings()
    warnings.start()
    warnings.update([Notice(code, Severity.WARNING)])
    assert codes(warnings) == [(code, "")]
    warnings.update([])
    assert not warnings.all


@pytest.mark.parametrize(
    "notice",
    [Notice("camera_silent", Severity.WARNING, camera="south"), Notice("robot_lost", Severity.ERROR, robot="ada")],
)
def test_other_notices_are_no_doubt(notice):
    warnings = DrawingWarnings()
    warnings.start()
    warnings.update([notice])
    assert not warnings.all
