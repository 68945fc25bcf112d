"""What makes a drawing doubtful: present errors of cameras, those that are over, and what is left out."""

import pytest

from vb_core.notices import Notice, Severity
from vb_voice_wizard.dialogue.drawing_warnings import DrawingWarnings

SILENT = Notice("camera_silent", Severity.ERROR, camera="south", values={"camera": "south"})


@pytest.mark.parametrize("drawing_first", [True, False])
def test_camera_error_is_remembered_until_the_next_drawing(drawing_first):
    warnings = DrawingWarnings()
    for step in (warnings.start, lambda: warnings.update([SILENT]))[:: 1 if drawing_first else -1]:
        step()
    for _ in range(2):
        assert warnings.all == (SILENT,)
        warnings.update([])
        assert [(one.code, one.camera) for one in warnings.all] == [("camera_failed_meanwhile", "south")]
        warnings.update([SILENT])
    warnings.update([])
    warnings.start()
    assert not warnings.all


@pytest.mark.parametrize(
    "notice, doubtful",
    [
        *(
            (Notice(code, Severity.WARNING), True)
            for code in ("strokes_left_out", "piece_unseen", "seed_held_elsewhere")
        ),
        (Notice("camera_silent", Severity.WARNING, camera="south"), False),
        (Notice("robot_lost", Severity.ERROR, robot="ada"), False),
    ],
)
def test_only_notices_about_left_out_spots_are_doubts(notice, doubtful):
    warnings = DrawingWarnings()
    warnings.start()
    warnings.update([notice])
    assert warnings.all == ((notice,) if doubtful else ())
    warnings.update([])
    assert not warnings.all
