"""The hidden operator's console: a terminal program, one key per command."""

from __future__ import annotations

import argparse
import os
import select
import socket
import sys
import termios
import threading
import time
import tty
from typing import Any, Dict, List, Optional, Tuple

import rosgraph
import rospy
from rich.console import Console
from rich.live import Live
from std_msgs.msg import Float32
from vb_core import names, sentences
from vb_core.errors import CodedError
from vb_core.ros import commands, node
from vb_core.ros.messages import BorderPreviewArray
from vb_core.ros.notices import NoticeListener
from vb_core.ros.transforms import TransformLookup
from vb_msgs.msg import BorderProgress, DetectorStatus, SpeechCommand, InteractionState, VirtualBorderArray
from vb_msgs.srv import CommandRequest, CommandResponse

from vb_voice_wizard.confirmation import ANSWERS
from vb_voice_wizard.console import view as console_view
from vb_voice_wizard.console.keys import COMMAND_KEYS, QUIT_KEY, KeyReader
from vb_voice_wizard.console.view import BAD, GOOD, NOTE, ConsoleContent

_PERIOD = 0.2  # [s] between two looks at the screen: an operator cannot follow more
_WATCH_PERIOD = 1.0  # [s]
_MIN_DRIVEN = 0.03  # [m] a robot that went further since the last look drives
_SILENCE_TIMEOUT = 3.0  # [s] a detector reports once a second, the microphone's level comes four times
_MIN_CONFIDENCE_SHOWN = 0.1  # confidence of something spoken that was not understood
# the nodes to watch, by a service that only they offer
_WATCHED = (
    ("interaction_manager", names.COMMAND),
    ("border_fusion", names.GET_DRAWN_BORDER),
    ("map_integrator", names.LIST_BORDERS),
)


