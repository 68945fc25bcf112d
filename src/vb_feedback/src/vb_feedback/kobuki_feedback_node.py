"""Node: light and sound on a Kobuki base."""

from __future__ import annotations

import importlib
from types import ModuleType

import rospy
from vb_core import names
from vb_core.errors import CodedError
from vb_core.interaction_tables import state_by_name
from vb_core.sounds import SOUNDS
from vb_msgs.msg import InteractionState, Sound


class KobukiFeedbackNode:
    """Shows the state, and whether robots are stopped, on a Kobuki base's LEDs, and plays sounds on its beeper.

    Subscribed topics:
        /virtual_borders/state (vb_msgs/InteractionState), /virtual_borders/sound (vb_msgs/Sound)
    Published topics:
        mobile_base/commands/led1 (kobuki_msgs/Led, latched): the state
        mobile_base/commands/led2 (kobuki_msgs/Led, latched): red while robots are stopped
        mobile_base/commands/sound (kobuki_msgs/Sound)

    Args:
        messages: the module kobuki_msgs.msg.
    """

    def __init__(self, messages: ModuleType) -> None:
        self._messages = messages
        self._led_colors = ("", "")
        self._leds = [
            rospy.Publisher(f"mobile_base/commands/{led}", messages.Led, queue_size=1, latch=True)
            for led in ("led1", "led2")
        ]
        self._sound = rospy.Publisher("mobile_base/commands/sound", messages.Sound, queue_size=5)
        rospy.Subscriber(names.STATE, InteractionState, self._on_state, queue_size=5)
        rospy.Subscriber(names.SOUND, Sound, self._on_sound, queue_size=5)

    def _on_state(self, message: InteractionState) -> None:
        stop_color = "RED" if message.stopped else "BLACK"
        led_colors = (state_by_name(message.name).led, stop_color)
        if led_colors != self._led_colors:
            self._led_colors = led_colors
            for led, color in zip(self._leds, led_colors):
                led.publish(self._messages.Led(value=getattr(self._messages.Led, color)))

    def _on_sound(self, message: Sound) -> None:
        beep = SOUNDS[message.name].beep if message.name in SOUNDS else ""
        if beep:
            self._sound.publish(self._messages.Sound(value=getattr(self._messages.Sound, beep)))


def build() -> KobukiFeedbackNode:
    """Constructs the node. Raises CodedError "no_kobuki" if kobuki_msgs is not installed."""
    try:
        # imported by name: the package is not a dependency, because only robots with this base have it
        messages = importlib.import_module("kobuki_msgs.msg")
    except ImportError:
        reason = "the package kobuki_msgs is not installed on this computer; without a Kobuki base leave this node out"
        raise CodedError("no_kobuki", reason) from None
    return KobukiFeedbackNode(messages)
