"""The interaction between person and system as a state machine (paper, Sect. 4.2).

Four states and nine commands. Every command is answered in every state; a repeated command
continues where the person left off and erases nothing. Only `cancel`, a completed `save` and a long silence end an
interaction. `stop` comes before everything else and holds until `resume`.
Time is injected, in seconds, and may pause or jump back.

Use it to add an input method or to test one: a command's name goes in, an answer with a code comes out. The node
`interaction_manager` wraps one instance.

>>> interaction = Interaction()
>>> interaction.command(DEFINE_BORDER, source="console", now=0.0).success
True
>>> interaction.state.name, interaction.suggested_commands()
('BORDER', ['define_seed', 'guide_robot', 'cancel', 'stop'])
"""

from __future__ import annotations

import dataclasses
import enum
import math
import uuid
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, List, Mapping, Optional, Tuple

from vb_core import sentences
from vb_core.errors import CodedError
from vb_core.parameters import Parameters, param


class State(enum.IntEnum):
    """The paper's states, with the numbers of vb_msgs/InteractionState."""

    DEFAULT = 0
    BORDER = 1
    SEED = 2
    GUIDE = 3


DEFINE_BORDER = "define_border"
DEFINE_SEED = "define_seed"
GUIDE_ROBOT = "guide_robot"
SAVE = "save"
CANCEL = "cancel"
STOP = "stop"
RESUME = "resume"
UNDO = "undo"
REDO = "redo"
COMMANDS = (DEFINE_BORDER, DEFINE_SEED, GUIDE_ROBOT, SAVE, CANCEL, STOP, RESUME, UNDO, REDO)

_ENTERS = {DEFINE_BORDER: State.BORDER, DEFINE_SEED: State.SEED, GUIDE_ROBOT: State.GUIDE}
# What a command that may have been misunderstood must not do on its own: these change the map, discard the drawing or
# let robots drive. The others stop robots, or do nothing before somebody points with the laser too.
_CONFIRMED = (SAVE, CANCEL, RESUME, UNDO, REDO)
# [s] without a spot in Border or Seed: a person has begun by then, or draws with a laser that no camera sees
UNSEEN_AFTER = 10.0
# [s] the second `save` counts as a confirmation within this time: enough to look at the preview, too short to forget
CONFIRM_WITHIN = 30.0

SAVED = "saved"
CANCELLED = "cancelled"
ABANDONED = "abandoned"
UNANSWERED = "unanswered"

NEVER, UNCERTAIN, ALWAYS = "never", "uncertain", "always"