class WizardConsoleNode:
    """Shows the interaction and sends commands.

    It waits for the ROS master, reports when the master or a node is lost, and continues when they are back. It checks
    border_fusion and map_integrator by their services /virtual_borders/get_drawn_border and
    /virtual_borders/list_borders, which it does not call.

    Subscribed topics:
        /virtual_borders/state (vb_msgs/InteractionState), /virtual_borders/progress (vb_msgs/BorderProgress)
        /virtual_borders/preview (vb_msgs/BorderPreview), /virtual_borders/borders (vb_msgs/VirtualBorderArray)
        /virtual_borders/notices (vb_msgs/NoticeArray), /virtual_borders/detectors (vb_msgs/DetectorStatus)
        /virtual_borders/voice/heard (vb_msgs/SpeechCommand), /virtual_borders/voice/level (std_msgs/Float32)
        /tf, /tf_static (tf2_msgs/TFMessage): where the robot is

    Services called:
        /virtual_borders/command (vb_msgs/Command)

    Args:
        source: who sends the commands, for the record.
        robot_frame: the robot whose place is shown; "" for none.
        note: code of a first message.
        language: of everything that is shown.
    """

    def __init__(
        self, source: str, robot_frame: str = "base_link", note: str = "", language: str = sentences.ENGLISH
    ) -> None:
        self._source = source
        self._robot_frame = robot_frame
        self._lock = threading.RLock()
        self._view = ConsoleContent(language=language, master=rosgraph.get_master_uri())
        self._changed = threading.Event()
        self._notices: Optional[NoticeListener] = None
        self._detectors: Dict[str, Tuple[float, float]] = {}
        self._level_at = float("-inf")
        self._answered = rospy.Time(0)
        self._transforms: Optional[TransformLookup] = None
        self._robot_at: Optional[Tuple[float, float]] = None
        # a master that was restarted knows nothing of this process: it must register again
        self._master_pid: Optional[int] = None
        self.stale = False
        self._master = rosgraph.Master("/wizard_console_watch")
        if note:
            self._add_code(note, NOTE)
        # a socket limit of this process: a master that hangs must not hang the watch for ever
        socket.setdefaulttimeout(5.0)
        self._orders = commands.CommandSender(source, self._on_answer)
        node.Worker(node.WakeTimer(_WATCH_PERIOD), lambda _woken: self._watch())

    # ------------------------------------------------------------------ presence
    def _watch(self) -> None:
        """Monitors the master, the nodes, the cameras and the robot."""
        away: List[str] = []
        try:
            pid: Optional[int] = self._master.getPid()
            if self._master_pid is not None:
                away = [who for who, service in _WATCHED if not self._answers(self._master, service)]
        except Exception:  # whatever the transport raises: the master does not answer
            pid = None
        self._take_watch(pid, tuple(away))
        self._update_robot()
        now = time.monotonic()
        with self._lock:
            view = self._view
            view.detectors = tuple(
                (camera, rate if now - heard <= _SILENCE_TIMEOUT else 0.0)
                for camera, (heard, rate) in sorted(self._detectors.items())
            )
            view.level_db = view.level_db if now - self._level_at <= _SILENCE_TIMEOUT else 0.0
            view.notices = tuple(self._notices.current()) if self._notices is not None else ()
            ends = view.state.ends_at.to_sec() if view.state is not None else 0.0
            view.ends_in_s = max(0.0, ends - rospy.get_time()) if ends else 0.0
        self._changed.set()

    @staticmethod
    def _answers(master: rosgraph.Master, service: str) -> bool:
        """Returns whether a running process offers a service: the master lists killed ones too."""
        try:
            master.lookupService(service)
            rospy.wait_for_service(service, timeout=0.8)
            return True
        except (rosgraph.MasterException, rospy.ROSException):
            return False

    def _take_watch(self, pid: Optional[int], away: Tuple[str, ...]) -> None:
        with self._lock:
            view = self._view
            if pid is None and view.connected:
                self._add_code("console_master_unreachable", BAD)
            elif pid is not None and self._master_pid not in (None, pid):
                self.stale = True
            elif pid is not None and not view.connected:
                self._add_code("console_master_connected", GOOD)
            # before the first state it is unknown which nodes to expect
            if pid is not None and view.state is not None:
                for who, _ in _WATCHED:
                    if (who in away) != (who in view.away):
                        gone = who in away
                        self._add_code(
                            "console_not_responding" if gone else "console_responding_again",
                            BAD if gone else GOOD,
                            who=f"${who}",
                        )
            view.connected, view.away = pid is not None, away if view.state is not None else ()

    def _update_robot(self) -> None:
        if self._transforms is None:
            return
        try:
            pose = self._transforms.lookup(names.MAP_FRAME, self._robot_frame, rospy.Time(0), 0.0)
            at: Optional[Tuple[float, float]] = (float(pose[0, 3]), float(pose[1, 3]))
        except CodedError:
            at = None
        before, self._robot_at = self._robot_at, at
        text = ""
        if at is not None:
            drives = before is not None and max(abs(at[0] - before[0]), abs(at[1] - before[1])) > _MIN_DRIVEN
            code = "console_driving" if drives else "console_stopped_at"
            text = self._view.words(code, x=f"{at[0]:.2f}", y=f"{at[1]:.2f}")
        self._view.robot = text

    # ------------------------------------------------------------------ ROS
    def connect(self) -> None:
        """Registers with the master, once it answers; call it from the main thread."""
        with self._lock:
            if self._master_pid is not None or not self._view.connected:
                return
        try:
            pid = rosgraph.Master("/wizard_console_watch").getPid()
            # messages of rospy itself would tear the screen
            rospy.init_node("wizard_console", anonymous=True, disable_signals=True, log_level=rospy.FATAL)
        except Exception as error:
            self._add_code("console_cannot_connect", BAD, why=error)
            return
        with self._lock:
            self._master_pid = pid
        self._orders.connect()
        rospy.Subscriber(names.STATE, InteractionState, self._on_state, queue_size=5)
        rospy.Subscriber(
            names.PROGRESS, BorderProgress, lambda message: self._show_newest("progress", message), queue_size=1
        )
        rospy.Subscriber(
            names.PREVIEW, BorderPreviewArray, lambda message: self._show_newest("preview", message), queue_size=1
        )
        rospy.Subscriber(
            names.BORDERS,
            VirtualBorderArray,
            lambda message: self._show_newest("borders", message.borders),
            queue_size=1,
        )
        rospy.Subscriber(names.SPEECH_COMMANDS, SpeechCommand, self._on_speech_command, queue_size=5)
        self._notices = NoticeListener()
        rospy.Subscriber(names.DETECTORS, DetectorStatus, self._on_detector, queue_size=10)
        rospy.Subscriber(names.VOICE_LEVEL, Float32, self._on_level, queue_size=1)
        if self._robot_frame:
            self._transforms = TransformLookup(cache_s=2.0)

    def _show_newest(self, where: str, what: Any) -> None:
        with self._lock:
            setattr(self._view, where, what)
        self._changed.set()

    def _on_state(self, message: InteractionState) -> None:
        self._show_newest("state", message)
        if message.last_command and message.last_answered != self._answered:
            self._answered = message.last_answered
            who = message.last_source or self._view.words("console_somebody")
            said = CommandResponse(code=message.last_code, values=message.last_values, message=message.last_message)
            text = f"{who}, {self._view.words('command_' + message.last_command)}: {self._view.sentence(said)}"
            self._add_message(text, GOOD if message.last_success else BAD)

    def _on_detector(self, message: DetectorStatus) -> None:
        with self._lock:
            self._detectors[message.camera] = time.monotonic(), message.rate_hz

    def _on_level(self, message: Float32) -> None:
        with self._lock:
            # full scale itself would be 0, which is none
            self._view.level_db, self._level_at = min(-0.1, message.data), time.monotonic()

    def _on_speech_command(self, message: SpeechCommand) -> None:
        # what was understood comes with the state, as any command
        if not message.accepted and message.confidence >= _MIN_CONFIDENCE_SHOWN:
            self._add_code(
                "console_not_understood",
                NOTE,
                command=f"$command_{ANSWERS.get(message.command, message.command)}",
                confidence=f"{message.confidence:.2f}",
                reason=f"$utterance_{message.reason}",
            )

    # ------------------------------------------------------------------ commands
    def press(self, key: str) -> bool:
        """Handles a pressed key; its command runs in a separate thread, so that the screen does not freeze.

        Returns:
            Whether the console is to be left.
        """
        if key == QUIT_KEY:
            return True
        if key not in COMMAND_KEYS:
            self._add_code("console_key_unknown", NOTE, key=key)
        elif self._master_pid is None:
            self._add_code("console_not_connected", BAD)
        elif not self._orders.put(COMMAND_KEYS[key]):
            self._add_code("console_too_many_keys", BAD)
        return False

    def _on_answer(
        self, _request: CommandRequest, _context: Any, answer: Optional[CommandResponse], error: Optional[CodedError]
    ) -> None:
        # the answer arrives with the state; "busy" is not remembered there
        if error is not None:
            what = sentences.translate(error.code, error.values, self._view.language, error.message)
            self._add_code("console_try_again", BAD, what=what)
        elif answer is not None and answer.code == "busy":
            self._add_message(self._view.sentence(answer), BAD)

    def _add_code(self, code: str, style: str, **values: Any) -> None:
        self._add_message(self._view.words(code, **values), style)

    def _add_message(self, text: str, style: str) -> None:
        with self._lock:
            self._view.add_message(time.strftime("%H:%M:%S"), text, style)
        self._changed.set()

    # ------------------------------------------------------------------ screen
    def run(self) -> bool:
        """Shows the screen until it is left; returns whether to start again because the master did."""
        console = Console()
        keyboard = sys.stdin.fileno()
        before = termios.tcgetattr(keyboard)
        try:
            # key by key, without an echo; control-C still interrupts
            tty.setcbreak(keyboard)
            # a whole screen is written over the one before, and only if something changed: nothing flickers
            with Live(console=console, screen=True, auto_refresh=False) as live:
                return self._show(console, live, keyboard)
        except KeyboardInterrupt:
            return False
        finally:
            termios.tcsetattr(keyboard, termios.TCSADRAIN, before)

    def _show(self, console: Console, live: Live, keyboard: int) -> bool:
        reader, shown_size = KeyReader(), None
        while not self.stale and not rospy.is_shutdown():
            self.connect()
            size = console.size
            if self._changed.is_set() or size != shown_size:
                self._changed.clear()
                shown_size = size
                with self._lock:
                    screen = console_view.render(self._view, size.width, size.height)
                live.update(screen, refresh=True)
            typed = ""
            if select.select([keyboard], [], [], _PERIOD)[0]:
                typed = os.read(keyboard, 64).decode("utf-8", "replace")
                if not typed:
                    return False  # the terminal is gone
            if any([self.press(key) for key in reader.feed(typed)]):
                return False
        return True


