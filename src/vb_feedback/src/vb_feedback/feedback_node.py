"""Node: controls light and sound."""

from __future__ import annotations

import threading
from typing import List, Optional

import rospy
from std_msgs.msg import ColorRGBA
from vb_core import names
from vb_msgs.msg import InteractionState, LaserSpot, Sound

from vb_feedback.display import colors
from vb_feedback.ros.sound_events import SoundEvents


class FeedbackNode:
    """Publishes light and sounds for the person (paper, Sect. 4.2: colored light and non-speech audio sound).

    Subscribed topics:
        /virtual_borders/state (vb_msgs/InteractionState)
        /virtual_borders/spots (vb_msgs/LaserSpot)

    Published topics:
        /virtual_borders/led (std_msgs/ColorRGBA, latched): one colour per state, red while robots are stopped.
        /virtual_borders/sound (vb_msgs/Sound): the state's name at each change of state, "success", "error",
            "question", "stopped", and "tick" per accepted spot, at most one every half second.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._sound_events = SoundEvents()
        self._led_color: Optional[colors.Color] = None
        self._led = rospy.Publisher(names.LED, ColorRGBA, queue_size=1, latch=True)
        self._sound = rospy.Publisher(names.SOUND, Sound, queue_size=10)
        rospy.Subscriber(names.STATE, InteractionState, self._on_state, queue_size=10)
        rospy.Subscriber(names.SPOTS, LaserSpot, self._on_spot, queue_size=10)

    def _on_state(self, message: InteractionState) -> None:
        color = colors.STOPPED if message.stopped else colors.state_color(message.name)
        with self._lock:
            self._play(self._sound_events.on_state(message))
            if color != self._led_color:
                self._led_color = color
                self._led.publish(ColorRGBA(*color, 1.0))

    def _on_spot(self, _message: LaserSpot) -> None:
        with self._lock:
            self._play(self._sound_events.on_spot(rospy.get_time()))

    def _play(self, sounds: List[str]) -> None:
        for name in sounds:
            sound = Sound(name=name)
            sound.header.stamp = rospy.Time.now()
            self._sound.publish(sound)


def build() -> FeedbackNode:
    """Constructs the node."""
    return FeedbackNode()
