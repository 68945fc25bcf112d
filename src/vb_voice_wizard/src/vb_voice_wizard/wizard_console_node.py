"""The hidden operator's console: a terminal program, one key per command."""

from __future__ import annotations

import argparse
import os
import select
import sys
import termios
import time
import tty
from functools import partial
from typing import Any, Optional

import rosgraph
import rospy
from rich.console import Group
from rich.live import Live
from rich.text import Text
from vb_core import names, sentences
from vb_core.errors import CodedError
from vb_core.ros import commands
from vb_core.ros.messages import NumpyBorderPreview, sentence_in
from vb_core.ros.notices import NoticeListener
from vb_msgs.msg import BorderProgress, InteractionState
from vb_msgs.srv import CommandRequest, CommandResponse

from vb_voice_wizard.wizard_console import COMMAND_KEYS, QUIT_KEY, ConsoleContent, extract_keys, safe_text
from vb_voice_wizard.wizard_console import OK_STYLE, WARNING_STYLE

_PERIOD = 0.2  # [s] between two updates; an operator could not follow faster ones
_SILENCE_TIMEOUT = 3.0  # [s] without a state, which otherwise arrives ten times a second


class WizardConsoleNode:
    """Shows the interaction and sends commands. While no state arrives, the console says so.

    Subscribed topics:
        /virtual_borders/state (vb_msgs/InteractionState), /virtual_borders/progress (vb_msgs/BorderProgress)
        /virtual_borders/preview (vb_msgs/BorderPreview), /virtual_borders/notices (vb_msgs/NoticeArray)
        /virtual_borders/drivers (vb_msgs/DriverState), /virtual_borders/robots (vb_msgs/RobotStatusArray): who holds a stop

    Services called:
        /virtual_borders/command (vb_msgs/Command)

    Args:
        source: who sends the commands, for the record.
        language: language of everything that is shown.
    """

    def __init__(self, source: str, language: str = sentences.ENGLISH) -> None:
        self._content = ConsoleContent(language=language)
        self._live = Live(auto_refresh=False, transient=True)
        self._heard_at = 0.0
        self._last_answered: Optional[rospy.Time] = None
        self._command_sender = commands.CommandSender(source, self._on_answer)
        self._notices = NoticeListener()
        rospy.Subscriber(names.STATE, InteractionState, self._on_state, queue_size=5)
        rospy.Subscriber(names.PROGRESS, BorderProgress, partial(setattr, self._content, "progress"), queue_size=1)
        rospy.Subscriber(names.PREVIEW, NumpyBorderPreview, partial(setattr, self._content, "preview"), queue_size=1)

    # ------------------------------------------------------------------ ROS
    def _on_state(self, message: InteractionState) -> None:
        self._heard_at = time.monotonic()
        self._content.state = message
        previous_time = self._last_answered
        self._last_answered = message.last_answered
        # an answer that was given before the console started is not printed
        if message.last_command and previous_time not in (None, message.last_answered):
            sender = message.last_source or self._content.translate("console_somebody")
            command = self._content.translate("command_" + message.last_command)
            answer = sentence_in(message, self._content.language, "last_")
            self._print(f"{sender}, {command}: {answer}", OK_STYLE if message.last_success else WARNING_STYLE)

    # ------------------------------------------------------------------ commands
    def press(self, key: str) -> bool:
        """Sends the command of a key, if it has one, from another thread. Returns whether the key leaves the console."""
        if key in COMMAND_KEYS and not self._command_sender.submit(COMMAND_KEYS[key]):
            self._print(self._content.translate("console_too_many_keys"), WARNING_STYLE)
        return key == QUIT_KEY

    def _on_answer(
        self, _request: CommandRequest, _context: Any, answer: Optional[CommandResponse], error: Optional[CodedError]
    ) -> None:
        # the others are printed when they arrive with the state
        if error is not None:
            sentence = sentences.translate(error.code, error.values, self._content.language, error.message)
            self._print(self._content.translate("console_try_again", what=sentence), WARNING_STYLE)
        elif answer is not None and answer.code in ("busy", "expired", "stop_held"):
            self._print(sentence_in(answer, self._content.language), WARNING_STYLE)

    # ------------------------------------------------------------------ screen
    def _print(self, text: str, style: str) -> None:
        """Prints a line with the time of day above the current state. May be called from any thread."""
        clock_time = Text(time.strftime("%H:%M:%S "), "dim")
        self._live.console.print(clock_time + safe_text(text, style))

    def run(self) -> None:
        """Shows the interaction until the operator leaves the console."""
        keyboard = sys.stdin.fileno()
        settings = termios.tcgetattr(keyboard)
        try:
            # the terminal then passes on each key at once and without an echo; control-C still interrupts
            tty.setcbreak(keyboard)
            with self._live:
                self._update_until_left(keyboard)
        except KeyboardInterrupt:
            pass
        finally:
            termios.tcsetattr(keyboard, termios.TCSADRAIN, settings)

    def _update_until_left(self, keyboard: int) -> None:
        shown_lines = None
        while not rospy.is_shutdown():
            if time.monotonic() - self._heard_at > _SILENCE_TIMEOUT:
                self._content.state = None
            self._content.notices = tuple(self._notices.current())
            screen = Group(*self._content.lines(rospy.get_time()))
            rendered_lines = self._live.console.render_lines(screen)
            if rendered_lines != shown_lines:  # avoids flicker
                shown_lines = rendered_lines
                self._live.update(screen, refresh=True)
            typed = ""
            if select.select([keyboard], [], [], _PERIOD)[0]:
                typed = os.read(keyboard, 64).decode("utf-8", "replace")
                if not typed:
                    return  # the terminal is gone
            if any([self.press(key) for key in extract_keys(typed)]):
                return


def main() -> None:
    """Runs the console until it is left."""
    parser = argparse.ArgumentParser(prog="wizard_console", description="The hidden operator's console.")
    parser.add_argument("--source", default="wizard", help="who gives the commands, for the record (default: wizard)")
    parser.add_argument("--language", default=sentences.ENGLISH, choices=sentences.languages(), help="(default: en)")
    options = parser.parse_args(rospy.myargv()[1:])
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        sys.exit("wizard_console needs a terminal; for scripts there is the service /virtual_borders/command")
    if not rosgraph.is_master_online():
        sys.exit(f"the ROS master does not answer at {rosgraph.get_master_uri()}: start the lab first")
    # rospy's own messages would garble the screen
    rospy.init_node("wizard_console", anonymous=True, disable_signals=True, log_level=rospy.FATAL)
    WizardConsoleNode(options.source, options.language).run()
    sys.stdout.flush()
    # exits without waiting for rospy's threads, which may wait for a master that is gone
    os._exit(0)
