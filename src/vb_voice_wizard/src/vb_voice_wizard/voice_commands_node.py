"""Node: recognises spoken commands."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import Any, Dict, List, Optional, Tuple

import numpy as np
import rospy
from std_msgs.msg import Float32
from vb_core import names
from vb_core.errors import CodedError, ParameterError
from vb_core.notices import Notice, Severity
from vb_core.parameters import Parameters, param
from vb_core.ros import commands, node, parameters
from vb_core.ros.messages import values_from_mapping
from vb_core.ros.notices import NoticePublisher
from vb_msgs.msg import Audio, SpeechCommand, Sound
from vb_msgs.srv import CommandRequest, CommandResponse

from vb_voice_wizard.voice.audio_sources import Microphone, Resampler, arecord, level_db
from vb_voice_wizard.voice.endpointing import END_SILENCE, Endpointer, Utterance
from vb_voice_wizard.recognizer import CommandRecognizer, RecognitionResult, RecognizerParams

AUDIO = "/virtual_borders/voice/audio"

_LEVEL_PERIOD = 0.25  # [s] wall time between two levels
_NEAR = 0.2  # confidence from which a rejected utterance gets the refusal sound: say it again
_DEAF_TIMEOUT = 5.0  # [s] without any sound after which people are told
_DIGITAL_SILENCE_DB = -90.0  # the quietest microphone has its own noise; this is its least significant bit


@dataclass(frozen=True)
class VoiceParams(Parameters):
    """Parameters of the voice commands, beside the recogniser's; config/voice_commands.yaml says why."""

    source: str = param("microphone", choices=("microphone", "topic"))
    device: str = param("default")
    sounds: dict = param(
        {
            "default": 0.3,
            "border": 0.3,
            "seed": 0.3,
            "guide": 0.3,
            "success": 0.6,
            "error": 0.5,
            "question": 0.4,
            "stopped": 0.5,
            "recognized": 0.1,
        }
    )
    mute_margin: float = param(0.25, "s", low=0.0, high=2.0)
    min_repeat_interval: float = param(0.5, "s", low=0.0, high=10.0)
    response_timeout: float = param(12.0, "s", above=0.0, high=60.0)


