"""What border_fusion does when an extraction fails or takes long; its other tests are in rostest_border_fusion.py."""

import threading
from unittest.mock import Mock

import pytest
import rospy

from vb_core.interaction_tables import BORDER, DEFAULT
from vb_fusion.border_fusion_node import BorderFusionNode
from vb_fusion.spot_collector import FloorSpot, SpotCollector


@pytest.mark.parametrize("shuts_down", [False, True])
def test_a_drawing_that_breaks_the_extraction_is_reported_until_the_next_one(shuts_down, monkeypatch):
    monkeypatch.setattr(rospy, "is_shutdown", lambda: shuts_down)
    monkeypatch.setattr(rospy, "logerr_throttle", Mock())
    node = BorderFusionNode.__new__(BorderFusionNode)
    node._failure = None
    node._publish_notices = Mock()
    node._tick = Mock(side_effect=[ZeroDivisionError(), True])
    node._publish(False)
    assert node._publish_notices.called != shuts_down
    assert (node._failure is None) == shuts_down
    node._publish(False)
    assert node._failure is None


def test_a_drawing_that_is_cancelled_during_an_extraction_is_shown_before_it_is_dropped():
    node = BorderFusionNode.__new__(BorderFusionNode)
    node._lock = threading.Lock()
    node._has_new_spots = False
    node._published = 0.0
    node._collector = SpotCollector()
    node._collector.set_state(BORDER, "one", 0.0)
    node._collector.add(FloorSpot(1.0, 2.0, 3.0, "red"))
    node._live = Mock()
    node._live.update.side_effect = lambda *_, **__: node._collector.set_state(DEFAULT, "", 2.0, "cancelled")
    node._progress_message = lambda snapshot, _drawn: snapshot.counts[0]
    node._progress = Mock()
    for spots_left in (1, 0):
        node._tick(True)
        node._progress.publish.assert_called_with(1)
        assert node._collector.counts[0] == spots_left
