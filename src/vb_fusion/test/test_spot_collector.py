"""Which spots belong to an interaction, and the share of time that the live extraction takes."""

import numpy as np
import pytest
from generated_strokes import Setting, draw
from vb_testing import assert_fields
from vb_core.interaction_tables import BORDER, DEFAULT, GUIDE, SEED
from vb_fusion.extraction import ExtractionParams, LiveExtractor, extract_border
from vb_fusion import spot_collector as collecting
from vb_fusion.spot_collector import SpotCollector, FloorSpot


def spot(stamp, x=0.0, y=0.0, camera="red"):
    """Returns a spot of a camera."""
    return FloorSpot(stamp, x, y, camera)


def in_border(entered=0.0):
    """Returns a collector in the state Border of the interaction a."""
    collector = SpotCollector()
    collector.set_state(BORDER, "a", entered)
    return collector


def test_collects_in_border_and_seed_of_an_interaction_until_the_next():
    collector = SpotCollector()
    assert collector.add(spot(1.0)) == "state"
    # drawing is interrupted and continued
    for entered, state in enumerate((BORDER, GUIDE, BORDER, SEED, DEFAULT), start=2):
        is_new = collector.set_state(state, "" if state == DEFAULT else "a", float(entered))
        assert is_new == (entered == 2)
        assert collector.add(spot(entered + 0.1)) == ("" if state.collects else "state")
    assert collector.counts == (2, 1, 2)
    assert collector.snapshot().counts[0] == 2
    assert collector.set_state(BORDER, "b", 7.0)
    assert collector.counts == (0, 0, 0)


def test_early_and_non_finite_spots_are_ignored_and_counted():
    collector = in_border(10.0)
    reasons = [collector.add(spot(*place)) for place in ((9.94,), (11.0, np.nan), (np.inf,), (9.96,))]
    assert reasons == ["before_state", "not_finite", "not_finite", ""]
    # spots of different cameras may arrive out of order
    assert collector.add(spot(10.5, camera="green")) == ""
    assert collector.add(spot(10.2, camera="blue")) == ""
    assert collector.counts == (3, 0, 3)
    assert collector.ignored["before_state"] == 1
    assert collector.snapshot().cameras == ["red", "green", "blue"]


@pytest.mark.parametrize("spots", [0, 1])
@pytest.mark.parametrize("drawn_in", [BORDER, SEED])
@pytest.mark.parametrize("outcome", ["", "saved", "cancelled", "abandoned"])
def test_a_drawing_without_an_outcome_is_lost(outcome, drawn_in, spots):
    """A restarted manager reports Default without an outcome; a drawing without spots has nothing to lose."""
    collector = SpotCollector()
    collector.set_state(DEFAULT, "", 0.0)
    collector.set_state(drawn_in, "a", 1.0)
    assert not collector.is_incomplete
    for number in range(spots):
        collector.add(spot(1.5 + number))
    is_lost = spots > 0 and not outcome
    for _ in range(2):  # the state is repeated
        collector.set_state(DEFAULT, "", 4.0, outcome)
        assert_fields(collector, is_incomplete=is_lost, may_clear=is_lost or outcome in ("cancelled", "abandoned"))
    collector.clear()
    assert_fields(collector, is_incomplete=is_lost, may_clear=False)
    collector.set_state(DEFAULT, "", 4.0, outcome)
    assert not collector.may_clear
    collector.set_state(BORDER, "b", 5.0, outcome)
    assert not collector.is_incomplete


def test_a_drawing_begun_before_the_collector_is_lost():
    collector = in_border()
    collector.set_state(SEED, "a", 1.0)
    assert collector.is_incomplete
    collector.set_state(DEFAULT, "", 2.0, "cancelled")
    assert_fields(collector, is_incomplete=False, may_clear=True)
    collector.set_state(BORDER, "b", 3.0, "cancelled")
    assert_fields(collector, is_incomplete=False, may_clear=False)


@pytest.mark.parametrize("count", [1000, 2600])
def test_a_full_store_keeps_the_whole_drawing_and_every_camera(count, monkeypatch):
    monkeypatch.setattr(collecting, "MAX_SPOTS", 200)
    collector = in_border()
    for k in range(count):
        if k == 150:
            early = collector.snapshot().border
        collector.add(spot(0.02 * k, x=k / count, camera=("red", "green")[k % 2]))
    assert collector.counts[0] == count
    spots = collector.snapshot().border
    collector.set_state(BORDER, "b", 0.02 * count)
    collector.add(spot(0.02 * count))
    assert early["stamps"].tolist() == [0.02 * k for k in range(150)]  # later spots do not change an earlier snapshot
    assert len(spots) <= 200
    x = spots["points"][:, 0]
    assert x[0] < 0.05
    assert x[-1] > 0.95
    red, green = np.bincount(spots["cameras"])
    assert red == pytest.approx(green, rel=0.1)


