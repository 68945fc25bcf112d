"""When a preview is made again."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vb_core.notices import Notice
from vb_voice_wizard.dialogue.preview_scheduler import MAX_TIME_SHARE, PERIOD, PreviewInputs, PreviewScheduler, places

CHAIN, SEED = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]), np.array([[0.5, 0.5]])
DRAWN = PreviewInputs("i1", places(CHAIN), places(SEED), (7.0, 3))


def changed(**changes) -> PreviewInputs:
    return dataclasses.replace(DRAWN, **changes)


def shown(
    situation: PreviewInputs = DRAWN, started: float = 100.0, took: float = 0.0, answered: bool = True
) -> PreviewScheduler:
    pace = PreviewScheduler()
    pace.record_preview(situation, started, started + took, answered)
    return pace


@pytest.mark.parametrize(
    "pace, now, at, delay",
    [
        (PreviewScheduler(), PreviewInputs(), 0.0, 0.0),  # the first one is due at once
        (PreviewScheduler(), DRAWN, 0.0, 0.0),
        (shown(), DRAWN, 1e9, None),  # nothing is done while nothing changes that can be seen
        (shown(), changed(chain=places(CHAIN + 0.009), seed=places(SEED - 0.009)), 1e9, None),
        (shown(), PreviewInputs(), 100.0, 0.0),  # another interaction is shown at once
        (shown(), changed(interaction_id="i2"), 100.0, 0.0),
        (shown(answered=False), DRAWN, 101.5, 0.5),  # a neighbour that is away is asked again
        (shown(answered=False), DRAWN, 103.0, 0.0),
    ],
)
def test_when_a_preview_is_due(pace, now, at, delay):
    assert pace.delay(now, at) == (delay and pytest.approx(delay))


@pytest.mark.parametrize(
    "now",
    [
        changed(chain=places(CHAIN + 0.03)),
        changed(chain=places(CHAIN[:2])),
        changed(seed=places(SEED + 0.03)),
        changed(seed=places(np.zeros((0, 2)))),
        changed(borders=(7.0, 4)),
        changed(borders=(7.1, 3)),
        changed(warnings=(Notice("cameras_disagree"),)),
    ],
)
def test_what_matters_is_looked_at_after_the_period(now):
    assert shown().delay(now, 100.2) == pytest.approx(0.3)
    assert shown().delay(now, 100.5) == 0.0


def test_slow_changes_add_up():
    pace, drifting = shown(), [changed(seed=places(SEED + step * 0.008)) for step in (1, 2)]
    assert [pace.delay(situation, 200.0) for situation in drifting] == [None, 0.0]


@given(st.floats(0.0, 100.0))
def test_previews_take_no_more_than_their_share(took):
    moved = changed(seed=places(SEED + 1.0))
    pause = shown(took=took).delay(moved, 100.0 + took)
    assert took + pause == pytest.approx(max(PERIOD, took / MAX_TIME_SHARE))


@pytest.mark.parametrize("missing", ["interaction_id", "chain", "seed"])
def test_nothing_is_previewed_before_there_are_border_and_seed(missing):
    assert DRAWN.complete and not changed(**{missing: PreviewInputs.__dataclass_fields__[missing].default}).complete
