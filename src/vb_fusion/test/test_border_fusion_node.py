"""The shutdown of the node border_fusion, step by step; its other tests are in rostest_border_fusion.py."""

from unittest.mock import Mock

import pytest
import rospy

from vb_fusion.border_fusion_node import BorderFusionNode


@pytest.fixture
def node():
    """A node that has only its worker."""
    found = BorderFusionNode.__new__(BorderFusionNode)
    found._closing, found._failure = False, None
    found._changed, found._tick, found._publish_notices = Mock(), Mock(), Mock()
    return found


def test_a_node_that_was_closed_says_nothing_more(node):
    node._changed.wait.side_effect = lambda _: setattr(node, "_closing", True)  # while the worker waits
    node._work()
    assert not node._publish_notices.called


def test_topics_that_close_first_are_no_fault(node, monkeypatch):
    node._publish_notices.side_effect = rospy.ROSException("publish() to a closed topic")
    monkeypatch.setattr(rospy, "is_shutdown", lambda: node._publish_notices.called)
    node._work()
    assert node._publish_notices.call_count == 1
