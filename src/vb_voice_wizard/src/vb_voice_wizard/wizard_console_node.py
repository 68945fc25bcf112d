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
from typing import Dict, List, Optional, Tuple

import rosgraph
import rospy
from rich.console import Console
from rich.live import Live
from std_msgs.msg import String
from std_srvs.srv import Trigger, TriggerRequest
from vb_core import names
from vb_core.errors import CodedError
from vb_core.ros import services
from vb_core.ros.messages import BorderPreviewArray
from vb_core.ros.transforms import TransformLookup
from vb_msgs.msg import BorderProgress, Finding, Heard, InteractionState, VirtualBorder, VirtualBorderArray
from vb_msgs.srv import Command, CommandRequest, RemoveBorder, RemoveBorderRequest, UpdateBorder, UpdateBorderRequest

from vb_voice_wizard import console_view
from vb_voice_wizard.console_keys import Action, BorderRow, KeyReader
from vb_voice_wizard.console_view import BAD, GOOD, NOTE, View
from vb_voice_wizard.interaction import spoken

_PERIOD_S = 0.2  # between two looks at the screen: an operator cannot follow more
_WATCH_S = 1.0
_DRIVES_M = 0.03  # [m] a robot that went further since the last look drives
_WORTH_TELLING = 0.1  # confidence of something spoken that was not understood
# who is watched, by a service that only they offer
_WATCHED = (
    ("interaction manager", names.COMMAND), ("border fusion", names.CANDIDATE), ("map integrator", names.LIST_BORDERS)
)


