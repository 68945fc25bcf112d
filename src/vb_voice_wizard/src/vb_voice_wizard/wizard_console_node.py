"""The hidden operator's console: a terminal program, one key per command."""

from __future__ import annotations

import argparse
import os
import select
import sys
import termios
import threading
import time
import tty
from typing import Any, List, Optional

import rosgraph
import rospy
from rich.console import Console
from rich.live import Live
from vb_core import names, sentences
from vb_core.errors import CodedError
from vb_core.ros import commands
from vb_core.ros.messages import BorderPreviewArray
from vb_core.ros.notices import NoticeListener
from vb_msgs.msg import BorderProgress, SpeechCommand, InteractionState, VirtualBorderArray
from vb_msgs.srv import CommandRequest, CommandResponse

from vb_voice_wizard.confirmation import ANSWERS
from vb_voice_wizard.console import view as console_view
from vb_voice_wizard.console.keys import COMMAND_KEYS, QUIT_KEY, letters
from vb_voice_wizard.console.view import BAD, GOOD, NOTE, ConsoleContent

_PERIOD = 0.2  # [s] between two looks at the screen: an operator cannot follow more
_SILENCE_TIMEOUT = 3.0  # [s] the state comes ten times a second
_MIN_CONFIDENCE_SHOWN = 0.1  # confidence of something spoken that was not understood


class WizardConsoleNode:
    """Shows the interaction and sends commands; says when no state comes, and goes on when it comes again.

    Subscribed topics:
        /virtual_borders/state (vb_msgs/InteractionState), /virtual_borders/progress (vb_msgs/BorderProgress)
        /virtual_borders/preview (vb_msgs/BorderPreview), /virtual_borders/borders (vb_msgs/VirtualBorderArray)
        /virtual_borders/notices (vb_msgs/NoticeArray), /virtual_borders/voice/heard (vb_msgs/SpeechCommand)

    Services called:
        /virtual_borders/command (vb_msgs/Command)

    Args:
        source: who sends the commands, for the record.
        language: of everything that is shown.
    """

    def __init__(self, source: str, language: str = sentences.ENGLISH) -> None:
        self._lock = threading.RLock()
        self._view = ConsoleContent(language=language)
        self._changed = threading.Event()
        self._heard_at = 0.0
        self._answered = rospy.Time(0)
        self._orders = commands.CommandSender(source, self._on_answer)
        self._orders.connect()
        self._notices = NoticeListener(self._changed.set)
        rospy.Subscriber(names.STATE, InteractionState, self._on_state, queue_size=5)
        rospy.Subscriber(names.PROGRESS, BorderProgress, self._store, "progress", queue_size=1)
        rospy.Subscriber(names.PREVIEW, BorderPreviewArray, self._store, "preview", queue_size=1)
        rospy.Subscriber(names.BORDERS, VirtualBorderArray, self._on_borders, queue_size=1)
        rospy.Subscriber(names.SPEECH_COMMANDS, SpeechCommand, self._on_speech_command, queue_size=5)

    # ------------------------------------------------------------------ ROS
    def _store(self, what: Any, where: str) -> None:
        with self._lock:
            setattr(self._view, where, what)
        self._changed.set()

    def _on_borders(self, message: VirtualBorderArray) -> None:
        self._store(message.borders, "borders")

    def _on_state(self, message: InteractionState) -> None:
        self._heard_at = time.monotonic()
        self._store(message, "state")
        if message.last_command and message.last_answered != self._answered:
            self._answered = message.last_answered
            who = message.last_source or self._view.words("console_somebody")
            said = CommandResponse(code=message.last_code, values=message.last_values, message=message.last_message)
            text = f"{who}, {self._view.words('command_' + message.last_command)}: {self._view.sentence(said)}"
            self._add_message(text, GOOD if message.last_success else BAD)

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
    def run(self) -> None:
        """Shows the screen until it is left."""
        console = Console()
        keyboard = sys.stdin.fileno()
        before = termios.tcgetattr(keyboard)
        try:
            # key by key, without an echo; control-C still interrupts
            tty.setcbreak(keyboard)
            # a whole screen is written over the one before, and only if something changed: nothing flickers
            with Live(console=console, screen=True, auto_refresh=False) as live:
                self._show(console, live, keyboard)
        except KeyboardInterrupt:
            pass
        finally:
            termios.tcsetattr(keyboard, termios.TCSADRAIN, before)

    def _show(self, console: Console, live: Live, keyboard: int) -> None:
        shown_size = None
        while not rospy.is_shutdown():
            with self._lock:
                view, silent = self._view, time.monotonic() - self._heard_at > _SILENCE_TIMEOUT
                if silent and view.state is not None:
                    view.state = None
                    self._changed.set()
                view.notices = tuple(self._notices.current())
                if self._changed.is_set() or console.size != shown_size:
                    self._changed.clear()
                    shown_size = console.size
                    live.update(console_view.render(view, rospy.get_time(), *shown_size), refresh=True)
            typed = ""
            if select.select([keyboard], [], [], _PERIOD)[0]:
                typed = os.read(keyboard, 64).decode("utf-8", "replace")
                if not typed:
                    return  # the terminal is gone
            if any([self.press(key) for key in letters(typed)]):
                return


def run(arguments: Optional[List[str]] = None) -> int:
    """Runs the console; returns the exit status."""
    given = sys.argv[1:] if arguments is None else arguments
    parser = argparse.ArgumentParser(prog="wizard_console", description="The hidden operator's console.")
    parser.add_argument("--source", default="wizard", help="who gives the commands, for the record (default: wizard)")
    parser.add_argument("--language", default=sentences.ENGLISH, choices=sentences.languages(), help="(default: en)")
    chosen = parser.parse_args(rospy.myargv(["wizard_console", *given])[1:])
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        print("wizard_console needs a terminal; for scripts there is 'rosrun vb_voice_wizard command'", file=sys.stderr)
        return 1
    if not rosgraph.is_master_online():
        print(f"the ROS master does not answer at {rosgraph.get_master_uri()}: start the lab first", file=sys.stderr)
        return 1
    # messages of rospy itself would tear the screen
    rospy.init_node("wizard_console", anonymous=True, disable_signals=True, log_level=rospy.FATAL)
    WizardConsoleNode(chosen.source, chosen.language).run()
    return 0


def main() -> None:
    """Runs the program."""
    status = run()
    sys.stdout.flush()
    # rospy's threads wait for a master that may be gone: leave without them
    os._exit(status)
