"""Repeated commands, doubts about a drawing, when a preview is made again, and what was undone."""

import dataclasses
import itertools
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from geometry_msgs.msg import Point
from hypothesis import given, strategies as st

from vb_core.notices import Notice, Severity
from vb_msgs.msg import VirtualBorder
from vb_voice_wizard.command_answers import Answer, AnswerCache
from vb_voice_wizard.preview.preview_scheduler import MAX_TIME_SHARE, PREVIEW_PERIOD, DrawingWarnings, PreviewInputs
from vb_voice_wizard.preview.preview_scheduler import PreviewScheduler, comparison_key
from vb_voice_wizard.interaction_manager_node import _describe_change


# ------------------------------------------------------------------ repeated commands
def counted():
    """Returns a command whose answers say how often it was carried out."""
    return map(lambda count: Answer(True, "border_removed", {"borders": count}), itertools.count(1)).__next__


def test_the_same_id_is_carried_out_once_and_gets_the_same_answer():
    cache, do = AnswerCache(5.0), counted()
    # a command without an id is carried out each time
    answers = [cache.answer_once(identity, do).values["borders"] for identity in ("a", "a", "b", "", "", "a")]
    assert answers == [1, 1, 2, 3, 4, 1]


@pytest.mark.parametrize("patience, code", [(60.0, "saved"), (0.0, "busy")])
def test_a_repetition_waits_for_the_first_one_for_a_time(patience, code):
    cache, began, go_on = AnswerCache(patience), threading.Event(), threading.Event()

    def slow():
        began.set()
        assert go_on.wait(60)
        return Answer(True, "saved")

    with ThreadPoolExecutor() as pool:
        first = pool.submit(cache.answer_once, "a", slow)
        assert began.wait(60)
        second = pool.submit(cache.answer_once, "a", slow)
        if patience == 0.0:
            assert second.result(60).code == code
        go_on.set()
    assert (first.result().code, second.result().code) == ("saved", code)


