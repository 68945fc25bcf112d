"""Node: light and sound on a Kobuki base."""

from __future__ import annotations

import importlib
from types import ModuleType

import rospy
from vb_core import names
from vb_core.errors import CodedError
from vb_msgs.msg import InteractionState, Sound

# by state a constant of kobuki_msgs/Led, as near to the display's colours as the LED can
LEDS = {"default": "BLACK", "border": "ORANGE", "seed": "GREEN", "guide": "RED"}
# by sound a constant of kobuki_msgs/Sound; none for ticks: they are too loud
BEEPS = {
    "border": "BUTTON",
    "seed": "BUTTON",
    "guide": "BUTTON",
    "default": "OFF",
    "success": "CLEANINGEND",
    "error": "ERROR",
    "question": "RECHARGE",
    "stopped": "OFF",
}


class KobukiFeedbackNode:
    """Shows the state with an LED of a Kobuki base, and plays sounds on its beeper.

    Subscribed topics:
        /virtual_borders/state (vb_msgs/InteractionState), /virtual_borders/sound (vb_msgs/Sound)

    Published topics:
        mobile_base/commands/led1 (kobuki_msgs/Led, latched), mobile_base/commands/sound (kobuki_msgs/Sound)

    Args:
        messages: the module kobuki_msgs.msg.
    """

    def __init__(self, messages: ModuleType) -> None:
        self._messages = messages
        self._lit = ""
        self._led = rospy.Publisher("mobile_base/commands/led1", messages.Led, queue_size=1, latch=True)
        self._sound = rospy.Publisher("mobile_base/commands/sound", messages.Sound, queue_size=5)
        rospy.Subscriber(names.STATE, InteractionState, self._on_state, queue_size=5)
        rospy.Subscriber(names.SOUND, Sound, self._on_sound, queue_size=5)

    def _on_state(self, message: InteractionState) -> None:
        light = LEDS.get(message.name, "BLACK")
        if light != self._lit:
            self._lit = light
            self._led.publish(self._messages.Led(value=getattr(self._messages.Led, light)))

    def _on_sound(self, message: Sound) -> None:
        if message.name in BEEPS:
            self._sound.publish(self._messages.Sound(value=getattr(self._messages.Sound, BEEPS[message.name])))


def build() -> KobukiFeedbackNode:
    """Reads the parameters and makes the node."""
    try:
        # by name: the package is not a dependency, only robots with this base have it
        messages = importlib.import_module("kobuki_msgs.msg")
    except ImportError:
        raise CodedError(
            "no_kobuki",
            "the package kobuki_msgs is not installed on this computer; without a Kobuki base leave this node out",
        ) from None
    return KobukiFeedbackNode(messages)
