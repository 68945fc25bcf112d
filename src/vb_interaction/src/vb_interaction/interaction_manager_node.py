"""Node: owns the state of the interaction."""

from __future__ import annotations

import threading
import traceback
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, Iterator, List, Mapping

import rospy
from vb_core import names
from vb_core.border_changes import ADDED, DISABLED, ENABLED, REMOVED, find_border_changes
from vb_core.errors import CodedError
from vb_core.files import append_line
from vb_core.interaction_tables import COMMANDS, RESUME, SAVE, STOP, UNDO, YES_ANSWERS, command_name_from_text
from vb_core.notices import Notice, Severity
from vb_core.parameters import param
from vb_core.ros import node, parameters, services
from vb_core.ros.messages import values_from_mapping
from vb_core.ros.notices import NoticeListener, NoticePublisher
from vb_core.stop_latch import StopLatch, new_id
from vb_core.sentences import words_of_name
from vb_msgs.msg import BorderProgress, DriverState, InteractionState, LaserSpot, Stop, VirtualBorder
from vb_msgs.msg import VirtualBorderArray
from vb_msgs.srv import Command, CommandRequest, CommandResponse

from vb_interaction.border_preview import PreviewPublisher
from vb_interaction.border_services import RESPONSE_TIMEOUT, SERVICE_TIMEOUT, BorderServices
from vb_interaction.command_answers import Answer, AnswerCache
from vb_interaction.interaction import Interaction, InteractionParams
from vb_interaction.state_message import make_state_message