def test_a_fault_is_not_an_answer():
    cache, do = AnswerCache(5.0), counted()
    with pytest.raises(ZeroDivisionError):
        cache.answer_once("a", lambda: Answer(1 // 0, ""))
    assert cache.answer_once("a", do).values == {"borders": 1}


def test_only_the_newest_answers_are_kept():
    cache, do = AnswerCache(5.0), counted()
    for number in range(1000):
        cache.answer_once(str(number), do)
    assert cache.answer_once("999", do).values == {"borders": 1000}
    assert cache.answer_once("899", do).values == {"borders": 1001}


# ------------------------------------------------------------------ doubts about a drawing
SILENT = Notice("camera_silent", Severity.ERROR, camera="south", values={"camera": "south"})


@pytest.mark.parametrize("drawing_first", [True, False])
def test_camera_error_is_remembered_until_the_next_drawing(drawing_first):
    warnings = DrawingWarnings()
    steps = [warnings.start, lambda: warnings.update([SILENT])]
    for step in steps if drawing_first else reversed(steps):
        step()
    for _ in range(2):
        assert warnings.all == (SILENT,)
        warnings.update([])
        assert [(notice.code, notice.camera) for notice in warnings.all] == [("camera_failed_meanwhile", "south")]
        warnings.update([SILENT])
    warnings.update([])
    warnings.start()
    assert not warnings.all


@pytest.mark.parametrize(
    "notice, doubtful",
    [
        (Notice("strokes_left_out", Severity.WARNING), True),
        (Notice("piece_unseen", Severity.WARNING), True),
        (Notice("seed_held_elsewhere", Severity.WARNING), True),
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


# ------------------------------------------------------------------ when a preview is made again
CHAIN, SEED = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]), np.array([[0.5, 0.5]])
DRAWN = PreviewInputs("i1", comparison_key(CHAIN), comparison_key(SEED), (7.0, 3))


def changed(**changes) -> PreviewInputs:
    return dataclasses.replace(DRAWN, **changes)


def shown(took=0.0, answered=True) -> PreviewScheduler:
    """Returns a scheduler after a preview of DRAWN, which began at 100 s."""
    scheduler = PreviewScheduler()
    scheduler.record_preview(DRAWN, 100.0, 100.0 + took, answered)
    return scheduler


@pytest.mark.parametrize(
    "scheduler, inputs, now, delay",
    [
        (PreviewScheduler(), PreviewInputs(), 0.0, 0.0),  # the first preview is due at once
        (PreviewScheduler(), DRAWN, 0.0, 0.0),
        (shown(), DRAWN, 1e9, None),  # no preview while nothing visible changes
        (shown(), changed(chain=comparison_key(CHAIN + 0.009), seed=comparison_key(SEED - 0.009)), 1e9, None),
        (shown(), PreviewInputs(), 100.0, 0.0),  # another interaction is shown at once
        (shown(), changed(interaction_id="i2"), 100.0, 0.0),
        (shown(answered=False), DRAWN, 101.5, 0.5),  # a missing neighbour is asked again
        (shown(answered=False), DRAWN, 103.0, 0.0),
    ],
)
def test_a_preview_is_due_at_first_for_another_interaction_and_for_a_retry(scheduler, inputs, now, delay):
    assert scheduler.delay(inputs, now) == (delay and pytest.approx(delay))


@pytest.mark.parametrize(
    "inputs",
    [
        changed(chain=comparison_key(CHAIN + 0.03)),
        changed(chain=comparison_key(CHAIN[:2])),
        changed(seed=comparison_key(SEED + 0.03)),
        changed(seed=comparison_key(np.zeros((0, 2)))),
        changed(borders=(7.0, 4)),
        changed(borders=(7.1, 3)),
        changed(warnings=(Notice("cameras_disagree"),)),
    ],
)
def test_a_visible_change_is_previewed_after_the_period(inputs):
    assert shown().delay(inputs, 100.2) == pytest.approx(0.3)
    assert shown().delay(inputs, 100.5) == 0.0


def test_slow_changes_add_up():
    scheduler, drifting = shown(), [changed(seed=comparison_key(SEED + step * 0.008)) for step in (1, 2)]
    assert [scheduler.delay(inputs, 200.0) for inputs in drifting] == [None, 0.0]


@given(st.floats(0.0, 100.0))
def test_previews_take_no_more_than_their_share(took):
    moved = changed(seed=comparison_key(SEED + 1.0))
    pause = shown(took=took).delay(moved, 100.0 + took)
    assert took + pause == pytest.approx(max(PREVIEW_PERIOD, took / MAX_TIME_SHARE))


@pytest.mark.parametrize("missing", ["interaction_id", "chain", "seed"])
def test_nothing_is_previewed_before_there_are_border_and_seed(missing):
    assert (
        DRAWN.is_complete and not changed(**{missing: PreviewInputs.__dataclass_fields__[missing].default}).is_complete
    )


# ------------------------------------------------------------------ what was undone
def rug(**changes):
    return VirtualBorder(**{"id": "b1", "name": "Rug", "enabled": True, **changes})


RUG, OFF, BED = rug(), rug(enabled=False), VirtualBorder(id="b2", name="Bed", enabled=True)
IDLE = VirtualBorder(id="b2", name="Bed", enabled=True, reason="inactive_on_this_map")  # as the map integrator fills in


@pytest.mark.parametrize(
    "command, before, after, code, name",
    [
        ("undo", [RUG, BED], [RUG], "border_removed", "Bed"),
        ("undo", [RUG], [RUG, BED], "border_restored", "Bed"),
        ("undo", [RUG, BED], [OFF, IDLE], "border_disabled", "Rug"),
        ("undo", [OFF, BED], [RUG, BED], "border_enabled", "Rug"),
        ("undo", [RUG, BED], [rug(name="Carpet"), BED], "change_undone", "Carpet"),
        ("redo", [RUG, BED], [rug(name="Carpet"), BED], "change_redone", "Carpet"),
        ("undo", [RUG, BED], [rug(robots=["ada"]), BED], "change_undone", "Rug"),
        ("undo", [RUG, BED], [rug(occupancy=0.5), BED], "change_undone", "Rug"),
        ("undo", [RUG, BED], [rug(seed=Point(0.05, 0.0, 0.0)), BED], "change_undone", "Rug"),
        # displaced slightly on a map that has grown, which is no change
        ("undo", [RUG, BED], [rug(seed=Point(1e-3, 0.0, 0.0)), BED], "borders_changed", None),
        ("undo", [RUG], [OFF, BED], "borders_changed", None),
        ("undo", [RUG, IDLE], [RUG, BED], "borders_changed", None),
    ],
)
def test_what_was_undone_is_named(command, before, after, code, name):
    by_id = [{border.id: border for border in borders} for borders in (before, after)]
    answer = _describe_change(command, *by_id)
    assert (answer.code, answer.values.get("borders")) == (code, name)
