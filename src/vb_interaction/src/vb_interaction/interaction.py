"""The interaction between person and system as a state machine (paper, Sect. 4.2).

Its commands and states are in the tables of vb_core.interaction_tables. Every command is answered in every state. A repeated command
continues where the person left off, and erases nothing. Only `cancel`, a completed `save` and a long silence end an
interaction, and silence does not end a paused one. `stop` has priority over everything else, and holds until somebody
who knows of it gives the command `resume`. The caller passes the time, in seconds; it may pause or jump back.

Whether a command must be confirmed depends on what it would do now. If it would move a robot, change the map or lose a
drawing, the person is asked for confirmation unless the command is beyond doubt. Any other command is carried out at
once. People confirm with a different phrase ("yes, save"), because a word that was misheard once is easily misheard
again. Only the source that was asked can confirm.

Use this module to add or test an input method: a command's name goes in, an answer with a code comes out. The node
`interaction_manager` wraps one instance.

>>> interaction = Interaction()
>>> interaction.command(DEFINE_BORDER, source="console", now=0.0).success
True
>>> interaction.state.name, interaction.suggested_commands()
('border', ['define_seed', 'guide_robot', 'pause', 'cancel', 'stop'])
"""

from __future__ import annotations

import json
import math
import uuid
from dataclasses import asdict, dataclass
from typing import Dict, List, NamedTuple, Optional, Sequence, Tuple

from vb_core.interaction_tables import ALWAYS, NEVER, WHILE_DRAWN, WHILE_POINTING, WHILE_STOPPED
from vb_core.interaction_tables import COMMANDS, STATES, State
from vb_core.interaction_tables import BORDER, DEFAULT, GUIDE, PAUSED, SEED
from vb_core.interaction_tables import CANCEL, CONTINUE, DEFINE_BORDER, DEFINE_SEED, GUIDE_ROBOT
from vb_core.interaction_tables import PAUSE, REDO, RESUME, SAVE, STOP, UNDO
from vb_core.parameters import Parameters, param
from vb_core.sentences import words_of_name
from vb_core.stop_latch import StopLatch, new_id
from vb_interaction.command_answers import Answer

MISSING_SPOT_DELAY = 10.0  # [s] in Border or Seed, after which people usually draw: then a missing spot is reported
_WARNING_TIME = 60.0  # [s] between the warning and the end of an idle interaction; at most half of the timeout
LASER_ON_TIMEOUT = 1.0  # [s] for which a laser counts as on after its last spot
CONFIRM_TIMEOUT = 30.0  # [s] to confirm a command: long enough to look at the preview, too short to forget the question


@dataclass(frozen=True)
class InteractionParams(Parameters):
    """Parameters of an interaction; config/interaction_manager.yaml explains them."""

    robot: bool = param(True)
    idle_timeout: float = param(300.0, "s", low=1.0, high=86400.0)


@dataclass(frozen=True)
class InteractionRecord:
    """The record of an interaction that has ended. Times are in seconds."""

    interaction_id: str
    outcome: str
    border_id: str
    started: float
    ended: float
    guide_s: float
    border_s: float
    seed_s: float
    total_s: float
    sources: Tuple[str, ...]

    def to_json(self, method: str, cameras: Sequence[str]) -> str:
        """Returns the record as one line of JSON, with the study's method and the cameras that contributed spots."""
        fields = asdict(self)
        for name, value in fields.items():
            if isinstance(value, float):
                fields[name] = round(value, 3)
        return json.dumps({**fields, "method": method, "cameras": list(cameras)})


class Question(NamedTuple):
    """The open question whether a person meant a command. `command` is "" if no question is open."""

    command: str = ""
    source: str = ""  # who gave the command; only this source can confirm it
    asked_at: float = 0.0  # [s]