@dataclass(frozen=True)
class InteractionParams(Parameters):
    """Parameters of an interaction's confirmations and time limits; config/interaction_manager.yaml explains them."""

    robot: bool = param(True)
    confirm_save: str = param(UNCERTAIN, choices=(NEVER, UNCERTAIN, ALWAYS))
    idle_timeout: float = param(300.0, "s", low=1.0, high=86400.0)
    idle_warning: float = param(60.0, "s", low=1.0, high=3600.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_order("idle_warning", "idle_timeout")


@dataclass(frozen=True)
class Answer:
    """The answer to the person: whether it was done, and the code and values of the sentence.

    Attributes:
        said: another node's English sentence, whose code our catalogue may not have.
    """

    success: bool
    code: str
    values: Mapping[str, str] = field(default_factory=dict)
    said: str = ""

    @property
    def message(self) -> str:
        """The sentence in English."""
        return sentences.translate(self.code, self.values, default=self.said)

    @staticmethod
    def refusal(error: CodedError) -> "Answer":
        """Makes an answer from an error."""
        return Answer(False, error.code, {name: str(value) for name, value in error.values.items()}, error.message)


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


def normalize(text: str) -> str:
    """Converts a command as people write it ("Define border") to its name ("define_border")."""
    return "_".join(text.replace("-", " ").replace("_", " ").lower().split())


def spoken_form(command: str) -> str:
    """Converts a command's name to what one says: "define border"."""
    return command.replace("_", " ")


# what outlives a restart of the node, as far as it is one number or text
_TIMES = ("started", "entered", "_active", "_counted_until", "last_answered")
_TEXTS = ("interaction_id", "last_command", "last_source", "last_outcome", "last_border_id")


def _new_id() -> str:
    return uuid.uuid4().hex[:8]


class Interaction:
    """The state machine, its memory and its clock. Not thread safe.

    `save`, `undo` and `redo` take two steps, since other nodes carry them out: `command(...)` checks and, if it
    succeeds, leaves `pending` set; then `finish_save` or `finish` must be called.

    Args:
        new_id: returns the id of the next interaction.
    """

    def __init__(self, params: InteractionParams = InteractionParams(), new_id: Callable[[], str] = _new_id) -> None:
        self._params = params
        self._new_id = new_id
        self.state = State.DEFAULT
        self.interaction_id = ""
        self.started = 0.0
        self.entered = 0.0
        self.pending = ""  # the command that another node is carrying out
        self.stopped = False
        self.stopped_by = ""
        self.last_command = ""
        self.last_source = ""
        self.last_answer = Answer(True, "")
        self.last_answered = 0.0
        self.last_outcome = ""
        self.last_border_id = ""
        self.unanswered_save = False  # whether a border was sent and never answered
        self.history: List[str] = []  # UNDO and REDO, each if the borders have something to undo or redo
        self._confirming = ""
        self._asked = 0.0
        self._pending_source = ""
        self._active = 0.0
        self._durations = {State.GUIDE: 0.0, State.BORDER: 0.0, State.SEED: 0.0}
        self._counted_until = 0.0
        self._sources: List[str] = []
        self._visited: List[State] = []
        self._spots = {State.BORDER: 0, State.SEED: 0, State.GUIDE: 0}
        self._record: Optional[Record] = None

    @property
    def saving(self) -> bool:
        """Returns whether a border is on its way to the map."""
        return self.pending == SAVE

    @property
    def confirm_save(self) -> bool:
        """Returns whether `save` was given and must be repeated."""
        return self._confirming == SAVE

    # ------------------------------------------------------------------ commands
    def command(
        self, name: str, source: str, now: float, uncertain: bool = False, doubtful_border: bool = False
    ) -> Answer:
        """Carries out a command and returns the answer; never raises, and never ignores a command.

        Args:
            name: one of COMMANDS; anything else is answered with "unknown_command".
            source: who sends it, for the record.
            now: [s].
            uncertain: whether it may have been misunderstood, as everything spoken.
            doubtful_border: whether the preview of what would be saved has issues.
        """
        self.advance(now)
        name = normalize(name)
        if name == STOP:
            return self._stop(source, now)
        if self.pending and name != RESUME:
            # not kept as the last answer: the current command's will be
            return Answer(False, "busy")
        if name not in COMMANDS:
            known = ", ".join(spoken_form(command) for command in COMMANDS)
            return self._answered(name, source, Answer(False, "unknown_command", {"commands": known}))
        if name == GUIDE_ROBOT and not self._params.robot:
            return self._answered(name, source, Answer(False, "no_robot_to_guide"))
        self._active = now
        if self.state != State.DEFAULT:
            self._note(source)
        # before any question: nobody should confirm what is refused anyway
        refusal = self._check(name)
        if refusal is None:
            refusal = self._ask(name, now, uncertain, doubtful_border)
        else:
            self._confirming = ""
        if refusal is not None:
            return self._answered(name, source, refusal)
        if name in (SAVE, UNDO, REDO):
            self.pending, self._pending_source = name, source
            return self._answered(name, source, Answer(True, "saving" if name == SAVE else "changing"))
        if name == CANCEL:
            return self._cancel(source, now)
        if name == RESUME:
            return self._resume(source)
        return self._enter(name, source, now)

    def expired(self, name: str, source: str, now: float) -> Answer:
        """Refuses a command that arrived too late; only the person who gave it is told."""
        self.advance(now)
        answer = Answer(False, "expired", {"command": spoken_form(normalize(name))})
        return answer if self.pending else self._answered(normalize(name), source, answer)

    def finish_save(self, border_id: str, now: float) -> Answer:
        """Ends the interaction and stops its timer: the border is in the map."""
        self.advance(now)
        source = self._pending_source
        self._end(SAVED, border_id, now)
        return self._answered(SAVE, source, Answer(True, "saved"))

    def finish(self, answer: Answer, now: float) -> Answer:
        """Completes `undo` or `redo`, or a pending command that failed: nothing is lost, the state stays."""
        self.advance(now)
        command, self.pending = self.pending, ""
        return self._answered(command, self._pending_source, answer)

    def _stop(self, source: str, now: float) -> Answer:
        self._confirming, self._active = "", now
        if self.stopped:
            # one press may come twice, on the topic and as a command: it is one stop, and is told once
            return Answer(True, "stopped")
        self.stopped, self.stopped_by = True, source
        return self._answered(STOP, source, Answer(True, "stopped"))

    def _resume(self, source: str) -> Answer:
        code = "resumed" if self.stopped else "not_stopped"
        self.stopped, self.stopped_by = False, ""
        return self._answered(RESUME, source, Answer(True, code))

    def _ask(self, name: str, now: float, uncertain: bool, doubtful_border: bool) -> Optional[Answer]:
        """Returns the question whether this command is meant, or None if it was answered or need not be asked."""
        confirmed = self._confirming == name and 0.0 <= now - self._asked <= CONFIRM_WITHIN
        self._confirming = ""
        if name == SAVE:
            rule = self._params.confirm_save
            ask = rule == ALWAYS or (rule == UNCERTAIN and (uncertain or doubtful_border))
        else:
            idle = (name == CANCEL and self.state == State.DEFAULT) or (name == RESUME and not self.stopped)
            ask = uncertain and name in _CONFIRMED and not idle
        if confirmed or not ask:
            return None
        self._confirming, self._asked = name, now
        return Answer(False, "confirm_save" if name == SAVE else "confirm_command", {"command": spoken_form(name)})

    def _enter(self, name: str, source: str, now: float) -> Answer:
        target = _ENTERS[name]
        again = target in self._visited
        if self.state == State.DEFAULT:
            self._begin(now)
            self._note(source)
        if self.state != target:
            self.state = target
            self.entered = now
        if not again:
            self._visited.append(target)
        if target == State.GUIDE:
            code = "guide_stopped" if self.stopped else "guide"
        elif target == State.BORDER:
            code = "draw_border_again" if again else "draw_border"
        else:
            code = "point_seed_again" if again else "point_seed"
        return self._answered(name, source, Answer(True, code))

    def _cancel(self, source: str, now: float) -> Answer:
        if self.state == State.DEFAULT:
            return self._answered(CANCEL, source, Answer(True, "nothing_to_cancel"))
        # the border that was sent may be in the map after all: only the map integrator knows
        lost = self.unanswered_save
        self._end(UNANSWERED if lost else CANCELLED, "", now)
        return self._answered(CANCEL, source, Answer(True, "cancelled_unanswered" if lost else "cancelled"))

    def _check(self, name: str) -> Optional[Answer]:
        """Says why a command cannot be carried out now, or returns None."""
        if name in (UNDO, REDO) and self.state != State.DEFAULT:
            # the newest change of the map is not what the person is drawing
            return Answer(False, "not_while_drawing", {"command": spoken_form(name)})
        if name != SAVE:
            return None
        if self.state == State.DEFAULT:
            return Answer(False, "nothing_to_save")
        missing = self.missing()
        if len(missing) == 1 and not any(self._spots.values()):
            # the person may have drawn all the same: what is missing first is a camera that sees it
            return Answer(False, "missing_spots")
        return Answer(False, "missing_" + "_and_".join(missing)) if missing else None

    # ------------------------------------------------------------------ queries
    def take_record(self) -> Optional[Record]:
        """Returns the record of an interaction that has just ended, once; None if there is none."""
        record, self._record = self._record, None
        return record

    def missing(self) -> List[str]:
        """Lists the parts of a border that the person has not begun yet: "border", "seed"."""
        wanted = (("border", State.BORDER), ("seed", State.SEED))
        return [word for word, state in wanted if state not in self._visited]

    def suggested_commands(self) -> List[str]:
        """Lists the commands that make sense now, most likely first; among them `stop` or, once stopped, `resume`."""
        last = [RESUME] if self.stopped else [STOP]
        guide = [GUIDE_ROBOT] if self._params.robot else []
        if self.pending:
            return last
        if self.state == State.DEFAULT:
            steps = [DEFINE_BORDER, *guide, *self.history[:1]]
            return [*(last + steps if self.stopped else steps + last), *self.history[1:]]
        missing = self.missing()
        steps = [SAVE] if not missing else []
        drawing = [DEFINE_BORDER, DEFINE_SEED]
        # missing parts come before what could be done again
        steps += sorted(
            (step for step in drawing if _ENTERS[step] != self.state),
            key=lambda step: (_ENTERS[step] in self._visited, drawing.index(step)),
        )
        if self.state != State.GUIDE:
            steps += guide
        return [*(last if self.stopped else []), *steps, CANCEL, *([] if self.stopped else last)]

    def durations(self, now: float) -> Dict[State, float]:
        """Returns the time [s] per active state up to now; in Default, of the interaction that ended last."""
        result = dict(self._durations)
        if self.state != State.DEFAULT and now > self._counted_until:
            result[self.state] += now - self._counted_until
        return result

    def advance(self, now: float) -> None:
        """Counts the time up to now. Time that jumped back is counted from there on, nothing is taken off."""
        self._durations = self.durations(now)
        self._counted_until = now
        self.started, self.entered = min(self.started, now), min(self.entered, now)
        self.last_answered, self._active = min(self.last_answered, now), min(self._active, now)
        if self._confirming and not 0.0 <= now - self._asked <= CONFIRM_WITHIN:
            self._confirming = ""

    # ------------------------------------------------------------------ abandoned interactions
    def count_spots(self, border: int, seed: int, others: int, now: float) -> None:
        """Stores how many spots this interaction has had so far: for the border, for the seed, and for neither."""
        spots = {State.BORDER: border, State.SEED: seed, State.GUIDE: others}
        if spots != self._spots:
            # the person draws, points or guides
            self._spots, self._active = spots, now

    @property
    def unseen(self) -> bool:
        """Returns whether the person should have drawn or pointed by now, and no spot was seen."""
        wanted = self.state in (State.BORDER, State.SEED) and not self.pending
        return wanted and not self._spots[self.state] and self._counted_until >= self.entered + UNSEEN_AFTER

    @property
    def ends_at(self) -> float:
        """[s] when the interaction ends by itself if nothing happens; 0 if not soon, or if there is no interaction."""
        if self.state == State.DEFAULT or self.pending:
            return 0.0
        ends = self._active + self._params.idle_timeout
        return ends if self._counted_until >= ends - self._params.idle_warning else 0.0

    def end_if_idle(self, now: float) -> bool:
        """Ends an interaction abandoned for too long; returns whether it did."""
        self.advance(now)
        if not self.ends_at or now < self.ends_at:
            return False
        idle = self._params.idle_timeout
        self._end(UNANSWERED if self.unanswered_save else ABANDONED, "", now)
        minutes = f"{idle / 60.0:g}"
        self._answered(CANCEL, "timeout", Answer(False, "abandoned", {"minutes": minutes}))
        return True

    # ------------------------------------------------------------------ memory across a restart of the node
    def to_mapping(self) -> Dict[str, Any]:
        """Returns the complete state as plain values; inverse of `from_mapping`."""
        return {
            **{name.strip("_"): getattr(self, name) for name in (*_TIMES, *_TEXTS)},
            "state": self.state.name,
            "durations": {state.name: value for state, value in self._durations.items()},
            "sources": list(self._sources),
            "visited": [state.name for state in self._visited],
            "unanswered_save": self.unanswered_save,
            "last_answer": dataclasses.asdict(self.last_answer),
        }

    @classmethod
    def from_mapping(
        cls,
        mapping: Mapping[str, Any],
        params: InteractionParams = InteractionParams(),
        new_id: Callable[[], str] = _new_id,
    ) -> "Interaction":
        """Restores a saved interaction; a command that was being carried out is not part of it and must be sent again.

        Whether robots are stopped is not part of it: that outlives every interaction.

        Raises:
            CodedError: "bad_state_file" if this is not a saved interaction.
        """
        self = cls(params, new_id)
        try:
            for names, kind in ((_TIMES, float), (_TEXTS, str)):
                for name in names:
                    setattr(self, name, kind(mapping[name.strip("_")]))
            self.state = State[mapping["state"]]
            self._durations = {state: float(mapping["durations"][state.name]) for state in self._durations}
            self._sources = [str(source) for source in mapping["sources"]]
            self._visited = [State[name] for name in mapping["visited"]]
            self.unanswered_save = mapping["unanswered_save"] is True
            answer = Answer(**mapping["last_answer"])
            values = {str(name): str(value) for name, value in answer.values.items()}
            self.last_answer = Answer(bool(answer.success), str(answer.code), values, str(answer.said))
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise CodedError("bad_state_file", f"this is not the saved state of an interaction: {error!r}") from None
        numbers = [*(getattr(self, name) for name in _TIMES), *self._durations.values()]
        if not all(map(math.isfinite, numbers)) or min(self._durations.values()) < 0:
            raise CodedError("bad_state_file", "this is not the saved state of an interaction: times must be finite")
        if (self.state == State.DEFAULT) != (self.interaction_id == ""):
            raise CodedError("bad_state_file", "this is not the saved state of an interaction: state and id do not fit")
        return self

    # ------------------------------------------------------------------ inside
    def _begin(self, now: float) -> None:
        self.interaction_id = self._new_id()
        self.started = self.entered = self._counted_until = self._active = now
        self._durations = {state: 0.0 for state in self._durations}
        self._sources, self._visited = [], []
        self._spots = {state: 0 for state in self._spots}
        self.unanswered_save = False

    def _end(self, outcome: str, border_id: str, now: float) -> None:
        durations = self._durations
        self._record = Record(
            interaction_id=self.interaction_id,
            outcome=outcome,
            border_id=border_id,
            started=self.started,
            ended=now,
            guide_s=durations[State.GUIDE],
            border_s=durations[State.BORDER],
            seed_s=durations[State.SEED],
            total_s=sum(durations.values()),
            sources=tuple(self._sources),
        )
        self.state = State.DEFAULT
        self.interaction_id = ""
        self.pending = self._confirming = ""
        self.unanswered_save = False
        self.started, self.entered = 0.0, now
        self._visited = []
        self.last_outcome, self.last_border_id = outcome, border_id

    def _note(self, source: str) -> None:
        if source and source not in self._sources:
            self._sources.append(source)

    def _answered(self, name: str, source: str, answer: Answer) -> Answer:
        self.last_command, self.last_source, self.last_answer = name, source, answer
        self.last_answered = self._counted_until
        return answer