class VoiceCommandsNode:
    """Recognises spoken commands and sends them to the interaction.

    Sound is handled as it arrives: people speak in wall time, whatever /clock says.

    Subscribed topics:
        /virtual_borders/sound (vb_msgs/Sound): while one of ~sounds plays, audio is ignored.
        /virtual_borders/voice/audio (vb_msgs/Audio): the sound, if ~source is "topic".

    Published topics:
        /virtual_borders/voice/heard (vb_msgs/SpeechCommand): every utterance, accepted or not, and how its command was answered.
        /virtual_borders/voice/level (std_msgs/Float32): the microphone's level [dB], 0 at full scale, four times a second.
        /virtual_borders/notices (vb_msgs/NoticeArray): microphone_missing, microphone_silent.
        /virtual_borders/sound (vb_msgs/Sound): "recognized" as soon as a command is understood; "error" for a near miss,
            and for a command without an answer. The feedback node tells how the interaction answers the command.

    Services called:
        /virtual_borders/command (vb_msgs/Command): with source "voice".

    Args:
        params: where sound comes from, and how to handle what was heard.
        recognizer: how commands are recognised.

    Raises:
        ParameterError: for a sound's duration that is not a number.
    """

    def __init__(self, params: VoiceParams, recognizer: CommandRecognizer) -> None:
        self._params = params
        self._recognizer = recognizer
        self._durations = _durations(params.sounds)
        self._endpointer = Endpointer()
        self._muted_until = 0.0
        self._mute_lock = threading.Lock()
        self._last_command = ""
        self._last_time = 0.0
        # 20 s of sound: a node that falls further behind should not act on old commands
        self._sound: node.Queue = node.Queue(400)
        self._microphone: Optional[Microphone] = None
        self._resampler = Resampler()
        self._trouble = ""
        self._level_lock = threading.Lock()
        self._pieces: List[np.ndarray] = []
        self._heard_at = time.monotonic()
        self._level = rospy.Publisher(names.VOICE_LEVEL, Float32, queue_size=2)
        self._notices = NoticePublisher()
        self._watch = node.WakeTimer(_LEVEL_PERIOD)
        self._heard = rospy.Publisher(names.SPEECH_COMMANDS, SpeechCommand, queue_size=10)
        self._beeper = rospy.Publisher(names.SOUND, Sound, queue_size=10)
        # a command's answer may take seconds; listening goes on meanwhile
        self._orders = commands.CommandSender(
            "voice", self._on_answer, response_timeout=params.response_timeout, size=4
        )
        node.Worker(self._sound, self._listen)
        node.Worker(self._watch, lambda _woken: self._on_watch())
        rospy.Subscriber(names.SOUND, Sound, self._on_sound, queue_size=10)
        if params.source == "topic":
            rospy.Subscriber(AUDIO, Audio, self._on_audio, queue_size=100)
        else:
            self._microphone = Microphone(arecord(params.device), self._put, self._on_trouble, start=node.start_thread)

    def close(self) -> None:
        """Releases the microphone, and ends the threads."""
        if self._microphone is not None:
            self._microphone.close()
        self._watch.close()
        self._sound.close()
        self._orders.close()

    # ------------------------------------------------------------------ sound in
    def _put(self, pcm: np.ndarray) -> None:
        with self._level_lock:
            self._pieces.append(pcm)
        if not self._sound.put((pcm, time.monotonic())):
            rospy.logwarn_throttle(5.0, "voice_commands: too slow for the sound that comes in, some is lost")

    def _on_audio(self, message: Audio) -> None:
        if not 4000 <= message.sample_rate <= 192000 or len(message.data) % 2:
            rospy.logwarn_throttle(
                5.0, f"voice_commands: sound dropped: {message.sample_rate} samples/s in {len(message.data)} bytes"
            )
            return
        # one thread calls this
        self._put(self._resampler.push(np.frombuffer(message.data, dtype="<i2"), message.sample_rate))

    def _on_trouble(self, sentence: str) -> None:
        self._trouble = sentence
        rospy.logwarn_throttle(30.0, f"voice_commands: no sound: {sentence}")

    def _on_watch(self) -> None:
        """Publishes the level, and says when there is no sound: a muted or missing microphone looks like silence."""
        with self._level_lock:
            pieces, self._pieces = self._pieces, []
        now = time.monotonic()
        if pieces:
            level = level_db(np.concatenate(pieces))
            self._level.publish(level)
            if level > _DIGITAL_SILENCE_DB:
                self._heard_at, self._trouble = now, ""
        missing = []
        if self._trouble:
            missing = [Notice("microphone_missing", Severity.WARNING, values={"why": self._trouble})]
        elif now - self._heard_at > _DEAF_TIMEOUT:
            missing = [Notice("microphone_silent", Severity.WARNING)]
        self._notices.set(missing)

    # ------------------------------------------------------------------ own sounds
    def _beep(self, name: str) -> None:
        sound = Sound(name=name)
        # ignore audio from now on, not only once the sound's message is back at this node
        self._on_sound(sound)
        sound.header.stamp = rospy.Time.now()
        self._beeper.publish(sound)

    def _on_sound(self, message: Sound) -> None:
        duration = self._durations.get(message.name, 0.0)
        if duration > 0.0:
            with self._mute_lock:
                self._muted_until = max(self._muted_until, time.monotonic() + duration + self._params.mute_margin)

    def _muted(self, when: float) -> bool:
        with self._mute_lock:
            return when < self._muted_until

    # ------------------------------------------------------------------ listening
    def _listen(self, piece: Tuple[np.ndarray, float]) -> None:
        pcm, when = piece
        if self._muted(when):
            if self._endpointer.speaking:
                self._publish(RecognitionResult(reason="muted"), 0.0, 0.0)
            self._endpointer.reset()
            # the noise estimate goes on with what is not our own sound
            return
        for utterance in self._endpointer.push(pcm):
            self._handle(utterance, when)

    def _handle(self, utterance: Utterance, when: float) -> None:
        """Handles an utterance that ended; `when` is when its last piece of sound arrived."""
        issue = self._recognizer.classify(utterance)
        if issue.command and self._muted(time.monotonic()):
            issue = issue.refused("muted")
        now = time.monotonic()
        if (
            issue.command
            and issue.command == self._last_command
            and now - self._last_time < self._params.min_repeat_interval
        ):
            issue = issue.refused("repeated")
        silence = 0.0 if utterance.too_long else END_SILENCE
        answer_s = now - when + silence
        if not issue.command:
            if issue.reason == "unlike_a_command" and issue.confidence >= _NEAR:
                self._beep("error")
            self._publish(issue, utterance.end - utterance.start, answer_s)
            return
        self._beep("recognized")
        self._last_command, self._last_time = issue.command, now
        heard = (issue, utterance.end - utterance.start, answer_s)
        # speech is never certain, so what acts on its own has to be said again
        if not self._orders.put(issue.command, heard, uncertain=True):
            self._publish(issue.refused("busy"), utterance.end - utterance.start, answer_s)

    def _on_answer(
        self, request: CommandRequest, context: Any, answer: Optional[CommandResponse], error: Optional[CodedError]
    ) -> None:
        if answer is None:
            rospy.logwarn("voice_commands: %s is lost: %s", request.command, error)
            answer = CommandResponse(
                success=False, code=error.code, message=error.message, values=values_from_mapping(error.values)
            )
            self._beep("error")
        self._publish(*context, answer)

    def _publish(
        self, issue: RecognitionResult, duration: float, answer_s: float, answer: Optional[CommandResponse] = None
    ) -> None:
        answer = answer or CommandResponse()
        heard = SpeechCommand(
            command=issue.best,
            accepted=bool(issue.command),
            confidence=issue.confidence,
            reason=issue.reason,
            duration_s=duration,
            answer_s=answer_s,
            success=answer.success,
            code=answer.code,
            message=answer.message,
            values=answer.values,
        )
        heard.header.stamp = rospy.Time.now()
        rospy.loginfo(
            "heard %s (%s, confidence %.2f, %.1f s, answered after %.2f s) %s",
            issue.best or "something",
            issue.reason,
            issue.confidence,
            duration,
            answer_s,
            answer.message,
        )
        self._heard.publish(heard)


def _durations(sounds: dict) -> Dict[str, float]:
    for name, duration in sounds.items():
        if isinstance(duration, bool) or not isinstance(duration, (int, float)) or not 0.0 <= duration <= 10.0:
            raise ParameterError(rospy.resolve_name(f"~sounds/{name}"), f"expected 0 to 10 seconds, got {duration!r}")
    return {str(name): float(duration) for name, duration in sounds.items()}


def build() -> VoiceCommandsNode:
    """Reads the parameters and makes the node."""
    params = parameters.read(VoiceParams, ignore=("recognizer",))
    return VoiceCommandsNode(params, CommandRecognizer(parameters.read(RecognizerParams, "~recognizer")))