class Interaction:
    """The state machine. Not thread safe.

    `save`, `undo` and `redo` take two steps, because other nodes carry them out. If `command` succeeds, the command is
    `pending`, and `finish_pending` must be called with the answer of those nodes.

    Args:
        latch: knows whether robots are stopped, which does not end with an interaction.
    """

    def __init__(self, params: InteractionParams = InteractionParams(), latch: Optional[StopLatch] = None) -> None:
        self._params = params
        self.question = Question()
        self.state = DEFAULT
        self.interaction_id = ""
        self.started_at = 0.0
        self.state_entered_at = 0.0
        self.pending = ""  # the command that another node is carrying out
        self.last_command = ""
        self.last_source = ""
        self.last_answer = Answer(True, "")
        self.last_answered = 0.0
        self.last_outcome = ""
        self.last_border_id = ""
        self.unanswered_save = False  # whether the map may contain the border, because a save was never answered
        self._active_at = 0.0  # [s] when somebody last gave a command, or when spots last arrived
        self._durations = {state: 0.0 for state in STATES.values() if state.robots_act}
        self._now = 0.0  # [s] the newest time that was passed
        self._sources: List[str] = []
        self._visited: List[State] = []  # states entered in this interaction, in the order of their last entry
        self._spots = {BORDER: 0, SEED: 0, GUIDE: 0}
        self._pending_source = ""
        self.latch = latch or StopLatch()
        self.laser_seen_at = -math.inf  # [s] when a camera last saw a spot, in any state
        self.undo_redo: List[str] = []  # contains "undo" and "redo" if there is a change to undo or redo
        self._record: Optional[InteractionRecord] = None

    # ------------------------------------------------------------------ commands
    def command(
        self,
        name: str,
        source: str,
        now: float,
        uncertain: bool = False,
        doubtful_border: bool = False,
        confirms: bool = False,
        seen_stop: str = "",
    ) -> Answer:
        """Carries out a command and returns the answer. Every command is answered, and nothing is raised.

        Args:
            name: one of COMMANDS; anything else is answered with "unknown_command".
            source: who gives the command, for the record.
            now: [s].
            uncertain: whether the command may have been misheard.
            doubtful_border: whether there are doubts about the border that would be saved.
            confirms: whether the person confirmed this command, by one of YES_ANSWERS.
            seen_stop: number of the newest stop that the sender knew of. A later stop makes the command void.
        """
        if name == STOP:
            return self.stop(new_id(), source, now)
        self.advance(now)
        if seen_stop and seen_stop != self.latch.number:
            answer = self._stopped_since(name)
            # not recorded while another command is pending, because that command's answer will be the last one
            return answer if self.pending else self._record_answer(name, source, answer)
        if self.pending and name != RESUME:
            return Answer(False, "busy")
        answer = self._refuse_unknown(name)
        if answer is None:
            self._active_at = now
            if self.state != DEFAULT:
                self._add_source(source)
            asked = self.question
            self.question = Question()
            # refused before it is asked about, because nobody should have to confirm a command that is refused anyway
            answer = self._refuse_now(name, seen_stop)
            answer = answer or self._ask_if_meant(name, source, uncertain, doubtful_border, confirms, asked)
            answer = answer or self._apply(name, source, seen_stop)
        return self._record_answer(name, source, answer)

    def finish_pending(self, answer: Answer, now: float, border_id: str = "", is_sent: bool = False) -> Answer:
        """Completes a pending command with the answer of the nodes that carried it out.

        A successful save ends the interaction; `border_id` is then the new border's id. A failed save leaves state and
        drawing unchanged. A save that was sent but not answered may have succeeded: see `unanswered_save`.
        """
        self.advance(now)
        command = self.pending
        self.pending = ""
        if command == SAVE and answer.success:
            self._end("saved", border_id)
        elif command == SAVE:
            # a service that is absent now may have received an earlier save, and only an answer from it ends the doubt
            if is_sent and answer.code != "no_service":
                self.unanswered_save = answer.code in ("no_response", "internal_error")
            if self.unanswered_save and answer.code in ("no_response", "no_service"):
                answer = Answer(False, "save_unanswered", answer.values)
        return self._record_answer(command, self._pending_source, answer)

    def stop(self, identity: str, source: str, now: float) -> Answer:
        """Stops all robots by a stop with this id, and returns the answer."""
        self.advance(now)
        self.question = Question()
        self._active_at = self._now
        was_stopped = self.latch.stopped
        is_new = self.latch.stop(identity, source)
        code = "stopped" if self.latch.stopped else "stop_released"
        # one press may arrive both by topic and as a command: it is one stop, and is recorded once
        if is_new and not was_stopped:
            return self._record_answer(STOP, source, Answer(True, code))
        return Answer(True, code)

    @staticmethod
    def _stopped_since(name: str) -> Answer:
        return Answer(False, "stopped_since", {"command": words_of_name(name)})

    def _ask_if_meant(
        self, name: str, source: str, uncertain: bool, doubtful_border: bool, confirms: bool, asked: Question
    ) -> Optional[Answer]:
        """Asks whether the person meant a command. Returns the question, or None if it is confirmed or not in doubt."""
        was_asked = (asked.command, asked.source) == (name, source)
        if was_asked and (confirms or not uncertain):
            return None
        if confirms:
            return Answer(False, "nothing_asked", {"command": words_of_name(name)})
        is_pointing = abs(self._now - self.laser_seen_at) <= LASER_ON_TIMEOUT
        has_consequences = {
            ALWAYS: True,
            NEVER: False,
            WHILE_DRAWN: len(self.missing_parts()) < 2,
            WHILE_STOPPED: self.latch.stopped,
            WHILE_POINTING: is_pointing and self._target(name) != self.state,
        }
        may_be_misheard = uncertain and has_consequences[COMMANDS[name].consequences]
        saves_doubtful_border = name == SAVE and doubtful_border
        if not may_be_misheard and not saves_doubtful_border:
            return None
        self.question = Question(name, source, self._now)
        code = "confirm_save" if name == SAVE else "confirm_command"
        confirming = "yes_" + name if uncertain else name
        return Answer(False, code, {"command": words_of_name(name), "answer": words_of_name(confirming)})

    def _apply(self, name: str, source: str, seen_stop: str) -> Answer:
        if COMMANDS[name].is_delegated:
            self.pending = name
            self._pending_source = source
            return Answer(True, "saving" if name == SAVE else "changing")
        if name == CANCEL:
            return self._cancel()
        if name == RESUME:
            code = "resumed" if self.latch.stopped else "not_stopped"
            if not self.latch.resume(seen_stop):
                return self._stopped_since(RESUME)  # another stop has arrived meanwhile
            return Answer(True, code)
        return self._enter(name, source)

    def _target(self, name: str) -> State:
        """Returns the state to which a command leads. `continue` leads back to the state before the pause."""
        if name == CONTINUE:
            return self._visited[-1]
        return STATES.get(COMMANDS[name].enters, self.state)

    def _enter(self, name: str, source: str) -> Answer:
        target = self._target(name)
        is_known = target in self._visited
        if self.state == DEFAULT:
            self._begin()
            self._add_source(source)
        if self.state != target:
            self.state = target
            self.state_entered_at = self._now
        if target.robots_act:
            self._visited = [state for state in self._visited if state != target] + [target]
        if target.guides:
            ending = "_stopped" if self.latch.stopped else ""
        else:
            ending = "_again" if is_known else ""
        return Answer(True, target.prompt + ending)

    def _cancel(self) -> Answer:
        if self.state == DEFAULT:
            return Answer(True, "nothing_to_cancel")
        code = "cancelled_unanswered" if self.unanswered_save else "cancelled"
        self._end("cancelled")
        return Answer(True, code)

    def _refuse_unknown(self, name: str) -> Optional[Answer]:
        """Returns the answer to a command that does not exist here, or None."""
        if name not in COMMANDS:
            return Answer(False, "unknown_command", {"commands": ", ".join(map(words_of_name, COMMANDS))})
        if name == GUIDE_ROBOT and not self._params.robot:
            return Answer(False, "no_robot_to_guide")
        return None

    def _refuse_now(self, name: str, seen_stop: str) -> Optional[Answer]:
        """Returns the answer that refuses a command now, or None."""
        if name in (UNDO, REDO) and self.state != DEFAULT:
            # it would undo or redo a change of the map, while the person may mean the drawing
            return Answer(False, "not_while_drawing", {"command": words_of_name(name)})
        if name == RESUME and self.latch.stopped and not seen_stop:
            return Answer(False, "resume_which_stop", {"stop": self.latch.number})
        if name == PAUSE and self.state == DEFAULT:
            return Answer(False, "nothing_to_pause")
        if name == CONTINUE and self.state != PAUSED:
            return Answer(False, "not_paused")
        if name != SAVE:
            return None
        if self.state == DEFAULT:
            return Answer(False, "nothing_to_save")
        missing = self.missing_parts()
        if not missing:
            return None
        if len(missing) == 1 and not any(self._spots.values()):
            # the person may have drawn, although no camera has seen it
            return Answer(False, "missing_spots")
        return Answer(False, "missing_" + "_and_".join(missing))

    # ------------------------------------------------------------------ the clock and what is seen
    def durations(self, now: float) -> Dict[State, float]:
        """Returns the time [s] spent in each active state. In Default, this is that of the interaction that ended last."""
        result = dict(self._durations)
        if self.state in self._durations and now > self._now:
            result[self.state] += now - self._now
        return result

    def advance(self, now: float) -> None:
        """Counts the time up to now. After a jump back in time, it goes on counting from there, and subtracts nothing."""
        self._durations = self.durations(now)
        self._now = now
        self.started_at = min(self.started_at, now)
        self.state_entered_at = min(self.state_entered_at, now)
        self.last_answered = min(self.last_answered, now)
        self._active_at = min(self._active_at, now)
        if not 0.0 <= now - self.question.asked_at <= CONFIRM_TIMEOUT:
            self.question = Question()

    def set_spot_counts(self, border: int, seed: int, others: int, now: float) -> None:
        """Stores how many spots there were so far in this interaction: for the border, for the seed, and for neither."""
        spots = {BORDER: border, SEED: seed, GUIDE: others}
        if spots != self._spots:
            self._spots = spots
            self._active_at = now  # the person draws, points or guides

    @property
    def is_spot_missing(self) -> bool:
        """Whether no camera has seen a spot although the person should have drawn or pointed by now."""
        if not self.state.collects or self.pending or self._spots[self.state]:
            return False
        return self._now >= self.state_entered_at + MISSING_SPOT_DELAY

    @property
    def ends_at(self) -> float:
        """The time [s] at which an idle interaction ends, or 0 if that is not soon. It never ends while paused or saving."""
        if not self.state.robots_act or self.pending:
            return 0.0
        timeout = self._params.idle_timeout
        end = self._active_at + timeout
        is_soon = self._now >= end - min(_WARNING_TIME, timeout / 2.0)
        return end if is_soon else 0.0

    def end_if_idle(self, now: float) -> bool:
        """Ends an interaction that was idle for too long. Returns whether it has ended."""
        self.advance(now)
        if not self.ends_at or now < self.ends_at:
            return False
        self._end("abandoned")
        minutes = f"{self._params.idle_timeout / 60.0:g}"
        self._record_answer(CANCEL, "timeout", Answer(False, "abandoned", {"minutes": minutes}))
        return True

    def take_record(self) -> Optional[InteractionRecord]:
        """Returns the record of an interaction that has ended, but only once. Returns None if there is no new record."""
        record = self._record
        self._record = None
        return record

    def missing_parts(self) -> List[str]:
        """Lists the parts that the person has not begun to draw yet: "border", "seed"."""
        return [state.collects for state in (BORDER, SEED) if state not in self._visited]

    # ------------------------------------------------------------------ queries
    def suggested_commands(self) -> List[str]:
        """Lists the commands that make sense now, most likely first. One is always `stop` or, once stopped, `resume`."""
        last = [RESUME] if self.latch.stopped else [STOP]
        guide = [GUIDE_ROBOT] if self._params.robot else []
        if self.pending:
            return last
        if self.state == DEFAULT:
            steps = [DEFINE_BORDER, *guide, *self.undo_redo[:1]]
            steps = last + steps if self.latch.stopped else steps + last
            return [*steps, *self.undo_redo[1:]]
        steps = [CONTINUE] if self.state == PAUSED else []
        if not self.missing_parts():
            steps.append(SAVE)
        # missing parts come before parts that could be drawn again
        parts = [step for step in (DEFINE_BORDER, DEFINE_SEED) if COMMANDS[step].enters != self.state.name]
        steps += sorted(parts, key=lambda step: STATES[COMMANDS[step].enters] in self._visited)
        if self.state != GUIDE:
            steps += guide
        if self.state != PAUSED:
            steps.append(PAUSE)
        return [*last, *steps, CANCEL] if self.latch.stopped else [*steps, CANCEL, *last]

    # ------------------------------------------------------------------ inside
    def _begin(self) -> None:
        self.interaction_id = uuid.uuid4().hex[:8]
        self.started_at = self.state_entered_at = self._active_at = self._now
        self._durations = {state: 0.0 for state in self._durations}
        self._sources = []
        self._spots = {state: 0 for state in self._spots}

    def _end(self, outcome: str, border_id: str = "") -> None:
        """Ends the interaction, and keeps its record for `take_record`."""
        if self.unanswered_save and outcome != "saved":
            outcome = "unanswered"  # only the map integrator knows whether the border is in the map
        durations = self._durations
        self._record = InteractionRecord(
            interaction_id=self.interaction_id,
            outcome=outcome,
            border_id=border_id,
            started=self.started_at,
            ended=self._now,
            guide_s=durations[GUIDE],
            border_s=durations[BORDER],
            seed_s=durations[SEED],
            total_s=sum(durations.values()),
            sources=tuple(self._sources),
        )
        self.state = DEFAULT
        self.interaction_id = ""
        self.pending = ""
        self.question = Question()
        self.unanswered_save = False
        self.started_at = 0.0
        self.state_entered_at = self._now
        self._visited = []
        self.last_outcome = outcome
        self.last_border_id = border_id

    def _add_source(self, source: str) -> None:
        if source and source not in self._sources:
            self._sources.append(source)

    def _record_answer(self, name: str, source: str, answer: Answer) -> Answer:
        self.last_command = name
        self.last_source = source
        self.last_answer = answer
        self.last_answered = self._now
        return answer
