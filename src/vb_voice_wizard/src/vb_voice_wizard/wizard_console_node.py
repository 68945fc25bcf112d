"""The hidden operator's console: a terminal program, one key per command."""
from __future__ import annotations

import argparse
import os
import queue
import select
import socket
import sys
import termios
import threading
import time
import tty
from typing import List, Optional

import rosgraph
import rospy
from rich.console import Console
from rich.live import Live
from std_srvs.srv import Trigger, TriggerRequest
from vb_core import names
from vb_core.errors import CodedError
from vb_core.ros import services
from vb_msgs.msg import BorderProgress, InteractionState, VirtualBorderArray
from vb_msgs.srv import Command, CommandRequest

from vb_voice_wizard import console_view
from vb_voice_wizard.console_view import BAD, COMMAND_KEYS, GOOD, NOTE, QUIT_KEY, REDO_KEY, UNDO_KEY, View
from vb_voice_wizard.interaction import spoken

_PERIOD_S = 0.2  # between two looks at the screen: an operator cannot follow more


class WizardConsole:
    """Shows the interaction and gives commands.

    Subscribes to /virtual_borders/state, /virtual_borders/progress, /virtual_borders/borders. Calls
    /virtual_borders/command, /virtual_borders/undo, /virtual_borders/redo. It waits for the ROS master,
    says when master or interaction manager go away, and goes on when they are back.

    Args:
        source: who gives the commands, for the record.
        note: a first message.
    """

    def __init__(self, source: str, note: str = "") -> None:
        self._source = source
        self._lock = threading.Lock()
        self._view = View(master=rosgraph.get_master_uri())
        self._changed = threading.Event()
        self._keys: "queue.Queue" = queue.Queue(maxsize=10)
        self._answered = rospy.Time(0)
        # a master that was restarted knows nothing of this process: it must register anew
        self._master_pid: Optional[int] = None
        self.stale = False
        if note:
            self._say(note, NOTE)
        threading.Thread(target=self._watch, daemon=True).start()
        threading.Thread(target=self._work, daemon=True).start()

    # ------------------------------------------------------------------ ROS
    def _watch(self) -> None:
        """Looks after the master and the interaction manager, once a second."""
        # an own socket limit: a master that hangs must not hang the console's watch for ever
        socket.setdefaulttimeout(5.0)
        master = rosgraph.Master("/wizard_console_watch")
        while True:
            try:
                pid: Optional[int] = master.getPid()
                present = self._master_pid is not None and self._manager_answers()
            except Exception:  # whatever the transport raises: the master does not answer
                pid, present = None, False
            self._take_watch(pid, present)
            time.sleep(1.0)

    @staticmethod
    def _manager_answers() -> bool:
        """Whether a living process offers the command service: the master remembers those killed too."""
        try:
            rospy.wait_for_service(names.COMMAND, timeout=0.8)
            return True
        except rospy.ROSException:
            return False

    def _take_watch(self, pid: Optional[int], present: bool) -> None:
        with self._lock:
            view = self._view
            if pid is None and view.connected:
                self._say("the ROS master is away, waiting for it", BAD)
            elif pid is not None and self._master_pid not in (None, pid):
                self.stale = True
            elif pid is not None and not view.connected:
                self._say("connected to the ROS master", GOOD)
            if view.state and view.manager_present != present:
                text = "the interaction manager is there" if present else "the interaction manager is away"
                self._say(text, GOOD if present else BAD)
            view.connected, view.manager_present = pid is not None, present
            self._changed.set()

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
            self._say(f"cannot connect: {error}", BAD)
            return
        with self._lock:
            self._master_pid = pid
        rospy.Subscriber(names.STATE, InteractionState, self._on_state, queue_size=5)
        rospy.Subscriber(names.PROGRESS, BorderProgress, self._on_progress, queue_size=1)
        rospy.Subscriber(names.BORDERS, VirtualBorderArray, self._on_borders, queue_size=1)

    def _on_state(self, message: InteractionState) -> None:
        with self._lock:
            view = self._view
            if not view.state:
                # later the watch tells, who knows a latched message from a living process
                view.manager_present = True
            if message.interaction_id != view.interaction_id:
                view.border_spots = view.seed_spots = view.chain_points = 0
                view.cameras = view.seeing = ()
            view.state, view.interaction_id = message.name, message.interaction_id
            view.times_s = (message.guide_s, message.border_s, message.seed_s)
            view.commands = tuple(message.commands)
            if message.last_command and message.last_answered != self._answered:
                self._answered = message.last_answered
                text = f"{message.last_source or 'somebody'}, {spoken(message.last_command)}: {message.last_message}"
                self._say(text, GOOD if message.last_success else BAD)
            self._changed.set()

    def _on_progress(self, message: BorderProgress) -> None:
        with self._lock:
            view = self._view
            view.border_spots, view.seed_spots = message.border_spots, message.seed_spots
            view.ignored_spots = message.ignored_spots
            view.chain_points, view.closed = len(message.chain), message.closed
            view.progress_message = "" if message.code == "ok" else message.message
            view.seeing, view.cameras = tuple(message.seeing), tuple(message.cameras)
            self._changed.set()

    def _on_borders(self, message: VirtualBorderArray) -> None:
        with self._lock:
            self._view.borders = tuple(
                (border.name or border.id, border.area_m2, border.enabled) for border in message.borders
            )
            self._changed.set()

    # ------------------------------------------------------------------ commands
    def press(self, key: str) -> None:
        """A key was pressed; its command is given by a thread of its own, so the screen goes on."""
        known = key in COMMAND_KEYS or key in (UNDO_KEY, REDO_KEY)
        try:
            if known:
                self._keys.put_nowait(key)
            elif key.isprintable():
                self._say(f"the key '{key}' means nothing", NOTE)
        except queue.Full:
            self._say("too many keys at once", BAD)

    def _work(self) -> None:
        while True:
            key = self._keys.get()
            if self._master_pid is None:
                self._say("not connected yet", BAD)
                continue
            try:
                if key in COMMAND_KEYS:
                    request = CommandRequest(command=COMMAND_KEYS[key], source=self._source)
                    # the answer arrives with the state; "busy" is not remembered there
                    answer = services.call(names.COMMAND, Command, request, "the interaction manager", 1.0, 15.0)
                    if answer.code == "busy":
                        self._say(answer.message, BAD)
                else:
                    service = names.UNDO if key == UNDO_KEY else names.REDO
                    answer = services.call(service, Trigger, TriggerRequest(), "the map integrator", 1.0, 5.0)
                    self._say(answer.message or "done", GOOD if answer.success else BAD)
            except CodedError as error:
                self._say(f"{error.message}, try again in a moment", BAD)

    def _say(self, text: str, style: str) -> None:
        self._view.say(time.strftime("%H:%M:%S"), text, style)
        self._changed.set()

    # ------------------------------------------------------------------ screen
    def run(self) -> bool:
        """Shows the screen until it is left; gives whether to start anew because the master did."""
        console = Console()
        keyboard = sys.stdin.fileno()
        before = termios.tcgetattr(keyboard)
        try:
            # key by key, without an echo; control-C still interrupts
            tty.setcbreak(keyboard)
            with Live(console=console, screen=True, auto_refresh=False) as live:
                while not self.stale:
                    self.connect()
                    if self._changed.is_set():
                        self._changed.clear()
                        with self._lock:
                            screen = console_view.render(self._view, console.size.height)
                        live.update(screen, refresh=True)
                    if select.select([keyboard], [], [], _PERIOD_S)[0]:
                        typed = os.read(keyboard, 64)
                        keys = console_view.keys_typed(typed.decode("utf-8", "replace"))
                        if not typed or QUIT_KEY in keys:
                            return False
                        for key in keys:
                            self.press(key)
            return True
        except KeyboardInterrupt:
            return False
        finally:
            termios.tcsetattr(keyboard, termios.TCSADRAIN, before)


def run(arguments: Optional[List[str]] = None) -> int:
    """Runs the console; gives the exit status."""
    given = sys.argv[1:] if arguments is None else arguments
    parser = argparse.ArgumentParser(prog="wizard_console", description="The hidden operator's console.")
    parser.add_argument("--source", default="wizard", help="who gives the commands, for the record (default: wizard)")
    parser.add_argument("--note", default="", help=argparse.SUPPRESS)
    chosen = parser.parse_args(rospy.myargv(["wizard_console", *given])[1:])
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        print("wizard_console needs a terminal; for scripts there is 'rosrun vb_voice_wizard command'", file=sys.stderr)
        return 1
    if WizardConsole(chosen.source, chosen.note).run():
        # rospy cannot register twice in one process: this one starts afresh in the same terminal
        sys.stdout.flush()
        again = ["--source", chosen.source, "--note", "the ROS master was restarted: connected again"]
        os.execv(sys.executable, [sys.executable, sys.argv[0], *again])
    return 0


def main() -> None:
    """Runs the program."""
    status = run()
    sys.stdout.flush()
    # rospy's threads wait for a master that may be gone: leave without them
    os._exit(status)