class WizardConsole:
    """Shows the interaction and gives commands.

    Subscribes to /virtual_borders/{state,progress,preview,borders,workspace,voice/heard} and tf. Calls
    /virtual_borders/{command,undo,redo,update_border,remove_border}. It waits for the ROS master, says when the
    master or a node goes away, and goes on when they are back.

    Args:
        source: who gives the commands, for the record.
        robot_frame: the robot whose place is shown; "" for none.
        note: a first message.
    """

    def __init__(self, source: str, robot_frame: str = "base_link", note: str = "") -> None:
        self._source = source
        self._robot_frame = robot_frame
        self._lock = threading.RLock()
        self._view = View(master=rosgraph.get_master_uri())
        self._changed = threading.Event()
        self._actions: "queue.Queue[Action]" = queue.Queue(maxsize=10)
        self._answered = rospy.Time(0)
        self._progress_of = ""
        self._borders: Dict[str, VirtualBorder] = {}
        self._transforms: Optional[TransformLookup] = None
        self._robot_at: Optional[Tuple[float, float]] = None
        # a master that was restarted knows nothing of this process: it must register anew
        self._master_pid: Optional[int] = None
        self.stale = False
        if note:
            self._say(note, NOTE)
        threading.Thread(target=self._watch, daemon=True).start()
        threading.Thread(target=self._work, daemon=True).start()

    # ------------------------------------------------------------------ who is there
    def _watch(self) -> None:
        """Looks after the master, the nodes and the robot."""
        # an own socket limit: a master that hangs must not hang the console's watch for ever
        socket.setdefaulttimeout(5.0)
        master = rosgraph.Master("/wizard_console_watch")
        while True:
            away: List[str] = []
            try:
                pid: Optional[int] = master.getPid()
                if self._master_pid is not None:
                    away = [who for who, service in _WATCHED if not self._answers(master, service)]
            except Exception:  # whatever the transport raises: the master does not answer
                pid = None
            self._take_watch(pid, tuple(away))
            self._look_at_robot()
            time.sleep(_WATCH_S)

    @staticmethod
    def _answers(master: rosgraph.Master, service: str) -> bool:
        """Whether a living process offers a service: the master remembers those killed too."""
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
                self._say("the ROS master is away, waiting for it", BAD)
            elif pid is not None and self._master_pid not in (None, pid):
                self.stale = True
            elif pid is not None and not view.connected:
                self._say("connected to the ROS master", GOOD)
            # before the first state nobody knows who ought to be there
            if pid is not None and view.state:
                for who, _ in _WATCHED:
                    if (who in away) != (who in view.away):
                        self._say(f"the {who} is {'away' if who in away else 'there'}", BAD if who in away else GOOD)
            shown = pid is not None, away if view.state else ()
            if shown != (view.connected, view.away):
                view.connected, view.away = shown
                self._changed.set()

    def _look_at_robot(self) -> None:
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
            drives = before is not None and max(abs(at[0] - before[0]), abs(at[1] - before[1])) > _DRIVES_M
            text = f"x {at[0]:.2f} m, y {at[1]:.2f} m, {'drives' if drives else 'stands'}"
        with self._lock:
            if text != self._view.robot:
                self._view.robot = text
                self._changed.set()

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
            self._say(f"cannot connect: {error}", BAD)
            return
        with self._lock:
            self._master_pid = pid
        rospy.Subscriber(names.STATE, InteractionState, self._on_state, queue_size=5)
        rospy.Subscriber(names.PROGRESS, BorderProgress, self._on_progress, queue_size=1)
        rospy.Subscriber(names.PREVIEW, BorderPreviewArray, self._on_preview, queue_size=1)
        rospy.Subscriber(names.BORDERS, VirtualBorderArray, self._on_borders, queue_size=1)
        rospy.Subscriber(names.HEARD, Heard, self._on_heard, queue_size=5)
        rospy.Subscriber(names.WORKSPACE, String, self._on_workspace, queue_size=5)
        if self._robot_frame:
            self._transforms = TransformLookup(cache_s=2.0)

    def _on_state(self, message: InteractionState) -> None:
        with self._lock:
            view = self._view
            # the first progress of an interaction may come before its state
            if message.interaction_id not in (view.interaction_id, self._progress_of):
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
            self._progress_of = message.interaction_id
            view.border_spots, view.seed_spots = message.border_spots, message.seed_spots
            view.ignored_spots = message.ignored_spots
            view.chain_points, view.closed = len(message.chain), message.closed
            view.progress_message = "" if message.code == "ok" else message.message
            view.seeing, view.cameras = tuple(message.seeing), tuple(message.cameras)
            self._changed.set()

    def _on_preview(self, message: BorderPreviewArray) -> None:
        with self._lock:
            view = self._view
            view.preview, view.preview_good = message.message, message.available and message.success
            if view.preview_good and message.free_parts > 1:
                view.preview += f"; the free space would fall into {message.free_parts} parts"
            view.findings = tuple((found.message, found.severity == Finding.ERROR) for found in message.findings)
            self._changed.set()

    def _on_borders(self, message: VirtualBorderArray) -> None:
        with self._lock:
            self._borders = {border.id: border for border in message.borders}
            self._view.borders = tuple(
                BorderRow(border.id, border.name or border.id, border.area_m2, border.enabled, border.occupancy)
                for border in message.borders
            )
            self._changed.set()

    def _on_workspace(self, message: String) -> None:
        self._say(message.data, NOTE)

    def _on_heard(self, message: Heard) -> None:
        # what was understood comes with the state, as any command
        if not message.accepted and message.confidence >= _WORTH_TELLING:
            words = f"like {spoken(message.command)}, confidence {message.confidence:.2f}"
            self._say(f"voice: not understood ({words}, {message.reason.replace('_', ' ')})", NOTE)

    # ------------------------------------------------------------------ commands
    def press(self, key: str) -> bool:
        """A key was pressed; what it asks for is done by a thread of its own, so the screen goes on.

        Returns:
            Whether the console is to be left.
        """
        with self._lock:
            action = self._view.controls.press(key, self._view.borders)
            self._changed.set()
        if action is None:
            return False
        if action.what == "note":
            self._say(action.text, NOTE)
        elif action.what != "quit":
            try:
                self._actions.put_nowait(action)
            except queue.Full:
                self._say("too many keys at once", BAD)
        return action.what == "quit"

    def _work(self) -> None:
        while True:
            action = self._actions.get()
            if self._master_pid is None:
                self._say("not connected yet", BAD)
                continue
            try:
                self._do(action)
            except CodedError as error:
                self._say(f"{error.message}, try again in a moment", BAD)

    def _do(self, action: Action) -> None:
        if action.what == "command":
            request = CommandRequest(command=action.text, source=self._source)
            # the answer arrives with the state; "busy" is not remembered there
            answer = services.call(names.COMMAND, Command, request, "the interaction manager", 1.0, 15.0)
            if answer.code == "busy":
                self._say(answer.message, BAD)
            return
        if action.what in ("undo", "redo"):
            service, kind, request = {"undo": names.UNDO, "redo": names.REDO}[action.what], Trigger, TriggerRequest()
        elif action.what == "remove":
            service, kind, request = names.REMOVE_BORDER, RemoveBorder, RemoveBorderRequest(id=action.border_id)
        else:
            with self._lock:
                border = self._borders.get(action.border_id)
            if border is None:
                self._say("this border is not there any more", BAD)
                return
            service, kind, request = names.UPDATE_BORDER, UpdateBorder, self._changed_border(border, action)
        answer = services.call(service, kind, request, "the map integrator", 1.0, 5.0)
        self._say(answer.message or "done", GOOD if answer.success else BAD)
        for found in getattr(answer, "findings", ()):
            if found.message not in answer.message:
                self._say(found.message, BAD)

    def _changed_border(self, border: VirtualBorder, action: Action) -> UpdateBorderRequest:
        wanted = VirtualBorder(**{name: getattr(border, name) for name in VirtualBorder.__slots__})
        if action.what == "rename":
            wanted.name = action.text
        else:
            wanted.enabled = action.what == "enable"
            # who turns it by hand does not want it to turn back by itself
            wanted.expires = rospy.Time(0)
        return UpdateBorderRequest(border=wanted, frame_id=names.MAP_FRAME, source=self._source)

    def _say(self, text: str, style: str) -> None:
        with self._lock:
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
            # a whole screen is written over the one before, and only if something changed: nothing flickers
            with Live(console=console, screen=True, auto_refresh=False) as live:
                return self._show(console, live, keyboard)
        except KeyboardInterrupt:
            return False
        finally:
            termios.tcsetattr(keyboard, termios.TCSADRAIN, before)

    def _show(self, console: Console, live: Live, keyboard: int) -> bool:
        reader, shown_size = KeyReader(), None
        while not self.stale:
            self.connect()
            size = console.size
            if self._changed.is_set() or size != shown_size:
                self._changed.clear()
                shown_size = size
                with self._lock:
                    screen = console_view.render(self._view, size.width, size.height)
                live.update(screen, refresh=True)
            typed = ""
            if select.select([keyboard], [], [], _PERIOD_S)[0]:
                typed = os.read(keyboard, 64).decode("utf-8", "replace")
                if not typed:
                    return False  # the terminal is gone
            if any([self.press(key) for key in reader.feed(typed)]):
                return False
        return True


