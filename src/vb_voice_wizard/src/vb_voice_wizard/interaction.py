"""The interaction between person and system as a state machine (paper, Sect. 4.2).

Four states and five commands. Every command is answered in every state; a command that repeats goes on
where the person left off and erases nothing. Only `cancel` and a completed `save` end an interaction.
Time is injected, in seconds, and may stand still or jump back.
"""
from __future__ import annotations

import enum
import math
import uuid
from dataclasses import dataclass
from typing import Any, Callable, Dict, List, Mapping, Optional, Tuple

from vb_core.errors import CodedError


class State(enum.IntEnum):
    """The states of the paper; the numbers are those of vb_msgs/InteractionState."""

    DEFAULT = 0
    BORDER = 1
    SEED = 2
    GUIDE = 3


DEFINE_BORDER = "define_border"
DEFINE_SEED = "define_seed"
GUIDE_ROBOT = "guide_robot"
SAVE = "save"
CANCEL = "cancel"
COMMANDS = (DEFINE_BORDER, DEFINE_SEED, GUIDE_ROBOT, SAVE, CANCEL)

_ENTERS = {DEFINE_BORDER: State.BORDER, DEFINE_SEED: State.SEED, GUIDE_ROBOT: State.GUIDE}

SAVED = "saved"
CANCELLED = "cancelled"

OK = "ok"


@dataclass(frozen=True)
class Answer:
    """What the person is told: "ok" or the reason why not, and a sentence."""

    success: bool
    code: str
    message: str


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


def normalise(text: str) -> str:
    """A command as people write it ("Define border") to its name ("define_border")."""
    return "_".join(text.replace("-", " ").replace("_", " ").lower().split())


def _new_id() -> str:
    return uuid.uuid4().hex[:8]


