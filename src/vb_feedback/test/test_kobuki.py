"""Lights and sounds on a Kobuki base."""

from types import SimpleNamespace

import pytest

from vb_core.vocabulary import STATES
from vb_feedback import kobuki_feedback_node
from vb_feedback.kobuki_feedback_node import KobukiFeedbackNode
from vb_msgs.msg import InteractionState


@pytest.mark.parametrize("stopped, expected", [(False, "BLACK"), (True, "RED")])
def test_a_stop_is_shown_beside_every_state(monkeypatch, stopped, expected):
    lit = {}
    monkeypatch.setattr(kobuki_feedback_node.rospy, "Subscriber", lambda *_args, **_options: None)
    monkeypatch.setattr(
        kobuki_feedback_node.rospy,
        "Publisher",
        lambda name, *_args, **_options: SimpleNamespace(publish=lambda led: lit.__setitem__(name[-4:], led.value)),
    )
    colors = {color: color for color in ("BLACK", "GREEN", "ORANGE", "RED")}
    messages = SimpleNamespace(Led=type("Led", (SimpleNamespace,), colors), Sound=None)
    node = KobukiFeedbackNode(messages)
    for state in STATES.values():
        node._on_state(InteractionState(name=state.name, stopped=stopped))
        assert lit == {"led1": state.led, "led2": expected}