def run(arguments: Optional[List[str]] = None) -> int:
    """Runs the console; gives the exit status."""
    given = sys.argv[1:] if arguments is None else arguments
    parser = argparse.ArgumentParser(prog="wizard_console", description="The hidden operator's console.")
    parser.add_argument("--source", default="wizard", help="who gives the commands, for the record (default: wizard)")
    parser.add_argument(
        "--robot-frame", default="base_link", help="the robot whose place is shown, empty for none (default: base_link)"
    )
    parser.add_argument("--note", default="", help=argparse.SUPPRESS)
    chosen = parser.parse_args(rospy.myargv(["wizard_console", *given])[1:])
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        print("wizard_console needs a terminal; for scripts there is 'rosrun vb_voice_wizard command'", file=sys.stderr)
        return 1
    if WizardConsole(chosen.source, chosen.robot_frame, chosen.note).run():
        # rospy cannot register twice in one process: this one starts afresh in the same terminal
        sys.stdout.flush()
        again = ["--source", chosen.source, "--robot-frame", chosen.robot_frame]
        again += ["--note", "the ROS master was restarted: connected again"]
        os.execv(sys.executable, [sys.executable, sys.argv[0], *again])
    return 0


def main() -> None:
    """Runs the program."""
    status = run()
    sys.stdout.flush()
    # rospy's threads wait for a master that may be gone: leave without them
    os._exit(status)
