"""The node that owns the state of the interaction."""
from __future__ import annotations

import queue
import threading
from dataclasses import dataclass
from typing import List, Optional

import numpy as np
import rospy
from std_msgs.msg import String
from vb_core import names
from vb_core.errors import CodedError
from vb_core.parameters import Parameters, param
from vb_core.ros import node, parameters
from vb_core.ros.messages import array_from_points
from vb_msgs.msg import BorderProgress, InteractionState, VirtualBorder, VirtualBorderArray
from vb_msgs.srv import Command, CommandRequest, CommandResponse

from vb_voice_wizard import memory
from vb_voice_wizard.interaction import Answer, Interaction, State, normalise
from vb_voice_wizard.neighbours import UNANSWERED, Neighbours
from vb_voice_wizard.preview_pace import PreviewParams
from vb_voice_wizard.previewer import Previewer


@dataclass(frozen=True)
class ManagerParams(Parameters):
    """Parameters of the interaction manager; config/interaction_manager.yaml says why."""

    log_file: str = param("~/.ros/virtual_borders/interactions.jsonl")
    state_file: str = param("~/.ros/virtual_borders/interaction_state.json")
    method: str = param("nrs")
    border_name: str = param("")
    occupancy: float = param(1.0, "", low=0.0, high=1.0)
    command_text_topic: str = param("/virtual_borders/command_text")
    service_wait: float = param(2.0, "s", above=0.0, high=10.0)
    service_answer: float = param(5.0, "s", above=0.0, high=60.0)
    publish_period: float = param(0.5, "s", above=0.0, high=0.5)


