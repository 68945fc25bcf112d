"""The interaction between person and system as a state machine (paper, Sect. 4.2).

Its commands and states are those of vb_core.vocabulary. Every command is answered in every state; a repeated command
continues where the person left off and erases nothing. Only `cancel`, a completed `save` and a long silence end an
interaction; silence never ends a paused one. `stop` has priority over everything else and holds until a `resume` given
after it. Time is injected, in seconds, and may pause or jump back.

Whether a command must be confirmed depends on what it would do now. One that would move a robot, change the map or lose
a drawing is asked about unless it is beyond doubt; all others are carried out at once. The answer is a different phrase
("yes, save"), as a word misheard once is misheard again, and only the source that was asked can give it.

Use it to add an input method or to test one: a command's name goes in, an answer with a code comes out. The node
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

from vb_core.parameters import Parameters, param
from vb_core.sentences import spelled_out
from vb_core.stop_latch import StopLatch, new_id
from vb_core.vocabulary import ALWAYS, NEVER, WHILE_DRAWN, WHILE_POINTING, WHILE_STOPPED
from vb_core.vocabulary import COMMANDS, QUESTIONS, STATES, State
from vb_core.vocabulary import BORDER, DEFAULT, GUIDE, PAUSED, SEED
from vb_core.vocabulary import CANCEL, CONTINUE, DEFINE_BORDER, DEFINE_SEED, GUIDE_ROBOT, PAUSE, RESUME, SAVE, STOP
from vb_core.vocabulary import REDO, UNDO
from vb_voice_wizard.dialogue.command_answers import Answer

# [s] without a spot in Border or Seed: by then a person has begun, perhaps with a laser that no camera sees
UNSEEN_AFTER = 10.0
# [s] people are warned this long before an interaction ends by itself, or when half of a short timeout is left
_WARNED_BEFORE = 60.0
# [s] a laser counts as on for this long after its last spot
LASER_ON = 1.0
# [s] an answer counts within this time: enough to look at the preview, too short to forget the question
CONFIRM_WITHIN = 30.0

SAVED = "saved"
CANCELLED = "cancelled"
ABANDONED = "abandoned"
UNANSWERED = "unanswered"


@dataclass(frozen=True)
class InteractionParams(Parameters):
    """Parameters of an interaction; config/interaction_manager.yaml explains them."""

    robot: bool = param(True)
    idle_timeout: float = param(300.0, "s", low=1.0, high=86400.0)


@dataclass(frozen=True)
class Record:
    """One interaction that has ended; times in seconds."""

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

    def line(self, method: str, cameras: Sequence[str]) -> str:
        """Returns the record as one line of JSON, without a newline."""
        fields = {name: round(value, 3) if isinstance(value, float) else value for name, value in asdict(self).items()}
        return json.dumps({**fields, "method": method, "cameras": list(cameras)})


class Question(NamedTuple):
    """The open question: its command, "" if there is none, the source that was asked, and when [s]."""

    command: str = ""
    source: str = ""
    asked: float = 0.0


class Interaction:
    """The state machine. Not thread safe.

    `save`, `undo` and `redo` take two steps, since other nodes carry them out: `command(...)` checks and, if it
    succeeds, leaves `pending` set; then `finish` must be called.

    Args:
        latch: whether robots are stopped, which outlives every interaction.
    """

    def __init__(self, params: InteractionParams = InteractionParams(), latch: Optional[StopLatch] = None) -> None:
        self._params = params
        self.question = Question()
        self.state = DEFAULT
        self.interaction_id = ""
        self.started = 0.0
        self.entered = 0.0
        self.pending = ""  # the command that another node is carrying out
        self.last_command = ""
        self.last_source = ""
        self.last_answer = Answer(True, "")
        self.last_answered = 0.0
        self.last_outcome = ""
        self.last_border_id = ""
        self.unanswered_save = False  # whether a border was sent and no answer came
        self._active = 0.0
        self._durations = {state: 0.0 for state in STATES.values() if state.robots_act}
        self._counted_until = 0.0
        self._sources: List[str] = []
        self._visited: List[State] = []
        self._spots = {BORDER: 0, SEED: 0, GUIDE: 0}
        self._laser_seen = -math.inf
        self._pending_source = ""
        self._save_sent = False  # whether the pending border is on its way to the map
        self._unanswered_before_save = False  # `unanswered_save` before it was sent
        self.latch = latch or StopLatch()
        self.undo_redo: List[str] = []  # "undo" and "redo", each if there is a change to undo or redo
        self._record: Optional[Record] = None

    # ------------------------------------------------------------------ commands
    def command(
        self,
        name: str,
        source: str,
        now: float,
        uncertain: bool = False,
        doubtful_border: bool = False,
        confirms: bool = False,
        identity: str = "",
        seen_stop: str = "",
    ) -> Answer:
        """Carries out a command and returns the answer; never raises, and never ignores a command.

        Args:
            name: one of COMMANDS; anything else is answered with "unknown_command".
            source: who sends it, for the record.
            now: [s].
            uncertain: whether it may have been misheard.
            doubtful_border: whether the preview of what would be saved has issues.
            confirms: whether the person confirmed this command, by one of ANSWERS.
            identity: the id of a stop; "": it gets one.
            seen_stop: number of the newest stop that the sender knew of; a command that is older than a stop is void.
        """
        self.advance(now)
        if name == STOP:
            return self._stop(identity or new_id(), source)
        void = bool(seen_stop) and seen_stop != self.latch.number
        if self.pending and (void or name != RESUME):
            # not kept as the last answer, which will be the pending command's
            return self._stopped_since(name) if void else Answer(False, "busy")
        answer = self._stopped_since(name) if void else self._refuse_unknown(name)
        if answer is None:
            self._active = now
            if self.state != DEFAULT:
                self._add_source(source)
            # before any question: nobody should have to confirm a command that is refused anyway
            answer = self._refuse_now(name, seen_stop) or self._ask_if_meant(
                name, source, uncertain, doubtful_border, confirms
            )
            if answer is None or answer.code not in QUESTIONS:
                self.question = Question()
        return self._record_answer(name, source, answer or self._apply(name, source, seen_stop))

    def mark_save_sent(self) -> None:
        """Records that the border is on its way to the map; until `finish` its arrival is unknown."""
        self._save_sent, self._unanswered_before_save, self.unanswered_save = True, self.unanswered_save, True

    def finish(self, answer: Answer, now: float, border_id: str = "") -> Answer:
        """Completes a pending command with the answer of the nodes that carried it out.

        A successful save, with the new border's id, ends the interaction and stops its timer. A failed one loses
        nothing and leaves the state unchanged; an unanswered one may have succeeded, and is remembered as such.
        """
        self.advance(now)
        command, self.pending = self.pending, ""
        if command == SAVE and answer.success:
            self._end(SAVED, border_id)
        elif command == SAVE:
            if self._save_sent:
                # an error from the service itself shows that no earlier request has arrived either
                arrived = {"no_response": True, "internal_error": True, "no_service": self._unanswered_before_save}
                self.unanswered_save = arrived.get(answer.code, False)
            if self.unanswered_save and answer.code in ("no_response", "no_service"):
                answer = Answer(False, "save_unanswered", answer.values)
        return self._record_answer(command, self._pending_source, answer)

    def _stop(self, identity: str, source: str) -> Answer:
        self.question = Question()
        self._active = self._counted_until
        before = self.latch.stopped
        new = self.latch.stop(identity, source)
        # one press may arrive twice, on the topic and as a command: it is one stop, and is reported once
        answer = Answer(True, "stopped" if self.latch.stopped else "stop_released")
        return self._record_answer(STOP, source, answer) if new and not before else answer

    @staticmethod
    def _stopped_since(name: str) -> Answer:
        return Answer(False, "stopped_since", {"command": spelled_out(name)})

    def _ask_if_meant(
        self, name: str, source: str, uncertain: bool, doubtful_border: bool, confirms: bool
    ) -> Optional[Answer]:
        """Returns the question whether this command is meant, or None if that was answered or need not be asked."""
        if self.question[:2] == (name, source) and (confirms or not uncertain):
            return None
        if confirms:
            return Answer(False, "nothing_asked", {"command": spelled_out(name)})
        must_be_certain = {
            ALWAYS: True,
            NEVER: False,
            WHILE_DRAWN: len(self.missing()) < 2,
            WHILE_STOPPED: self.latch.stopped,
            WHILE_POINTING: self.laser_is_on(self._counted_until) and self._target(name) != self.state,
        }
        if not (uncertain and must_be_certain[COMMANDS[name].matters]) and not (name == SAVE and doubtful_border):
            return None
        self.question = Question(name, source, self._counted_until)
        answer = spelled_out(name if not uncertain else "yes_" + name)
        code = "confirm_save" if name == SAVE else "confirm_command"
        return Answer(False, code, {"command": spelled_out(name), "answer": answer})

    def _apply(self, name: str, source: str, seen_stop: str) -> Answer:
        if COMMANDS[name].carried_out_elsewhere:
            self.pending, self._pending_source, self._save_sent = name, source, False
            return Answer(True, "saving" if name == SAVE else "changing")
        if name == CANCEL:
            return self._cancel()
        if name == RESUME:
            code = "resumed" if self.latch.stopped else "not_stopped"
            # a stop may have arrived while this was decided
            return Answer(True, code) if self.latch.resume(seen_stop) else self._stopped_since(RESUME)
        return self._enter(name, source)

    def _target(self, name: str) -> State:
        """Returns the state after a command; `continue` goes back to where the person was."""
        return self._visited[-1] if name == CONTINUE else STATES.get(COMMANDS[name].enters, self.state)

    def _enter(self, name: str, source: str) -> Answer:
        target = self._target(name)
        again = target in self._visited
        if self.state == DEFAULT:
            self._begin()
            self._add_source(source)
        if self.state != target:
            self.state, self.entered = target, self._counted_until
        if target.robots_act:
            self._visited = [state for state in self._visited if state != target] + [target]
        suffix = "_stopped" * self.latch.stopped if target.guides else "_again" * again
        return Answer(True, target.prompt + suffix)

    def _cancel(self) -> Answer:
        if self.state == DEFAULT:
            return Answer(True, "nothing_to_cancel")
        # a border that was sent may be in the map: only the map integrator knows
        lost = self.unanswered_save
        self._end(UNANSWERED if lost else CANCELLED, "")
        return Answer(True, "cancelled_unanswered" if lost else "cancelled")

    def _refuse_unknown(self, name: str) -> Optional[Answer]:
        """Returns the answer to a command that does not exist here, or None."""
        if name not in COMMANDS:
            return Answer(False, "unknown_command", {"commands": ", ".join(map(spelled_out, COMMANDS))})
        return Answer(False, "no_robot_to_guide") if name == GUIDE_ROBOT and not self._params.robot else None

    def _refuse_now(self, name: str, seen_stop: str) -> Optional[Answer]:
        """Returns the answer that refuses a command now, or None."""
        if name in (UNDO, REDO) and self.state != DEFAULT:
            # the newest change of the map is not what the person is drawing
            return Answer(False, "not_while_drawing", {"command": spelled_out(name)})
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
        missing = self.missing()
        if len(missing) == 1 and not any(self._spots.values()):
            # the person may have drawn nonetheless, unseen by any camera
            return Answer(False, "missing_spots")
        return Answer(False, "missing_" + "_and_".join(missing)) if missing else None

    # ------------------------------------------------------------------ the clock and what is seen
    def durations(self, now: float) -> Dict[State, float]:
        """Returns the time [s] per active state up to now; in Default, for the interaction that ended last."""
        result = dict(self._durations)
        if self.state in self._durations and now > self._counted_until:
            result[self.state] += now - self._counted_until
        return result

    def advance(self, now: float) -> None:
        """Counts the time up to now. After a jump back in time it counts on from there, and subtracts nothing."""
        self._durations = self.durations(now)
        self._counted_until = now
        self.started, self.entered = min(self.started, now), min(self.entered, now)
        self.last_answered, self._active = min(self.last_answered, now), min(self._active, now)
        if not 0.0 <= now - self.question.asked <= CONFIRM_WITHIN:
            self.question = Question()

    def see_laser(self, now: float) -> None:
        """Records that a camera saw a spot at a time [s], in any state."""
        self._laser_seen = now

    def laser_is_on(self, now: float) -> bool:
        """Returns whether somebody is pointing with the laser."""
        return abs(now - self._laser_seen) <= LASER_ON

    def set_spot_counts(self, border: int, seed: int, others: int, now: float) -> None:
        """Stores how many spots this interaction has had so far: for the border, for the seed, and for neither."""
        spots = {BORDER: border, SEED: seed, GUIDE: others}
        if spots != self._spots:
            # the person draws, points or guides
            self._spots, self._active = spots, now

    @property
    def unseen(self) -> bool:
        """Whether no spot was seen although the person should have drawn or pointed by now."""
        return (
            bool(self.state.collects)
            and not self.pending
            and not self._spots[self.state]
            and self._counted_until >= self.entered + UNSEEN_AFTER
        )

    @property
    def ends_at(self) -> float:
        """[s] when the interaction ends by itself; 0 if not soon, or while it is paused or saving, or in Default."""
        if not self.state.robots_act or self.pending:
            return 0.0
        ends = self._active + self._params.idle_timeout
        return ends if self._counted_until >= ends - min(_WARNED_BEFORE, self._params.idle_timeout / 2.0) else 0.0

    def end_if_idle(self, now: float) -> bool:
        """Ends an interaction that was idle for too long; returns whether it did."""
        self.advance(now)
        if not self.ends_at or now < self.ends_at:
            return False
        self._end(UNANSWERED if self.unanswered_save else ABANDONED, "")
        minutes = f"{self._params.idle_timeout / 60.0:g}"
        self._record_answer(CANCEL, "timeout", Answer(False, "abandoned", {"minutes": minutes}))
        return True

    def take_record(self) -> Optional[Record]:
        """Returns the record of an interaction that has just ended, once; None if there is none."""
        record, self._record = self._record, None
        return record

    def missing(self) -> List[str]:
        """Lists the parts of a border that the person has not begun yet: "border", "seed"."""
        return [state.collects for state in (BORDER, SEED) if state not in self._visited]

    # ------------------------------------------------------------------ queries
    def suggested_commands(self) -> List[str]:
        """Lists the commands that make sense now, most likely first; among them `stop` or, once stopped, `resume`."""
        last = [RESUME] if self.latch.stopped else [STOP]
        guide = [GUIDE_ROBOT] if self._params.robot else []
        if self.pending:
            return last
        if self.state == DEFAULT:
            steps = [DEFINE_BORDER, *guide, *self.undo_redo[:1]]
            return [*(last + steps if self.latch.stopped else steps + last), *self.undo_redo[1:]]
        missing = self.missing()
        steps = [CONTINUE] * (self.state == PAUSED) + [SAVE] * (not missing)
        drawing = [DEFINE_BORDER, DEFINE_SEED]
        # missing parts come before parts that could be drawn again
        others = [step for step in drawing if COMMANDS[step].enters != self.state.name]
        steps += sorted(others, key=lambda step: STATES[COMMANDS[step].enters] in self._visited)
        if self.state != GUIDE:
            steps += guide
        steps += [PAUSE] * (self.state != PAUSED)
        return [*(last if self.latch.stopped else []), *steps, CANCEL, *([] if self.latch.stopped else last)]

    # ------------------------------------------------------------------ inside
    def _begin(self) -> None:
        self.interaction_id = uuid.uuid4().hex[:8]
        self.started = self.entered = self._active = self._counted_until
        self._durations = {state: 0.0 for state in self._durations}
        self._sources, self._visited = [], []
        self._spots = {state: 0 for state in self._spots}
        self.unanswered_save = False

    def _end(self, outcome: str, border_id: str) -> None:
        durations = self._durations
        self._record = Record(
            interaction_id=self.interaction_id,
            outcome=outcome,
            border_id=border_id,
            started=self.started,
            ended=self._counted_until,
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
        self.started, self.entered = 0.0, self._counted_until
        self._visited = []
        self.last_outcome, self.last_border_id = outcome, border_id

    def _add_source(self, source: str) -> None:
        if source and source not in self._sources:
            self._sources.append(source)

    def _record_answer(self, name: str, source: str, answer: Answer) -> Answer:
        self.last_command, self.last_source, self.last_answer = name, source, answer
        self.last_answered = self._counted_until
        return answer