_PUBLISH_PERIOD = 0.1  # [s] of wall time: robots stop half a second after the last state (vb_msgs/InteractionState)
_STORE_PERIOD = 2.0  # [s] between attempts to store the stop, because a full disk may have room again
# codes of answers to undo and redo, by the change of the borders; all other changes share a general answer
_CODES = {REMOVED: "border_removed", ADDED: "border_restored", ENABLED: "border_enabled", DISABLED: "border_disabled"}


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
        /virtual_borders/stop (vb_msgs/Stop): stops of all robots, which any node may publish.
        /virtual_borders/drivers (vb_msgs/DriverState): stops that only a robot has received.
        /virtual_borders/progress (vb_msgs/BorderProgress): the cameras that contributed, for the record; border and
            seed so far, for the preview; and whether drawing continues.
        /virtual_borders/spots (vb_msgs/LaserSpot): whether somebody points. If so, unclear commands must be confirmed.
        /virtual_borders/borders (vb_msgs/VirtualBorderArray): whether the preview is still valid, and
            whether there is something to undo or redo.
        /virtual_borders/notices (vb_msgs/NoticeArray): doubts about the drawing, and faulty cameras, such as
            those that disagree about the spot or have a lens that was not calibrated. They become the preview's issues.

    Published topics:
        /virtual_borders/state (vb_msgs/InteractionState, latched): on each change, and every 0.1 s of wall time.
        /virtual_borders/stop (vb_msgs/Stop): on `stop`, before anything else. Not latched, because the state contains it.
        /virtual_borders/notices (vb_msgs/NoticeArray): stopped, stop_state_lost, stop_not_stored, interaction_ends_soon,
            spot_not_seen_check_laser.
        /virtual_borders/preview (vb_msgs/BorderPreview, latched): what saving now would do, as soon as there are
            a border and a seed, and again when they, the map or the borders in it change.

    Services:
        /virtual_borders/command (vb_msgs/Command): a command with an id is carried out once, however often it is sent.
            It is refused if it has expired ("expired"), or if there was a stop of which its sender did not know
            ("stopped_since"). `stop` is always carried out.

    Services called:
        /virtual_borders/get_drawn_border (vb_msgs/GetDrawnBorder): for the preview, and on `save` if more was drawn since.
        /virtual_borders/add_border (vb_msgs/AddBorder): on `save`, with the interaction's id, so that a repeated
            save adds only one border. No lock is held meanwhile; commands other than `stop` and `resume` are answered
            with "busy".
        /virtual_borders/undo_redo (vb_msgs/UndoRedo): on `undo` and `redo`.
        /virtual_borders/list_borders (vb_msgs/ListBorders): before and after undo and redo.
        /virtual_borders/preview_border (vb_msgs/PreviewBorder): for the preview, from a separate thread.

    Parameters:
        config/interaction_manager.yaml
    """

    def __init__(self, params: ManagerParams) -> None:
        self._params = params
        self._log_file = Path(params.log_file).expanduser()
        node.keep_private(self._log_file)
        self._lock = threading.Lock()
        self._latch = StopLatch(Path(params.stop_file).expanduser())
        if self._latch.lost:
            rospy.logwarn("interaction_manager: robots count as stopped until resume: the stop's file cannot be used")
        self._interaction = Interaction(params, latch=self._latch)
        # a save makes two service calls, undo makes three
        self._answer_cache = AnswerCache(3.0 * (SERVICE_TIMEOUT + RESPONSE_TIMEOUT))
        self._contributing_cameras: Dict[str, List[str]] = {}  # by interaction's id; only those of the newest one
        self._services = BorderServices(params.occupancy)
        self._preview_publisher = PreviewPublisher(self._services, NoticeListener().current)
        self._stop_publisher = rospy.Publisher(names.STOP, Stop, queue_size=10)
        self._state_publisher = rospy.Publisher(names.STATE, InteractionState, queue_size=10, latch=True)
        self._notices = NoticePublisher()
        with self._lock:
            self._publish()
        self._publish_timer = node.WakeTimer(_PUBLISH_PERIOD)
        self._store_timer = node.WakeTimer(_STORE_PERIOD)
        node.Worker(self._publish_timer, lambda _woken: self._publish_again())
        node.Worker(self._store_timer, lambda _woken: self._latch.store())
        rospy.Subscriber(names.STOP, Stop, self._on_stop, queue_size=10)
        rospy.Subscriber(names.DRIVERS, DriverState, self._on_driver, queue_size=20)
        rospy.Subscriber(names.PROGRESS, BorderProgress, self._on_progress, queue_size=1)
        rospy.Subscriber(names.SPOTS, LaserSpot, self._on_spot, queue_size=1)
        rospy.Subscriber(names.BORDERS, VirtualBorderArray, self._on_borders, queue_size=1)
        self._service = rospy.Service(names.COMMAND, Command, self._on_command)

    def close(self) -> None:
        """Ends the workers."""
        self._publish_timer.close()
        self._store_timer.close()
        self._preview_publisher.close()

    # ------------------------------------------------------------------ inputs
    def _on_progress(self, message: BorderProgress) -> None:
        with self._lock:
            self._contributing_cameras = {message.interaction_id: list(message.cameras)}
            if message.interaction_id == self._interaction.interaction_id:
                # in the state Guide border_fusion ignores all spots, but they show that a person holds the laser
                counts = (message.border_spots, message.seed_spots, message.ignored_spots)
                self._interaction.set_spot_counts(*counts, rospy.get_time())
        self._preview_publisher.on_progress(message)

    def _on_spot(self, message: LaserSpot) -> None:
        # a single assignment needs no lock; with one, spots would have to wait while a state is published
        self._interaction.laser_seen_at = message.header.stamp.to_sec()

    def _on_borders(self, message: VirtualBorderArray) -> None:
        with self._lock:
            self._interaction.undo_redo = list(message.available_commands)
            self._publish()
        self._preview_publisher.on_borders(message)

    def _on_stop(self, message: Stop) -> None:
        sender = message._connection_header.get("callerid", "")
        if sender != rospy.get_name():
            self._stop_robots(message.id, message.source or sender.strip("/"))

    def _on_driver(self, message: DriverState) -> None:
        for identity in message.stops:
            if identity not in self._latch.stops:
                self._stop_robots(identity, message.robot or "robot_driver")

    def _publish_again(self) -> None:
        with self._lock_and_record():
            self._interaction.end_if_idle(rospy.get_time())
            self._publish()

    # ------------------------------------------------------------------ commands
    def _on_command(self, request: CommandRequest) -> CommandResponse:
        phrase = command_name_from_text(request.command)
        command = YES_ANSWERS.get(phrase, phrase)  # "yes, save" means "save"
        if command == STOP:
            answer = self._stop_robots(request.id, request.source)
        else:
            answer = self._answer_cache.answer_once(request.id, lambda: self._run_command(command, phrase, request))
        rospy.loginfo("%s says %s: %s [%s]", request.source or "somebody", phrase, answer.message, answer.code)
        values = values_from_mapping(answer.values)
        return CommandResponse(success=answer.success, code=answer.code, message=answer.message, values=values)

    def _stop_robots(self, identity: str, source: str) -> Answer:
        identity = identity or new_id()
        # published first, so that robots do not have to wait for locks, files or answers
        self._stop_publisher.publish(Stop(id=identity, source=source))
        with self._lock:
            answer = self._interaction.stop(identity, source, rospy.get_time())
            self._publish()
        # only the answer waits for the disk, so that a restart cannot release a stop that was confirmed
        return answer if self._latch.store() else Answer(True, "stop_not_stored")

    def _run_command(self, command: str, phrase: str, request: CommandRequest) -> Answer:
        """Carries out a command. `phrase` is the command's name, or the answer by which a person confirmed it."""
        with self._lock_and_record():
            interaction = self._interaction
            now = rospy.get_time()
            if not request.expires.is_zero() and now > request.expires.to_sec():
                # not recorded, so that only the person who gave the command gets this answer
                answer = Answer(False, "expired", {"command": words_of_name(phrase)})
            else:
                is_doubtful = self._preview_publisher.is_doubtful(interaction.interaction_id)
                confirms = phrase in YES_ANSWERS
                doubts = {"uncertain": request.uncertain, "doubtful_border": is_doubtful, "confirms": confirms}
                answer = interaction.command(command, request.source, now, seen_stop=request.seen_stop, **doubts)
            is_delegated = answer.success and COMMANDS[command].is_delegated
            interaction_id = interaction.interaction_id
            # a save usually has its final answer before the next state is due
            is_save_pending = is_delegated and command == SAVE
            if not is_save_pending:
                self._publish()
        if command == RESUME:
            self._latch.store()
        if is_delegated:
            return self._complete(command, interaction_id, request)
        return answer

    def _complete(self, command: str, interaction_id: str, request: CommandRequest) -> Answer:
        """Lets other nodes carry out a pending command, without holding the lock, and completes it with their answer."""
        border_id = ""
        is_sent = False
        try:
            if command == SAVE:
                border = self._preview_publisher.fetch_border_to_save(interaction_id)
                is_sent = True
                border_id = self._services.add(border, request.source, interaction_id)
                answer = Answer(True, "saved")
            else:
                answer = self._undo_or_redo(command, request.id)
        except CodedError as error:
            answer = Answer.from_error(error)
            if error.code in services.UNANSWERED:
                rospy.logwarn("interaction_manager: %s: %s", error, error.__cause__)
        except Exception:
            # after a fault of this program, the command must not remain pending: all others would be answered "busy"
            rospy.logerr("interaction_manager: %s failed:\n%s", command, traceback.format_exc())
            answer = Answer.from_error(CodedError("internal_error"))
        with self._lock_and_record():
            answer = self._interaction.finish_pending(answer, rospy.get_time(), border_id, is_sent)
            self._publish()
        return answer

    def _undo_or_redo(self, command: str, request_id: str) -> Answer:
        """Lets the map integrator undo or redo a change of the borders. The answer says how the borders have changed."""
        before = self._services.fetch_borders()
        self._services.change(command, request_id)
        try:
            return _describe_change(command, before, self._services.fetch_borders())
        except CodedError:
            return Answer(True, "borders_changed")

    @contextmanager
    def _lock_and_record(self) -> Iterator[None]:
        """Holds the lock, then releases it and logs an ended interaction: publishing never waits for the disk."""
        with self._lock:
            yield
            ended = self._interaction.take_record()
            cameras = self._contributing_cameras
        if ended is None:
            return
        rospy.loginfo("interaction %s %s after %.1f s", ended.interaction_id, ended.outcome, ended.total_s)
        try:
            contributing = cameras.get(ended.interaction_id, [])
            append_line(self._log_file, ended.to_json(self._params.method, contributing))
        except OSError as error:
            rospy.logwarn("interaction_manager: cannot write %s: %s", self._log_file, error)

    # ------------------------------------------------------------------ outputs; the lock is held
    def _publish(self) -> None:
        """Publishes state and notices, and passes the current interaction on to the preview."""
        self._state_publisher.publish(make_state_message(self._interaction, self._latch, rospy.get_time()))
        is_saving = self._interaction.pending == SAVE
        self._preview_publisher.on_interaction(self._interaction.interaction_id, is_saving)
        self._notices.set(self._list_notices())

    def _list_notices(self) -> List[Notice]:
        notices = []
        if self._latch.stopped:
            code = "stop_state_lost" if self._latch.lost else "stopped"
            notices.append(Notice(code, Severity.WARNING, values={"by": self._latch.stopped_by}))
        if not self._latch.stored:
            notices.append(Notice("stop_not_stored", Severity.WARNING))
        if self._interaction.ends_at:
            notices.append(Notice("interaction_ends_soon", Severity.WARNING))
        if self._interaction.is_spot_missing:
            notices.append(Notice("spot_not_seen_check_laser", Severity.WARNING))
        return notices


def _describe_change(command: str, before: Mapping[str, VirtualBorder], after: Mapping[str, VirtualBorder]) -> Answer:
    """Returns the answer to `undo` or `redo`, given the borders by id before and after it.

    The answer names the borders that changed, if all of them changed in the same way.
    """
    general_code = "change_undone" if command == UNDO else "change_redone"
    changes = find_border_changes(before, after)
    codes = {_CODES.get(kind, general_code) for kind, _ in changes}
    if len(codes) != 1:
        return Answer(True, "borders_changed")
    changed_borders = ", ".join(border.name or border.id for _, border in changes)
    return Answer(True, codes.pop(), {"borders": changed_borders})


def build() -> InteractionManagerNode:
    """Reads the parameters and makes the node."""
    return InteractionManagerNode(parameters.read(ManagerParams))
