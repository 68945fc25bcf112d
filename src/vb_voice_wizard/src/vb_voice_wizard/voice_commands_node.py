"""Node: recognises spoken commands."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, Optional, Tuple

import numpy as np
import rospy
from vb_core import names
from vb_core.errors import CodedError
from vb_core.notices import Notice, Severity
from vb_core.parameters import Parameters, param
from vb_core.ros import commands, node, parameters
from vb_core.ros.notices import NoticePublisher
from vb_msgs.msg import Audio, SpeechCommand, Sound
from vb_msgs.srv import CommandRequest, CommandResponse

from vb_voice_wizard.voice.microphone import SAMPLE_RATE, Microphone, arecord_command, has_sound
from vb_voice_wizard.voice.recognizer import CommandListener, CommandRecognizer, RecognitionResult

AUDIO = "/virtual_borders/voice/audio"

_WATCH_PERIOD = 0.25  # [s] wall time between two checks whether there is sound
_NEAR_MISS = 0.2  # a rejected utterance with at least this confidence is answered by a sound, so that people repeat it
_SILENCE_TIMEOUT = 5.0  # [s] without any sound, after which a notice is published
_LATE = 2.0  # [s] a command that is recognised so long after its end is late, and may no longer be wanted


@dataclass(frozen=True)
class VoiceParams(Parameters):
    """Parameters of the voice commands; config/voice_commands.yaml explains them."""

    source: str = param("microphone", choices=("microphone", "topic"))
    device: str = param("default")


class VoiceCommandsNode:
    """Recognises spoken commands and sends them to the interaction.

    Sound is handled in wall time, even in simulation, because people speak in wall time. An overloaded computer
    recognises commands late. Such a command has not expired, because its age is counted from its recognition. But if it
    has consequences, it must be confirmed like an uncertain command, and a notice is published.

    Subscribed topics:
        /virtual_borders/sound (vb_msgs/Sound): speech that lies entirely within a sound counts only if it is *stop*.
        /virtual_borders/voice/audio (vb_msgs/Audio): the sound, if ~source is "topic"; 16,000 samples a second.
        /virtual_borders/state (vb_msgs/InteractionState): the newest stop, which is sent with each spoken command.
        /virtual_borders/drivers (vb_msgs/DriverState), /virtual_borders/robots (vb_msgs/RobotStatusArray): who holds a stop.

    Published topics:
        /virtual_borders/voice/heard (vb_msgs/SpeechCommand): each utterance, accepted or not, and the command's answer.
        /virtual_borders/stop (vb_msgs/Stop): on `stop`.
        /virtual_borders/notices (vb_msgs/NoticeArray): microphone_missing, microphone_silent, speech_late.
        /virtual_borders/sound (vb_msgs/Sound): "recognized" as soon as a command is recognised; "error" for a near
            miss, and for a command without an answer. The feedback node plays the sound for the interaction's answer.

    Services called:
        /virtual_borders/command (vb_msgs/Command): with source "voice".

    Parameters:
        config/voice_commands.yaml
    """

    def __init__(self, params: VoiceParams) -> None:
        self._listener = CommandListener(CommandRecognizer())
        # room for 20 s of sound: a node that is further behind must not carry out such old commands
        self._samples: node.Queue = node.Queue(400)
        self._microphone: Optional[Microphone] = None
        self._trouble = ""
        self._late = False
        self._sound_at = time.monotonic()
        self._notices = NoticePublisher()
        self._watch_timer = node.WakeTimer(_WATCH_PERIOD)
        self._heard_publisher = rospy.Publisher(names.SPEECH_COMMANDS, SpeechCommand, queue_size=10)
        self._sound_publisher = rospy.Publisher(names.SOUND, Sound, queue_size=10)
        # sends commands from another thread, so that this node goes on listening while an answer takes seconds
        self._command_sender = commands.CommandSender("voice", self._on_answer)
        node.Worker(self._samples, self._listen)
        node.Worker(self._watch_timer, lambda _woken: self._check_sound())
        rospy.Subscriber(names.SOUND, Sound, self._on_sound, queue_size=10)
        if params.source == "topic":
            rospy.Subscriber(AUDIO, Audio, self._on_audio, queue_size=100)
        else:
            self._microphone = Microphone(arecord_command(params.device), self._on_trouble)
            node.Worker(self._microphone, self._queue_sound)

    def close(self) -> None:
        """Releases the microphone and ends the workers."""
        if self._microphone is not None:
            self._microphone.close()
        self._watch_timer.close()
        self._samples.close()

    # ------------------------------------------------------------------ input
    def _queue_sound(self, pcm: np.ndarray) -> None:
        if has_sound(pcm):
            self._sound_at = time.monotonic()
            self._trouble = ""
        if not self._samples.put((pcm, time.monotonic())):
            rospy.logwarn_throttle(5.0, "voice_commands: too slow for the incoming sound; some is lost")

    def _on_audio(self, message: Audio) -> None:
        if message.sample_rate != SAMPLE_RATE or len(message.data) % 2:
            mismatch = f"{message.sample_rate} samples/s in {len(message.data)} bytes, not {SAMPLE_RATE} of 2 bytes"
            rospy.logwarn_throttle(5.0, f"voice_commands: sound dropped: {mismatch}")
            return
        self._queue_sound(np.frombuffer(message.data, dtype="<i2"))

    def _on_trouble(self, sentence: str) -> None:
        self._trouble = sentence
        rospy.logwarn_throttle(30.0, f"voice_commands: no sound: {sentence}")

    def _check_sound(self) -> None:
        """Publishes a notice if there is no sound, such as from a muted microphone, or if speech is recognised late."""
        notices = []
        if self._trouble:
            notices = [Notice("microphone_missing", Severity.WARNING, values={"why": self._trouble})]
        elif time.monotonic() - self._sound_at > _SILENCE_TIMEOUT:
            notices = [Notice("microphone_silent", Severity.WARNING)]
        elif self._late:
            notices = [Notice("speech_late", Severity.WARNING)]
        self._notices.set(notices)

    # ------------------------------------------------------------------ the system's sounds
    def _beep(self, name: str) -> None:
        sound = Sound(name=name)
        sound.header.stamp = rospy.Time.now()
        self._sound_publisher.publish(sound)

    def _on_sound(self, message: Sound) -> None:
        self._listener.play(message.name, time.monotonic())

    # ------------------------------------------------------------------ listening
    def _listen(self, piece: Tuple[np.ndarray, float]) -> None:
        for heard in self._listener.push(*piece):
            self._handle(heard)

    def _handle(self, heard: RecognitionResult) -> None:
        self._late = time.monotonic() - heard.end > _LATE
        if not heard.command:
            if heard.reason == "unlike_a_command" and heard.confidence >= _NEAR_MISS:
                self._beep("error")
            self._publish(heard)
            return
        self._beep("recognized")
        uncertain = self._late or not heard.certain
        seen_stop = self._command_sender.stop_number(heard.start)
        if not self._command_sender.submit(heard.command, heard, uncertain=uncertain, seen_stop=seen_stop):
            self._publish(heard.refuse("busy"))

    def _on_answer(
        self, request: CommandRequest, context: Any, answer: Optional[CommandResponse], error: Optional[CodedError]
    ) -> None:
        if answer is None:
            rospy.logwarn("voice_commands: %s is lost: %s", request.command, error)
            answer = CommandResponse(code=error.code, message=error.message)
            self._beep("error")
        self._publish(context, answer)

    def _publish(self, heard: RecognitionResult, answer: Optional[CommandResponse] = None) -> None:
        """Publishes and logs the result for an utterance, with the answer if a command was sent."""
        answer = answer or CommandResponse()
        message = SpeechCommand(
            command=heard.best,
            accepted=bool(heard.command),
            confidence=heard.confidence,
            reason=heard.reason,
            success=answer.success,
            code=answer.code,
        )
        message.header.stamp = rospy.Time.now()
        delay = time.monotonic() - heard.end
        details = f"{heard.reason}, confidence {heard.confidence:.2f}, answered after {delay:.2f} s"
        rospy.loginfo("heard %s (%s) %s", heard.best or "something", details, answer.message)
        self._heard_publisher.publish(message)


def build() -> VoiceCommandsNode:
    """Reads the parameters and constructs the node."""
    return VoiceCommandsNode(parameters.read(VoiceParams))
