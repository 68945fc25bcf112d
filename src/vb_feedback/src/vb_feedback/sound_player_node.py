"""Node: plays the sounds."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Tuple

import rospy
from vb_core import names
from vb_core.errors import CodedError
from vb_core.parameters import Parameters, param
from vb_core.ros import node, parameters
from vb_core.sounds import SOUNDS, TICK
from vb_msgs.msg import Sound

from vb_feedback.sound.sound_output import play, synthesize

_RETRY_DELAY = 5.0  # [s] after a failure, because a device may be plugged in later
_MAX_WAITING = 16  # sounds in the queue, which become too old long before it is full


@dataclass(frozen=True)
class SoundParams(Parameters):
    """Parameters of sound_player; config/sound_player.yaml explains them."""

    device: str = param("default")
    volume: float = param(0.7, "", low=0.0, high=1.0)
    max_age: float = param(1.0, "s", above=0.0, high=10.0)


class SoundPlayerNode:
    """Plays sounds on this computer. Without a sound device it logs one warning and stays silent.

    Sounds may arrive faster than they can be played. Therefore a tick is dropped while another sound is playing, and a
    sound that has waited longer than ~max_age is dropped, because it is outdated.

    Subscribed topics:
        /virtual_borders/sound (vb_msgs/Sound): names from vb_core.sounds, which defines the sounds.
    """

    def __init__(self, params: SoundParams) -> None:
        self._params = params
        self._waiting: node.Queue = node.Queue(_MAX_WAITING)
        self._busy = False
        self._silent_until = 0.0
        self._has_warned = False
        node.Worker(self._waiting, self._play)
        rospy.Subscriber(names.SOUND, Sound, self._on_sound, queue_size=10)

    def close(self) -> None:
        """Ends the thread."""
        self._waiting.close()

    def _on_sound(self, message: Sound) -> None:
        if message.name not in SOUNDS:
            rospy.logwarn_throttle(10.0, f"sound_player: no sound is called '{message.name}'")
        elif message.name != TICK or not self._busy:
            self._waiting.put((message.name, time.monotonic()))

    def _play(self, sound: Tuple[str, float]) -> None:
        name, queued = sound
        now = time.monotonic()
        if now < self._silent_until or now - queued > self._params.max_age:
            return
        self._busy = True
        try:
            play(synthesize(name, self._params.volume), self._params.device)
        except CodedError as error:
            # a device may be plugged in later, so the node tries again periodically, without a second warning
            self._silent_until = time.monotonic() + _RETRY_DELAY
            if not self._has_warned:
                self._has_warned = True
                rospy.logwarn("sound_player: there is no sound: %s", error)
            return
        finally:
            self._busy = False
        if self._has_warned:
            self._has_warned = False
            rospy.loginfo("sound_player: sounds are played again")


def build() -> SoundPlayerNode:
    """Reads the parameters and makes the node."""
    return SoundPlayerNode(parameters.read(SoundParams))