class Interaction:
    """The state machine, its memory and its clock. Not thread safe.

    `save` takes two steps, since others decide whether a border can be added: `command("save", ...)`
    checks and, if it succeeds, leaves `saving` set; then `finish_save` or `refuse_save` must be called.

    Args:
        new_id: gives the id of the next interaction.
    """

    def __init__(self, new_id: Callable[[], str] = _new_id) -> None:
        self._new_id = new_id
        self.state = State.DEFAULT
        self.interaction_id = ""
        self.started = 0.0
        self.entered = 0.0
        self.saving = False
        self.last_command = ""
        self.last_source = ""
        self.last_answer = Answer(True, OK, "")
        self.last_answered = 0.0
        self.last_outcome = ""
        self.last_border_id = ""
        self._durations = {State.GUIDE: 0.0, State.BORDER: 0.0, State.SEED: 0.0}
        self._counted_until = 0.0
        self._sources: List[str] = []
        self._visited: List[State] = []
        self._record: Optional[Record] = None

    # ------------------------------------------------------------------ commands
    def command(self, name: str, source: str, now: float) -> Answer:
        """Takes a command; never raises, never ignores.

        Args:
            name: one of COMMANDS; anything else is answered with "unknown_command".
            source: who gives it, for the record.
            now: [s].
        """
        self.advance(now)
        name = normalise(name)
        if self.saving:
            # not remembered as the last answer: the save that is under way will be
            return Answer(False, "busy", "The border is just being saved, one moment.")
        if name not in COMMANDS:
            return self._answered(
                name, source, False, "unknown_command", f"I know {', '.join(spoken(c) for c in COMMANDS)}."
            )
        if self.state != State.DEFAULT:
            self._note(source)
        if name == CANCEL:
            return self._cancel(source, now)
        if name == SAVE:
            return self._check_save(source)
        return self._enter(name, source, now)

    def finish_save(self, border_id: str, now: float) -> Answer:
        """The map has taken the border: the interaction ends, and with it its clock."""
        self.advance(now)
        self._end(SAVED, border_id, now)
        return self._answered(SAVE, self.last_source, True, OK, "Saved: the robot keeps out of this area now.")

    def refuse_save(self, code: str, message: str, now: float) -> Answer:
        """The border could not be added: nothing is lost, the interaction goes on in its state."""
        self.advance(now)
        self.saving = False
        return self._answered(SAVE, self.last_source, False, code, message)

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
        return self._answered(name, source, True, OK, self._prompt(target, again))

    def _prompt(self, target: State, again: bool) -> str:
        if target == State.BORDER:
            return "Go on drawing, what you drew is kept." if again else "Draw the border on the floor with the laser."
        if target == State.SEED:
            if again:
                return "Point again at the area to keep the robot out of."
            return "Point the laser at the area to keep the robot out of."
        return "The robot follows the laser spot, nothing is drawn."

    def _cancel(self, source: str, now: float) -> Answer:
        if self.state == State.DEFAULT:
            return self._answered(CANCEL, source, True, OK, "Nothing was under way.")
        self._end(CANCELLED, "", now)
        return self._answered(CANCEL, source, True, OK, "Cancelled, the map stays as it was.")

    def _check_save(self, source: str) -> Answer:
        if self.state == State.DEFAULT:
            return self._answered(
                SAVE, source, False, "nothing_to_save", "There is nothing to save: say define border first."
            )
        missing = self.missing()
        if missing == ["border", "seed"]:
            return self._answered(
                SAVE, source, False, "missing_border_and_seed",
                "Not saved: border and seed are missing. Say define border.",
            )
        if missing == ["border"]:
            return self._answered(
                SAVE, source, False, "missing_border", "Not saved: the border is missing. Say define border."
            )
        if missing == ["seed"]:
            return self._answered(
                SAVE, source, False, "missing_seed", "Not saved: the seed is missing. Say define seed."
            )
        self.saving = True
        return self._answered(SAVE, source, True, OK, "Saving the border.")

    # ------------------------------------------------------------------ what others ask
    def take_record(self) -> Optional[Record]:
        """The record of an interaction that has just ended, once; None if there is none."""
        record, self._record = self._record, None
        return record

    def missing(self) -> List[str]:
        """Which parts of a border the person has not begun yet: "border", "seed"."""
        wanted = (("border", State.BORDER), ("seed", State.SEED))
        return [word for word, state in wanted if state not in self._visited]

    def sensible_commands(self) -> List[str]:
        """The commands that bring a person further now, the most likely one first."""
        if self.saving:
            return []
        if self.state == State.DEFAULT:
            return [DEFINE_BORDER, GUIDE_ROBOT]
        missing = self.missing()
        steps = [SAVE] if not missing else []
        drawing = [DEFINE_BORDER, DEFINE_SEED]
        # what is still missing comes before what could be done again
        steps += sorted(
            (step for step in drawing if _ENTERS[step] != self.state),
            key=lambda step: (_ENTERS[step] in self._visited, drawing.index(step)),
        )
        if self.state != State.GUIDE:
            steps.append(GUIDE_ROBOT)
        return steps + [CANCEL]

    def durations(self, now: float) -> Dict[State, float]:
        """[s] per active state up to now; in Default, of the interaction that ended last."""
        result = dict(self._durations)
        if self.state != State.DEFAULT and now > self._counted_until:
            result[self.state] += now - self._counted_until
        return result

    def advance(self, now: float) -> None:
        """Counts the time up to now. Time that jumped back is counted from there on, nothing is taken off."""
        self._durations = self.durations(now)
        self._counted_until = now
        self.started, self.entered = min(self.started, now), min(self.entered, now)
        self.last_answered = min(self.last_answered, now)

    # ------------------------------------------------------------------ memory across a restart of the node
    def to_mapping(self) -> Dict[str, Any]:
        """Everything there is to remember, as plain values; inverse of `from_mapping`."""
        return {
            "state": self.state.name.lower(),
            "interaction_id": self.interaction_id,
            "started": self.started,
            "entered": self.entered,
            "counted_until": self._counted_until,
            "durations": {state.name.lower(): value for state, value in self._durations.items()},
            "sources": list(self._sources),
            "visited": [state.name.lower() for state in self._visited],
            "last_command": self.last_command,
            "last_source": self.last_source,
            "last_success": self.last_answer.success,
            "last_code": self.last_answer.code,
            "last_message": self.last_answer.message,
            "last_answered": self.last_answered,
            "last_outcome": self.last_outcome,
            "last_border_id": self.last_border_id,
        }

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any], new_id: Callable[[], str] = _new_id) -> "Interaction":
        """The interaction that was remembered; a save that was under way is not: say save again.

        Raises:
            CodedError: "bad_memory" if this is no memory of an interaction.
        """
        self = cls(new_id)
        try:
            self.state = State[mapping["state"].upper()]
            self.interaction_id = str(mapping["interaction_id"])
            self.started, self.entered = float(mapping["started"]), float(mapping["entered"])
            self._counted_until = float(mapping["counted_until"])
            for state in self._durations:
                self._durations[state] = float(mapping["durations"][state.name.lower()])
            self._sources = [str(source) for source in mapping["sources"]]
            self._visited = [State[name.upper()] for name in mapping["visited"]]
            self.last_command, self.last_source = str(mapping["last_command"]), str(mapping["last_source"])
            self.last_answer = Answer(
                bool(mapping["last_success"]), str(mapping["last_code"]), str(mapping["last_message"])
            )
            self.last_answered = float(mapping["last_answered"])
            self.last_outcome, self.last_border_id = str(mapping["last_outcome"]), str(mapping["last_border_id"])
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise CodedError("bad_memory", f"this is no memory of an interaction: {error!r}") from None
        numbers = [self.started, self.entered, self._counted_until, self.last_answered, *self._durations.values()]
        if not all(math.isfinite(number) for number in numbers) or min(self._durations.values()) < 0:
            raise CodedError("bad_memory", "this is no memory of an interaction: times must be finite")
        if (self.state == State.DEFAULT) != (self.interaction_id == ""):
            raise CodedError("bad_memory", "this is no memory of an interaction: state and id do not fit")
        return self

    # ------------------------------------------------------------------ inside
    def _begin(self, now: float) -> None:
        self.interaction_id = self._new_id()
        self.started = self.entered = self._counted_until = now
        self._durations = {state: 0.0 for state in self._durations}
        self._sources, self._visited = [], []

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
        self.saving = False
        self.started, self.entered = 0.0, now
        self._visited = []
        self.last_outcome, self.last_border_id = outcome, border_id

    def _note(self, source: str) -> None:
        if source and source not in self._sources:
            self._sources.append(source)

    def _answered(self, name: str, source: str, success: bool, code: str, message: str) -> Answer:
        self.last_command, self.last_source, self.last_answer = name, source, Answer(success, code, message)
        self.last_answered = self._counted_until
        return self.last_answer


def spoken(command: str) -> str:
    """A command as one says it: "define border"."""
    return command.replace("_", " ")
