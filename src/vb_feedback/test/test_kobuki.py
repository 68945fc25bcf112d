"""Light and sound on a Kobuki base, whose messages need not be installed."""

from __future__ import annotations

from types import SimpleNamespace

import rospy

from vb_feedback.kobuki_feedback_node import KobukiFeedbackNode
from vb_msgs.msg import InteractionState, Sound


class KobukiMessages:
    """The messages of kobuki_msgs, with the package's own constants."""

    class Led(SimpleNamespace):
        BLACK, GREEN, ORANGE, RED = range(4)

    class Sound(SimpleNamespace):
        ON, OFF, RECHARGE, BUTTON, ERROR, CLEANINGSTART, CLEANINGEND = range(7)


def test_lights_show_the_state_and_the_stop_and_errors_beep(monkeypatch):
    sent = []
    monkeypatch.setattr(rospy, "Subscriber", lambda *_args, **_named: None)
    monkeypatch.setattr(
        rospy,
        "Publisher",
        lambda topic, *_args, **_named: SimpleNamespace(
            publish=lambda message: sent.append((topic.rsplit("/", 1)[1], message.value))
        ),
    )
    node, red = KobukiFeedbackNode(KobukiMessages), KobukiMessages.Led.RED
    node._on_state(InteractionState(name="guide"))
    node._on_state(InteractionState(name="guide", border_s=1.0))  # the same lights: nothing is sent
    node._on_state(InteractionState(name="default"))
    node._on_state(InteractionState(name="guide", stopped=True))
    assert sent == [("led1", red), ("led2", 0), ("led1", 0), ("led2", 0), ("led1", red), ("led2", red)]
    sent.clear()
    for name in ("tick", "error", "no such sound"):
        node._on_sound(Sound(name=name))
    assert sent == [("sound", KobukiMessages.Sound.ERROR)]
