"""Which spots belong to an interaction, and the live candidate's thrift."""

import numpy as np
import pytest
from strokes import Setting, draw

from vb_core.vocabulary import BORDER, DEFAULT, GUIDE, SEED
from vb_fusion.extraction import ExtractionParams, extract_border
from vb_fusion.live_extraction import LiveExtractor
from vb_fusion.collector import Collector, CollectorParams, FloorSpot


def spot(stamp, x=0.0, y=0.0, camera="red"):
    return FloorSpot(stamp, x, y, camera)


def test_collects_in_border_and_seed_only():
    collector = Collector()
    assert collector.add(spot(1.0)) == "state"
    assert collector.set_state(BORDER, "a", 2.0)
    assert collector.add(spot(2.1)) == ""
    assert not collector.set_state(GUIDE, "a", 3.0)
    assert collector.add(spot(3.1)) == "state"
    collector.set_state(SEED, "a", 4.0)
    assert collector.add(spot(4.1)) == ""
    collector.set_state(DEFAULT, "", 5.0)
    assert collector.add(spot(5.1)) == "state"
    assert collector.counts == (1, 1, 2)


def test_spots_from_before_the_state_are_ignored_and_counted():
    collector = Collector(CollectorParams(stamp_tolerance=0.0))
    collector.set_state(BORDER, "a", 10.0)
    assert collector.add(spot(9.9)) == "before_state"
    assert collector.add(spot(10.0)) == ""
    # cameras out of order among themselves do no harm
    assert collector.add(spot(10.5, camera="green")) == ""
    assert collector.add(spot(10.2, camera="blue")) == ""
    assert collector.ignored["before_state"] == 1
    assert collector.collection().cameras == ["red", "green", "blue"]


def test_not_finite_spots_are_counted():
    collector = Collector()
    collector.set_state(BORDER, "a", 0.0)
    assert collector.add(spot(1.0, float("nan"))) == "not_finite"
    assert collector.add(spot(float("inf"))) == "not_finite"
    assert collector.counts == (0, 0, 2)


def test_a_new_interaction_starts_empty_and_an_old_one_stays_until_then():
    collector = Collector()
    collector.set_state(BORDER, "a", 0.0)
    collector.add(spot(1.0))
    collector.set_state(DEFAULT, "", 2.0)
    assert collector.collection().border_total == 1
    assert collector.set_state(BORDER, "b", 3.0)
    assert collector.counts == (0, 0, 0)
    collector.add(spot(4.0))
    # drawing is interrupted and continued
    collector.set_state(GUIDE, "b", 5.0)
    collector.set_state(BORDER, "b", 6.0)
    collector.add(spot(7.0))
    assert collector.collection().border_total == 2


def test_memory_is_bounded_and_the_whole_drawing_stays():
    collector = Collector(CollectorParams(max_spots=100))
    collector.set_state(BORDER, "a", 0.0)
    for k in range(1000):
        collector.add(spot(float(k), x=k / 1000.0))
    rows = collector.collection().border
    assert len(rows) <= 100 and collector.counts[0] == 1000
    assert rows[0, 1] < 0.05 and rows[-1, 1] > 0.95


def test_a_full_collection_keeps_every_camera():
    collector = Collector(CollectorParams(max_spots=1000))
    collector.set_state(BORDER, "a", 0.0)
    for k in range(2600):
        collector.add(spot(0.02 * k, camera=("red", "green")[k % 2]))
    counts = np.bincount(collector.collection().border[:, 4].astype(int))
    assert counts.min() > 0.9 * counts.max()


def test_a_clock_that_is_set_back_while_somebody_draws_is_undone():
    collector = Collector()
    collector.set_state(BORDER, "a", 100.0)
    for k in range(400):
        back = 5.0 if k >= 200 else 0.0
        collector.add(spot(110.0 + 0.02 * k - back, x=0.01 * k, camera=("red", "green")[k % 2]))
    rows = collector.collection().border
    assert len(rows) == 398 and collector.ignored["clock"] == 2  # each camera's first after it
    order = np.argsort(rows[:, 0], kind="stable")
    assert np.diff(rows[order, 1]).min() > -0.05
    assert np.ptp(rows[:, 0]) == pytest.approx(8.0, abs=0.2)