@pytest.mark.parametrize("count", [400, 600])
def test_a_clock_that_is_set_back_while_somebody_draws_is_undone_for_every_camera(count):
    """Blue sees the spot only later, when the stamps of the clock that was set back fall among those of the others."""
    collector = in_border(107.0)
    for k in range(count):
        back = 5.0 if k >= 200 else 0.0
        camera = ("red", "green")[k % 2] if k < 400 else "blue"
        collector.add(spot(110.0 + 0.02 * k - back, x=0.01 * k, camera=camera))
    collector.add(spot(110.0 + 0.02 * count, x=0.01 * count, camera="of another computer"))
    spots = collector.snapshot().border
    assert len(spots) == count - 1
    assert collector.ignored["clock"] == 2  # the first spot of red and of green after it
    x_in_order_of_stamps = spots["points"][np.argsort(spots["stamps"], kind="stable"), 0]
    assert np.diff(x_in_order_of_stamps).min() > -0.05
    assert np.ptp(spots["stamps"]) == pytest.approx(0.02 * count, abs=0.2)


def test_a_single_old_spot_is_ignored_and_does_not_reset_the_clock():
    collector = in_border(100.0)
    reasons = [collector.add(spot(stamp)) for stamp in (110.0, 80.0, 110.1, 110.2)]
    assert reasons == ["", "clock", "", ""]
    assert collector.snapshot().border["stamps"].tolist() == [110.0, 110.1, 110.2]


def test_a_camera_with_wrong_clock_or_frame_is_ignored_and_named():
    collector = in_border(1000.0)
    assert collector.add(spot(1001.0), now=1001.1) == ""
    assert collector.add(spot(1001.0 + 86400.0, camera="robot"), now=1001.1) == "clock"
    assert collector.add(spot(1.0, camera="blue"), now=1001.1) == "before_state"
    collector.ignore_frame("green")
    clock = "camera_clock_off"
    assert collector.faults == {(clock, "robot"), (clock, "blue"), ("spots_wrong_frame", "green")}
    assert collector.counts == (1, 0, 3)


def test_a_camera_sees_the_spot_until_its_last_one_is_too_old():
    collector = SpotCollector()
    collector.add(spot(10.0, camera="red"))
    collector.add(spot(12.0, camera="green"))
    assert collector.cameras_seeing(12.1, 0.5) == ["green"]
    collector.add(spot(1.0, camera="green"))  # its clock was set back
    assert collector.cameras_seeing(1.1, 0.5) == ["green"]


def test_live_extraction_keeps_to_its_share():
    collector = in_border()
    for k in range(100):
        collector.add(spot(0.04 * k, x=0.02 * k))
    ticks = iter(np.arange(0.0, 1000.0, 0.5))
    live = LiveExtractor(ExtractionParams(), share=0.1)
    first = live.update(collector.snapshot(), lambda: next(ticks))
    assert first.chain is not None
    assert first.seed is None
    assert first.seed_error.code == "no_spots"
    assert live.update(collector.snapshot(), lambda: next(ticks)) is first  # nothing new
    collector.add(spot(5.0, x=2.02))
    assert live.update(collector.snapshot(), lambda: next(ticks)) is first  # too early
    assert live.update(collector.snapshot(), lambda: next(ticks), force=True) is not first


def test_live_and_final_border_are_the_same(monkeypatch):
    """This holds whatever was extracted before, for two cameras, of whose spots the collector could not keep all."""
    monkeypatch.setattr(collecting, "MAX_SPOTS", 400)
    collector = in_border()
    live = LiveExtractor(ExtractionParams(), share=1.0)
    stroke = draw("rectangle", Setting(), np.random.default_rng(4))
    for number, row in enumerate(np.argsort(stroke.stamps)):
        collector.add(spot(stroke.stamps[row], *stroke.points[row], camera=str(stroke.cameras[row])))
        if number % 50 == 0:
            live.update(collector.snapshot(), float, force=True)
    drawn = live.update(collector.snapshot(), float, force=True).chain
    again = LiveExtractor(ExtractionParams(), share=1.0).update(collector.snapshot(), float, force=True).chain
    spots = collector.snapshot().border
    final = extract_border(spots["points"], stamps=spots["stamps"], cameras=spots["cameras"])
    assert len(spots) < len(stroke.points)
    assert final.closed
    assert drawn.points == pytest.approx(final.points, abs=1e-9)
    assert again.points == pytest.approx(final.points, abs=1e-9)
