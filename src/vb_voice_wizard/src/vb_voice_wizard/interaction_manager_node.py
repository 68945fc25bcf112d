"""Node: owns the state of the interaction."""

from __future__ import annotations

import threading
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, List, Mapping

import rospy
from vb_core import names
from vb_core.border_changes import ADDED, DISABLED, ENABLED, REMOVED, border_changes
from vb_core.errors import CodedError
from vb_core.files import append_line
from vb_core.notices import Notice, Severity
from vb_core.parameters import param
from vb_core.ros import node, parameters, services
from vb_core.ros.messages import values_from_mapping
from vb_core.ros.notices import NoticeListener, NoticePublisher
from vb_core.stop_latch import StopLatch, new_id
from vb_core.sentences import spelled_out
from vb_core.vocabulary import ANSWERS, BORDER, COMMANDS, GUIDE, RESUME, SAVE, SEED, STOP, UNDO, normalize
from vb_msgs.msg import BorderProgress, DriverState, InteractionState, LaserSpot, Stop, VirtualBorder
from vb_msgs.msg import VirtualBorderArray
from vb_msgs.srv import Command, CommandRequest, CommandResponse

from vb_voice_wizard.dialogue.command_answers import Answer, AnswerCache
from vb_voice_wizard.dialogue.borders import RESPONSE_TIMEOUT, SERVICE_TIMEOUT, BorderServices, Previewer
from vb_voice_wizard.interaction import Interaction, InteractionParams

# [s] wall time: robots stop half a second after the last state, see vb_msgs/InteractionState
_REPEATED_AFTER = 0.1
# what undo and redo did to borders; any other change is reported as undone or redone
_CODES = {REMOVED: "border_removed", ADDED: "border_restored", ENABLED: "border_enabled", DISABLED: "border_disabled"}
_STORE_PERIOD = 2.0  # [s] between attempts to store the stop: a full disk may have room again


@dataclass(frozen=True)
class ManagerParams(InteractionParams):
    """Parameters of the interaction manager; config/interaction_manager.yaml explains them."""

    log_file: str = param("~/.ros/virtual_borders/interactions.jsonl")
    stop_file: str = param("~/.ros/virtual_borders/robots.stop")
    method: str = param("nrs")
    occupancy: float = param(1.0, "", low=0.01, high=1.0)


