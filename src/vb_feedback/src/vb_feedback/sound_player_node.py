"""Node: plays the sounds."""
from __future__ import annotations

import time
from dataclasses import dataclass

import rospy
from vb_core import names
from vb_core.errors import CodedError
from vb_core.parameters import Parameters, param
from vb_core.ros import node, parameters
from vb_msgs.msg import Sound

from vb_feedback.sound import tone_synthesis
from vb_feedback.sound.audio_sink import AudioSink
from vb_feedback.sound.playlist import SoundQueue


@dataclass(frozen=True)
class SoundParams(Parameters):
    """Parameters of sound_player; config/sound_player.yaml says why."""

    device: str = param("default")
    program: str = param("aplay")
    volume: float = param(0.7, "", low=0.0, high=1.0)
    max_age: float = param(1.0, "s", above=0.0, high=10.0)
    retry: float = param(30.0, "s", low=1.0, high=3600.0)


class SoundPlayer:
    """Plays sounds on this computer. Without a sound device it says so once and stays quiet.

    Subscribed topics:
        /virtual_borders/sound (vb_msgs/Sound): names of sounds; see tone_synthesis.SOUNDS for what they sound like.

    Args:
        params: see config/sound_player.yaml.
        sink: the output.
    """

    def __init__(self, params: SoundParams, sink: AudioSink) -> None:
        self._params = params
        self._sink = sink
        self._playlist = SoundQueue(params.max_age)
        self._silent_until = 0.0
        self._said = False
        node.Worker(self._playlist, self._play)
        rospy.Subscriber(names.SOUND, Sound, self._on_sound, queue_size=10)

    def close(self) -> None:
        """Ends the thread."""
        self._playlist.close()

    def _on_sound(self, message: Sound) -> None:
        if message.name in tone_synthesis.SOUNDS:
            self._playlist.put(message.name)
        else:
            rospy.logwarn_throttle(10.0, f"sound_player: no sound is called '{message.name}'")

    def _play(self, name: str) -> None:
        if time.monotonic() < self._silent_until:
            return
        try:
            self._sink.play(tone_synthesis.samples(name, self._params.volume))
        except CodedError as error:
            # a device may be plugged in later: tried again now and then, without a second word
            self._silent_until = time.monotonic() + self._params.retry
            if not self._said:
                self._said = True
                rospy.logwarn("sound_player: there is no sound: %s", error)
            return
        if self._said:
            self._said = False
            rospy.loginfo("sound_player: sounds are played again")


def _build() -> SoundPlayer:
    params = parameters.read(SoundParams)
    return SoundPlayer(params, AudioSink(params.device, params.program))


def main() -> None:
    """Runs the node."""
    node.run("sound_player", _build)
