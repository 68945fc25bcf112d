"""Doubts about a drawing, and when a preview is made again."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, strategies as st

from vb_core.notices import Notice, Severity
from vb_interaction.border_preview import MAX_TIME_SHARE, PREVIEW_PERIOD, DrawingWarnings, PreviewInputs
from vb_interaction.border_preview import PreviewScheduler, comparison_key

SILENT = Notice("camera_silent", Severity.ERROR, camera="south", values={"camera": "south"})


def test_camera_error_is_remembered_until_the_next_drawing():
    warnings = DrawingWarnings()
    warnings.update([SILENT], is_new_drawing=True)
    for _ in range(2):
        assert warnings.all == (SILENT,)
        warnings.update([])
        assert [(notice.code, notice.camera) for notice in warnings.all] == [("camera_failed_meanwhile", "south")]
        warnings.update([SILENT])
    warnings.update([], is_new_drawing=True)
    assert not warnings.all


DOUBTS = [Notice(code, Severity.WARNING) for code in ("strokes_left_out", "piece_unseen", "seed_held_elsewhere")]
OTHERS = [Notice("camera_silent", Severity.WARNING, camera="south"), Notice("robot_lost", Severity.ERROR, robot="ada")]


@pytest.mark.parametrize("notice", [*DOUBTS, *OTHERS])
def test_only_notices_about_left_out_spots_are_doubts(notice):
    warnings = DrawingWarnings()
    warnings.update([notice])
    assert warnings.all == ((notice,) if notice in DOUBTS else ())
    warnings.update([])
    assert not warnings.all


CHAIN, SEED = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]), np.array([[0.5, 0.5]])
DRAWN = PreviewInputs("i1", comparison_key(CHAIN), comparison_key(SEED), (7.0, 3))


def vary(**changes) -> PreviewInputs:
    return dataclasses.replace(DRAWN, **changes)


def new_scheduler(took=0.0, answered=True) -> PreviewScheduler:
    """Returns a scheduler after a preview of DRAWN, which began at 100 s."""
    scheduler = PreviewScheduler()
    scheduler.record_preview(DRAWN, 100.0, 100.0 + took, answered)
    return scheduler


@pytest.mark.parametrize(
    "scheduler, inputs, now, delay",
    [
        (PreviewScheduler(), PreviewInputs(), 0.0, 0.0),  # the first preview is due at once
        (PreviewScheduler(), DRAWN, 0.0, 0.0),
        (new_scheduler(), DRAWN, 1e9, None),  # no preview while nothing visible changes
        (new_scheduler(), vary(chain=comparison_key(CHAIN + 0.009), seed=comparison_key(SEED - 0.009)), 1e9, None),
        (new_scheduler(), PreviewInputs(), 100.0, 0.0),  # another interaction is shown at once
        (new_scheduler(), vary(interaction_id="i2"), 100.0, 0.0),
        (new_scheduler(answered=False), DRAWN, 101.5, 0.5),  # a missing neighbour is asked again
        (new_scheduler(answered=False), DRAWN, 103.0, 0.0),
    ],
)
def test_a_preview_is_due_at_first_for_another_interaction_and_for_a_retry(scheduler, inputs, now, delay):
    assert scheduler.delay(inputs, now) == delay


@pytest.mark.parametrize(
    "inputs",
    [
        vary(chain=comparison_key(CHAIN + 0.03)),
        vary(chain=comparison_key(CHAIN[:2])),
        vary(seed=comparison_key(SEED + 0.03)),
        vary(seed=comparison_key(np.zeros((0, 2)))),
        vary(borders=(7.0, 4)),
        vary(borders=(7.1, 3)),
        vary(warnings=(Notice("cameras_disagree"),)),
    ],
)
def test_a_visible_change_is_previewed_after_the_period(inputs):
    assert new_scheduler().delay(inputs, 100.2) == pytest.approx(0.3)
    assert new_scheduler().delay(inputs, 100.5) == 0.0


def test_slow_changes_add_up():
    drifting = [vary(seed=comparison_key(SEED + step * 0.008)) for step in (1, 2)]
    assert [new_scheduler().delay(inputs, 200.0) for inputs in drifting] == [None, 0.0]


@given(st.floats(0.0, 100.0))
def test_previews_take_no_more_than_their_share(took):
    moved = vary(seed=comparison_key(SEED + 1.0))
    pause = new_scheduler(took=took).delay(moved, 100.0 + took)
    assert took + pause == pytest.approx(max(PREVIEW_PERIOD, took / MAX_TIME_SHARE))


@pytest.mark.parametrize("missing", ["interaction_id", "chain", "seed"])
def test_nothing_is_previewed_before_there_are_border_and_seed(missing):
    assert DRAWN.is_complete
    assert not vary(**{missing: getattr(PreviewInputs(), missing)}).is_complete
