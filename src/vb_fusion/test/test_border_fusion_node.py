"""The end of the node border_fusion, step by step; all else is in rostest_border_fusion.py."""

from types import SimpleNamespace

import rospy

from vb_fusion.border_fusion_node import BorderFusionNode


def ending(at_wait, publish_notices):
    """A node that ends while its worker waits, or once that has published."""
    node = BorderFusionNode.__new__(BorderFusionNode)
    node._closing, node._failure = False, None
    node._changed = SimpleNamespace(wait=lambda _: at_wait(node), clear=lambda: None)
    node._tick, node._publish_notices = lambda _: True, publish_notices
    return node


def test_a_node_that_was_closed_says_nothing_more():
    said = []
    ending(lambda node: setattr(node, "_closing", True), lambda: said.append("notices"))._work()
    assert said == []


def test_topics_that_close_first_are_no_fault(monkeypatch):
    over = []

    def publish_notices():
        over.append(True)
        raise rospy.ROSException("publish() to a closed topic")

    monkeypatch.setattr(rospy, "is_shutdown", lambda: bool(over))
    ending(lambda _: False, publish_notices)._work()
    assert over == [True]
