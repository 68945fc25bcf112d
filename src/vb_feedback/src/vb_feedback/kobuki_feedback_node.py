"""Node: light and sound on a Kobuki base."""
from __future__ import annotations

import importlib
from types import ModuleType

import rospy
from vb_core import names
from vb_core.errors import CodedError
from vb_core.ros import node, parameters
from vb_msgs.msg import InteractionState, Sound

from vb_feedback.kobuki import KobukiParams


class KobukiFeedback:
    """Shows states by an LED of the base, plays sounds on its beeper.

    Subscribed topics:
        /virtual_borders/state (vb_msgs/InteractionState), /virtual_borders/sound (vb_msgs/Sound)

    Published topics:
        mobile_base/commands/led1 (kobuki_msgs/Led, latched), mobile_base/commands/sound (kobuki_msgs/Sound)

    Args:
        params: see config/kobuki_feedback.yaml.
        messages: the module kobuki_msgs.msg.
    """

    def __init__(self, params: KobukiParams, messages: ModuleType) -> None:
        self._params = params
        self._messages = messages
        self._lit = ""
        self._led = rospy.Publisher("mobile_base/commands/led1", messages.Led, queue_size=1, latch=True)
        self._sound = rospy.Publisher("mobile_base/commands/sound", messages.Sound, queue_size=5)
        rospy.Subscriber(names.STATE, InteractionState, self._on_state, queue_size=5)
        rospy.Subscriber(names.SOUND, Sound, self._on_sound, queue_size=5)

    def _on_state(self, message: InteractionState) -> None:
        light = self._params.led(message.name)
        if light != self._lit:
            self._lit = light
            self._led.publish(self._messages.Led(value=getattr(self._messages.Led, light)))

    def _on_sound(self, message: Sound) -> None:
        beep = self._params.beep(message.name)
        if beep:
            self._sound.publish(self._messages.Sound(value=getattr(self._messages.Sound, beep)))


def _build() -> KobukiFeedback:
    params = parameters.read(KobukiParams)
    try:
        # by name: the package is not a dependency, only robots with this base have it
        messages = importlib.import_module("kobuki_msgs.msg")
    except ImportError:
        raise CodedError(
            "no_kobuki", "the package kobuki_msgs is not installed on this computer; without a Kobuki base leave this node out"
        ) from None
    return KobukiFeedback(params, messages)


def main() -> None:
    """Runs the node."""
    node.run("kobuki_feedback", _build)