class InteractionManager:
    """Takes commands, owns the state, and saves the border when the person says so.

    Subscribes to:
        /virtual_borders/command_text (std_msgs/String): a command as text, "define_border" or "define border";
            its answer is in the state.
        /virtual_borders/progress (vb_msgs/BorderProgress): which cameras contributed, for the record; border and
            seed so far, for the preview.
        /virtual_borders/borders (vb_msgs/VirtualBorderArray): to see whether a save whose answer was lost
            has arrived after all, and whether the preview is still right.

    Publishes:
        /virtual_borders/state (vb_msgs/InteractionState, latched): on each change, and every
            ~publish_period while an interaction is under way.
        /virtual_borders/preview (vb_msgs/BorderPreview, latched): what saving now would do, as soon as there are
            border and seed, and anew when they, the map or the borders in it change.

    Offers:
        /virtual_borders/command (vb_msgs/Command).

    Calls on "save":
        /virtual_borders/get_candidate (vb_msgs/GetCandidate), then /virtual_borders/add_border (vb_msgs/AddBorder).
        No lock is held meanwhile; other commands are answered with "busy".

    Calls for the preview, from a thread of its own:
        /virtual_borders/get_candidate, then /virtual_borders/preview_border (vb_msgs/PreviewBorder).

    Args:
        params, preview: see config/interaction_manager.yaml.
        run_id: the roscore's /run_id, by which a memory of another run is told apart.
    """

    def __init__(self, params: ManagerParams, preview: PreviewParams, run_id: str) -> None:
        self._params = params
        self._log_file = memory.writable("~log_file", params.log_file)
        self._state_file = memory.StateFile(memory.writable("~state_file", params.state_file), run_id)
        self._lock = threading.Lock()
        self._interaction = Interaction()
        # set while it is not known whether the map integrator has taken this interaction's border
        self._unsure = False
        self._cameras: List[str] = []
        self._cameras_of = ""
        self._borders: List[VirtualBorder] = []
        self._texts: "queue.Queue" = queue.Queue(maxsize=20)
        self._recall()

        self._neighbours = Neighbours(
            params.border_name, params.occupancy, params.service_wait, params.service_answer
        )
        self._preview = Previewer(preview, self._neighbours)
        self._publisher = rospy.Publisher(names.STATE, InteractionState, queue_size=10, latch=True)
        with self._lock:
            self._publish()
        rospy.Subscriber(names.PROGRESS, BorderProgress, self._on_progress, queue_size=1)
        rospy.Subscriber(names.BORDERS, VirtualBorderArray, self._on_borders, queue_size=1)
        rospy.Subscriber(params.command_text_topic, String, self._on_text, queue_size=10)
        threading.Thread(target=self._serve_texts, daemon=True).start()
        self._service = rospy.Service(names.COMMAND, Command, self._on_command)
        # reset: simulated time may jump back when a simulation starts afresh
        self._timer = rospy.Timer(rospy.Duration(params.publish_period), self._on_timer, reset=True)

    def close(self) -> None:
        """Ends the preview's worker."""
        self._preview.close()

    # ------------------------------------------------------------------ inputs
    def _on_progress(self, message: BorderProgress) -> None:
        with self._lock:
            self._cameras, self._cameras_of = list(message.cameras), message.interaction_id
        self._preview.on_progress(message)

    def _on_borders(self, message: VirtualBorderArray) -> None:
        with self._lock:
            self._borders = list(message.borders)
        self._preview.on_borders(message)

    def _on_text(self, message: String) -> None:
        try:
            self._texts.put_nowait(message.data)
        except queue.Full:
            rospy.logwarn_throttle(5.0, "interaction_manager: too many commands as text at once, some are lost")

    def _serve_texts(self) -> None:
        while not rospy.is_shutdown():
            self._handle(self._texts.get(), "text")

    def _on_command(self, request: CommandRequest) -> CommandResponse:
        answer = self._handle(request.command, request.source)
        return CommandResponse(success=answer.success, code=answer.code, message=answer.message)

    def _on_timer(self, _event: rospy.timer.TimerEvent) -> None:
        with self._lock:
            if self._interaction.state != State.DEFAULT:
                self._interaction.advance(rospy.get_time())
            # also in Default: robots' drivers stop when it is silent
            self._publish()

    # ------------------------------------------------------------------ commands
    def _handle(self, command: str, source: str) -> Answer:
        with self._lock:
            answer = self._interaction.command(command, source, rospy.get_time())
            save = answer.success and self._interaction.saving
            interaction_id, unsure = self._interaction.interaction_id, self._unsure
            if save:
                self._preview.on_interaction(interaction_id, saving=True)
            else:
                self._changed()
        if save:
            answer = self._save(interaction_id, unsure)
        rospy.loginfo("%s says %s: %s [%s]", source or "somebody", normalise(command), answer.message, answer.code)
        return answer

    def _save(self, interaction_id: str, unsure: bool) -> Answer:
        """Asks the neighbours, without the lock, then ends or continues the interaction."""
        try:
            border = self._neighbours.candidate(interaction_id)
            border_id = self._find(border) if unsure else ""
            if not border_id:
                border_id = self._add(border)
        except CodedError as error:
            message = error.message
            if error.code in UNANSWERED:
                rospy.logwarn("interaction_manager: %s: %s", error, error.__cause__)
                message = f"{message}; say save again in a moment."
            with self._lock:
                answer = self._interaction.refuse_save(error.code, message, rospy.get_time())
                self._changed()
            return answer
        with self._lock:
            self._unsure = False
            answer = self._interaction.finish_save(border_id, rospy.get_time())
            self._changed()
        return answer

    def _add(self, border: VirtualBorder) -> str:
        with self._lock:
            self._unsure = True
            self._remember()
            source = self._interaction.last_source
        try:
            border_id = self._neighbours.add(border, source)
        except CodedError as error:
            # only what was sent and not answered may have arrived
            if error.code != "no_answer":
                with self._lock:
                    self._unsure = False
            raise
        with self._lock:
            self._unsure = False
        return border_id

    def _find(self, border: VirtualBorder) -> str:
        """The id of a border in the store with this very chain and seed, or ""."""
        with self._lock:
            stored = list(self._borders)
        wanted = array_from_points([*border.points, border.seed])
        for candidate in stored:
            found = array_from_points([*candidate.points, candidate.seed])
            if found.shape == wanted.shape and np.allclose(found, wanted, atol=1e-6):
                return candidate.id
        return ""

    # ------------------------------------------------------------------ outputs; the lock is held
    def _changed(self) -> None:
        record = self._interaction.take_record()
        if record is not None:
            self._unsure = False
            cameras = self._cameras if self._cameras_of == record.interaction_id else []
            line = memory.record_line(record, self._params.method, cameras)
            rospy.loginfo("interaction %s %s after %.1f s", record.interaction_id, record.outcome, record.total_s)
            try:
                memory.append_line(self._log_file, line)
            except OSError as error:
                rospy.logwarn("interaction_manager: cannot write %s: %s", self._log_file, error)
        self._remember()
        self._publish()

    def _remember(self) -> None:
        try:
            self._state_file.write({"interaction": self._interaction.to_mapping(), "unsure": self._unsure})
        except OSError as error:
            rospy.logwarn_throttle(30.0, f"interaction_manager: cannot remember the interaction: {error}")

    def _recall(self) -> None:
        try:
            remembered = self._state_file.read()
            if remembered is None:
                return
            self._interaction = Interaction.from_mapping(remembered.get("interaction"))
            self._unsure = remembered.get("unsure") is True
        except CodedError as error:
            rospy.logwarn("interaction_manager: starting afresh: %s", error)
            return
        self._interaction.advance(rospy.get_time())
        if self._interaction.state != State.DEFAULT:
            rospy.loginfo(
                "interaction %s goes on in state %s",
                self._interaction.interaction_id,
                self._interaction.state.name.lower(),
            )

    def _publish(self) -> None:
        self._preview.on_interaction(self._interaction.interaction_id, self._interaction.saving)
        interaction, now = self._interaction, rospy.get_time()
        durations = interaction.durations(now)
        message = InteractionState()
        message.header.stamp = rospy.Time.from_sec(now)
        message.header.frame_id = names.MAP_FRAME
        message.state = int(interaction.state)
        message.name = interaction.state.name.lower()
        message.interaction_id = interaction.interaction_id
        message.started = rospy.Time.from_sec(interaction.started)
        message.entered = rospy.Time.from_sec(interaction.entered)
        message.guide_s = durations[State.GUIDE]
        message.border_s = durations[State.BORDER]
        message.seed_s = durations[State.SEED]
        message.commands = interaction.sensible_commands()
        message.last_command = interaction.last_command
        message.last_source = interaction.last_source
        message.last_success = interaction.last_answer.success
        message.last_code = interaction.last_answer.code
        message.last_message = interaction.last_answer.message
        message.last_answered = rospy.Time.from_sec(interaction.last_answered)
        message.last_outcome = interaction.last_outcome
        message.last_border_id = interaction.last_border_id
        self._publisher.publish(message)


def _await_clock(limit_s: float = 3.0) -> None:
    """Waits for simulated time, so that a remembered interaction is not counted from zero; not for ever."""
    waited = 0.0
    while rospy.get_rostime().is_zero() and waited < limit_s and not rospy.is_shutdown():
        rospy.rostime.wallsleep(0.02)
        waited += 0.02


def _build() -> InteractionManager:
    params = parameters.read(ManagerParams, ignore=("preview",))
    preview = parameters.read(PreviewParams, "~preview")
    _await_clock()
    run_id: Optional[str] = rospy.get_param("/run_id", "")
    return InteractionManager(params, preview, str(run_id or ""))


def main() -> None:
    """Runs the node."""
    node.run("interaction_manager", _build)