def test_one_old_message_is_no_clock_that_was_set_back():
    collector = Collector()
    collector.set_state(BORDER, "a", 100.0)
    stamps = [110.0, 80.0, 110.1, 110.2]
    assert [collector.add(spot(stamp)) for stamp in stamps] == ["", "clock", "", ""]
    assert collector.collection().border[:, 0].tolist() == [110.0, 110.1, 110.2]


def test_a_camera_whose_clock_is_off_is_left_out_and_named():
    collector = Collector()
    collector.set_state(BORDER, "a", 1000.0)
    assert collector.add(spot(1001.0), now=1001.1) == ""
    assert collector.add(spot(1001.0 + 86400.0, camera="robot"), now=1001.1) == "clock"
    assert collector.add(spot(1.0, camera="blue"), now=1001.1) == "before_state"
    assert collector.wrong_clocks == {"robot", "blue"}
    assert collector.counts == (1, 0, 2)


def test_seeing():
    collector = Collector()
    collector.add(spot(10.0, camera="red"))
    collector.add(spot(12.0, camera="green"))
    assert collector.cameras_seeing(12.1) == ["green"]
    collector.add(spot(1.0, camera="green"))  # the clock was set back
    assert collector.cameras_seeing(1.1) == ["green"]


def test_live_candidate_keeps_to_its_share():
    collector = Collector()
    collector.set_state(BORDER, "a", 0.0)
    for k in range(100):
        collector.add(spot(0.04 * k, x=0.02 * k))
    ticks = iter(np.arange(0.0, 1000.0, 0.5))
    live = LiveExtractor(ExtractionParams(), share=0.1)
    first = live.update(collector.collection(), lambda: next(ticks))
    assert first.chain is not None and first.seed is None and first.no_seed.code == "no_spots"
    assert live.update(collector.collection(), lambda: next(ticks)) is first  # nothing new
    collector.add(spot(5.0, x=2.02))
    assert live.update(collector.collection(), lambda: next(ticks)) is first  # too early
    assert live.update(collector.collection(), lambda: next(ticks), force=True) is not first


def test_live_and_final_border_are_the_same():
    """Whatever was extracted before: of two cameras in step, of which the collector could not keep all spots."""
    collector, live = Collector(CollectorParams(max_spots=400)), LiveExtractor(ExtractionParams(), share=1.0)
    collector.set_state(BORDER, "a", 0.0)
    stroke = draw("rectangle", Setting(), np.random.default_rng(4))
    for number, row in enumerate(np.argsort(stroke.stamps)):
        collector.add(spot(stroke.stamps[row], *stroke.points[row], camera=str(stroke.cameras[row])))
        if number % 50 == 0:
            live.update(collector.collection(), float, force=True)
    drawn = live.update(collector.collection(), float, force=True).chain
    again = LiveExtractor(ExtractionParams(), share=1.0).update(collector.collection(), float, force=True).chain
    rows = collector.collection().border
    final = extract_border(rows[:, 1:3], stamps=rows[:, 0], cameras=rows[:, 4].astype(int))
    assert len(rows) < len(stroke.points) and final.closed
    assert drawn.points == pytest.approx(final.points, abs=1e-9)
    assert again.points == pytest.approx(final.points, abs=1e-9)


def test_what_was_collected_is_not_changed_by_later_spots():
    collector = Collector(CollectorParams(max_spots=100))
    collector.set_state(BORDER, "a", 0.0)
    for k in range(90):
        collector.add(spot(float(k)))
    rows = collector.collection().border
    for k in range(90, 200):
        collector.add(spot(float(k)))
    collector.set_state(BORDER, "b", 200.0)
    collector.add(spot(300.0))
    assert rows[:, 0].tolist() == list(range(90))