class InteractionManagerNode:
    """Carries out commands, owns the state, and saves the border on the command *save*.

    Subscribed topics:
        /virtual_borders/stop (vb_msgs/Stop): stops every robot; from any node.
        /virtual_borders/drivers (vb_msgs/DriverState): stops that only a robot has received.
        /virtual_borders/progress (vb_msgs/BorderProgress): which cameras contributed, for the record; border and seed
            so far, for the preview; whether drawing continues.
        /virtual_borders/spots (vb_msgs/LaserSpot): whether somebody points: an unclear command is then asked about.
        /virtual_borders/borders (vb_msgs/VirtualBorderArray): whether the preview is still valid, and
            whether there is something to undo or redo.
        /virtual_borders/notices (vb_msgs/NoticeArray): doubts about the drawing, and faulty cameras, such as
            those that disagree on the spot or have another lens than calibrated; each preview lists them as issues.

    Published topics:
        /virtual_borders/state (vb_msgs/InteractionState, latched): on each change, and every 0.1 s of wall time.
        /virtual_borders/stop (vb_msgs/Stop): on `stop`, before anything else; not latched, as the state contains it.
        /virtual_borders/notices (vb_msgs/NoticeArray): stopped, stop_state_lost, stop_not_stored, interaction_ends_soon,
            spot_not_seen_check_laser.
        /virtual_borders/preview (vb_msgs/BorderPreview, latched): what saving now would do, as soon as there are
            a border and a seed, and again when they, the map or the borders in it change.

    Services:
        /virtual_borders/command (vb_msgs/Command): one with an id is carried out once, however often it is sent.
            A command is refused after its expiry ("expired"), or after a stop that its sender had not seen
            ("stopped_since"). `stop` is always carried out.

    Services called:
        /virtual_borders/get_drawn_border (vb_msgs/GetDrawnBorder): for the preview, and on `save` if more was drawn since.
        /virtual_borders/add_border (vb_msgs/AddBorder): on `save`, with the interaction's id, so that a repeated
            save adds only one border. No lock is held meanwhile; commands other than `stop` and `resume` are answered
            with "busy".
        /virtual_borders/undo_redo (vb_msgs/UndoRedo): on `undo` and `redo`.
        /virtual_borders/list_borders (vb_msgs/ListBorders): before and after undo and redo.
        /virtual_borders/preview_border (vb_msgs/PreviewBorder): for the preview, from a separate thread.

    Args:
        params: see config/interaction_manager.yaml.
    """

    def __init__(self, params: ManagerParams) -> None:
        self._params = params
        self._log_file = Path(params.log_file).expanduser()
        node.keep_private(self._log_file)
        self._lock = threading.Lock()
        self._latch = StopLatch(Path(params.stop_file).expanduser())
        if self._latch.lost:
            rospy.logwarn("interaction_manager: it is not known whether robots were stopped: they are, until resume")
        self._interaction = Interaction(params, latch=self._latch)
        # a save makes two service calls, undo makes three
        self._answer_cache = AnswerCache(3.0 * (SERVICE_TIMEOUT + RESPONSE_TIMEOUT))
        self._cameras: Dict[str, List[str]] = {}  # that contributed, by the id of the newest known interaction

        self._services = BorderServices(params.occupancy)
        self._preview = Previewer(self._services, NoticeListener().current)
        self._stop = rospy.Publisher(names.STOP, Stop, queue_size=10)
        self._publisher = rospy.Publisher(names.STATE, InteractionState, queue_size=10, latch=True)
        self._notices = NoticePublisher()
        with self._lock:
            self._publish()
        self._timer = node.WakeTimer(_REPEATED_AFTER)
        self._storing = node.WakeTimer(_STORE_PERIOD)
        node.Worker(self._timer, lambda _woken: self._on_beat())
        node.Worker(self._storing, lambda _woken: self._latch.store())
        rospy.Subscriber(names.STOP, Stop, self._on_stop, queue_size=10)
        rospy.Subscriber(names.DRIVERS, DriverState, self._on_driver, queue_size=20)
        rospy.Subscriber(names.PROGRESS, BorderProgress, self._on_progress, queue_size=1)
        rospy.Subscriber(names.SPOTS, LaserSpot, self._on_spot, queue_size=1)
        rospy.Subscriber(names.BORDERS, VirtualBorderArray, self._on_borders, queue_size=1)
        self._service = rospy.Service(names.COMMAND, Command, self._on_command)

    def close(self) -> None:
        """Ends the workers."""
        self._timer.close()
        self._storing.close()
        self._preview.close()

    # ------------------------------------------------------------------ inputs
    def _on_progress(self, message: BorderProgress) -> None:
        with self._lock:
            self._cameras = {message.interaction_id: list(message.cameras)}
            if message.interaction_id == self._interaction.interaction_id:
                # in Guide the fusion ignores all spots, but they show that a person holds the laser
                self._interaction.set_spot_counts(
                    message.border_spots, message.seed_spots, message.ignored_spots, rospy.get_time()
                )
        self._preview.on_progress(message)

    def _on_spot(self, message: LaserSpot) -> None:
        # one assignment, which is read once: it needs no lock, and spots do not wait while a state is published
        self._interaction.see_laser(message.header.stamp.to_sec())

    def _on_borders(self, message: VirtualBorderArray) -> None:
        with self._lock:
            self._interaction.undo_redo = list(message.available_commands)
            self._publish()
        self._preview.on_borders(message)

    def _on_stop(self, message: Stop) -> None:
        sender = message._connection_header.get("callerid", "")
        if sender != rospy.get_name():
            self._stop_robots(message.id, message.source or sender.strip("/"))

    def _on_driver(self, message: DriverState) -> None:
        for identity in message.stops:
            if identity not in self._latch.stops:
                self._stop_robots(identity, message.robot or "robot_driver")

    def _on_beat(self) -> None:
        with self._lock:
            if self._interaction.end_if_idle(rospy.get_time()):
                self._publish_and_record()
            else:
                self._publish()

    # ------------------------------------------------------------------ commands
    def _on_command(self, order: CommandRequest) -> CommandResponse:
        said = normalize(order.command)
        command = ANSWERS.get(said, said)  # "yes, save" means "save"
        if command == STOP:
            answer = self._stop_robots(order.id, order.source)
        else:
            answer = self._answer_cache.answer_once(order.id, lambda: self._run_command(command, said, order))
        rospy.loginfo("%s says %s: %s [%s]", order.source or "somebody", said, answer.message, answer.code)
        return CommandResponse(
            success=answer.success, code=answer.code, message=answer.message, values=values_from_mapping(answer.values)
        )

    def _stop_robots(self, identity: str, source: str) -> Answer:
        identity = identity or new_id()
        # robots do not wait for locks, files or answers
        self._stop.publish(Stop(id=identity, source=source))
        with self._lock:
            answer = self._interaction.command(STOP, source, rospy.get_time(), identity=identity)
            self._publish()
        # robots have stopped; the answer waits for the disk, so that no restart undoes what was answered
        return answer if self._latch.store() else Answer(True, "stop_not_stored")

    def _run_command(self, command: str, said: str, order: CommandRequest) -> Answer:
        """Carries out the command that was meant by what a person said."""
        with self._lock:
            interaction, now = self._interaction, rospy.get_time()
            if not order.expires.is_zero() and now > order.expires.to_sec():
                # only the person who gave it is told
                answer = Answer(False, "expired", {"command": spelled_out(said)})
            else:
                doubtful = self._preview.has_warning(interaction.interaction_id)
                answer = interaction.command(
                    command, order.source, now, order.uncertain, doubtful, said in ANSWERS, seen_stop=order.seen_stop
                )
            pending = interaction.pending if answer.success and COMMANDS[command].carried_out_elsewhere else ""
            interaction_id = interaction.interaction_id
            if pending == SAVE:
                self._preview.on_interaction(interaction_id, saving=True)
            else:
                self._publish_and_record()
        if command == RESUME:
            self._latch.store()
        return self._complete(pending, interaction_id, order) if pending else answer

    def _complete(self, pending: str, interaction_id: str, order: CommandRequest) -> Answer:
        """Has other nodes carry out a pending command, without the lock, and completes it with their answer."""
        border_id = ""
        try:
            if pending == SAVE:
                border_id, answer = self._save(interaction_id, order.source), Answer(True, "saved")
            else:
                answer = self._change(pending, order.id)
        except CodedError as error:
            answer = Answer.refusal(error)
            if error.code in services.UNANSWERED:
                rospy.logwarn("interaction_manager: %s: %s", error, error.__cause__)
        except Exception:
            # a fault of this program must not leave it answering "busy" for ever
            rospy.logerr("interaction_manager: %s failed:\n%s", pending, traceback.format_exc())
            answer = Answer.refusal(CodedError("internal_error"))
        with self._lock:
            answer = self._interaction.finish(answer, rospy.get_time(), border_id)
            self._publish_and_record()
        return answer

    def _save(self, interaction_id: str, source: str) -> str:
        """Adds the drawn border to the map; returns its id."""
        border = self._preview.border_to_save(interaction_id)
        with self._lock:
            self._interaction.mark_save_sent()
        return self._services.add(border, source, interaction_id)

    def _change(self, command: str, request_id: str) -> Answer:
        """Carries out undo or redo; returns how the borders changed."""
        before = self._services.fetch_borders()
        self._services.change(command, request_id)
        try:
            return _what_changed(command, before, self._services.fetch_borders())
        except CodedError:
            return Answer(True, "borders_changed")

    # ------------------------------------------------------------------ outputs; the lock is held
    def _publish_and_record(self) -> None:
        """Publishes the state, and appends the record of an interaction that has just ended."""
        self._publish()
        ended = self._interaction.take_record()
        if ended is not None:
            cameras = self._cameras.get(ended.interaction_id, [])
            rospy.loginfo("interaction %s %s after %.1f s", ended.interaction_id, ended.outcome, ended.total_s)
            try:
                append_line(self._log_file, ended.line(self._params.method, cameras), private=True)
            except OSError as error:
                rospy.logwarn("interaction_manager: cannot write %s: %s", self._log_file, error)

    def _publish(self) -> None:
        interaction, now = self._interaction, rospy.get_time()
        durations = interaction.durations(now)
        message = InteractionState()
        message.header.stamp = rospy.Time.from_sec(now)
        message.header.frame_id = names.MAP_FRAME
        message.name = interaction.state.name
        message.interaction_id = interaction.interaction_id
        message.started = rospy.Time.from_sec(interaction.started)
        message.entered = rospy.Time.from_sec(interaction.entered)
        message.guide_s = durations[GUIDE]
        message.border_s = durations[BORDER]
        message.seed_s = durations[SEED]
        message.stopped, message.stopped_by, message.stop_number, message.stops = self._latch.read()
        message.ends_at = rospy.Time.from_sec(interaction.ends_at)
        message.confirm_save = interaction.question.command == SAVE
        message.available_commands = interaction.suggested_commands()
        message.last_command = interaction.last_command
        message.last_source = interaction.last_source
        message.last_success = interaction.last_answer.success
        message.last_code = interaction.last_answer.code
        message.last_message = interaction.last_answer.message if interaction.last_answer.code else ""
        message.last_values = values_from_mapping(interaction.last_answer.values)
        message.last_answered = rospy.Time.from_sec(interaction.last_answered)
        message.last_outcome = interaction.last_outcome
        message.last_border_id = interaction.last_border_id
        self._publisher.publish(message)
        self._preview.on_interaction(interaction.interaction_id, interaction.pending == SAVE)
        self._notices.set(self._list_notices())

    def _list_notices(self) -> List[Notice]:
        said = []
        if self._latch.stopped:
            code = "stop_state_lost" if self._latch.lost else "stopped"
            said.append(Notice(code, Severity.WARNING, values={"by": self._latch.by}))
        if not self._latch.stored:
            said.append(Notice("stop_not_stored", Severity.WARNING))
        if self._interaction.ends_at:
            said.append(Notice("interaction_ends_soon", Severity.WARNING))
        if self._interaction.unseen:
            said.append(Notice("spot_not_seen_check_laser", Severity.WARNING))
        return said


def _what_changed(command: str, before: Mapping[str, VirtualBorder], after: Mapping[str, VirtualBorder]) -> Answer:
    """Returns the answer to `undo` or `redo`, from the borders by id before and after it.

    It names the borders if all of them changed in the same way.
    """
    other = "change_undone" if command == UNDO else "change_redone"
    changes = [(_CODES.get(kind, other), border) for kind, border in border_changes(before, after)]
    if len({code for code, _ in changes}) != 1:
        return Answer(True, "borders_changed")
    return Answer(True, changes[0][0], {"borders": ", ".join(border.name or border.id for _, border in changes)})


def build() -> InteractionManagerNode:
    """Reads the parameters and makes the node."""
    return InteractionManagerNode(parameters.read(ManagerParams))
