"""What border_fusion says when an extraction fails; its other tests are in rostest_border_fusion.py."""

from unittest.mock import Mock

import pytest
import rospy

from vb_fusion.border_fusion_node import BorderFusionNode


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