def run(arguments: Optional[List[str]] = None) -> int:
    """Runs the console; returns the exit status."""
    given = sys.argv[1:] if arguments is None else arguments
    parser = argparse.ArgumentParser(prog="wizard_console", description="The hidden operator's console.")
    parser.add_argument("--source", default="wizard", help="who gives the commands, for the record (default: wizard)")
    parser.add_argument(
        "--robot-frame", default="base_link", help="the robot whose place is shown, empty for none (default: base_link)"
    )
    parser.add_argument("--language", default=sentences.ENGLISH, choices=sentences.languages(), help="(default: en)")
    parser.add_argument("--note", default="", help=argparse.SUPPRESS)
    chosen = parser.parse_args(rospy.myargv(["wizard_console", *given])[1:])
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        print("wizard_console needs a terminal; for scripts there is 'rosrun vb_voice_wizard command'", file=sys.stderr)
        return 1
    if WizardConsoleNode(chosen.source, chosen.robot_frame, chosen.note, chosen.language).run():
        # rospy cannot register twice in one process: this one starts again in the same terminal
        sys.stdout.flush()
        again = ["--source", chosen.source, "--robot-frame", chosen.robot_frame, "--language", chosen.language]
        again += ["--note", "console_master_restarted"]
        os.execv(sys.executable, [sys.executable, sys.argv[0], *again])
    return 0


def main() -> None:
    """Runs the program."""
    status = run()
    sys.stdout.flush()
    # rospy's threads wait for a master that may be gone: leave without them
    os._exit(status)
